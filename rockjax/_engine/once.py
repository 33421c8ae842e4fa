"""Numbers that the compiler works out once.

XLA makes kernels of a step, loops over lanes, and works out in each kernel again what it needs of the others,
back to what is stored: in a trial of an elastic podium half of all operations. Numbers that several kernels
need are stored here, and read again.
"""

from __future__ import annotations

from typing import TypeVar

import jax

T = TypeVar("T")


def once(values: T) -> T:
    """The same values, that nothing behind them works out again."""
    return jax.lax.optimization_barrier(values)
