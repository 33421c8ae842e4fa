"""Base classes of the estimators of a probability of failure P(G(u) ≤ 0).

G is the limit-state function of a vector u of independent standard normal numbers. A sample is a random u,
and a scene is one evaluation of G. An estimator adds rounds of samples until its estimate has converged.
"""

from __future__ import annotations

import abc
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import scipy

from rockjax._risk.limit_state import AbstractLimitState
from rockjax._risk.search import DesignPoints

CONFIDENCE = 0.95  # confidence level of the interval
MIN_ROUNDS = 2  # smallest number of rounds of a converged estimate
MIN_EFFECTIVE = 20  # smallest effective number of failures of a converged estimate


class ProbabilityEstimate(NamedTuple):
    """A probability with its accuracy."""

    probability: float
    standard_error: float
    interval: tuple[float, float]  # confidence interval at `CONFIDENCE`
    # Effective number of failures: this number of independent failures of equal weight would give about the
    # same accuracy.
    effective: float

    @property
    def cov(self) -> float:
        """Coefficient of variation of the estimate; inf if no sample has failed."""
        return self.standard_error / self.probability if self.probability > 0 else math.inf


class ProbabilitySlopes(NamedTuple):
    """Derivatives of a probability with respect to parameters."""

    by_name: dict[str, tuple[float, float]]  # (derivative, standard error) by the name of the parameter
    # Share of the surface of failure across which G jumps, weighted by the density of u. The derivatives
    # leave this part out.
    jumps: float


class AbstractEstimator(abc.ABC):
    """Estimator of P(G(u) ≤ 0).

    - `limit`: limit state
    - `points`: design points of the limit state; not used if `needs_design_points` is False
    - `rng`: source of random numbers
    - `rounds`: number of rounds so far
    """

    needs_design_points = True
    has_exact_interval = False  # True if the interval is valid even before convergence

    def __init__(self, limit: AbstractLimitState, points: DesignPoints, rng: np.random.Generator):
        self.limit, self.points, self.rng = limit, points, rng
        self.rounds = 0

    @abc.abstractmethod
    def round(self, size: int) -> None:
        """Add a round of about `size` scenes."""

    @abc.abstractmethod
    def estimate(self) -> ProbabilityEstimate:
        """Return the estimate from all rounds so far."""

    def slopes(self) -> ProbabilitySlopes | None:
        """Return dP/dy for the named parameters y, from the samples so far; None if the limit state has no
        named parameters, or if the method computes no derivatives."""
        return None

    def has_converged(self, estimate: ProbabilityEstimate, cov: float) -> bool:
        """Return True if the coefficient of variation of an estimate is at most `cov`, after at least
        `MIN_ROUNDS` rounds and with at least `MIN_EFFECTIVE` effective failures."""
        return self.rounds >= MIN_ROUNDS and estimate.effective >= MIN_EFFECTIVE and estimate.cov <= cov

    def has_light_tail(self) -> bool:
        """Return False if a few samples dominate the estimate. Its standard error is then unreliable."""
        return True

    def is_exhausted(self) -> bool:
        """Return True if further rounds would add no information."""
        return False

    def run(
        self, cov: float, max_scenes: int, first: int, report: Callable[[ProbabilityEstimate], None]
    ) -> ProbabilityEstimate:
        """Add rounds until the estimate converges, the estimator is exhausted, or `max_scenes` is reached,
        and return the last estimate. No round begins after `max_scenes` scenes. `report` receives the
        estimate after each round.

        The first round has about `first` scenes, except that the first round of a `Subset` has a fixed size.
        The size of later rounds follows from the last estimate, but is at most three times the number of
        scenes so far.
        """
        start, size = self.limit.scenes, first
        while True:
            self.round(size)
            self.rounds += 1
            latest, spent = self.estimate(), self.limit.scenes - start
            report(latest)
            if spent >= max_scenes or self.has_converged(latest, cov) or self.is_exhausted():
                return latest
            needed = spent * ((latest.cov / cov) ** 2 - 1) if math.isfinite(latest.cov) else 3 * spent
            size = int(min(max(1.1 * needed, first / 2), 3 * spent, max_scenes - spent + 1))


class AbstractMean(AbstractEstimator):
    """Base class for estimators of P as the mean of independent contributions y ≥ 0, one for each sample."""

    def __init__(self, limit, points, rng):
        super().__init__(limit, points, rng)
        self.count, self.total, self.sum_of_squares = 0, 0.0, 0.0

    def add(self, y: np.ndarray) -> None:
        """Add contributions, shape (k,)."""
        self.count += y.size
        self.total += float(y.sum())
        self.sum_of_squares += float((y**2).sum())

    def estimate(self) -> ProbabilityEstimate:
        p = self.total / self.count
        variance = max(self.sum_of_squares / self.count - p**2, 0.0) / max(self.count - 1, 1)
        effective = self.total**2 / self.sum_of_squares if self.sum_of_squares > 0 else 0.0
        error = math.sqrt(variance)
        return ProbabilityEstimate(p, error, lognormal_interval(p, error, self.count), effective)


def lognormal_interval(p: float, error: float, count: int) -> tuple[float, float]:
    """Return the lognormal confidence interval of an estimate p with the standard error `error`. For p = 0 it
    starts at 0, and its upper end is the probability of failure at which `count` samples contain no failure
    with the probability 1 − `CONFIDENCE`."""
    if p == 0:
        return 0.0, 1 - (1 - CONFIDENCE) ** (1 / count)
    factor = math.exp(
        float(scipy.stats.norm.ppf(0.5 + CONFIDENCE / 2)) * math.sqrt(math.log1p((error / p) ** 2))
    )
    return p / factor, min(p * factor, 1.0)
