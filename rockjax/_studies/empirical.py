"""Empirical distributions of samples that may have unknown values, with bounds for every sample size.

The equations (E1) to (E3) are in docs/ensembles.md.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np


class Sample(NamedTuple):
    """Independent values of a scalar, some of which may be unknown.

    - `values`: values, shape (n,); ±inf is allowed
    - `is_open`: True where a value is unknown, shape (n,). In place of an unknown value, estimates use the
      entry of `values`. Confidence bounds hold whatever the unknown values are
    """

    values: np.ndarray
    is_open: np.ndarray

    @property
    def size(self) -> int:
        """Number of values."""
        return self.values.size

    @property
    def lowest(self) -> np.ndarray:
        """Values in ascending order, with −∞ for unknown values."""
        return np.sort(np.where(self.is_open, -np.inf, self.values))

    @property
    def highest(self) -> np.ndarray:
        """Values in ascending order, with +∞ for unknown values."""
        return np.sort(np.where(self.is_open, np.inf, self.values))


class Estimates(NamedTuple):
    """Estimates and their lower and upper confidence bounds, three arrays of the same shape."""

    value: np.ndarray
    lower: np.ndarray
    upper: np.ndarray


def band_half_width(n: int, confidence: float) -> float:
    """Return the half width of the confidence band of an empirical distribution function [–].

    For n values the half width is ε = √(ln(2/a)/(2n)) with a = 1 − confidence, (E1), from the inequality of
    Dvoretzky, Kiefer and Wolfowitz with the constant of Massart (1990). The band holds for every n ≥ 1 and
    every distribution, at all values at once.
    """
    return math.sqrt(math.log(2 / (1 - confidence)) / (2 * n))


def share_up_to(ordered: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return the share of the values `ordered`, in ascending order, that are ≤ `at`."""
    return np.searchsorted(ordered, at, side="right") / ordered.size


def distribution(sample: Sample, at: np.ndarray, confidence: float) -> Estimates:
    """Return the empirical distribution function and its band, which holds at all values at once.

    - `sample`: the values
    - `at`: values at which the function is evaluated, any shape
    - `confidence`: confidence level of the band, in (0, 1)
    """
    half_width = band_half_width(sample.size, confidence)
    return Estimates(
        share_up_to(np.sort(sample.values), at),
        np.maximum(share_up_to(sample.highest, at) - half_width, 0.0),
        np.minimum(share_up_to(sample.lowest, at) + half_width, 1.0),
    )


def quantiles(sample: Sample, probability: np.ndarray, confidence: float) -> Estimates:
    """Return the quantile and its confidence interval for each probability.

    The estimate is the least value at which the empirical distribution function is ≥ probability. The ends of
    the interval are order statistics (values of the sorted sample). They follow from the number of values
    below a quantile, which is binomial for continuous distributions, (E2) (David and Nagaraja, Order
    Statistics, 2003, section 7.1). For every distribution, the true quantile lies below the interval with a
    probability of at most (1 − confidence)/2, and above it with a probability of at most (1 − confidence)/2.
    If there are too few values, the lower bound is −∞ or the upper bound is +∞.

    - `sample`: the values
    - `probability`: probabilities of not exceeding the quantiles, in (0, 1), shape (q,)
    - `confidence`: confidence level of each interval, in (0, 1)
    """
    from scipy.stats import binom

    n, tail = sample.size, (1 - confidence) / 2
    # The factor prevents a rounding error of n·probability from raising the rank by 1.
    rank = np.ceil(n * probability * (1 - 1e-12)).astype(int)
    # Ranks 0 and n + 1 are the bounds −∞ and +∞.
    low = binom.ppf(tail, n, probability).astype(int)
    high = binom.ppf(1 - tail, n, probability).astype(int) + 1
    lower_ends = np.r_[-np.inf, sample.lowest, np.inf]
    upper_ends = np.r_[-np.inf, sample.highest, np.inf]
    return Estimates(np.sort(sample.values)[np.maximum(rank, 1) - 1], lower_ends[low], upper_ends[high])


def probability_interval(least: int, most: int, n: int, confidence: float) -> tuple[float, float]:
    """Return the Clopper–Pearson interval of a probability.

    - `least`, `most`: least and largest possible number of events. Trials with an unknown outcome count as
      events only in `most`
    - `n`: number of trials
    - `confidence`: confidence level, in (0, 1)
    """
    from scipy.stats import binomtest

    low, high = (binomtest(k, n).proportion_ci(confidence) for k in (least, most))
    return float(low.low), float(high.high)


class Comparison(NamedTuple):
    """Kolmogorov–Smirnov comparison of two samples of n and m values.

    - `statistic`: D, the largest distance between the empirical distribution functions [–]
    - `at`: value at which the functions have the distance D
    - `p_value`: approximate probability that two samples from the same distribution have a distance ≥ D [–].
      If there are unknown values, the least distance that they allow replaces D. For discontinuous
      distributions `p_value` is too large; for samples of less than about 20 values it may be too small
    - `lower`, `upper`: confidence interval of the largest distance between the true distributions, from the
      bands of both samples, (E3) [–]. If `lower` > 0, the distributions differ at this confidence
    - `confidence`: confidence level of the interval [–]
    """

    statistic: float
    at: float
    p_value: float
    lower: float
    upper: float
    confidence: float


def compare(first: Sample, second: Sample, confidence: float) -> Comparison:
    """Compare two independent samples by the test of Kolmogorov and Smirnov.

    - `first`, `second`: the samples
    - `confidence`: confidence level of the interval, in (0, 1)

    Values of +∞ count as equal, and so do values of −∞. The error probability 1 − confidence is shared
    equally between the bands of the samples.
    """
    from scipy.special import gammaln
    from scipy.stats import kstwo

    x = np.unique(np.concatenate([[-np.inf], first.values, second.values]))
    difference = np.abs(share_up_to(np.sort(first.values), x) - share_up_to(np.sort(second.values), x))
    # Whatever the unknown values are, each distribution function lies between its two bounds. The bounds
    # therefore give the least and the largest possible distance.
    bounds = [[share_up_to(y, x) for y in (sample.highest, sample.lowest)] for sample in (first, second)]
    (low_1, high_1), (low_2, high_2) = bounds
    least = max(float(np.max(np.maximum(low_1 - high_2, low_2 - high_1))), 0.0)
    most = float(np.max(np.maximum(high_1 - low_2, high_2 - low_1)))
    n, m = first.size, second.size
    # Probability that two samples from the same distribution do not overlap; no result is less probable.
    no_overlap = 2 * math.exp(gammaln(n + 1) + gammaln(m + 1) - gammaln(n + m + 1))
    widths = sum(band_half_width(size, (1 + confidence) / 2) for size in (n, m))
    return Comparison(
        float(difference.max()),
        float(x[difference.argmax()]),
        min(max(float(kstwo.sf(least, max(round(n * m / (n + m)), 1))), no_overlap), 1.0),
        max(least - widths, 0.0),
        min(most + widths, 1.0),
        confidence,
    )
