"""Restrainers from parameters in SI units."""

from __future__ import annotations

from rockjax._checks import array_module, as_numpy_unless_traced, require, require_not_negative
from rockjax._types import Number

from .base import AbstractRestrainer
from .damper import Damper
from .inerter import Inerter
from .tendon import Tendon


def restrainers_of(
    owner: str, mass: Number, R: Number, g: Number, force, stiffness, coefficient, exponent, inertance
) -> tuple[AbstractRestrainer, ...]:
    """Return the restrainers of a column from parameters in SI units. A device is left out if its parameters,
    not counting the exponent, are the Python number 0. Raises `ValueError` for values out of range; traced
    values are not checked.

    - `mass` [kg], `R` [m], `g` [m/s²]: mass and half diagonal of the column, acceleration of gravity
    - `force`, `stiffness`: initial force [N] and stiffness [N/m] of the tendon
    - `coefficient`, `exponent`: coefficient [N(s/m)^ν] and exponent ν of the damper
    - `inertance`: inertance of the inerter [kg]
    """
    require_not_negative(
        owner,
        tendon_force=force,
        tendon_stiffness=stiffness,
        damper_coefficient=coefficient,
        inertance=inertance,
    )
    require(owner, "damper_exponent", exponent, lambda v: (v > 0) & (v <= 1), "in (0, 1]")
    is_zero = lambda value: isinstance(value, int | float) and value == 0
    weight, restrainers = mass * g, []
    if not (is_zero(force) and is_zero(stiffness)):
        restrainers.append(
            Tendon(as_numpy_unless_traced(force) / weight, as_numpy_unless_traced(stiffness) * R / weight)
        )
    if not is_zero(coefficient):
        speed = array_module(g, R).sqrt(0.75 * g * R)  # Rp
        restrainers.append(
            Damper(
                as_numpy_unless_traced(coefficient) * speed ** as_numpy_unless_traced(exponent) / weight,
                exponent,
            )
        )
    if not is_zero(inertance):
        restrainers.append(Inerter(as_numpy_unless_traced(inertance) / mass))
    return tuple(restrainers)
