"""Threads that compute like the one that starts them."""

from __future__ import annotations

import contextlib
import importlib
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor

import jax

TABLES = "xarray", "dask.array"  # xarray imports the latter for its first Dataset, where it is installed


def import_meanwhile(*modules: str) -> None:
    """Import what is needed at the end (to make tables, to draw) while the scenes are worked out."""

    def load() -> None:
        # The first is said where the module is needed, the second where the process has ended meanwhile.
        with contextlib.suppress(ImportError, RuntimeError):
            for name in modules:
                importlib.import_module(name)

    threading.Thread(target=load).start()


def meanwhile(work: Callable[[], object]) -> None:
    """Do what will be done once more, and then say its errors, in a thread that computes like this one."""
    x64 = bool(jax.config.jax_enable_x64)  # pyright: ignore[reportAttributeAccessIssue]

    def run() -> None:
        with contextlib.suppress(Exception), precision(x64):
            work()

    threading.Thread(target=run).start()


class Pool(ThreadPoolExecutor):
    """A thread pool whose threads have the floating-point precision of the caller, which JAX keeps for each
    thread."""

    def submit(self, fn, /, *args, **kwargs) -> Future:
        x64 = bool(jax.config.jax_enable_x64)  # pyright: ignore[reportAttributeAccessIssue]

        def run():
            with precision(x64):
                return fn(*args, **kwargs)

        return super().submit(run)


def precision(x64: bool):
    """In this context and thread, float64 or float32."""
    if hasattr(jax, "enable_x64"):
        return jax.enable_x64(x64)
    return jax.experimental.enable_x64(x64)  # pyright: ignore[reportAttributeAccessIssue]
