"""A barrier against repeated computation by the compiler.

XLA splits a step into kernels, which are loops over the scenes of a batch. Every kernel computes all
intermediate results again that it needs, back to stored values. Values behind the barrier are stored
once, and all kernels read them.
"""

from __future__ import annotations

from typing import TypeVar

import jax

T = TypeVar("T")


def barrier(values: T) -> T:
    """Return the values behind an optimisation barrier, so that later kernels do not compute them again."""
    return jax.lax.optimization_barrier(values)
