"""Quotients that are safe to differentiate."""

from __future__ import annotations

import jax.numpy as jnp

from rockjax._types import Flags, Values


def safe_ratio(a: Values, b: Values, wanted: Flags) -> Values:
    """a/b where wanted, else 0; never a NaN, in derivatives neither."""
    good = wanted & (b != 0)
    return jnp.where(good, a, 0.0) / jnp.where(good, b, 1.0)
