import os
from pathlib import Path

# One thread pool per worker process is enough: the workers already fill the cores.
os.environ.setdefault("MPLBACKEND", "Agg")

import jax
import pytest

import rockjax as rj

jax.config.update("jax_numpy_rank_promotion", "raise")


def pytest_configure(config):
    # Programs compiled by one worker serve the others.
    cache = Path(config.rootpath) / ".pytest_cache" / "jax"
    jax.config.update("jax_compilation_cache_dir", str(cache))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 1.0)


def pytest_sessionstart():
    assert jax.config.jax_enable_x64


@pytest.fixture(params=["block", "frame", "rigid", "elastic"])
def podium(request):
    from .scenes import PODIUMS

    return PODIUMS[request.param]


@pytest.fixture
def tight():
    return rj.Options(rtol=1e-12, atol=1e-14, method="dopri8")
