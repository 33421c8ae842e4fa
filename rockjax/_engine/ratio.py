"""Quotients that are safe to differentiate."""

from __future__ import annotations

import jax.numpy as jnp

from rockjax._types import Flags, Values


def safe_ratio(a: Values, b: Values, wanted: Flags) -> Values:
    """Return a/b where wanted, else 0; neither the value nor its derivatives are ever NaN."""
    good = wanted & (b != 0)
    return jnp.where(good, a, 0.0) / jnp.where(good, b, 1.0)
