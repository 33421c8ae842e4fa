"""The largest displacement of a linear oscillator under a motion that is linear between samples, including
the interior of intervals.

With z = u̇ − λ̄u and λ = −ζω + iω_d the equation ü + 2ζωu̇ + ω²u = −a(t) is ż = λz − a(t), with one complex
number instead of two real ones. Its solution is exact from sample to sample (Nigam & Jennings 1969), and
between them.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm
from scipy.signal import lfilter

from rockjax._roots import bisect

_PIECES = 8  # least number of pieces per period, so that ü changes sign at most once in a piece
_TERMS = 20  # terms of a series in |λτ| ≤ 2π/8, accurate to rounding
_HALVINGS = 60


class _Oscillator(NamedTuple):
    omega: float
    damping: float

    @property
    def damped(self) -> float:
        """Circular frequency with damping, ω_d [rad/s]."""
        return self.omega * math.sqrt(1 - self.damping**2)

    @property
    def pole(self) -> complex:
        """λ [rad/s]."""
        return complex(-self.damping * self.omega, self.damped)

    def displacement(self, z):
        return np.imag(z) / self.damped

    def velocity(self, z):
        return np.real(z) - self.damping * self.omega * self.displacement(z)

    def at_samples(self, load: np.ndarray, dt: float) -> np.ndarray:
        """Return z at every sample of a load, from rest."""
        # exp of this matrix contains exp(λ dt) and its first two integrals, without cancellation.
        blocks = expm(dt * np.array([[self.pole, 1, 0], [0, 0, 1], [0, 0, 0]]))
        decay, hold, ramp = blocks[0, 0], blocks[0, 1], blocks[0, 2] / dt
        steps = -(hold - ramp) * load[:-1] - ramp * load[1:]
        return np.concatenate([[0.0], lfilter([1.0], [1.0, -decay], steps)])

    def state_after(self, z, load, slope, tau):
        """Return z a time τ ≤ T/8 later, under the load `load` + `slope` τ; arrays of one shape."""
        s = self.pole * tau
        term = np.ones_like(s)
        decay, hold, ramp = term, np.zeros_like(s), np.zeros_like(s)
        for k in range(1, _TERMS):
            hold = hold + term / k
            ramp = ramp + term / (k * (k + 1))
            term = term * s / k
            decay = decay + term
        return decay * z - tau * (load * hold + slope * tau * ramp)

    def turning_time(self, z, load, slope):
        """Return the first τ > 0 at which ü = 0 if the load continues, a zero of a damped sinusoid."""
        u, v = self.displacement(z), self.velocity(z)
        w, b = self.omega, self.damping * self.omega
        start = -load - 2 * b * v - w * w * u
        rate = -slope - 2 * b * start - w * w * v
        angle = np.arctan2(start, -(rate + b * start) / self.damped) % math.pi
        return np.where(angle == 0, math.pi, angle) / self.damped


def largest_displacement(load: np.ndarray, dt: float, period: float, damping: float) -> float:
    """Return max|u| of ü + 2ζωu̇ + ω²u = −a(t) from rest, with a linear between samples and zero after the
    last [m].

    - `load`: samples of a, shape (n,), n ≥ 2 [m/s²]; `dt`: their interval [s]
    - `period`: T > 0 [s]; `damping`: 0 ≤ ζ < 1 [–]
    """
    finer = max(1, math.ceil(_PIECES * dt / period))
    if finer > 1:
        n = len(load)
        load = np.interp(np.arange((n - 1) * finer + 1) / finer, np.arange(n), load)
        dt = dt / finer
    oscillator = _Oscillator(2 * math.pi / period, damping)
    z = oscillator.at_samples(load, dt)
    largest_so_far = max(float(np.abs(oscillator.displacement(z)).max()), _largest_free(oscillator, z[-1]))
    return _largest_inside(oscillator, z, load[:-1], np.diff(load) / dt, dt, largest_so_far)


def _largest_inside(oscillator: _Oscillator, z, load, slope, dt: float, largest_so_far: float) -> float:
    """Return the largest |u| where u̇ = 0 inside an interval, or `largest_so_far` if none exceeds it."""
    start, end = z[:-1], z[1:]
    # u̇ is monotone on both sides of a zero of ü, and an interval contains at most one.
    middle = oscillator.turning_time(start, load, slope)
    turns = np.flatnonzero(middle < dt)
    middle = np.minimum(middle, dt)
    between = end.copy()
    between[turns] = oscillator.state_after(start[turns], load[turns], slope[turns], middle[turns])
    velocity = [oscillator.velocity(y) for y in (start, between, end)]
    times = [np.zeros_like(middle), middle, np.full_like(middle, dt)]
    bound = np.abs(oscillator.displacement(start)) + dt * np.max(np.abs(velocity), axis=0)
    largest = largest_so_far
    for k in range(2):
        at = np.flatnonzero((velocity[k] * velocity[k + 1] < 0) & (bound > largest_so_far))
        if not at.size:
            continue
        motion = start[at], load[at], slope[at]
        sign, state_after = np.sign(velocity[k][at]), functools.partial(oscillator.state_after, *motion)
        before = lambda tau, sign=sign, state_after=state_after: (
            sign * oscillator.velocity(state_after(tau)) > 0
        )
        low, high = bisect(before, times[k][at], times[k + 1][at], _HALVINGS)
        u = oscillator.displacement(state_after(0.5 * (low + high)))
        largest = max(largest, float(np.abs(u).max()))
    return largest


def _largest_free(oscillator: _Oscillator, z: complex) -> float:
    """Return the largest |u| of free vibration after `z`: at its first turning point."""
    u, v = oscillator.displacement(z), oscillator.velocity(z)
    b = oscillator.damping * oscillator.omega
    # u̇ = exp(−bt) (v cos ω_d t − (b v + ω² u)/ω_d sin ω_d t)
    angle = math.atan2(v, (b * v + oscillator.omega**2 * u) / oscillator.damped) % math.pi
    return abs(oscillator.displacement(z * np.exp(oscillator.pole * angle / oscillator.damped)))
