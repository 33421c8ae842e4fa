"""Maxima of smooth quantities over one step, from the quintic through both ends."""

from __future__ import annotations

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp

from rockjax._engine.once import once
from rockjax._types import Flag, Value, Values

from .hermite import Quintic, derivative, turning_point_or_dip
from .ratio import safe_ratio

# An extremum is landed on when it would raise the record and lies well inside the step; near the ends the
# polynomial is as good as the step itself.
NEAR_RECORD = 1e-2
WELL_INSIDE = 0.02
# … of what vibrates, whose derivatives grow with every swing.
WELL_INSIDE_QUINTIC = 2e-3
WELL_INSIDE_CUBIC = 1e-4
ROUNDING = 64  # times the resolution of numbers


class Maximum(NamedTuple):
    """The largest |f| over a step, and how far to shorten the step to land on it; of one quantity, or of
    several in a row."""

    value: Values
    cut: Values  # fraction of the step, inf where there is no need


class End(NamedTuple):
    """An end of a step: the quantity, its rate in time, and how far past its time stamp the end lies [s]."""

    value: Values
    rate: Values
    past: Value


@functools.partial(jax.jit, static_argnames=("inside", "lands"))
def largest(
    path: Quintic,
    h: Value,
    long: Flag,
    record: Values,
    ends: tuple[End, End],
    inside: float = WELL_INSIDE_QUINTIC,
    lands: bool = True,
) -> Maximum:
    """Return max|f| over a step of length h, and where to shorten the step to land on it.

    - `path`: f(z) on z ∈ [0, 1], with its value, slope and curvature at both ends
    - `long`: whether the curvatures of the path are more than rounding, `hermite.is_long`
    - `record`: largest |f| so far
    - `ends`: f and its rate at both ends; an end that is an event or a breakpoint moves with the parameters
    - `inside`: part of the step at both ends where an extremum need not be landed on
    - `lands`: whether extrema are landed on

    A step over which f turns twice is cut between both extrema where they could raise the record.
    """
    rates, sizes = [end.rate for end in ends], [jnp.abs(end.value) for end in ends]
    turned = rates[0] * rates[1] < 0
    z, dips = turning_point_or_dip(jax.lax.stop_gradient(path), turned, rates[0] > 0)
    at_z = jnp.abs(path.value(z))
    value = jnp.where(turned, at_z, -jnp.inf)
    of_rates = safe_ratio(rates[1] - rates[0], h, h > 0)
    for place, end in zip((0.0, 1.0), ends, strict=True):
        bend = jnp.where(long, safe_ratio(path.curvature(jnp.full_like(h, place)), h * h, h > 0), of_rates)
        size = jnp.abs(end.value + end.past * (end.rate + 0.5 * end.past * bend))
        value = jnp.where(size > value, size, value)
    value = once(value)
    # In a short hop the quantity hardly changes: a maximum that the ends have to rounding is not landed on.
    of_ends = jnp.maximum(*sizes)
    stands_out = jax.lax.stop_gradient(value > of_ends * (1 + ROUNDING * jnp.finfo(h.dtype).eps))
    near = record * (1 - NEAR_RECORD)
    raises = lands & turned & stands_out & (value > near)
    raises |= long & dips & (jnp.maximum(of_ends, at_z + jnp.abs(path.slope(z))) > near)
    raises &= (z > inside) & (z < 1 - inside)
    return Maximum(value, jnp.where(raises, z, jnp.inf))


def spring(deformation: Quintic, omega2: Values, damping: Values, h: Value) -> Quintic:
    """ω² d + 2ζω ḋ, the spring and damper force of a deformation polynomial, Eq. (7), over a step of length
    h."""
    rates = [*derivative(deformation), jnp.zeros_like(h)]
    return Quintic(*(omega2 * c + damping / h * rate for c, rate in zip(deformation, rates, strict=True)))


def cubic(f0: Values, rate0: Values, f1: Values, rate1: Values, h: Value) -> Quintic:
    """The cubic Hermite polynomial, for a quantity whose curvature is not at hand."""
    m0, m1, rise = h * rate0, h * rate1, f1 - f0
    zero = jnp.zeros_like(f0)
    return Quintic(f0, m0, 3 * rise - 2 * m0 - m1, m0 + m1 - 2 * rise, zero, zero)
