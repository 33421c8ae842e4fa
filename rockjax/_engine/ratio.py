"""Quotients that are safe to differentiate."""

from __future__ import annotations

import jax.numpy as jnp

from rockjax._types import Flags, Values


def safe_ratio(a: Values, b: Values, is_valid: Flags) -> Values:
    """Return a/b where `is_valid` holds and b ≠ 0, else 0.

    With a zero denominator, neither the value nor its derivatives are NaN.
    """
    divides = is_valid & (b != 0)
    return jnp.where(divides, a, 0.0) / jnp.where(divides, b, 1.0)
