"""What estimators share: rounds of independent contributions, whose mean is the probability."""

from __future__ import annotations

import abc
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import scipy

from rockjax._risk.limit_state import AbstractLimitState
from rockjax._risk.search import Found

LEVEL = 0.95  # of the interval
ROUNDS = 2  # at least, and
EFFECTIVE = 20  # effective failures, before a round may be the last


class Estimate(NamedTuple):
    """A probability with what is known of its accuracy; `effective` is the effective number of failures in
    the sample."""

    probability: float
    standard_error: float
    interval: tuple[float, float]
    effective: float

    @property
    def cov(self) -> float:
        """Coefficient of variation of the estimate, inf while nothing has failed."""
        return self.standard_error / self.probability if self.probability > 0 else math.inf


class Slopes(NamedTuple):
    """Derivatives of a probability by name, each with its standard error; and the share of the surface of
    failure, by its density, across which G jumps, of which they know nothing."""

    named: dict[str, tuple[float, float]]
    jumps: float


class AbstractEstimator(abc.ABC):
    """An estimator of P(G ≤ 0). Rounds go on until the coefficient of variation or the number of scenes is
    reached."""

    needs_design_points = True
    always_covers = False  # the interval of an estimate that has not converged covers as often as it says

    def __init__(self, limit: AbstractLimitState, found: Found, rng: np.random.Generator):
        self.limit, self.found, self.rng = limit, found, rng
        self.rounds = 0

    @abc.abstractmethod
    def round(self, size: int) -> None:
        """Add a round that costs about `size` scenes."""

    @abc.abstractmethod
    def estimate(self) -> Estimate:
        """What is known so far."""

    def slopes(self) -> Slopes | None:
        """dP/dy by the same samples, where limit state and method say them."""
        return None

    def converged(self, known: Estimate, cov: float) -> bool:
        """Whether an estimate is as accurate as asked for, as far as its own samples can tell."""
        return self.rounds >= ROUNDS and known.effective >= EFFECTIVE and known.cov <= cov

    def has_light_tail(self) -> bool:
        """Whether no few contributions make up most of the estimate, so that its spread tells its error."""
        return True

    def exhausted(self) -> bool:
        """Whether more rounds would tell nothing more."""
        return False

    def run(self, cov: float, max_scenes: int, first: int, report: Callable[[Estimate], None]) -> Estimate:
        """Rounds, each as large as the last estimate asks for, at most four times all before it."""
        start, size = self.limit.scenes, first
        while True:
            self.round(size)
            self.rounds += 1
            known, spent = self.estimate(), self.limit.scenes - start
            report(known)
            if spent >= max_scenes or self.converged(known, cov) or self.exhausted():
                return known
            missing = spent * ((known.cov / cov) ** 2 - 1) if math.isfinite(known.cov) else 3 * spent
            size = int(min(max(1.1 * missing, first / 2), 3 * spent, max_scenes - spent + 1))


class AbstractMean(AbstractEstimator):
    """Independent contributions y ≥ 0 with P = E[y]."""

    def __init__(self, limit, found, rng):
        super().__init__(limit, found, rng)
        self.count, self.total, self.squares = 0, 0.0, 0.0

    def add(self, y: np.ndarray) -> None:
        self.count += y.size
        self.total += float(y.sum())
        self.squares += float((y**2).sum())

    def estimate(self) -> Estimate:
        p = self.total / self.count
        variance = max(self.squares / self.count - p**2, 0.0) / max(self.count - 1, 1)
        effective = self.total**2 / self.squares if self.squares > 0 else 0.0
        error = math.sqrt(variance)
        return Estimate(p, error, lognormal_interval(p, error, self.count), effective)


def lognormal_interval(p: float, error: float, count: int) -> tuple[float, float]:
    """Of a positive estimate, lognormal; where nothing has failed in `count` samples, up to what that rules
    out."""
    if p == 0:
        return 0.0, 1 - (1 - LEVEL) ** (1 / count)
    reach = math.exp(float(scipy.stats.norm.ppf(0.5 + LEVEL / 2)) * math.sqrt(math.log1p((error / p) ** 2)))
    return p / reach, min(p * reach, 1.0)
