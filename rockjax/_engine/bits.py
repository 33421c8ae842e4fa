"""Roots and logarithms that need not be exact, from the bits of floating-point numbers.

Of many lanes those of the library are worked out one by one.
"""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp

from rockjax._types import Value

_MANTISSA = {"float64": 52, "float32": 23}  # bits


def inverse_eighth_root(y: Value) -> Value:
    """y^(−1/8) of positive numbers to 1 %: the bits of a floating-point number are nearly its logarithm, and
    one step of Newton."""
    kind, mantissa, one = _layout(y)
    logarithm = jax.lax.shift_right_logical(jax.lax.bitcast_convert_type(y, kind), jnp.asarray(3, kind))
    # Between powers of 2 the bits go up in a straight line, which is below the logarithm: half of the most.
    bits = one + (one >> 3) - logarithm - jnp.asarray(int(0.0485 * 2**mantissa), kind)
    root = jax.lax.bitcast_convert_type(bits, y.dtype)
    return root * (9 - y * root**8) / 8


def rough_logarithm(y: Value) -> Value:
    """The natural logarithm of numbers ≥ 1, to 2e-4: of the exponent exactly, and from one power of 2 to the
    next nearly a straight line."""
    kind, mantissa, one = _layout(y)
    bits = jax.lax.bitcast_convert_type(y, kind) - one
    exponent = (bits >> jnp.asarray(mantissa, kind)).astype(jnp.int32).astype(y.dtype)
    rest = bits & jnp.asarray(2**mantissa - 1, kind)
    x = jax.lax.bitcast_convert_type(rest + one, y.dtype) - 1
    return math.log(2) * (exponent + x + x * (1 - x) * (0.43918 - x * (0.23965 - x * 0.081626)))


def _layout(y: Value) -> tuple[Any, int, Any]:
    """The integers of the size of y, how many bits the mantissa has, and 1 as an integer."""
    kind = jnp.int64 if y.dtype == jnp.float64 else jnp.int32
    return kind, _MANTISSA[str(y.dtype)], jax.lax.bitcast_convert_type(jnp.ones((), y.dtype), kind)
