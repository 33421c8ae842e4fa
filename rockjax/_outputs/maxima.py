"""Maxima of smooth quantities in one step, from polynomials through both ends of the step.

The polynomials are functions of z ∈ [0, 1], the time since the start of the step divided by the length of the
step. Slopes and curvatures are derivatives with respect to z, and rates are derivatives in time. An
accumulator is the largest value so far in the scene (one podium under one excitation).
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple, Protocol

import jax
import jax.numpy as jnp

from rockjax._engine.hermite import Quintic, derivative
from rockjax._engine.ratio import safe_ratio
from rockjax._programs.barrier import barrier
from rockjax._types import Flag, Flags, Value, Values

# If the polynomial has an extremum that may exceed the maximum so far, the step is shortened to end on the
# extremum. This is not necessary in the *end zones* at both ends of the step, in which the polynomial is as
# accurate as the step itself. An extremum may exceed the maximum so far if it is above (1 − NEAR_MAXIMUM)
# times this maximum.
NEAR_MAXIMUM = 1e-2
END_ZONE = 0.02  # end zone for turning points of θ, as a fraction of the step
# End zones for other quantities. They are smaller for two reasons. Higher derivatives of a vibrating
# superstructure are larger. And the time at which a force turns may depend strongly on a parameter; then even
# a small error of this time changes the derivative of the force with respect to the parameter.
END_ZONE_DEFORMATIONS = 2e-3
END_ZONE_ACCELERATIONS = 1e-6
ROUNDING = 64  # relative differences below this multiple of the machine epsilon are rounding
ROUNDING_ANGLE = 4  # as ROUNDING, for θ, which has smaller rounding errors because the solver integrates it
CLOSE = 1024  # as ROUNDING, for the difference between an extremum and the value at an end of the step


class Cubic(NamedTuple):
    """Coefficients of a polynomial c0 + c1 z + c2 z² + c3 z³, or of an array of such polynomials."""

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

    def integral(self, z: Values | float) -> Values:
        """Return the integral from 0 to z."""
        return z * (self.c0 + z * (self.c1 / 2 + z * (self.c2 / 3 + z * (self.c3 / 4))))

    def turning_point_or_dip(self, turned: Flags, rising: Flags) -> tuple[Values, Flags]:
        """Apply `hermite.turning_point_or_dip` to this polynomial. Its slope a + b z + c z² has roots in
        closed form."""
        sign = jnp.where(rising, 1.0, -1.0)
        a, b, c = (sign * y for y in derivative(self))
        is_increasing = b > 0  # the slope increases at z = 0 before it decreases to zero
        q = -0.5 * (b + jnp.where(is_increasing, 1.0, -1.0) * jnp.sqrt(jnp.maximum(b * b - 4 * a * c, 0.0)))
        may_dip = ~turned & (b < 0) & (b + 2 * c > 0)
        numerator = jnp.where(turned, jnp.where(is_increasing, q, a), -b)
        denominator = jnp.where(turned, jnp.where(is_increasing, c, q), 2 * c)
        z = jnp.clip(numerator / jnp.where(denominator == 0, 1.0, denominator), 0.0, 1.0)
        noise = 128 * jnp.finfo(z.dtype).eps * jnp.abs(self.c0)
        return z, may_dip & (a + z * (b + z * c) < -noise)


class Quartic(NamedTuple):
    """Coefficients of a polynomial c0 + c1 z + … + c4 z⁴, or of an array of such polynomials."""

    c0: Values
    c1: Values
    c2: Values
    c3: Values
    c4: Values

    def value(self, z: Values | float) -> Values:
        return self.c0 + z * (self.c1 + z * (self.c2 + z * (self.c3 + z * self.c4)))

    def slope(self, z: Values | float) -> Values:
        return self.c1 + z * (2 * self.c2 + z * (3 * self.c3 + z * (4 * self.c4)))

    def curvature(self, z: Values | float) -> Values:
        return 2 * self.c2 + z * (6 * self.c3 + z * (12 * self.c4))

    @property
    def cubic(self) -> Cubic:
        """The cubic with the same values and slopes at both ends."""
        return Cubic(self.c0, self.c1, self.c2 - self.c4, self.c3 + 2 * self.c4)

    def extremum_near(self, z: Values, exists: Flags) -> Values:
        """Return the position of the extremum near `z`, an extremum of `cubic`, by Newton's method. Where
        `exists` is False, return `z`."""
        for _ in range(2):
            curvature = self.curvature(z)
            newton = z - self.slope(z) / jnp.where(curvature == 0, 1.0, curvature)
            z = barrier(jnp.where(exists & (newton > 0) & (newton < 1), newton, z))
        return z

    def turning_point_or_dip(self, turned: Flags, rising: Flags) -> tuple[Values, Flags]:
        """Apply `hermite.turning_point_or_dip` to this polynomial. The dip is that of the cubic with the same
        values and slopes at both ends."""
        z, dips = self.cubic.turning_point_or_dip(turned, rising)
        return self.extremum_near(z, turned), dips


Sizes = Literal["absolute", "signed", "both"]  # which maxima `largest` returns
_SIZES: dict[str, tuple[Callable[[Values], Values], ...]] = {
    "absolute": (jnp.abs,),
    "signed": (lambda y: y,),
    "both": (jnp.negative, lambda y: y),
}


class Path(Protocol):
    """A quantity f(z) over a step, z ∈ [0, 1]."""

    def value(self, z: Any) -> Values: ...
    def slope(self, z: Any) -> Values: ...
    def curvature(self, z: Any) -> Values: ...
    def turning_point_or_dip(self, turned: Flags, rising: Flags) -> tuple[Values, Flags]: ...


class Maximum(NamedTuple):
    """The largest value of a quantity, or of a row of quantities, over a step."""

    value: Any  # an array or a tuple, like the accumulator
    retry_fraction: Values  # position z at which the next trial must end; inf if the step needs no new trial


class End(NamedTuple):
    """A quantity at one end of a step, and its rate in time."""

    value: Values
    rate: Values
    past: Value  # time from this end to the event or breakpoint there, not constant under differentiation [s]


def larger(new: Values, accumulator: Values) -> Values:
    """Return the larger of two values. If they are equal, the result has the derivative of `accumulator`,
    while `jnp.maximum` would average both derivatives."""
    return jnp.where(new > accumulator, new, accumulator)


def curvatures_at_ends(path: Path, h: Value, long: Flag, rates: Sequence[Values]) -> list[Values]:
    """Return the second derivative in time of a quantity at the start and at the end of a step: that of its
    polynomial, or the mean over the step unless `long`.

    - `path`, `h`, `long`: as for `largest`
    - `rates`: derivatives in time at both ends
    """
    per_second = safe_ratio(jnp.ones_like(h), h, h > 0)
    mean = (rates[1] - rates[0]) * per_second
    at_ends = [path.curvature(jnp.full_like(h, z)) * per_second**2 for z in (0.0, 1.0)]
    return [jnp.where(long, curvature, mean) for curvature in at_ends]


@functools.partial(jax.jit, static_argnames=("end_zone", "shortens_step", "sizes"))
def largest(
    path: Path,
    h: Value,
    long: Flag,
    accumulator: Any,
    ends: tuple[End, End],
    end_zone: float = END_ZONE_DEFORMATIONS,
    shortens_step: bool = True,
    sizes: Sizes = "absolute",
) -> Maximum:
    """Return the `Maximum` of a quantity f over a step.

    - `path`: f(z) on z ∈ [0, 1]
    - `h`: length of the step [s]
    - `long`: whether the step is long enough for accurate curvatures of the path (`hermite.is_long`)
    - `accumulator`: largest value so far
    - `ends`: f at both ends
    - `end_zone`: fraction of the step at both ends where an extremum needs no shorter step
    - `shortens_step`: whether the next trial ends on a maximum that may exceed the accumulator
    - `sizes`: "absolute" for max|f|, "signed" for max f, "both" for a pair of max(−f) and max f;
      `accumulator` has the same form

    If f turns twice in the step, and one of the two extrema or the value at an end may exceed the
    accumulator, the next trial ends between the extrema, whatever `shortens_step` is. Quartics, the paths of
    forces in the joints, have a stricter condition: an extremum itself may exceed the accumulator and 99 % of
    the larger value at the ends. If a force grows by orders of magnitude in a step, its polynomial may turn
    twice although the force does not. The stricter condition then avoids a shorter step.
    """
    rates = [end.rate for end in ends]
    turned = rates[0] * rates[1] < 0
    z, extremum, dips = _extremum(path, h, long, turned, ends)
    change = jnp.abs(path.slope(z))
    curvatures = curvatures_at_ends(path, h, long, rates)
    eps = jnp.finfo(h.dtype).eps
    at_ends = []
    for curvature, end in zip(curvatures, ends, strict=True):
        # If the nearest extremum equals the value at this end up to rounding, the extremum replaces the
        # value. An error δt of the time of the extremum changes the value only by order δt², but the
        # derivative of the value with respect to parameters by order δt.
        constant = jax.lax.stop_gradient(curvature)
        to_extremum = -0.5 * safe_ratio(end.rate * end.rate, constant, constant != 0)
        is_close = jnp.abs(to_extremum) < CLOSE * eps * jnp.abs(end.value)
        value = end.value + end.past * (end.rate + 0.5 * end.past * curvature)
        at_ends.append(value + jnp.where(is_close, to_extremum, 0.0))
    extremum, change, at_ends = barrier((extremum, change, at_ends))
    # A maximum that equals the value at an end up to rounding, as in short steps, needs no shorter step.
    rounding = ROUNDING * eps
    values, fractions = [], []
    for size_of, so_far in zip(
        _SIZES[sizes], accumulator if sizes == "both" else (accumulator,), strict=True
    ):
        size_at_z = size_of(extremum)
        value = jnp.where(turned, size_at_z, -jnp.inf)
        for at_end in at_ends:
            size = size_of(at_end)
            value = jnp.where(size > value, size, value)
        value = barrier(value)
        largest_end = jnp.maximum(*[size_of(end.value) for end in ends])
        if sizes == "absolute":
            exceeds_ends = jax.lax.stop_gradient(value > largest_end * (1 + rounding))
            threshold = so_far * (1 - NEAR_MAXIMUM)
        else:
            exceeds_ends = jax.lax.stop_gradient(value > largest_end + rounding * jnp.abs(largest_end))
            threshold = so_far - jnp.where(jnp.isfinite(so_far), NEAR_MAXIMUM * jnp.abs(so_far), 0.0)
        shortens = shortens_step & turned & exceeds_ends & (value > threshold)
        size_of_dip = size_at_z + change  # bound on f or |f| at both turning points
        if isinstance(path, Quartic):
            threshold = jnp.maximum(threshold, largest_end - NEAR_MAXIMUM * jnp.abs(largest_end))
        else:
            size_of_dip = jnp.maximum(largest_end, size_of_dip)
        shortens |= long & dips & (size_of_dip > threshold)
        shortens &= (z > end_zone) & (z < 1 - end_zone)
        values.append(value)
        fractions.append(jnp.where(shortens, z, jnp.inf))
    if sizes == "both":
        return Maximum(tuple(values), jnp.minimum(*fractions))
    return Maximum(values[0], fractions[0])


def _extremum(
    path: Path, h: Value, long: Flag, turned: Flags, ends: tuple[End, End]
) -> tuple[Values, Values, Flags]:
    """Return the position z and the value of the extremum in a step, and whether the path turns twice
    (`hermite.turning_point_or_dip`).

    In a short step, rounding dominates the polynomial, but not the rates. The extremum then follows from the
    rates, which are nearly linear in time, and from the value at the nearer end.
    """
    start, end = ends
    change_of_rate = end.rate - start.rate
    rises = (start.rate > 0) | ((start.rate == 0) & (end.rate > 0))
    z, dips = barrier(jax.lax.stop_gradient(path).turning_point_or_dip(turned, rises))
    z_linear = safe_ratio(*jax.lax.stop_gradient((start.rate, -change_of_rate)), turned)
    z = jnp.where(turned & ~long, z_linear, z)
    from_start, from_end = (
        end.value + h * dz * (end.rate + 0.5 * dz * change_of_rate)
        for end, dz in zip(ends, (z, z - 1.0), strict=True)
    )
    return z, jnp.where(long, path.value(z), jnp.where(z < 0.5, from_start, from_end)), dips


def spring(deformation: Quintic, omega2: Values, damping: Values, h: Value) -> Quintic:
    """Return the force of spring and damper divided by the mass, ω² d + 2ζω ḋ, Eq. (7), over a step [m/s²].

    - `deformation`: polynomial of the deformation d [m]
    - `omega2`, `damping`: ω² [1/s²] and 2ζω [1/s]
    - `h`: length of the step [s]
    """
    rates = [*derivative(deformation), jnp.zeros_like(h)]
    return Quintic(*(omega2 * c + damping / h * rate for c, rate in zip(deformation, rates, strict=True)))


def cubic(f0: Values, rate0: Values, f1: Values, rate1: Values, h: Value) -> Cubic:
    """Return the cubic Hermite polynomial over a step.

    - `f0`, `rate0`: value and rate in time at the start
    - `f1`, `rate1`: value and rate in time at the end
    - `h`: length of the step [s]
    """
    m0, m1, rise = h * rate0, h * rate1, f1 - f0
    return Cubic(f0, m0, 3 * rise - 2 * m0 - m1, m0 + m1 - 2 * rise)


def quartic(cubic: Cubic, middle: Values, long: Flag) -> Quartic:
    """Return the quartic with the values and slopes of a cubic at both ends of the step, and with a given
    value in the middle. In a short step, the quartic is equal to the cubic, because their difference would be
    rounding.

    - `cubic`: the Hermite polynomial over the step
    - `middle`: value of the quantity at z = 0.5
    - `long`: whether the step is long (`hermite.is_long`)
    """
    c0, c1, c2, c3 = cubic
    c4 = jnp.where(long, 16 * (middle - cubic.value(0.5)), 0.0)
    return Quartic(c0, c1, c2 + c4, c3 - 2 * c4, c4)
