"""Logarithmic derivatives of overturning boundaries by the implicit function theorem."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


def along_boundary(
    footing: Callable[[Float[Array, " n+1"]], Float[Array, ""]], number: int, dtype
) -> Float[Array, " n"]:
    """d ln a/d ln y by the implicit function theorem, NaN where it says nothing.

    `footing` has a zero on the boundary; it is a function of ln a and of `number` logarithms ln y, relative
    to now.
    """
    slope = jax.jacfwd(footing)(jnp.zeros(1 + number, dtype))
    usable = (slope[0] != 0) & jnp.all(jnp.isfinite(slope))
    return jnp.where(usable, -slope[1:] / jnp.where(usable, slope[0], 1.0), jnp.nan)
