"""Maxima of smooth quantities over one step, from the quintic through both ends."""

from __future__ import annotations

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp

from rockjax._once import once
from rockjax._types import Value, Values

from .hermite import Quintic, derivative, turning_point
from .ratio import safe_ratio

# An extremum is landed on when it would raise the record and lies well inside the step; near the ends the
# polynomial is as good as the step itself.
NEAR_RECORD = 1e-2
WELL_INSIDE = 0.02
WELL_INSIDE_CUBIC = 1e-4
ON_SUMMIT = 1e-4
ROUNDING = 64  # times the resolution of numbers


class Maximum(NamedTuple):
    """The largest |f| over a step, and how far to shorten the step to land on it; of one quantity, or of
    several in a row."""

    value: Values
    cut: Values  # fraction of the step, inf where there is no need


def summit(path, end: float) -> Values:
    """Where the path turns, if that is within rounding of an end of the step, else the end itself; a
    constant.

    An extremum on which a step ends has the value of that end, but not its derivative: it moves with the
    parameters.
    """
    path = jax.lax.stop_gradient(path)
    slope, curvature = path.slope(end), path.curvature(end)
    flat = curvature != 0
    time_past_end = -slope / jnp.where(flat, curvature, 1.0)
    return jnp.where(flat & (jnp.abs(time_past_end) <= ON_SUMMIT), end + time_past_end, end)


class End(NamedTuple):
    """An end of a step: the quantity, its rate in time, and how far past its time stamp the end lies [s]."""

    value: Values
    rate: Values
    past: Value


@functools.partial(jax.jit, static_argnames="inside")
def largest(
    path: Quintic, h: Value, record: Values, ends: tuple[End, End], inside: float = WELL_INSIDE
) -> Maximum:
    """max|f| over a step of length h from its path f(z) (value, slope, curvature) on z ∈ [0, 1], and its
    ends."""
    turned = ends[0].rate * ends[1].rate < 0
    z = turning_point(jax.lax.stop_gradient(path), ends[0].rate > 0)
    value = jnp.where(turned, jnp.abs(path.value(z)), -jnp.inf)
    for place, end in zip((0.0, 1.0), ends, strict=True):
        on_summit = once(summit(path, place))
        curvature = path.curvature(jnp.full_like(h, place))
        # Over a very short step it is a difference of nearly equal numbers, and not needed.
        bend = safe_ratio(curvature, h * h, jnp.abs(curvature) > 1e-8 * jnp.abs(end.value))
        past_end = end.value + end.past * (end.rate + 0.5 * end.past * bend)
        there = jnp.where(on_summit == place, past_end, path.value(on_summit))
        value = jnp.where(jnp.abs(there) > value, jnp.abs(there), value)
    value = once(value)
    # In a short hop the quantity hardly changes: a maximum that the ends have to rounding is not landed on.
    of_ends = jnp.maximum(jnp.abs(ends[0].value), jnp.abs(ends[1].value))
    stands_out = jax.lax.stop_gradient(value > of_ends * (1 + ROUNDING * jnp.finfo(h.dtype).eps))
    raises = turned & stands_out & (value > record * (1 - NEAR_RECORD)) & (z > inside) & (z < 1 - inside)
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
