"""Confidence intervals of the median, dispersion and probability of a fitted fragility curve.

If the data are capacities (the least overturning intensities of records), the intervals follow from the
profile likelihood. The profile of a quantity, such as the median, assigns to each value of the quantity the
largest likelihood of all distributions with this value. Let μ and σ be the mean and the standard deviation of
ln(capacity). As a function of θ = 1/σ and δ = μ/σ the log-likelihood is concave (Olsen 1978), so every
profile has only one maximum. A record is censored if its capacity is only known to exceed a level.
Without censored records, the profile of the median is a function of Student's t statistic, and the profile of
the dispersion is a function of the χ² statistic. Bounds at the quantiles of t and χ² are therefore exact.
With censored records the same quantiles give approximate bounds.

If the data are counts of overturned records at several levels, the intervals follow from the jackknife over
records: the fit is repeated without each record in turn. The counts at different levels are not independent,
because they come from the same records.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri, log_ndtr, stdtrit  # scipy.stats takes long to import

from rockjax._roots import bisect

_HALVINGS = 48  # number of bisections in the search for a zero
_MAX_DOUBLINGS = 60  # largest number of doublings of the first step in the search for a bracket


class Intervals(NamedTuple):
    """Bounds of ln(median), ln(dispersion) and the probit Φ⁻¹(probability), with the first axis (lower,
    upper). Φ is the standard normal distribution function."""

    log_median: np.ndarray
    log_dispersion: np.ndarray
    probit: np.ndarray


class Capacities(NamedTuple):
    """Sufficient statistics of lognormal capacities: scalars, or arrays for several samples.

    - `observed`: number of known capacities
    - `mean`, `variance`: mean and variance of the logarithms of the known capacities
    - `censored`: number of censored capacities that are only known to exceed each of g limits; the first axis
      has the length g
    - `log_limits`: logarithms of these limits, shape (g,)
    """

    observed: np.ndarray
    mean: np.ndarray
    variance: np.ndarray
    censored: np.ndarray
    log_limits: np.ndarray

    @classmethod
    def from_values(cls, capacity: np.ndarray, limit) -> Capacities:
        """Return the statistics of capacities, shape (…, n). Capacities that are only known to exceed `limit`
        are inf; `limit` is a number or has the shape (n,)."""
        finite = np.isfinite(capacity)
        log = np.log(np.where(finite, capacity, 1.0))
        observed = finite.sum(axis=-1)
        mean = log.sum(axis=-1) / observed
        variance = np.sum(np.where(finite, (log - mean[..., None]) ** 2, 0.0), axis=-1) / observed
        limits = np.unique(np.broadcast_to(limit, capacity.shape)[~finite])
        censored = np.array([(~finite & (limit == y)).sum(axis=-1) for y in limits])
        return cls(observed, mean, variance, censored, np.log(limits))

    @property
    def total(self):
        """Number of known and censored capacities."""
        return self.observed + self.censored.sum(axis=0)

    def _sum_over_censored(self, term: Callable):
        """Return the sum of `term`, a function of the logarithm of a limit, over censored capacities."""
        return sum(count * term(limit) for count, limit in zip(self.censored, self.log_limits, strict=True))

    def log_likelihood(self, theta, delta):
        """Return the log-likelihood at θ = 1/σ and δ = μ/σ."""
        z2 = (theta * self.mean - delta) ** 2 + theta**2 * self.variance
        return self.observed * (np.log(theta) - 0.5 * z2) + self._sum_over_censored(
            lambda log_limit: log_ndtr(delta - theta * log_limit)
        )

    def profile_at_probit(self, x, probit):
        """Return the largest log-likelihood of all distributions with P(capacity ≤ exp(x)) = Φ(probit)."""
        offset = self.mean - x

        def derivative(log_theta):
            theta = np.exp(log_theta)
            slope = self.observed * (1 / theta - (theta * offset + probit) * offset - theta * self.variance)
            return slope + self._sum_over_censored(
                lambda log_limit: _inverse_mills_ratio(theta * (x - log_limit) - probit) * (x - log_limit)
            )

        theta = np.exp(_find_decreasing_zero(derivative, -0.5 * np.log(self.variance) + 0 * (x + probit)))
        return self.log_likelihood(theta, theta * x - probit)

    def profile_at_dispersion(self, log_dispersion):
        """Return the largest log-likelihood of all distributions with this dispersion."""
        theta = np.exp(-log_dispersion)

        def derivative(delta):
            return self.observed * (theta * self.mean - delta) + self._sum_over_censored(
                lambda log_limit: _inverse_mills_ratio(delta - theta * log_limit)
            )

        return self.log_likelihood(theta, _find_decreasing_zero(derivative, theta * self.mean))


def _inverse_mills_ratio(z):
    """Return φ(z)/Φ(z), the standard normal density divided by the standard normal distribution function."""
    return np.exp(-0.5 * z * z - 0.5 * math.log(2 * math.pi) - log_ndtr(z))


def _first_outside(condition: Callable, start: np.ndarray, direction: int) -> np.ndarray:
    """Return points at which an elementwise condition is false.

    The search starts at `start` and goes upwards (`direction` 1) or downwards (`direction` −1). It doubles
    the distance from `start` until the condition is false, at most `_MAX_DOUBLINGS` times. The condition may
    still be true then.
    """
    point, step = start, 0.5
    for _ in range(_MAX_DOUBLINGS):
        is_inside = condition(point)
        if not np.any(is_inside):
            break
        point, step = np.where(is_inside, start + direction * step, point), 2 * step
    return point


def _find_zero(f: Callable, positive: np.ndarray, negative: np.ndarray) -> np.ndarray:
    """Return the zeros of an elementwise function between points at which it is > 0 and ≤ 0."""
    positive, negative = bisect(lambda y: f(y) > 0, positive, negative, _HALVINGS)
    return 0.5 * (positive + negative)


def _find_decreasing_zero(f: Callable, start: np.ndarray) -> np.ndarray:
    """Return the zeros of a decreasing elementwise function, searched from the points `start`."""
    return _find_zero(
        f, _first_outside(lambda y: f(y) <= 0, start, -1), _first_outside(lambda y: f(y) > 0, start, 1)
    )


def profile_intervals(capacities: Capacities, median, dispersion, at, confidence: float) -> Intervals:
    """Return the profile-likelihood intervals of a lognormal distribution fitted to capacities.

    - `capacities`: statistics of the capacities
    - `median`, `dispersion`: the fitted values
    - `at`: intensities at which the curve is evaluated, in the unit of the median; their shape must broadcast
      with `capacities`
    - `confidence`: confidence level, in (0, 1)
    """
    n, (low, high) = capacities.total, ((1 - confidence) / 2, (1 + confidence) / 2)
    mu = np.log(median)
    maximum = capacities.log_likelihood(1 / dispersion, mu / dispersion)
    # At the bounds, the profile of the log-likelihood is below its maximum by half this value.
    allowed_fall = n * np.log1p(stdtrit(n - 1, high) ** 2 / (n - 1))

    def bounds(excess: Callable, start) -> np.ndarray:
        ends = (_first_outside(lambda y: excess(y) > 0, start, direction) for direction in (-1, 1))
        return np.stack([_find_zero(excess, start, end) for end in ends])

    def dispersion_bound(p):
        return _dispersion_bound(capacities, np.log(dispersion), maximum, chdtri(n - 1, 1 - p) / n)

    x = np.log(at)
    return Intervals(
        bounds(lambda y: allowed_fall - 2 * (maximum - capacities.profile_at_probit(y, 0.0)), mu),
        np.stack([dispersion_bound(high), dispersion_bound(low)]),
        bounds(
            lambda q: allowed_fall - 2 * (maximum - capacities.profile_at_probit(x, q)), (x - mu) / dispersion
        ),
    )


def _dispersion_bound(capacities: Capacities, log_dispersion, maximum, ratio) -> np.ndarray:
    """Return the confidence bound of ln(dispersion) that corresponds to a quantile of χ².

    - `capacities`: statistics of n capacities
    - `log_dispersion`: the fitted value of ln(dispersion)
    - `maximum`: the largest log-likelihood
    - `ratio`: (quantile of χ²)/n; without censored records this is variance/dispersion² at the bound

    With or without censored records, the profile at the bound is below its maximum by the same amount.
    """
    target = np.sign(ratio - 1) * np.sqrt(capacities.total * (ratio - 1 - np.log(ratio)))

    def residual(y):
        fall = 2 * (maximum - capacities.profile_at_dispersion(y))
        return np.sign(log_dispersion - y) * np.sqrt(np.maximum(fall, 0.0)) - target

    return _find_decreasing_zero(residual, log_dispersion)


def jackknife_intervals(estimate: np.ndarray, reduced: np.ndarray, confidence: float) -> np.ndarray:
    """Return bias-corrected jackknife intervals (lower, upper) with quantiles of Student's t, shape (2, …).

    - `estimate`: estimates from all n records, shape (…)
    - `reduced`: estimates from all records except one; the first axis is the omitted record, shape (n, …)
    - `confidence`: confidence level, in (0, 1)
    """
    n = len(reduced)
    mean = reduced.mean(axis=0)
    error = np.sqrt((n - 1) / n * np.sum((reduced - mean) ** 2, axis=0))
    unbiased = n * estimate - (n - 1) * mean
    half_width = float(stdtrit(n - 1, (1 + confidence) / 2)) * error
    return np.stack([unbiased - half_width, unbiased + half_width])
