"""Threads that compute like the one that starts them."""

from __future__ import annotations

import contextlib
import importlib
import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait

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


def meanwhile(work: Callable[[], object], name: str | None = None) -> None:
    """Do what will be done again, in a thread that computes like this one; its errors are said then."""
    work = _as_here(work)

    def run() -> None:
        with contextlib.suppress(Exception):
            work()

    threading.Thread(target=run, name=name).start()


class Pool(ThreadPoolExecutor):
    """A thread pool whose threads have the floating-point precision of the caller, which JAX keeps for each
    thread."""

    def __init__(self, threads: int):
        super().__init__(threads)
        self._submitted: list[Future] = []

    def submit(self, fn, /, *args, **kwargs) -> Future:
        future = super().submit(_as_here(fn), *args, **kwargs)
        self._submitted.append(future)
        return future

    def finish(self) -> None:
        """Wait for all that was submitted."""
        wait(self._submitted)
        self._submitted.clear()


_IDLE: dict[int, list[Pool]] = {}  # by their number of threads
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_IDLE.clear)  # a forked process has none of their threads


@contextlib.contextmanager
def borrowed_pool(threads: int) -> Iterator[Pool]:
    """A pool that others use when this one is through: to start a thread takes as long as some scenes.

    Left only when all that was submitted has ended.
    """
    idle = _IDLE.setdefault(threads, [])
    try:
        pool = idle.pop()
    except IndexError:
        pool = Pool(threads)
    try:
        yield pool
    finally:
        pool.finish()
        idle.append(pool)


def _as_here(function: Callable) -> Callable:
    """The same function for another thread, with the floating-point precision of this one."""
    x64 = bool(jax.config.jax_enable_x64)  # pyright: ignore[reportAttributeAccessIssue]

    def run(*args, **kwargs):
        with precision(x64):
            return function(*args, **kwargs)

    return run


def precision(x64: bool):
    """In this context and thread, float64 or float32."""
    if hasattr(jax, "enable_x64"):
        return jax.enable_x64(x64)
    return jax.experimental.enable_x64(x64)  # pyright: ignore[reportAttributeAccessIssue]
