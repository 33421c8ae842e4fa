"""Sine and cosine from polynomials, with derivative rules.

In float64 the compiler would call scalar library routines, whereas polynomials use vector instructions.

`sincos` is for the equations of motion. There the argument is ψ = σα − θ, with the sign σ = ±1 of the
rotation θ, and |ψ| ≤ π/2. In this range, polynomials of eight terms are accurate to rounding. In a rejected
trial step |ψ| may be larger; the error then grows smoothly, to 2e-8 at |ψ| = 3. `sin` and `cos` are for the
phases of ground motions. They accept any argument and first reduce it to ±π/2.
"""

import math
from fractions import Fraction

import jax
import jax.numpy as jnp

from rockjax._programs.barrier import barrier
from rockjax._types import Value

_LIMIT = Fraction(5, 2)  # upper limit of ψ² for the polynomials, slightly more than (π/2)²


def _economised(series: list[Fraction], terms: int) -> tuple[float, ...]:
    """Return the coefficients of a power series in z, reduced to `terms` terms by Lanczos' economisation.
    Chebyshev polynomials on the interval from 0 to `_LIMIT` remove the highest powers. No other polynomial of
    the same degree is much more accurate on this interval."""
    series = list(series)
    while len(series) > terms:
        degree = len(series) - 1
        # The recurrence gives the shifted Chebyshev polynomial T*_n(x) = T_n(2x − 1). Subtracting a multiple
        # of T*_n removes the highest power.
        previous, shifted = [Fraction(1)], [Fraction(-1), Fraction(2)]
        for _ in range(degree - 1):
            following = [Fraction(0), *(4 * c for c in shifted)]
            for k, c in enumerate(shifted):
                following[k] -= 2 * c
            for k, c in enumerate(previous):
                following[k] -= c
            previous, shifted = shifted, following
        scaled = [c / _LIMIT**k for k, c in enumerate(shifted)]
        factor = series[-1] / scaled[-1]
        series = [a - factor * c for a, c in zip(series, scaled, strict=True)][:-1]
    return tuple(float(c) for c in series)


# Polynomials for (sin ψ/ψ − 1)/ψ² and (cos ψ − 1)/ψ² in z = ψ².
_SIN = _economised([Fraction((-1) ** k, math.factorial(2 * k + 1)) for k in range(1, 16)], 8)
_COS = _economised([Fraction((-1) ** k, math.factorial(2 * k)) for k in range(1, 16)], 8)


def _horner(coefficients: tuple[float, ...], z: Value) -> Value:
    """Return the polynomial in z with the coefficients, the constant term first."""
    total = z * coefficients[-1] + coefficients[-2]
    for c in coefficients[-3::-1]:
        total = total * z + c
    return total


@jax.custom_jvp
@jax.jit
def sincos(psi: Value) -> tuple[Value, Value]:
    """Return (sin ψ, cos ψ), accurate to rounding for |ψ| ≤ π/2."""
    z = psi * psi
    # The leading terms are added last, so that small angles have full relative accuracy.
    return psi + psi * z * _horner(_SIN, z), 1.0 + z * _horner(_COS, z)


@sincos.defjvp
def _sincos_jvp(primals, tangents):
    (psi,), (psi_dot,) = primals, tangents
    psi = barrier(psi)
    s, c = barrier(sincos(psi))
    return (s, c), (c * psi_dot, -s * psi_dot)


# π as a sum of three numbers. The first two have so few digits that their products with whole numbers
# below 2²⁰ are exact (Cody & Waite).
_PI = (3.1415926534682512, 1.2154201012607932e-10, 4.044532497591901e-21)


@jax.custom_jvp
@jax.jit
def sin(x: Value) -> Value:
    """Return sin x for any x. The error is at most about two rounding errors of the result, or one rounding
    error of x if that is larger."""
    half_turns, sign = _half_turns(x)
    s, _ = sincos(_subtract_half_turns(x, half_turns))
    return sign * s


@jax.custom_jvp
@jax.jit
def cos(x: Value) -> Value:
    """Return cos x for any x, as accurately as `sin` except near the zeros of cos x. There the error is one
    rounding error of the number 1."""
    half_turns, sign = _half_turns(x)
    _, c = sincos(_subtract_half_turns(x, half_turns))
    return sign * c


@sin.defjvp
def _sin_jvp(primals, tangents):
    (x,), (x_dot,) = primals, tangents
    return sin(x), cos(x) * x_dot


@cos.defjvp
def _cos_jvp(primals, tangents):
    (x,), (x_dot,) = primals, tangents
    return cos(x), -sin(x) * x_dot


def _half_turns(x: Value) -> tuple[Value, Value]:
    """Return the number of half turns, x/π rounded to a whole number, and the sign (−1)^half_turns."""
    half_turns = jnp.round(x * (1 / math.pi))
    return half_turns, 1.0 - 2.0 * (half_turns - 2.0 * jnp.floor(0.5 * half_turns))


def _subtract_half_turns(x: Value, half_turns: Value) -> Value:
    """Return x − π·half_turns without loss of digits."""
    for term in _PI:
        x = x - half_turns * term
    return x
