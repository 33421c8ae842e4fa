"""A barrier against repeated computation by the compiler.

XLA splits a step into kernels, loops over lanes, and computes in each kernel again all intermediate results
that it needs, back to stored values. Values behind the barrier are stored once and read by all kernels.
"""

from __future__ import annotations

from typing import TypeVar

import jax

T = TypeVar("T")


def barrier(values: T) -> T:
    """Return the values behind an optimisation barrier, so that later kernels do not compute them again."""
    return jax.lax.optimization_barrier(values)
