"""The quintic Hermite polynomial of a quantity over a step, with its turning points and roots.

The polynomial in z ∈ [0, 1], the time since the start of the step divided by the length h of the step,
matches value, slope and curvature at both ends. Its error is O(h⁶) with a small constant, below the local
error of a fifth-order method. This suffices to locate events with methods of any order: the polynomial only
proposes where the next step ends, and that step then ends on the event.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp

from rockjax._programs.barrier import barrier
from rockjax._types import Flags, Value, Values

from .ratio import safe_ratio

# Numbers of iterations of the safeguarded Newton searches. Derivatives of peaks need the z of turning points
# to about 1e-6. Crossings may be less accurate, because they only propose the end of the next trial.
_TURN_ITERATIONS, _CROSSING_ITERATIONS = 5, 4


class Quintic(NamedTuple):
    """Coefficients of a polynomial c0 + c1 z + … + c5 z⁵, or of an array of such polynomials. Slopes and
    curvatures are derivatives with respect to z."""

    c0: Values
    c1: Values
    c2: Values
    c3: Values
    c4: Values
    c5: Values

    def value(self, z: Values | float) -> Values:
        return self.c0 + z * (self.c1 + z * (self.c2 + z * (self.c3 + z * (self.c4 + z * self.c5))))

    def slope(self, z: Values | float) -> Values:
        return self.c1 + z * (2 * self.c2 + z * (3 * self.c3 + z * (4 * self.c4 + z * (5 * self.c5))))

    def curvature(self, z: Values | float) -> Values:
        return 2 * self.c2 + z * (6 * self.c3 + z * (12 * self.c4 + z * (20 * self.c5)))

    def turning_point_or_dip(self, turned: Flags, rising: Flags) -> tuple[Values, Flags]:
        """Apply the function `turning_point_or_dip` to this polynomial."""
        return turning_point_or_dip(self, turned, rising)


def quintic(x0: Values, v0: Values, a0: Values, x1: Values, v1: Values, a1: Values, h: Value) -> Quintic:
    """Return the quintic with given values, slopes and curvatures in time at both ends of a step.

    - `x0`, `v0`, `a0`: value, slope and curvature at the start
    - `x1`, `v1`, `a1`: value, slope and curvature at the end
    - `h`: length of the step [s]
    """
    v0, v1, a0, a1 = v0 * h, v1 * h, a0 * h * h, a1 * h * h
    rise = x1 - x0 - v0 - 0.5 * a0
    steepening = v1 - v0 - a0
    bending = a1 - a0
    v0, a0, rise, steepening, bending = barrier((v0, a0, rise, steepening, bending))
    return Quintic(
        x0,
        v0,
        0.5 * a0,
        10 * rise - 4 * steepening + 0.5 * bending,
        -15 * rise + 7 * steepening - bending,
        6 * rise - 3 * steepening + 0.5 * bending,
    )


def middle(
    x0: Values, v0: Values, a0: Values, x1: Values, v1: Values, a1: Values, h: Value
) -> tuple[Values, Values]:
    """Return the value and the slope in time, at z = 0.5, of the quintic through both ends of a step.

    - `x0`, `v0`, `a0`: value, slope and curvature at the start
    - `x1`, `v1`, `a1`: value, slope and curvature at the end
    - `h`: length of the step [s]
    """
    value = 0.5 * (x0 + x1) + h * (5 / 32 * (v0 - v1) + h / 64 * (a0 + a1))
    slope = safe_ratio(15 / 8 * (x1 - x0), h, h > 0) - 7 / 16 * (v0 + v1) + h / 32 * (a1 - a0)
    return value, slope


def third_at_end(path: Quintic, a0: Values, a1: Values, h: Value, max_step: Value) -> Values:
    """Return h³/3! times the third derivative in time at the end of a step.

    - `path`: quintic of the step
    - `a0`, `a1`: curvatures in time at both ends
    - `h`: length of the step [s]
    - `max_step`: longest step of the scene [s]

    Over a very short step, rounding dominates the higher coefficients of the quintic. The result is then
    h³/3! times the mean third derivative over the step.
    """
    return jnp.where(is_long(h, max_step), path.c3 + 4 * path.c4 + 10 * path.c5, (a1 - a0) * h**2 / 6)


def is_long(h: Value, max_step: Value) -> Flags:
    """Return whether a step is longer than 1 % of the longest step of the scene. In such a step, rounding
    does not dominate the higher coefficients of the quintic."""
    return h > 0.01 * max_step


def _horner(coefficients: Sequence[Values], z: Values) -> Values:
    total = coefficients[-1]
    for c in reversed(coefficients[:-1]):
        total = c + z * total
    return total


def derivative(coefficients: Sequence[Values]) -> list[Values]:
    """Return the coefficients of the derivative of a polynomial, lowest power first."""
    return [k * c for k, c in enumerate(coefficients) if k]


@functools.partial(jax.jit, static_argnames="iterations")
def _safeguarded_newton(f: Sequence[Values], lo: Values, hi: Values, z: Values, iterations: int) -> Values:
    """Return the root of a polynomial that is positive at `lo` and negative at `hi`, by Newton's method from
    the guess `z`, safeguarded by bisection."""
    f, df, z = barrier((list(f), derivative(f), z))
    for _ in range(iterations):
        value, slope = barrier(_horner(f, z)), _horner(df, z)
        lo, hi = jnp.where(value > 0, z, lo), jnp.where(value > 0, hi, z)
        newton = z - value / jnp.where(slope == 0, 1.0, slope)
        z = jnp.where((newton >= lo) & (newton <= hi), newton, 0.5 * (lo + hi))
        # With the barrier, XLA computes each iteration once for all later ones.
        z, lo, hi = barrier((z, lo, hi))
    return z


def turning_point_or_dip(polynomial: Quintic, turned: Flags, rising: Flags) -> tuple[Values, Flags]:
    """Return the position z ∈ [0, 1] of the turning point, or else of the dip, of a quantity over a step, and
    whether the quantity turns twice.

    If the slopes at both ends have opposite signs (`turned`), z is the turning point. Otherwise the slope has
    the same sign at both ends (positive if `rising`), and z is the dip: the minimum of a slope that is
    positive at both ends, or the maximum of a slope that is negative at both ends. If the slope has the other
    sign at the dip, the quantity turns twice, once before and once after z.
    """
    return turning_point_of_slope(derivative(polynomial), jnp.abs(polynomial.c0), turned, rising)


def turning_point_of_slope(
    coefficients: Sequence[Values], size: Values, turned: Flags, rising: Flags
) -> tuple[Values, Flags]:
    """Return the results of `turning_point_or_dip`, computed from the slope of the quantity. The slope is a
    polynomial in z and may be multiplied by any positive factor.

    - `coefficients`: coefficients of the slope, lowest power first
    - `size`: order of magnitude of the quantity; a change of sign of the slope within the rounding of this
      size is ignored
    - `turned`, `rising`: as for `turning_point_or_dip`
    """
    sign = barrier(jnp.where(rising, 1.0, -1.0))
    slope = [sign * c for c in coefficients]
    curvature = [-c for c in derivative(slope)]
    # `curvature` is −d(slope)/dz, which changes from positive to negative at a minimum of the slope.
    # `_first_zero` finds changes of this kind.
    may_dip = ~turned & (curvature[0] > 0) & (sum(curvature[1:], curvature[0]) < 0)
    pairs = zip(slope, [*curvature, jnp.zeros_like(sign)], strict=True)
    z = _first_zero([jnp.where(turned, a, b) for a, b in pairs])
    noise = 128 * jnp.finfo(sign.dtype).eps * size
    return z, may_dip & (_horner(slope, z) < -noise)


def _first_zero(f: Sequence[Values]) -> Values:
    """Return the root in (0, 1) of a slope (a polynomial) that is positive just after z = 0 and negative at
    z = 1.

    A motion that begins at rest, such as an uplift, has the slope zero at z = 0. After an uplift without a
    jump of the ground acceleration, the curvature there is also zero, up to rounding. z = 0 is then a single
    or double root of the slope, but not a turning point. The function therefore divides the slope by z or z².
    """
    f = list(f)
    for _ in range(2):
        at_rest = f[0] <= 0
        divided = [*f[1:], jnp.zeros_like(f[0])]
        f = [jnp.where(at_rest, b, a) for a, b in zip(f, divided, strict=True)]
    lo, hi = jnp.zeros_like(f[0]), jnp.ones_like(f[0])
    guess = _parabola_root(f[0], f[1], sum(f[1:], f[0]))
    return _safeguarded_newton(f, lo, hi, guess, _TURN_ITERATIONS)


def _parabola_root(first: Values, slope: Values, last: Values) -> Values:
    """Return the root in [0, 1] of the parabola with the value `first` > 0 and the slope `slope` at 0, and
    with the value `last` < 0 at 1.

    The root is a good first guess for θ̇ = 0 between two samples of the ground motion, where θ̇ is very
    nearly a parabola.
    """
    bend = last - first - slope
    root = jnp.sqrt(jnp.maximum(slope * slope - 4 * first * bend, 0.0))
    return jnp.clip(2 * first / jnp.where(root > slope, root - slope, 1.0), 0.0, 1.0)


def crossing(polynomial: Quintic, lo: Value, hi: Value) -> Value:
    """Return the root in [lo, hi] of a polynomial that is positive at lo and negative at hi."""
    length = hi - lo
    above, below = polynomial.value(lo), polynomial.value(hi)
    guess = lo + length * _parabola_root(above, polynomial.slope(lo) * length, below)
    return _safeguarded_newton(polynomial, lo, hi, guess, _CROSSING_ITERATIONS)


def turns_more_than_once(polynomial: Quintic, rising: Flags, rising_at_end: Flags, dips: Flags) -> Flags:
    """Return whether the slope changes sign more than once in a step.

    - `polynomial`: the quantity over the step
    - `rising`, `rising_at_end`: whether the quantity rises at the start and at the end
    - `dips`: second result of `turning_point_or_dip`

    The function checks the sign of the slope at three points inside the step, and also uses `dips`.
    """
    turns = jnp.zeros((), jnp.int32)
    before = rising
    # Slopes below the rounding of the value are ignored.
    noise = 128 * jnp.finfo(polynomial.c0.dtype).eps * jnp.abs(polynomial.c0)
    for z in (0.25, 0.5, 0.75):
        slope = polynomial.slope(z)
        here = jnp.where(jnp.abs(slope) > noise, slope > 0, before)
        turns, before = turns + (here != before).astype(jnp.int32), here
    return dips | (turns + (before != rising_at_end).astype(jnp.int32) > 1)
