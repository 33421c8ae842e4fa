"""The largest displacement of a linear oscillator under a motion that is linear between samples.

With z = u̇ − λ̄u and λ = −ζω + iω_d, the equation ü + 2ζωu̇ + ω²u = −a(t) becomes ż = λz − a(t): one
complex unknown instead of two real ones. Its solution is exact at samples (Nigam & Jennings 1969) and
between them, where peaks are found as well.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm
from scipy.signal import lfilter

from rockjax._roots import bisect

# Minimum number of intervals per period. Longer intervals are divided, so that ü changes sign at most
# once in each.
_PIECES = 8
_TERMS = 20  # number of terms of the series in λτ; for |λτ| ≤ 2π/8 it is accurate to rounding
_HALVINGS = 60  # number of bisections of the time of a peak


class _Oscillator(NamedTuple):
    """A linear oscillator and its motion in terms of z."""

    omega: float  # circular frequency ω [rad/s]
    damping: float  # damping ratio ζ [–]

    @property
    def damped(self) -> float:
        """Circular frequency ω_d of the damped vibration [rad/s]."""
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
        """Return z at every sample of the acceleration a, from rest."""
        # The exponential of this matrix contains exp(λ dt) and its first two integrals, without cancellation.
        blocks = expm(dt * np.array([[self.pole, 1, 0], [0, 0, 1], [0, 0, 0]]))
        decay, hold, ramp = blocks[0, 0], blocks[0, 1], blocks[0, 2] / dt
        steps = -(hold - ramp) * load[:-1] - ramp * load[1:]
        return np.concatenate([[0.0], lfilter([1.0], [1.0, -decay], steps)])

    def state_after(self, z, load, slope, tau):
        """Return z a time τ ≤ T/8 later, under a = `load` + `slope` τ. All arguments are arrays of one
        shape."""
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
        """Return the first τ > 0 at which ü = 0 under a = `load` + `slope` τ. There ü is a damped
        sinusoid."""
        u, v = self.displacement(z), self.velocity(z)
        w, b = self.omega, self.damping * self.omega
        start = -load - 2 * b * v - w * w * u
        rate = -slope - 2 * b * start - w * w * v
        angle = np.arctan2(start, -(rate + b * start) / self.damped) % math.pi
        return np.where(angle == 0, math.pi, angle) / self.damped


def largest_displacement(load: np.ndarray, dt: float, period: float, damping: float) -> float:
    """Return max|u| of ü + 2ζωu̇ + ω²u = −a(t) from rest, with a linear between samples and zero after the
    last [m].

    - `load`: samples of a, shape (n,), n ≥ 2 [m/s²]
    - `dt`: sampling interval [s]
    - `period`: period T > 0 [s]
    - `damping`: damping ratio, 0 ≤ ζ < 1 [–]
    """
    divisions = max(1, math.ceil(_PIECES * dt / period))
    if divisions > 1:
        n = len(load)
        load = np.interp(np.arange((n - 1) * divisions + 1) / divisions, np.arange(n), load)
        dt = dt / divisions
    oscillator = _Oscillator(2 * math.pi / period, damping)
    z = oscillator.at_samples(load, dt)
    largest_so_far = max(float(np.abs(oscillator.displacement(z)).max()), _largest_free(oscillator, z[-1]))
    return _largest_inside(oscillator, z, load[:-1], np.diff(load) / dt, dt, largest_so_far)


def _largest_inside(oscillator: _Oscillator, z, load, slope, dt: float, largest_so_far: float) -> float:
    """Return the largest |u| at points inside intervals with u̇ = 0, or `largest_so_far` if it is larger.

    - `z`: states at the samples
    - `load`, `slope`: a and its slope at the start of each interval
    - `dt`: length of the intervals [s]
    """
    start, end = z[:-1], z[1:]
    # An interval contains at most one zero of ü, and u̇ is monotone on both sides of it.
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
        chosen = np.flatnonzero((velocity[k] * velocity[k + 1] < 0) & (bound > largest_so_far))
        if not chosen.size:
            continue
        motion = start[chosen], load[chosen], slope[chosen]
        sign, state_after = np.sign(velocity[k][chosen]), functools.partial(oscillator.state_after, *motion)
        is_before = lambda tau, sign=sign, state_after=state_after: (
            sign * oscillator.velocity(state_after(tau)) > 0
        )
        low, high = bisect(is_before, times[k][chosen], times[k + 1][chosen], _HALVINGS)
        u = oscillator.displacement(state_after(0.5 * (low + high)))
        largest = max(largest, float(np.abs(u).max()))
    return largest


def _largest_free(oscillator: _Oscillator, z: complex) -> float:
    """Return |u| at the first turning point of the free vibration from the state `z`, where it is largest."""
    u, v = oscillator.displacement(z), oscillator.velocity(z)
    b = oscillator.damping * oscillator.omega
    # u̇ = exp(−bt) (v cos ω_d t − (b v + ω² u)/ω_d sin ω_d t)
    angle = math.atan2(v, (b * v + oscillator.omega**2 * u) / oscillator.damped) % math.pi
    return abs(oscillator.displacement(z * np.exp(oscillator.pole * angle / oscillator.damped)))
