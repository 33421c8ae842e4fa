"""Wavelets with a variable number of oscillations.

Unlike the pulses in `pulses.py`, wavelets are not monotone on fixed intervals. Therefore their lookaheads
(see `base.py`) search for the next exceedance of a threshold, with the help of bounds on |ü_g| and
|d²ü_g/dt²|.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from rockjax._checks import as_number, product, require, require_finite, require_positive
from rockjax._sincos import cos, sin
from rockjax._types import Index, Number, Value

from .base import AbstractExcitation, AbstractLookahead, size_on

# Longest step, divided by the period. The quintic polynomial through both ends of such a step differs from a
# harmonic by at most (2π/3)⁶/46080 = 0.2 % of the amplitude.
LONGEST_STEP = 1 / 3
SAMPLES_OF_TWO_PERIODS = 257  # number of samples in the search for the largest |ü_g|


class _BoundedLookahead(AbstractLookahead):
    """Lookahead of a smooth motion with |ü_g| ≤ `amplitude` [m/s²] and |d²ü_g/dt²| ≤ `curvature` [m/s⁴]. The
    motion is a harmonic with an envelope that decreases with |t|. In `period` [s], the phase of the harmonic
    increases by at least 2π."""

    motion: AbstractExcitation
    threshold: Value | None
    amplitude: Value
    curvature: Value
    period: Value

    def next_exceedance(self, t: Value, piece: Index) -> Value:
        """Return the first time ≥ t at which |ü_g| exceeds the threshold [s], or inf if there is none. A step
        of the search ends where the motion would reach the threshold if d²ü_g/dt² were as large as its bound,
        so no step passes a crossing. The search converges quadratically."""
        del piece
        threshold = self.threshold
        assert threshold is not None
        _, end = self.motion.support
        resolution = 4 * jnp.finfo(t.dtype).eps

        def safe_step(a, slope, sign):
            distance = jnp.maximum(threshold - sign * a, 0.0)
            return (-sign * slope + jnp.sqrt(slope**2 + 2 * self.curvature * distance)) / self.curvature

        def advance(carry):
            _, t, _ = carry
            formula = self.motion.piece(self.motion.locate(t))
            a, slope = jax.jvp(formula, (t,), (jnp.ones_like(t),))
            is_above = jnp.abs(a) > threshold
            step = jnp.minimum(safe_step(a, slope, 1.0), safe_step(a, slope, -1.0))
            # Steps are at least the resolution of time, so that the search passes points at which the motion
            # only touches the threshold, and points at which rounding decides the comparison.
            min_step = resolution * jnp.maximum(jnp.abs(t), jnp.sqrt(self.amplitude / self.curvature))
            return t, t + jnp.maximum(step, min_step), is_above

        t = jnp.maximum(t, self.motion.support[0])
        never_exceeds = self.amplitude <= threshold
        t, _, is_found = jax.lax.while_loop(
            lambda carry: ~carry[2] & (carry[1] < end) & ~never_exceeds, advance, (t, t, jnp.zeros((), bool))
        )
        return jnp.where(is_found, t, jnp.inf)

    def impulse(self, t: Value, piece: Index) -> Value:
        del piece
        start, end = self.motion.support
        return self.amplitude * jnp.maximum(end - jnp.maximum(t, start), 0.0)

    def peak(self, t: Value, piece: Index, now: Value) -> Value:
        del piece, now
        return jnp.where(t < self.motion.support[1], self.amplitude, 0.0)

    def highest_time(self, start: Value, end: Value, side: Value | None = None) -> Value:
        first, last = self.motion.support
        start, end = jnp.clip(start, first, last), jnp.clip(end, first, last)
        # The envelope is largest at t = 0, and both signs occur in a period. The maximum is therefore at most
        # one period away from that time of the interval at which the envelope is largest.
        nearest = jnp.clip(0.0, start, end)
        start, end = jnp.maximum(start, nearest - self.period), jnp.minimum(end, nearest + self.period)
        times = start + (end - start) * jnp.linspace(0.0, 1.0, SAMPLES_OF_TWO_PERIODS)
        spacing = (end - start) / (SAMPLES_OF_TWO_PERIODS - 1)
        best = times[jnp.argmax(_with_tops(size_on(side, self.motion(times))))]
        # Newton's method finds a zero of the slope between the neighbouring samples.
        formula = self.motion.piece(self.motion.locate(best))
        slope = jax.grad(formula)
        refined = best
        for _ in range(4):
            curvature = jax.grad(slope)(refined)
            is_flat = curvature == 0
            step = jnp.where(is_flat, 0.0, -slope(refined) / jnp.where(is_flat, 1.0, curvature))
            refined = jnp.clip(
                refined + step, jnp.maximum(start, best - spacing), jnp.minimum(end, best + spacing)
            )
        size = lambda t: size_on(side, formula(t))
        return jnp.where(size(refined) > size(best), refined, best)


def _with_tops(values: Array) -> Array:
    """Return equally spaced values of a quantity, in which each local maximum is replaced by the top of the
    parabola through it and its neighbours."""
    before, middle, after = values[:-2], values[1:-1], values[2:]
    bend = before - 2 * middle + after
    is_top = (middle >= before) & (middle >= after) & (bend < 0)
    rise = (after - before) ** 2 / (8 * jnp.where(is_top, -bend, 1.0))
    return values.at[1:-1].add(jnp.where(is_top, rise, 0.0))


class MavroeidisPapageorgiou(AbstractExcitation):
    """Pulse of Mavroeidis & Papageorgiou (2003); ü_g is the derivative of the ground velocity

    v = (A/2) [1 + cos(2πf_p t/γ)] cos(2πf_p t + ν) on |t| ≤ γ/(2f_p).

    - `A`: velocity amplitude [m/s]
    - `f_p`: prevailing frequency [Hz], > 0
    - `gamma`: number of oscillations γ [–], > 1
    - `nu`: phase ν [rad]
    """

    A: Number = eqx.field(converter=as_number("MavroeidisPapageorgiou: A"))
    f_p: Number = eqx.field(converter=as_number("MavroeidisPapageorgiou: f_p"))
    gamma: Number = eqx.field(converter=as_number("MavroeidisPapageorgiou: gamma"), default=2.0)
    nu: Number = eqx.field(converter=as_number("MavroeidisPapageorgiou: nu"), default=0.0)

    def __check_init__(self):
        require_finite("MavroeidisPapageorgiou", A=self.A, nu=self.nu)
        require_positive("MavroeidisPapageorgiou", f_p=self.f_p)
        require("MavroeidisPapageorgiou", "gamma", self.gamma, lambda v: v > 1, "finite and > 1")

    @property
    def support(self) -> tuple[Number, Number]:
        half_duration = 0.5 * self.gamma / self.f_p
        return -half_duration, half_duration

    @property
    def breakpoints(self) -> Float[Array, "*batch n"]:
        return jnp.stack(jnp.broadcast_arrays(*self.support), axis=-1)

    def longest_step(self) -> Number:
        return jnp.minimum(super().longest_step(), LONGEST_STEP / self.f_p)

    def scaled(self, factor) -> Self:
        return dataclasses.replace(self, A=product(factor, self.A))

    def strength(self) -> np.ndarray:
        return np.abs(np.multiply(self.A, self.f_p))

    def piece(self, index: Index) -> Callable[[Value], Value]:
        omega = 2 * math.pi * self.f_p

        def formula(t):
            envelope, carrier = omega * t / self.gamma, omega * t + self.nu
            rate = sin(envelope) * cos(carrier) / self.gamma + (1 + cos(envelope)) * sin(carrier)
            return jnp.where(index == 1, -0.5 * self.A * omega * rate, 0.0)

        return formula

    def curvature(self) -> Value:
        return self._bounds()[1]

    def _bounds(self) -> tuple[Value, Value]:
        """Return upper bounds of |ü_g| [m/s²] and |d²ü_g/dt²| [m/s⁴]."""
        # The velocity is a sum of harmonics with the frequencies ω and ω(1±1/γ) and the amplitudes A/2
        # and A/4. Each derivative of the velocity is bounded by the sum of the amplitudes that the
        # harmonics have in this derivative.
        motion: MavroeidisPapageorgiou = jax.lax.stop_gradient(self)
        omega = 2 * math.pi * motion.f_p
        rates = (omega, omega * (1 + 1 / motion.gamma), omega * (1 - 1 / motion.gamma))
        weights = (0.5 * jnp.abs(motion.A), 0.25 * jnp.abs(motion.A), 0.25 * jnp.abs(motion.A))
        amplitude = sum((w * r for w, r in zip(weights, rates, strict=True)), start=jnp.zeros(()))
        curvature = sum((w * r**3 for w, r in zip(weights, rates, strict=True)), start=jnp.zeros(()))
        return amplitude, curvature

    def lookahead(self, threshold: Value | None) -> AbstractLookahead:
        motion: MavroeidisPapageorgiou = jax.lax.stop_gradient(self)
        return _bounded_lookahead(motion, threshold, *self._bounds(), 1 / motion.f_p)


class Gabor(AbstractExcitation):
    """Gabor wavelet, a harmonic with a Gaussian envelope, centred on t = 0 (Vassiliou & Makris 2011):

    ü_g = a_p exp(−½(2πt/(γT_p))²) cos(2πt/T_p + φ). Outside its support the Gaussian is below 1e-18.

    - `a_p`: amplitude of the envelope [m/s²]
    - `T_p`: period of the harmonic [s], > 0
    - `gamma`: number of oscillations γ [–], > 0
    - `phi`: phase φ [rad]
    """

    a_p: Number = eqx.field(converter=as_number("Gabor: a_p"))
    T_p: Number = eqx.field(converter=as_number("Gabor: T_p"))
    gamma: Number = eqx.field(converter=as_number("Gabor: gamma"), default=2.0)
    phi: Number = eqx.field(converter=as_number("Gabor: phi"), default=0.0)

    def __check_init__(self):
        require_finite("Gabor", a_p=self.a_p, phi=self.phi)
        require_positive("Gabor", T_p=self.T_p, gamma=self.gamma)

    @property
    def support(self) -> tuple[Number, Number]:
        half_duration = 9.2 * self.gamma * self.T_p / (2 * math.pi)
        return -half_duration, half_duration

    @property
    def breakpoints(self) -> Float[Array, "*batch n"]:
        return jnp.zeros((*jnp.broadcast_shapes(self.T_p.shape, self.gamma.shape), 0))

    def longest_step(self) -> Number:
        return jnp.minimum(super().longest_step(), LONGEST_STEP * self.T_p)

    def scaled(self, factor) -> Self:
        return dataclasses.replace(self, a_p=product(factor, self.a_p))

    def strength(self) -> np.ndarray:
        return np.abs(self.a_p)

    def piece(self, index: Index) -> Callable[[Value], Value]:
        del index

        def formula(t):
            z = 2 * math.pi * t / self.T_p
            return self.a_p * jnp.exp(-0.5 * (z / self.gamma) ** 2) * cos(z + self.phi)

        return formula

    def curvature(self) -> Value:
        return self._bounds()[1]

    def _bounds(self) -> tuple[Value, Value]:
        """Return upper bounds of |ü_g| [m/s²] and |d²ü_g/dt²| [m/s⁴]."""
        motion: Gabor = jax.lax.stop_gradient(self)
        amplitude = jnp.abs(motion.a_p)
        # With time in units of T_p/(2π), the derivatives of the envelope E are bounded by |E'| ≤ e^(−½)/γ and
        # |E''| ≤ 1/γ². The bound of d²ü_g/dt² follows from the product rule.
        rate = 2 * math.pi / motion.T_p
        curvature = amplitude * rate**2 * (1 + 2 * math.exp(-0.5) / motion.gamma + 1 / motion.gamma**2)
        return amplitude, curvature

    def lookahead(self, threshold: Value | None) -> AbstractLookahead:
        motion: Gabor = jax.lax.stop_gradient(self)
        return _bounded_lookahead(motion, threshold, *self._bounds(), motion.T_p)


def _bounded_lookahead(motion, threshold, amplitude, curvature, period) -> AbstractLookahead:
    threshold = None if threshold is None else jax.lax.stop_gradient(threshold)
    curvature = jnp.maximum(curvature, jnp.finfo(curvature.dtype).tiny)
    return _BoundedLookahead(motion, threshold, amplitude, curvature, period)
