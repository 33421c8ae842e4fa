"""Maxima of smooth quantities over one step, from the quintic through both ends."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, Literal, NamedTuple, Protocol

import jax
import jax.numpy as jnp

from rockjax._engine.hermite import Quintic, derivative
from rockjax._engine.ratio import safe_ratio
from rockjax._programs.barrier import barrier
from rockjax._types import Flag, Flags, Value, Values

# A step is shortened to end on an extremum that would raise the record and lies well inside the step. Near
# the ends the polynomial is as accurate as the step itself.
NEAR_RECORD = 1e-2
WELL_INSIDE = 0.02
# Limits for the vibrating superstructure, whose derivatives grow with every swing.
WELL_INSIDE_QUINTIC = 2e-3
WELL_INSIDE_CUBIC = 1e-4
ROUNDING = 64  # times the resolution of numbers


class Cubic(NamedTuple):
    """A polynomial c0 + c1 z + c2 z² + c3 z³ of one quantity, or of several in a row."""

    c0: Values
    c1: Values
    c2: Values
    c3: Values

    def value(self, z: Values | float) -> Values:
        return self.c0 + z * (self.c1 + z * (self.c2 + z * self.c3))

    def slope(self, z: Values | float) -> Values:
        return self.c1 + z * (2 * self.c2 + z * (3 * self.c3))

    def curvature(self, z: Values | float) -> Values:
        return 2 * self.c2 + z * (6 * self.c3)

    def turning_point_or_dip(self, turned: Flags, rising: Flags) -> tuple[Values, Flags]:
        """Return the same as `hermite.turning_point_or_dip`: the slope a + b z + c z² has roots in closed
        form."""
        sign = jnp.where(rising, 1.0, -1.0)
        a, b, c = (sign * y for y in derivative(self))
        opens = b > 0  # the slope rises at z = 0, and falls to its zero later
        q = -0.5 * (b + jnp.where(opens, 1.0, -1.0) * jnp.sqrt(jnp.maximum(b * b - 4 * a * c, 0.0)))
        may_dip = ~turned & (b < 0) & (b + 2 * c > 0)
        numerator = jnp.where(turned, jnp.where(opens, q, a), -b)
        denominator = jnp.where(turned, jnp.where(opens, c, q), 2 * c)
        z = jnp.clip(numerator / jnp.where(denominator == 0, 1.0, denominator), 0.0, 1.0)
        noise = 128 * jnp.finfo(z.dtype).eps * jnp.abs(self.c0)
        return z, may_dip & (a + z * (b + z * c) < -noise)


Sizes = Literal["absolute", "signed", "both"]
_SIZES: dict[str, Callable[[Values], Values]] = {
    "absolute": jnp.abs,
    "signed": lambda y: y,
    "both": lambda y: jnp.concatenate([-y, y]),
}


class Path(Protocol):
    """A quantity f(z) over a step, z ∈ [0, 1]."""

    def value(self, z: Any) -> Values: ...
    def slope(self, z: Any) -> Values: ...
    def curvature(self, z: Any) -> Values: ...
    def turning_point_or_dip(self, turned: Flags, rising: Flags) -> tuple[Values, Flags]: ...


class Maximum(NamedTuple):
    """The largest |f| over a step, and the shorter step that ends on it; of one quantity, or of several in a
    row."""

    value: Values
    cut: Values  # fraction of the step, inf where no shorter step is needed


class End(NamedTuple):
    """An end of a step: the quantity, its rate in time, and how far past its time stamp the end lies [s]."""

    value: Values
    rate: Values
    past: Value


@functools.partial(jax.jit, static_argnames=("inside", "lands", "sizes"))
def largest(
    path: Path,
    h: Value,
    long: Flag,
    record: Values,
    ends: tuple[End, End],
    inside: float = WELL_INSIDE_QUINTIC,
    lands: bool = True,
    sizes: Sizes = "absolute",
) -> Maximum:
    """Return max|f| over a step of length h, and where to shorten the step to land on it.

    - `path`: f(z) on z ∈ [0, 1], with its value, slope and curvature at both ends
    - `long`: whether the curvatures of the path are more than rounding, `hermite.is_long`
    - `record`: largest |f| so far
    - `ends`: f and its rate at both ends; an end that is an event or a breakpoint moves with the parameters
    - `inside`: part of the step at both ends where an extremum need not be landed on
    - `lands`: whether extrema are landed on
    - `sizes`: "absolute" for max|f|, "signed" for max f, "both" for max(−f) and then max f in records and
      values; in the last two these may be negative

    A step over which f turns twice is cut between both extrema where they could raise the record.
    """
    size_of = _SIZES[sizes]
    each = (lambda y: jnp.concatenate([y, y])) if sizes == "both" else (lambda y: y)
    rates, of_each_end = [end.rate for end in ends], [size_of(end.value) for end in ends]
    turned = rates[0] * rates[1] < 0
    z, dips = barrier(jax.lax.stop_gradient(path).turning_point_or_dip(turned, rates[0] > 0))
    at_z = size_of(path.value(z))
    value = jnp.where(each(turned), at_z, -jnp.inf)
    of_rates = safe_ratio(rates[1] - rates[0], h, h > 0)
    for place, end in zip((0.0, 1.0), ends, strict=True):
        bend = jnp.where(long, safe_ratio(path.curvature(jnp.full_like(h, place)), h * h, h > 0), of_rates)
        size = size_of(end.value + end.past * (end.rate + 0.5 * end.past * bend))
        value = jnp.where(size > value, size, value)
    value = barrier(value)
    # Over a short hop the quantity is nearly constant: a maximum that equals an end value up to rounding
    # needs no shorter step.
    of_ends = jnp.maximum(*of_each_end)
    rounding = ROUNDING * jnp.finfo(h.dtype).eps
    if sizes != "absolute":
        stands_out = jax.lax.stop_gradient(value > of_ends + rounding * jnp.abs(of_ends))
        near = record - jnp.where(jnp.isfinite(record), NEAR_RECORD * jnp.abs(record), 0.0)
    else:
        stands_out = jax.lax.stop_gradient(value > of_ends * (1 + rounding))
        near = record * (1 - NEAR_RECORD)
    raises = lands & each(turned) & stands_out & (value > near)
    raises |= each(long & dips) & (jnp.maximum(of_ends, at_z + each(jnp.abs(path.slope(z)))) > near)
    raises &= each((z > inside) & (z < 1 - inside))
    return Maximum(value, jnp.where(raises, each(z), jnp.inf))


def spring(deformation: Quintic, omega2: Values, damping: Values, h: Value) -> Quintic:
    """Return the spring and damper force per mass ω² d + 2ζω ḋ, Eq. (7), as a polynomial over a step.

    - `deformation`: polynomial of the deformation d [m]
    - `omega2`, `damping`: ω² [1/s²] and 2ζω [1/s]
    - `h`: length of the step [s]
    """
    rates = [*derivative(deformation), jnp.zeros_like(h)]
    return Quintic(*(omega2 * c + damping / h * rate for c, rate in zip(deformation, rates, strict=True)))


def cubic(f0: Values, rate0: Values, f1: Values, rate1: Values, h: Value) -> Cubic:
    """Return the cubic Hermite polynomial over a step, for a quantity whose curvature is not available.

    - `f0`, `rate0`: value and rate in time at the start
    - `f1`, `rate1`: value and rate in time at the end
    - `h`: length of the step [s]
    """
    m0, m1, rise = h * rate0, h * rate1, f1 - f0
    return Cubic(f0, m0, 3 * rise - 2 * m0 - m1, m0 + m1 - 2 * rise)
