"""Monte Carlo: the share of failures among independent samples of standard normal vectors u."""

from __future__ import annotations

import math

import scipy

from ._base import CONFIDENCE, AbstractMean, ProbabilityEstimate

BATCH = 4096  # number of samples in memory at once


class MonteCarlo(AbstractMean):
    """Monte Carlo: each contribution is 1 for a failure and 0 otherwise."""

    needs_design_points = False
    has_exact_interval = True  # the binomial interval is exact

    def round(self, size: int) -> None:
        for start in range(0, size, BATCH):
            u = self.rng.standard_normal((min(BATCH, size - start), self.limit.dimension))
            self.add((self.limit.values(u) <= 0).astype(float))

    def estimate(self) -> ProbabilityEstimate:
        failures = round(self.total)
        p = failures / self.count
        interval = scipy.stats.binomtest(failures, self.count).proportion_ci(CONFIDENCE, method="exact")
        error = math.sqrt(p * (1 - p) / self.count)
        return ProbabilityEstimate(p, error, (float(interval.low), float(interval.high)), float(failures))
