"""A barrier against repeated computation by the compiler.

XLA splits an integration step into kernels, which are loops over the scenes of a batch. Without barriers,
every kernel that needs an intermediate result computes it again. A barrier stores its values, and all later
kernels read them.
"""

from __future__ import annotations

from typing import TypeVar

import jax

T = TypeVar("T")


def barrier(values: T) -> T:
    """Put values behind an optimisation barrier, so that later kernels do not compute them again."""
    return jax.lax.optimization_barrier(values)
