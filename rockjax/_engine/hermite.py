"""The quintic Hermite polynomial of a step, on z ∈ [0, 1], and where it turns and crosses zero.

It joins value, slope and curvature at both ends of a step, so its error is O(h⁶) with a small constant: below
the local error of a fifth-order method, and good enough to know where to land for any other.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp

from rockjax._engine.once import once
from rockjax._types import Flags, Value, Values

# Of the safeguarded Newton searches. A turning point has to be known to about 1e-6 for the derivatives of
# peaks; a crossing only says where to try next.
_TO_TURN, _TO_CROSS = 5, 4


class Quintic(NamedTuple):
    """c0 + c1 z + … + c5 z⁵; of one quantity, or of several in a row."""

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


def quintic(x0: Values, v0: Values, a0: Values, x1: Values, v1: Values, a1: Values, h: Value) -> Quintic:
    """The quintic with value x, slope v and curvature a in time at both ends of a step of length h."""
    v0, v1, a0, a1 = v0 * h, v1 * h, a0 * h * h, a1 * h * h
    rise = x1 - x0 - v0 - 0.5 * a0
    steepening = v1 - v0 - a0
    bending = a1 - a0
    v0, a0, rise, steepening, bending = once((v0, a0, rise, steepening, bending))
    return Quintic(
        x0,
        v0,
        0.5 * a0,
        10 * rise - 4 * steepening + 0.5 * bending,
        -15 * rise + 7 * steepening - bending,
        6 * rise - 3 * steepening + 0.5 * bending,
    )


def third_at_end(path: Quintic, a0: Values, a1: Values, h: Value, longest: Value) -> Values:
    """h³/3! times the third derivative at the end of a step with curvatures a0 and a1.

    Over a very short step the quintic is a difference of nearly equal numbers, and the mean is enough.
    """
    return jnp.where(is_long(h, longest), path.c3 + 4 * path.c4 + 10 * path.c5, (a1 - a0) * h**2 / 6)


def is_long(h: Value, longest: Value) -> Flags:
    """Whether the quintic of a step knows more than its ends."""
    return h > 0.01 * longest


def _horner(coefficients: Sequence[Values], z: Values) -> Values:
    total = coefficients[-1]
    for c in reversed(coefficients[:-1]):
        total = c + z * total
    return total


def derivative(coefficients: Sequence[Values]) -> list[Values]:
    """Coefficients of the derivative of a polynomial, from those of the polynomial, lowest power first."""
    return [k * c for k, c in enumerate(coefficients) if k]


@functools.partial(jax.jit, static_argnames="iterations")
def _safeguarded_newton(f: Sequence[Values], lo: Values, hi: Values, z: Values, iterations: int) -> Values:
    """Where the polynomial passes from positive at lo to negative at hi: Newton from z, kept in by
    bisection."""
    f, df, z = once((list(f), derivative(f), z))
    for _ in range(iterations):
        value, slope = once(_horner(f, z)), _horner(df, z)
        lo, hi = jnp.where(value > 0, z, lo), jnp.where(value > 0, hi, z)
        newton = z - value / jnp.where(slope == 0, 1.0, slope)
        z = jnp.where((newton >= lo) & (newton <= hi), newton, 0.5 * (lo + hi))
        # Or each iteration would be worked out again inside every later one.
        z, lo, hi = once((z, lo, hi))
    return z


def turning_point_or_dip(polynomial: Quintic, turned: Flags, rising: Flags) -> tuple[Values, Flags]:
    """Where a quantity turns over a step, and whether it turns twice.

    Where its slopes at both ends have opposite signs (`turned`) it is the turning point. Else it may dip: the
    slope is least, against its sign at the ends (`rising`), at the zero of the curvature that is returned;
    where it changes sign there, the quantity turns before and after.
    """
    sign = once(jnp.where(rising, 1.0, -1.0))
    slope = [sign * c for c in derivative(polynomial)]
    curvature = [-c for c in derivative(slope)]
    may_dip = ~turned & (curvature[0] > 0) & (sum(curvature[1:], curvature[0]) < 0)
    pairs = zip(slope, [*curvature, jnp.zeros_like(sign)], strict=True)
    z = _first_zero([jnp.where(turned, a, b) for a, b in pairs])
    noise = 128 * jnp.finfo(sign.dtype).eps * jnp.abs(polynomial.c0)
    return z, may_dip & (_horner(slope, z) < -noise)


def _first_zero(f: Sequence[Values]) -> Values:
    """Where a polynomial, positive after z = 0, is zero and negative at z = 1.

    What begins at rest, as columns do that are lifted, has no slope at z = 0, and after an uplift that is
    not a jump no curvature either, but for rounding: then z = 0 is no turning point, and is divided out.
    """
    f = list(f)
    for _ in range(2):
        at_rest = f[0] <= 0
        divided = [*f[1:], jnp.zeros_like(f[0])]
        f = [jnp.where(at_rest, b, a) for a, b in zip(f, divided, strict=True)]
    # The parabola through both ends that leaves the first along f: between samples of a record the slope of a
    # rotation is very nearly that. It is positive at 0 and negative at 1, so that it has one zero there.
    last = sum(f[1:], f[0])
    bend = last - f[0] - f[1]
    root = jnp.sqrt(jnp.maximum(f[1] * f[1] - 4 * f[0] * bend, 0.0))
    guess = 2 * f[0] / jnp.where(root > f[1], root - f[1], 1.0)
    lo, hi = jnp.zeros_like(f[0]), jnp.ones_like(f[0])
    return _safeguarded_newton(f, lo, hi, jnp.clip(guess, 0.0, 1.0), _TO_TURN)


def crossing(polynomial: Quintic, lo: Value, hi: Value) -> Value:
    """The z in [lo, hi] at which the polynomial falls through zero, positive at lo and negative at hi."""
    above, below = polynomial.value(lo), polynomial.value(hi)
    fall = above - below
    secant = lo + (hi - lo) * jnp.clip(above / jnp.where(fall > 0, fall, 1.0), 0.0, 1.0)
    return _safeguarded_newton(polynomial, lo, hi, secant, _TO_CROSS)


def turns_more_than_once(polynomial: Quintic, rising: Flags, rising_after: Flags, dips: Flags) -> Flags:
    """Whether the slope changes sign more than once in a step: in a dip, or at three places inside."""
    turns = jnp.zeros((), jnp.int32)
    before = rising
    # Slopes at rounding of the value say nothing.
    noise = 128 * jnp.finfo(polynomial.c0.dtype).eps * jnp.abs(polynomial.c0)
    for z in (0.25, 0.5, 0.75):
        slope = polynomial.slope(z)
        here = jnp.where(jnp.abs(slope) > noise, slope > 0, before)
        turns, before = turns + (here != before).astype(jnp.int32), here
    return dips | (turns + (before != rising_after).astype(jnp.int32) > 1)
