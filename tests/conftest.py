import collections
import fnmatch
import os
import signal
import sys
from pathlib import Path

os.environ.setdefault("MPLBACKEND", "Agg")
# Workers and modules share their compiled programs.
os.environ["ROCKJAX_CACHE_DIR"] = str(Path(__file__).parent.parent / ".pytest_cache" / "rockjax")
# Functions that tests compile need as little time for it as stored programs. Workers inherit the flag, which
# must not occur twice, because it belongs to the keys of stored programs.
os.environ["XLA_FLAGS"] = " ".join(
    dict.fromkeys([*os.environ.get("XLA_FLAGS", "").split(), "--xla_backend_optimization_level=1"])
)
# Processes that tests start inherit this setting, and so use the same stored programs.
os.environ["JAX_NUMPY_RANK_PROMOTION"] = "raise"

import jax
import pytest

from rockjax._programs.program import forget


def pytest_configure(config):
    # Jobs in the background of a shell ignore SIGINT, and so would the processes that tests start and stop.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    # A program that is traced again need not be compiled again.
    cache = Path(config.rootpath) / ".pytest_cache" / "jax"
    jax.config.update("jax_compilation_cache_dir", str(cache))
    # This includes single operations, because other modules and workers use the same ones.
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config, items):
    """Select the slow tests: `slow(but=[…])` excepts the cases whose names match one of the list.

    Modules with the most slow tests run first, even if these tests are skipped, because their other tests
    take the longest too. The workers then end at about the same time (with `--no-loadscope-reorder`).
    """
    without_a_case: dict[tuple[str, str], set[str]] = {}
    for item in items:
        mark = item.get_closest_marker("slow")
        kept = mark.kwargs.get("but", ()) if mark else ()
        if not kept:
            continue
        own = {name for name in kept if fnmatch.fnmatchcase(item.callspec.id, name)}
        without_a_case.setdefault((str(item.path), item.originalname), set(kept)).difference_update(own)
        if own:
            item.own_markers[:] = [m for m in item.own_markers if m.name != "slow"]
    if not any("::" in argument for argument in config.args):  # no single case was requested
        for (path, test), names in without_a_case.items():
            if names:
                raise pytest.UsageError(f"{path}: {test}: slow(but={sorted(names)}) is the name of no case")
    slow = collections.Counter(item.path for item in items if item.get_closest_marker("slow"))
    items.sort(key=lambda item: -slow[item.path])


def pytest_sessionstart():
    assert jax.config.jax_enable_x64
    assert jax.config.jax_numpy_rank_promotion == "raise"


@pytest.fixture(scope="module", autouse=True)
def _forget_programs():
    """Clear compiled programs and close figures after each module. Programs use memory maps, of which Linux
    allows 65530 per process; a complete run would need more. Open figures would cause warnings in the next
    module.
    """
    yield
    forget()
    jax.clear_caches()
    if "matplotlib.pyplot" in sys.modules:
        sys.modules["matplotlib.pyplot"].close("all")


# In these modules, numbers of different types are combined only on purpose. (tests/engine/typed.py checks the
# engine.)
STRICT = ("excitations", "motions", "parameters")


@pytest.fixture(scope="module", autouse=True)
def _strict_types(request):
    strict = request.path.parent.name in STRICT
    with jax.numpy_dtype_promotion("strict" if strict else "standard"):
        yield


@pytest.fixture(params=["block", "frame", "rigid", "elastic"])
def podium(request):
    from .scenes import PODIUMS

    return PODIUMS[request.param]
