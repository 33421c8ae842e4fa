import collections
import fnmatch
import os
import signal
import sys
from pathlib import Path

os.environ.setdefault("MPLBACKEND", "Agg")
# Programs compiled by one worker, and by one module, serve the others.
os.environ["ROCKJAX_CACHE_DIR"] = str(Path(__file__).parent.parent / ".pytest_cache" / "rockjax")

import jax
import pytest

from rockjax._programs.program import forget

jax.config.update("jax_numpy_rank_promotion", "raise")


def pytest_configure(config):
    # Jobs in the background of a shell ignore SIGINT, and so would the processes that tests start and stop.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    # What is traced anew: at least it is not compiled anew.
    cache = Path(config.rootpath) / ".pytest_cache" / "jax"
    jax.config.update("jax_compilation_cache_dir", str(cache))
    # Also single operations: another module, or the other worker, asks for the same ones.
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config, items):
    """`slow(but=[…])`: the cases whose names match one of these are not.

    Modules with most slow tests first, whether they run or not: what is left of them takes longest as well,
    and the workers then end at about the same time (with `--no-loadscope-reorder`).
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
    if not any("::" in argument for argument in config.args):  # all cases are there
        for (path, test), names in without_a_case.items():
            if names:
                raise pytest.UsageError(f"{path}: {test}: slow(but={sorted(names)}) is the name of no case")
    slow = collections.Counter(item.path for item in items if item.get_closest_marker("slow"))
    items.sort(key=lambda item: -slow[item.path])


def pytest_sessionstart():
    assert jax.config.jax_enable_x64


@pytest.fixture(scope="module", autouse=True)
def _forget_programs():
    """Compiled programs hold memory maps, of which a process may have 65530 on Linux: a whole run would need
    more.

    And open figures of one module would make matplotlib warn in another.
    """
    yield
    forget()
    jax.clear_caches()
    if "matplotlib.pyplot" in sys.modules:
        sys.modules["matplotlib.pyplot"].close("all")


# Where numbers of different types meet only on purpose. (Of the engine, tests/engine/typed.py looks at that.)
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
