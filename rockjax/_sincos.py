"""Sine and cosine from polynomials, with their own derivative rules.

In float64 the compiler calls scalar library routines for them, 7 to 35 ns a lane; polynomials vectorise.
Inside a rocking structure the argument ψ = σα − θ stays within ±π/2, and two polynomials of eight terms
are at rounding level. Beyond (a trial step that overshoots and is rejected) they lose accuracy smoothly: 1e-8
at |ψ| = 3. Ground motions may have any phase, which is reduced to that range first.
"""

import math
from fractions import Fraction

import jax
import jax.numpy as jnp

from rockjax._programs.barrier import barrier
from rockjax._types import Value

_LIMIT = Fraction(5, 2)  # of ψ², a little over (π/2)²


def _economised(series: list[Fraction], terms: int) -> tuple[float, ...]:
    """Return a power series in z shortened by Chebyshev polynomials on [0, _LIMIT] (Lanczos), nearly the best
    of its length."""
    series = list(series)
    while len(series) > terms:
        degree = len(series) - 1
        # T*_n(x) = T_n(2x − 1), by its recurrence; the highest power is taken off with a multiple of it.
        before, shifted = [Fraction(1)], [Fraction(-1), Fraction(2)]
        for _ in range(degree - 1):
            following = [Fraction(0), *(4 * c for c in shifted)]
            for k, c in enumerate(shifted):
                following[k] -= 2 * c
            for k, c in enumerate(before):
                following[k] -= c
            before, shifted = shifted, following
        scaled = [c / _LIMIT**k for k, c in enumerate(shifted)]
        factor = series[-1] / scaled[-1]
        series = [a - factor * c for a, c in zip(series, scaled, strict=True)][:-1]
    return tuple(float(c) for c in series)


# (sin ψ/ψ − 1)/ψ² and (cos ψ − 1)/ψ² in z = ψ².
_SIN = _economised([Fraction((-1) ** k, math.factorial(2 * k + 1)) for k in range(1, 16)], 8)
_COS = _economised([Fraction((-1) ** k, math.factorial(2 * k)) for k in range(1, 16)], 8)


def _horner(coefficients: tuple[float, ...], z: Value) -> Value:
    total = z * coefficients[-1] + coefficients[-2]
    for c in coefficients[-3::-1]:
        total = total * z + c
    return total


@jax.custom_jvp
@jax.jit
def sincos(psi: Value) -> tuple[Value, Value]:
    """(sin ψ, cos ψ) for |ψ| ≤ π/2 to rounding."""
    z = psi * psi
    # The leading terms are kept apart so that small angles keep full relative accuracy.
    return psi + psi * z * _horner(_SIN, z), 1.0 + z * _horner(_COS, z)


@sincos.defjvp
def _sincos_jvp(primals, tangents):
    (psi,), (psi_dot,) = primals, tangents
    psi = barrier(psi)
    s, c = barrier(sincos(psi))
    return (s, c), (c * psi_dot, -s * psi_dot)


# π in three parts, the first two so short that a whole number below 2²⁰ times them is exact (Cody & Waite).
_PI = (3.1415926534682512, 1.2154201012607932e-10, 4.044532497591901e-21)


@jax.custom_jvp
@jax.jit
def sin(x: Value) -> Value:
    """sin x of any x, to a rounding of x or two of the answer."""
    turns, sign = _half_turns(x)
    s, _ = sincos(_less(x, turns))
    return sign * s


@jax.custom_jvp
@jax.jit
def cos(x: Value) -> Value:
    """cos x likewise; close to its zeros to a rounding of 1."""
    turns, sign = _half_turns(x)
    _, c = sincos(_less(x, turns))
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
    """Return the nearest whole number of half turns in x, and the sign that they give."""
    turns = jnp.round(x * (1 / math.pi))
    return turns, 1.0 - 2.0 * (turns - 2.0 * jnp.floor(0.5 * turns))


def _less(x: Value, turns: Value) -> Value:
    """x − π turns, without a digit lost."""
    for part in _PI:
        x = x - turns * part
    return x
