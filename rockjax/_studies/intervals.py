"""Confidence intervals of a fitted fragility curve: of median, dispersion and probability.

For capacities the likelihood is known. With θ = 1/σ and δ = μ/σ of the logarithms it is concave (Olsen 1978),
so that its profiles have one maximum. Without censored records, the profiles of median and dispersion are
functions of Student's t and of χ² alone: their bounds are taken at the quantiles of those distributions
instead of the large-sample χ², and are exact. With censored records they are taken at the same quantiles.

Counts at different levels come from the same records and are not independent, so the jackknife over records
is used.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.special import log_ndtr
from scipy.stats import chi2, t

from rockjax._roots import bisect

_HALVINGS = 48
_MAX_DOUBLINGS = 60  # greatest number of doublings of a first step


class Intervals(NamedTuple):
    """Bounds, lower and upper along the first axis: of ln(median), ln(dispersion) and the probit of P(x)."""

    log_median: np.ndarray
    log_dispersion: np.ndarray
    probit: np.ndarray


class Capacities(NamedTuple):
    """Sufficient statistics of lognormal capacities for their likelihood; numbers, or arrays for several
    samples.

    - `observed`: number of capacities that are known; `mean`, `variance`: of their logarithms
    - `censored`: number that lie above the limit; `log_limit`: its logarithm
    """

    observed: np.ndarray
    mean: np.ndarray
    variance: np.ndarray
    censored: np.ndarray
    log_limit: np.ndarray

    @classmethod
    def of(cls, capacity: np.ndarray, limit) -> Capacities:
        """Return the statistics of capacities (…, n), inf where they lie above the limit."""
        finite = np.isfinite(capacity)
        log = np.log(np.where(finite, capacity, 1.0))
        observed = finite.sum(axis=-1)
        mean = log.sum(axis=-1) / observed
        variance = np.sum(np.where(finite, (log - mean[..., None]) ** 2, 0.0), axis=-1) / observed
        return cls(observed, mean, variance, capacity.shape[-1] - observed, np.log(limit))

    @property
    def total(self):
        return self.observed + self.censored

    def likelihood(self, theta, delta):
        """Return the logarithm of the likelihood."""
        z2 = (theta * self.mean - delta) ** 2 + theta**2 * self.variance
        return self.observed * (np.log(theta) - 0.5 * z2) + self.censored * log_ndtr(
            delta - theta * self.log_limit
        )

    def best_at_probit(self, x, probit):
        """Return the greatest log-likelihood of all distributions whose P(capacity ≤ exp(x)) has this
        `probit`."""
        offset, limit = self.mean - x, x - self.log_limit

        def derivative(log_theta):
            theta = np.exp(log_theta)
            slope = self.observed * (1 / theta - (theta * offset + probit) * offset - theta * self.variance)
            return slope + self.censored * _hazard(theta * limit - probit) * limit

        theta = np.exp(_find_decreasing_zero(derivative, -0.5 * np.log(self.variance) + 0 * (x + probit)))
        return self.likelihood(theta, theta * x - probit)

    def best_at_dispersion(self, log_dispersion):
        """Return the greatest log-likelihood of all distributions with this dispersion."""
        theta = np.exp(-log_dispersion)

        def derivative(delta):
            return self.observed * (theta * self.mean - delta) + self.censored * _hazard(
                delta - theta * self.log_limit
            )

        return self.likelihood(theta, _find_decreasing_zero(derivative, theta * self.mean))


def _hazard(z):
    """Return φ/Φ."""
    return np.exp(-0.5 * z * z - 0.5 * math.log(2 * math.pi) - log_ndtr(z))


def _first_failing(holds: Callable, start: np.ndarray, sign: int) -> np.ndarray:
    """Return the first place at which a condition fails, with steps from `start` that double."""
    value, step = start, 0.5
    for _ in range(_MAX_DOUBLINGS):
        holding = holds(value)
        if not np.any(holding):
            break
        value, step = np.where(holding, start + sign * step, value), 2 * step
    return value


def _find_zero(f: Callable, positive: np.ndarray, negative: np.ndarray) -> np.ndarray:
    """Return the zeros of f, a function of arrays, between places where it is > 0 and places where it is
    not."""
    positive, negative = bisect(lambda y: f(y) > 0, positive, negative, _HALVINGS)
    return 0.5 * (positive + negative)


def _find_decreasing_zero(derivative: Callable, start: np.ndarray) -> np.ndarray:
    """Return the zero of a decreasing function of arrays."""
    return _find_zero(
        derivative,
        _first_failing(lambda y: derivative(y) <= 0, start, -1),
        _first_failing(lambda y: derivative(y) > 0, start, 1),
    )


def profile_intervals(capacities: Capacities, median, dispersion, at, confidence: float) -> Intervals:
    """Return intervals by profile likelihood of a distribution fitted to capacities.

    - `capacities`: statistics of the capacities
    - `median`, `dispersion`: the fitted values
    - `at`: intensities of the curve, in units of the median, of a shape that broadcasts
    - `confidence`: in (0, 1)
    """
    n, (low, high) = capacities.total, ((1 - confidence) / 2, (1 + confidence) / 2)
    mu = np.log(median)
    best = capacities.likelihood(1 / dispersion, mu / dispersion)
    allowed_fall = n * np.log1p(t.ppf(high, n - 1) ** 2 / (n - 1))  # greatest fall of 2 ln(likelihood)

    def bounds(excess: Callable, start) -> np.ndarray:
        ends = (_first_failing(lambda y: excess(y) > 0, start, sign) for sign in (-1, 1))
        return np.stack([_find_zero(excess, start, end) for end in ends])

    x = np.log(at)
    return Intervals(
        bounds(lambda y: allowed_fall - 2 * (best - capacities.best_at_probit(y, 0.0)), mu),
        np.stack(
            [_dispersion(capacities, np.log(dispersion), best, chi2.ppf(p, n - 1) / n) for p in (high, low)]
        ),
        bounds(lambda q: allowed_fall - 2 * (best - capacities.best_at_probit(x, q)), (x - mu) / dispersion),
    )


def _dispersion(capacities: Capacities, log_dispersion, best, ratio) -> np.ndarray:
    """Return the ln(dispersion) at which the profile has the value that it has, without censoring, for a
    variance of `ratio` times the dispersion squared."""
    target = np.sign(ratio - 1) * np.sqrt(capacities.total * (ratio - 1 - np.log(ratio)))

    def residual(y):
        fall = 2 * (best - capacities.best_at_dispersion(y))
        return np.sign(log_dispersion - y) * np.sqrt(np.maximum(fall, 0.0)) - target

    return _find_decreasing_zero(residual, log_dispersion)


def jackknife_intervals(estimate: np.ndarray, without: np.ndarray, confidence: float) -> np.ndarray:
    """Return intervals (2, …) of estimates (…) by the jackknife, from the estimates `without` each record,
    (n, …).

    They are corrected for bias, and their width uses Student's t.
    """
    n = len(without)
    mean = without.mean(axis=0)
    error = np.sqrt((n - 1) / n * np.sum((without - mean) ** 2, axis=0))
    middle, half = n * estimate - (n - 1) * mean, float(t.ppf((1 + confidence) / 2, n - 1)) * error
    return np.stack([middle - half, middle + half])
