"""Analytical pulses ü_g = a_p·s(t/T_p) with amplitude a_p, period T_p and a fixed shape s.

The knots of a shape are the ends of the intervals on which s is monotone. Eq. (32) is in docs/model.md.
`base.py` defines support, breakpoints and lookaheads.
"""

from __future__ import annotations

import abc
import dataclasses
import functools
import math
from collections.abc import Callable
from typing import Any, ClassVar, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from rockjax import _sincos as sincos
from rockjax._checks import as_number, concrete, product, require_finite, require_positive
from rockjax._roots import bisect, newton
from rockjax._types import Index, Number, Value
from rockjax._unit_warnings import warn_about_units
from rockjax._units import STANDARD_GRAVITY

from .base import AbstractExcitation, AbstractLookahead, size_on
from .names import PULSE_CLASSES

MAX_AMPLITUDE = 20 * STANDARD_GRAVITY  # [m/s²]; a larger amplitude was probably given in gal (cm/s²)
# Maximum of |z (z²−3)| e^(−z²/2), at z = √(3−√6). With this divisor the antisymmetric Ricker pulse, the
# second of Eqs. (32), has max|ü_g| = |a_p|.
BETA = math.sqrt(6 * (3 - math.sqrt(6))) * math.exp(-(3 - math.sqrt(6)) / 2)


# At a knot, a value |s| below this limit counts as zero. Such a value is a rounding error, or the tail of a
# Ricker pulse at an end of its support.
_NEGLIGIBLE = 1e-15
_HALVINGS, _NEWTON_STEPS = 10, 5  # numbers of bisections and Newton steps in a root search


def _root(f: Callable[[Array], Array], lo: Array, hi: Array) -> Array:
    """Return the root of an increasing function f in [lo, hi], rounded to the side with f > 0, or hi if there
    is no root. A fixed number of bisections and Newton steps narrows the interval. Bisections follow until no
    floating-point number lies between its ends; they are many only if f is flat at the root."""
    is_positive = lambda z: f(z) > 0
    lo = jnp.where((f(lo) <= 0) & is_positive(hi), lo, hi)
    hi, lo = bisect(is_positive, hi, lo, _HALVINGS, jnp)
    hi, lo, z, slope = newton(f, hi, lo, _NEWTON_STEPS)
    # Estimated error of z, times 4 for safety. It is the rounding of z plus the rounding of f, whose values
    # are of order 1, divided by the slope of f.
    inverse_slope = 1 / jnp.where(slope == 0, jnp.inf, slope)
    rounding = 4 * jnp.finfo(z.dtype).eps * (jnp.abs(z) + jnp.abs(inverse_slope))
    for trial in (z - rounding, z + rounding):
        trial = jnp.clip(trial, lo, hi)
        lo, hi = jnp.where(is_positive(trial), lo, trial), jnp.where(is_positive(trial), trial, hi)

    def is_unresolved(ends):
        hi, lo = ends
        middle = 0.5 * (lo + hi)
        return jnp.any((lo < middle) & (middle < hi))

    return jax.lax.while_loop(is_unresolved, lambda ends: bisect(is_positive, *ends, 1, jnp), (hi, lo))[0]


class _PulseLookahead(AbstractLookahead):
    """Lookahead of a pulse. Exceedances of the threshold follow from the crossings of the threshold on the
    intervals where the pulse is monotone.

    - `a_p`, `T_p`: amplitude [m/s²] and period [s]
    - `lead`, `trail`: times at which exceedances end or start, divided by T_p [–], shape (intervals,).
      Between the knots b_k and b_{k+1}, |ü_g| exceeds the threshold from b_k to lead_k and from trail_k to
      b_{k+1}; either part may be empty. None if there is no threshold
    - `pulse`: class of the pulse
    """

    a_p: Value
    T_p: Value
    lead: Float[Array, " n"] | None
    trail: Float[Array, " n"] | None
    pulse: type[AbstractPulse] = eqx.field(static=True)

    def next_exceedance(self, t: Value, piece: Index) -> Value:
        del piece
        assert self.lead is not None
        assert self.trail is not None
        tau = t / self.T_p
        knots = np.asarray(self.pulse.knots())
        leading, trailing = jnp.maximum(tau, knots[:-1]), jnp.maximum(tau, self.trail)
        leading = jnp.where(leading < self.lead, leading, jnp.inf)
        trailing = jnp.where(trailing < knots[1:], trailing, jnp.inf)
        return jnp.maximum(t, jnp.min(jnp.minimum(leading, trailing)) * self.T_p)

    def impulse(self, t: Value, piece: Index) -> Value:
        del piece
        pulse = self.pulse
        knots = (*pulse.zeros, pulse.span[1])
        velocity = [float(pulse.velocity(np.float64(z))) for z in knots]
        tau = jnp.clip(t / self.T_p, *pulse.span)
        # The zeros of the shape divide it into lobes. The integral of |ü_g| from t on is the area of the rest
        # of the present lobe plus the areas of all later lobes.
        lobe_end, later_lobes = velocity[-1], 0.0
        for k in reversed(range(len(pulse.zeros))):
            lobes = sum(abs(b - a) for a, b in zip(velocity[k:-1], velocity[k + 1 :], strict=True))
            lobe_end, later_lobes = (
                jnp.where(tau < knots[k], a, b) for a, b in ((velocity[k], lobe_end), (lobes, later_lobes))
            )
        return jnp.abs(self.a_p) * self.T_p * (jnp.abs(lobe_end - pulse.velocity(tau)) + later_lobes)

    def peak(self, t: Value, piece: Index, now: Value) -> Value:
        del piece
        # The shape is monotone between knots, so the largest value is at t or at a later knot.
        later_peak = 0.0
        for z in self.pulse.knots():
            height = abs(float(self.pulse.shape(np.float64(z))))
            later_peak = jnp.where(t <= z * self.T_p, jnp.maximum(height, later_peak), later_peak)
        return jnp.maximum(jnp.abs(now), jnp.abs(self.a_p) * later_peak)

    def highest_time(self, start: Value, end: Value, side: Value | None = None) -> Value:
        # The shape is monotone between knots, so the maximum is at a knot or at an end of the interval.
        knots = jnp.asarray(self.pulse.knots()) * self.T_p
        start, end = (jnp.clip(t, knots[0], knots[-1]) for t in (start, end))
        times = jnp.append(jnp.clip(knots, start, end), jnp.stack([start, end]))
        side = None if side is None else side * jnp.sign(self.a_p)
        return times[jnp.argmax(size_on(side, self.pulse.shape(times / self.T_p)))]


class AbstractPulse(AbstractExcitation):
    """A pulse a_p·s(t/T_p) with a fixed shape s.

    - `a_p`: amplitude [m/s²], |a_p| = max|ü_g|; a negative amplitude mirrors the response
    - `T_p`: period [s], > 0; ω_p = 2π/T_p
    """

    a_p: Number = eqx.field(converter=as_number("a_p"))
    T_p: Number = eqx.field(converter=as_number("T_p"))

    # Properties of the shape; times are divided by T_p.
    span: ClassVar[tuple[float, float]]  # start and end of the support
    compact: ClassVar[bool]  # True if the pulse is zero outside the span, whose ends are then breakpoints
    zeros: ClassVar[tuple[float, ...]]  # zeros inside the span
    turning: ClassVar[tuple[float, ...]]  # times of the extrema inside the span

    def __check_init__(self):
        require_finite(type(self).__name__, a_p=self.a_p)
        require_positive(type(self).__name__, T_p=self.T_p)
        amplitude = concrete(self.a_p)
        if amplitude is not None and amplitude.ndim == 0 and abs(amplitude) > MAX_AMPLITUDE:
            in_g = f"a_p = {float(amplitude):g} m/s² is {abs(float(amplitude)) / STANDARD_GRAVITY:.3g} g"
            warn_about_units(f"{type(self).__name__}: {in_g}; did you pass gal (cm/s²)?", stacklevel=4)

    @staticmethod
    @abc.abstractmethod
    def shape(tau: Any) -> Any:
        """Return ü_g/a_p at τ = t/T_p, for τ inside the span."""

    @staticmethod
    @abc.abstractmethod
    def velocity(tau: Any) -> Any:
        """Return an antiderivative of the shape at τ; a NumPy value for a NumPy argument."""

    @classmethod
    def knots(cls) -> tuple[float, ...]:
        """Return the knots: the ends of the span and the extrema, as values of τ, ascending."""
        return (cls.span[0], *cls.turning, cls.span[1])

    @property
    def omega_p(self) -> Number:
        """Circular frequency ω_p = 2π/T_p [rad/s]."""
        return 2 * math.pi / self.T_p

    @property
    def support(self) -> tuple[Number, Number]:
        return product(self.span[0], self.T_p), product(self.span[1], self.T_p)

    @property
    def breakpoints(self) -> Float[Array, "*batch n"]:
        ends = self.span if self.compact else ()
        return jnp.stack([z * self.T_p for z in ends], axis=-1) if ends else jnp.zeros((*self.T_p.shape, 0))

    def scaled(self, factor) -> Self:
        return dataclasses.replace(self, a_p=product(factor, self.a_p))

    def strength(self) -> np.ndarray:
        return np.abs(self.a_p)

    def piece(self, index: Index) -> Callable[[Value], Value]:
        def formula(t):
            return self.a_p * self.shape(t / self.T_p)

        def formula_of_piece(t):
            return jnp.where(index == 1, formula(t), 0.0)

        return formula_of_piece if self.compact else formula

    def at_most(self, piece: Index, t: Value, ahead: Value, now: Value) -> Value:
        del piece, t
        # |ü_g| is `now` at the time t and then grows at most as fast as the largest slope of the pulse.
        return now + jnp.abs(self.a_p / self.T_p) * _derivative_bound(type(self), 1) * ahead

    def curvature(self) -> Value:
        return jnp.abs(self.a_p) * _derivative_bound(type(self), 2) / self.T_p**2

    def lowest(self) -> tuple[Value, Value]:
        heights = np.array([float(self.shape(np.float64(z))) for z in self.knots()])
        minimum = jnp.minimum(self.a_p * heights.min(), self.a_p * heights.max())
        extrema = np.asarray(self.knots())[[heights.argmin(), heights.argmax()]]
        return minimum, self.T_p * jnp.where(self.a_p > 0, *extrema)

    def lookahead(self, threshold: Value | None) -> AbstractLookahead:
        a_p, T_p = jax.lax.stop_gradient((self.a_p, self.T_p))
        if threshold is None:
            return _PulseLookahead(a_p, T_p, None, None, type(self))
        # The level is the threshold divided by the amplitude. For zero amplitude it is inf, because such
        # a pulse exceeds no threshold.
        level = jax.lax.stop_gradient(threshold) / jnp.where(a_p == 0, 1.0, jnp.abs(a_p))
        level = jnp.where(a_p == 0, jnp.inf, level)
        knots = np.asarray(self.knots())
        heights = np.asarray(self.shape(knots))
        start, end = heights[:-1], heights[1:]
        # On each interval the shape is monotone, from `start` to `end`. Therefore, if |s| exceeds the level
        # somewhere on an interval, |s| also exceeds the level at one of the two knots of this interval. If s
        # exceeds the level with the same sign at both knots, |s| exceeds the level on the whole interval.
        falls = self._level_crossings(level, start, rises=False)
        rises = self._level_crossings(level, end, rises=True)
        lead = jnp.where(
            np.abs(start) > level, jnp.where(np.sign(start) * end > level, knots[1:], falls), knots[:-1]
        )
        trail = jnp.where(
            np.abs(end) > level, jnp.where(np.sign(end) * start > level, knots[:-1], rises), knots[1:]
        )
        return _PulseLookahead(a_p, T_p, lead, trail, type(self))

    def _level_crossings(self, level: Value, tops: np.ndarray, rises: bool) -> Array:
        """Return the times τ at which |s| crosses a level [–], one for each monotone interval. `tops` are the
        values of the shape s at the right end of each interval, to which |s| rises, if `rises`; otherwise at
        the left end, from which |s| falls. The result is arbitrary for intervals on which |`tops`| is below
        the level."""
        knots = np.asarray(self.knots())
        high = np.flatnonzero(np.abs(tops) > _NEGLIGIBLE)
        sign = np.sign(tops[high]) if rises else -np.sign(tops[high])
        threshold = level if rises else -level
        left, right = (jnp.asarray(z[high]) for z in (knots[:-1], knots[1:]))
        roots = list(_root(lambda z: sign * self.shape(z) - threshold, left, right))
        return jnp.stack([roots.pop(0) if k in high else jnp.zeros_like(level) for k in range(tops.size)])


@functools.cache
def _derivative_bound(pulse: type[AbstractPulse], order: int) -> float:
    """Return a bound of the first or second derivative (`order`) of a shape inside its span: the largest
    absolute value of differences on a fine grid, increased by 1 %."""
    h, (start, end) = 1e-4, pulse.span
    with jax.ensure_compile_time_eval():
        s = np.asarray(pulse.shape(np.arange(start + 0.5 * h, end, h)))
    return 1.01 * float(np.abs(np.diff(s, order)).max()) / h**order


# For NumPy arguments, the following functions return NumPy values, without JAX.
def _exp(x):
    return np.exp(x) if isinstance(x, np.ndarray | np.floating) else jnp.exp(x)


def _sin(x):
    return np.sin(x) if isinstance(x, np.ndarray | np.floating) else sincos.sin(x)


def _cos(x):
    return np.cos(x) if isinstance(x, np.ndarray | np.floating) else sincos.cos(x)


class Ricker(AbstractPulse):
    """Symmetric Ricker ("Mexican hat") pulse, the first of Eqs. (32), centred on t = 0:

    ü_g = a_p (1 − 2x) e^(−x), x = (π t/T_p)². The support is ±2.2 T_p; outside, |ü_g| is below 1e-18 |a_p|.
    """

    span = (-2.2, 2.2)
    compact = False
    zeros = (-1 / (math.pi * math.sqrt(2)), 1 / (math.pi * math.sqrt(2)))
    turning = (-math.sqrt(1.5) / math.pi, 0.0, math.sqrt(1.5) / math.pi)

    @staticmethod
    def shape(tau: Any) -> Any:
        x = (math.pi * tau) ** 2
        return (1 - 2 * x) * _exp(-x)

    @staticmethod
    def velocity(tau: Any) -> Any:
        return tau * _exp(-((math.pi * tau) ** 2))


def _z_to_tau(z: float) -> float:
    """Return τ = t/T_p at z = 2πt/(√3 T_p), the variable of the antisymmetric Ricker pulse."""
    return z * math.sqrt(3) / (2 * math.pi)


class AntisymmetricRicker(AbstractPulse):
    """Antisymmetric Ricker pulse, the second of Eqs. (32), centred on t = 0:

    ü_g = (a_p/β)(z²−3) z e^(−z²/2), z = 2πt/(√3 T_p), with β = 1.380119, so that max|ü_g| = |a_p|. The
    support is ±2.75 T_p; outside, |ü_g| is below 1e-18 |a_p|.
    """

    span = (-2.75, 2.75)
    compact = False
    zeros = (-_z_to_tau(math.sqrt(3)), 0.0, _z_to_tau(math.sqrt(3)))
    turning = tuple(
        _z_to_tau(sign * math.sqrt(3 + inner * math.sqrt(6)))
        for sign, inner in ((-1, 1), (-1, -1), (1, -1), (1, 1))
    )

    @staticmethod
    def shape(tau: Any) -> Any:
        z = (2 * math.pi / math.sqrt(3)) * tau
        return (z * z - 3) * z * _exp(-0.5 * z * z) / BETA

    @staticmethod
    def velocity(tau: Any) -> Any:
        z = (2 * math.pi / math.sqrt(3)) * tau
        return _z_to_tau(1 / BETA) * (1 - z * z) * _exp(-0.5 * z * z)


class OneSine(AbstractPulse):
    """One full sine, ü_g = a_p sin(2πt/T_p) on [0, T_p]."""

    span = (0.0, 1.0)
    compact = True
    zeros = (0.5,)
    turning = (0.25, 0.75)

    @staticmethod
    def shape(tau: Any) -> Any:
        return _sin(2 * math.pi * tau)

    @staticmethod
    def velocity(tau: Any) -> Any:
        return (1 - _cos(2 * math.pi * tau)) / (2 * math.pi)


class OneCosine(AbstractPulse):
    """One full cosine, ü_g = a_p cos(2πt/T_p) on [0, T_p]; it starts and ends with a jump."""

    span = (0.0, 1.0)
    compact = True
    zeros = (0.25, 0.75)
    turning = (0.5,)

    @staticmethod
    def shape(tau: Any) -> Any:
        return _cos(2 * math.pi * tau)

    @staticmethod
    def velocity(tau: Any) -> Any:
        return _sin(2 * math.pi * tau) / (2 * math.pi)


class HalfSine(AbstractPulse):
    """Half a sine, ü_g = a_p sin(2πt/T_p) on [0, T_p/2]."""

    span = (0.0, 0.5)
    compact = True
    zeros = ()
    turning = (0.25,)

    shape = staticmethod(OneSine.shape)
    velocity = staticmethod(OneSine.velocity)


# Name of a pulse in problem files and on the command line ↦ its class.
PULSES: dict[str, type[AbstractPulse]] = {name: globals()[kind] for name, kind in PULSE_CLASSES.items()}
