"""The column: its size, and the acceleration that lifts it."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from rockjax._checks import array_module, concrete
from rockjax._plausibility import doubt
from rockjax._types import Number

STANDARD_GRAVITY = 9.80665
LARGEST_R = 100.0  # m: no column of that size was ever left free to rock


def doubt_size(width, height) -> None:
    sides = concrete(width), concrete(height)
    if sides[0] is None or sides[1] is None:
        return
    R = float(np.max(0.5 * np.hypot(*sides)))
    if R > LARGEST_R:
        size = f"a column of {np.max(sides[0]):g} m by {np.max(sides[1]):g} m has R = {R:.4g} m"
        doubt(
            f"Podium.from_dimensions: {size}; width and height are in m, were they meant in mm?", stacklevel=3
        )


def column_of(width: Number, height: Number) -> tuple[Number, Number]:
    """Slenderness α [rad] and half diagonal R [m] of a column of full width 2B and full height 2H [m], Eq.
    (1)."""
    numpy = array_module(width, height)
    return numpy.arctan(width / height), 0.5 * numpy.sqrt(width**2 + height**2)


def g_tan_alpha(alpha: Number, g: Number) -> Number:
    """What ground accelerations are measured by [m/s²], Eq. (5)."""
    return g * jnp.tan(alpha)
