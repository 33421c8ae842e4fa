"""Threads that compute like the one that starts them."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor

import jax


class Pool(ThreadPoolExecutor):
    """A thread pool whose threads have the floating-point precision of the caller, which JAX keeps for each thread."""

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
