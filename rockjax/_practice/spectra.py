"""Response spectra, exact to rounding, of ground motions that are linear between samples and zero after the
last sample."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from rockjax._motions.motion import Motion
from rockjax._oscillators import Response, ground_load, largest

PERIOD_RATIO = 1.02  # largest ratio of consecutive periods in the search for a maximum
REFINEMENT_POINTS = 32  # number of periods in each of the two refinements of a maximum
NEAR_LARGEST = 0.98  # local maxima above this fraction of the largest value are refined


def spectrum(motion: Motion, periods, damping, response: Response) -> np.ndarray:
    """Return the spectrum of a motion, including free vibration after the motion, shape (periods,).

    - `motion`: ground motion
    - `periods`: periods > 0, a number or shape (periods,) [s]
    - `damping`: damping ratio in [0, 1), a number or shape (periods,) [–]
    - `response`: `"displacement"` for S_d = max|x| with the displacement x relative to the ground [m];
      `"acceleration"` for the absolute acceleration S_a = max|2ζωẋ + ω²x| [m/s²], ω = 2π/T, which is not the
      pseudo-acceleration
    """
    T, zeta = np.broadcast_arrays(np.atleast_1d(np.asarray(periods, float)), np.asarray(damping, float))
    load = ground_load(motion.acceleration, motion.dt)
    return largest(load, T, np.array(zeta), rests=True, responses=(response,)).values[0]


def refined_maximum(
    values_at: Callable[[np.ndarray], np.ndarray], periods: np.ndarray, values: np.ndarray
) -> float:
    """Return the largest value of a spectrum between the first and the last period.

    All local maxima within 2 % of the largest value are refined twice.

    - `values_at`: function that returns the values of the spectrum at an array of periods [s]
    - `periods`: ascending periods [s], each at most 2 % longer than the one before
    - `values`: values of the spectrum at `periods`
    """
    for _ in range(2):
        padded = np.concatenate([[-np.inf], values, [-np.inf]])
        is_peak = (values > padded[:-2]) & (values >= padded[2:]) & (values >= NEAR_LARGEST * values.max())
        peaks = np.flatnonzero(is_peak)
        low, high = periods[np.maximum(peaks - 1, 0)], periods[np.minimum(peaks + 1, periods.size - 1)]
        periods = np.unique(np.linspace(low, high, REFINEMENT_POINTS))
        values = values_at(periods)
    return float(values.max())


def period_grid(shortest: float, longest: float) -> np.ndarray:
    """Return periods from `shortest` to `longest` [s] with a constant ratio of at most 1.02."""
    return np.geomspace(
        shortest, longest, 2 + math.ceil(math.log(longest / shortest) / math.log(PERIOD_RATIO))
    )


def largest_displacement(motion: Motion, longest: float, damping: float) -> float:
    """Return the largest spectral displacement S_d(T) at periods 0 < T ≤ `longest` [m].

    With ω = 2π/T and the damping ratio ζ, S_d(T) ≤ PGA/ω² coth(πζ/(2√(1−ζ²))). Periods at which this bound is
    below S_d(`longest`) are not searched.

    - `motion`: ground motion
    - `longest`: longest period > 0 [s]
    - `damping`: damping ratio in (0, 1) [–]
    """
    at_longest = float(spectrum(motion, longest, damping, "displacement")[0])
    if at_longest == 0:
        return 0.0
    amplification = 1 / math.tanh(0.5 * math.pi * damping / math.sqrt(1 - damping**2))
    shortest = min(2 * math.pi * math.sqrt(at_longest / (amplification * motion.pga)), longest)
    values_at = lambda T: spectrum(motion, T, damping, "displacement")
    periods = period_grid(shortest, longest)
    return max(refined_maximum(values_at, periods, values_at(periods)), at_longest)
