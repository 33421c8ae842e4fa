"""Columns: dimensions, checks of their units, and round ends.

(R5) is in docs/forces.md.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from rockjax._checks import array_module, concrete, require, require_not_negative
from rockjax._types import Number
from rockjax._unit_warnings import warn_about_units

LARGEST_R = 100.0  # half diagonal that no real column exceeds [m]
DENSITIES = 300.0, 8000.0  # plausible range [kg/m³], from light timber or a hollow section to steel


def check_column_units(width, height, mass) -> None:
    """Warn if a column, with its full dimensions [m] and mass [kg], is larger than real columns, or if its
    density is implausible for a square section."""
    sides, mass = (concrete(width), concrete(height)), concrete(mass)
    if sides[0] is None or sides[1] is None:
        return
    R = float(np.max(0.5 * np.hypot(*sides)))
    if R > LARGEST_R:
        size = f"a column of {np.max(sides[0]):g} m by {np.max(sides[1]):g} m has R = {R:.4g} m"
        warn_about_units(
            f"Podium.from_dimensions: {size}; width and height are in m, were they meant in mm?", stacklevel=3
        )
    elif mass is not None:
        _check_density(*np.broadcast_arrays(*sides, mass))


def _check_density(width: np.ndarray, height: np.ndarray, mass: np.ndarray) -> None:
    """Warn if the density of a square column is outside `DENSITIES`."""
    density = mass / (width**2 * height)
    low, high = DENSITIES
    is_unlikely = (density < low) | (density > high)
    if is_unlikely.any():
        b, h, m, rho = (float(y[is_unlikely].flat[0]) for y in (width, height, mass, density))
        advice = (
            "masses are in kg, were they meant in t?" if rho < low else "masses are in kg, dimensions in m"
        )
        column = f"a square column of {b:g} m by {b:g} m by {h:g} m"
        warn_about_units(
            f"Podium.from_dimensions: column_mass = {m:g} kg makes {column} {rho:.3g} kg/m³ dense, outside "
            f"{low:g} to {high:g}; {advice}",
            stacklevel=4,
        )


def slenderness_and_size(width: Number, height: Number) -> tuple[Number, Number]:
    """Return slenderness α [rad] and half diagonal R [m] of a column of full width 2B and full height 2H [m],
    Eq. (1)."""
    xp = array_module(width, height)
    return xp.arctan(width / height), 0.5 * xp.sqrt(width**2 + height**2)


def enlargement(owner: str, radius: Number, height: Number) -> Number:
    """Return H/(H − r_c), the factor on R that makes a podium with flat column ends equivalent to a podium
    with round ends of the radius r_c, 0 ≤ r_c < H [m], (R5). `height` is the full height 2H of a column [m].
    Raises `ValueError` for a radius out of range, unless it is traced."""
    require_not_negative(owner, end_radius=radius)
    half_height = 0.5 * height
    radii, limits = concrete(radius), concrete(half_height)
    if radii is not None and limits is not None:
        radii, limits = np.broadcast_arrays(radii, limits)
        limit = float(limits[radii >= limits].min(initial=np.inf))
        accepted = f"less than half the height, {limit:g} m (a column with rounder ends never overturns)"
        require(owner, "end_radius", radii, lambda v: v < limits, accepted)
    return half_height / (half_height - radius)


def g_tan_alpha(alpha: Number, g: Number) -> Number:
    """Return g tan α [m/s²], the unit of dimensionless ground accelerations, Eq. (5)."""
    return g * jnp.tan(alpha)
