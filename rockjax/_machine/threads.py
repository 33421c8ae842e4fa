"""Threads with the JAX precision of the thread that starts them."""

from __future__ import annotations

import contextlib
import importlib
import os
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, as_completed, wait
from typing import Any

import jax

# Modules for tables, in the order in which xarray imports them for the first Dataset (dask if installed).
# This order matters: if two threads begin to import a package with different modules, one thread may see an
# incomplete module.
TABLE_MODULES = "xarray", "dask.base", "dask.array"

# The thread pool, once it exists. It starts another thread whenever none is idle, up to 1024, so that waiting
# threads do not block other work. All threads finish their work before the process ends.
_POOLS: list[ThreadPoolExecutor] = []
_IMPORTS: list[Future] = []  # imports in other threads, until `wait_for_imports`
if hasattr(os, "register_at_fork"):  # threads do not exist in a forked process
    os.register_at_fork(after_in_child=_POOLS.clear)
    os.register_at_fork(after_in_child=_IMPORTS.clear)


def submit(work: Callable, *arguments: Any) -> Future:
    """Run `work(*arguments)` in another thread, with the floating-point precision of this thread; each
    thread has its own precision setting in JAX."""
    x64 = bool(jax.config.jax_enable_x64)  # pyright: ignore[reportAttributeAccessIssue]

    def run() -> Any:
        with jax.enable_x64(x64):
            return work(*arguments)

    if not _POOLS:
        _POOLS.append(ThreadPoolExecutor(1024, "rockjax"))
    return _POOLS[0].submit(run)


def run_in_threads(work: Callable[[], None], count: int, stop: threading.Event, *, raises: bool) -> None:
    """Run `work()` in several threads, and wait until all have ended.

    - `work`: function that ends soon after `stop` is set
    - `count`: number of threads; 1 runs `work` in this thread
    - `stop`: event that stops the work; Ctrl-C and any exception set it
    - `raises`: whether Ctrl-C raises `KeyboardInterrupt`; other exceptions are always raised
    """
    futures: list[Future] = []
    try:
        if count == 1:
            work()
        else:
            futures += [submit(work) for _ in range(count)]
            for future in as_completed(futures):
                future.result()
    except BaseException as error:
        stop.set()
        wait(futures)
        if raises or not isinstance(error, KeyboardInterrupt):
            raise


def import_in_background(*modules: str) -> None:
    """Import modules in another thread, for example modules for tables, while this thread computes scenes."""

    def load() -> None:
        for name in modules:
            with contextlib.suppress(ImportError):  # code that needs the module raises it again
                importlib.import_module(name)

    _IMPORTS.append(submit(load))


def wait_for_imports() -> None:
    """Wait until `import_in_background` has imported its modules. Otherwise, if two threads import packages
    that import each other, such as dask and distributed, one thread may see an incomplete module."""
    wait(_IMPORTS)
    _IMPORTS.clear()
