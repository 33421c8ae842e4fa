"""Importance sampling from normal densities around the design points, weighted by likelihood ratios.

Failure is G(u) ≤ 0, with the limit state function G of a vector u of independent standard normal numbers. The
samples u have the density h(u) = Σ w_i φ(u − u_i) + w_0 φ(u), a mixture of standard normal densities φ
around the design points u_i and around the origin. The design points share the weight 1 − w_0: half of it in
proportion to Φ(−β_i), with the distances β_i = |u_i| and the standard normal distribution function Φ, and
half of it equally. The weight of a sample is its likelihood ratio φ(u)/h(u). Because φ itself is part of the
mixture, no weight exceeds 1/w_0. The weights depend only on the projections of u on the design points, so
they do not degenerate in high dimensions.

If failure is unrelated to the design points, as often in rocking, the weights of failing samples have a heavy
tail: a few samples dominate the sum. To detect this, a generalised Pareto distribution is fitted to the
largest weights (Vehtari et al. 2024). If its shape k is above 0.7, neither the estimate nor its spread is
reliable.

A failing sample with a large weight lies far from every design point of the mixture. A search for further
design points starts from such samples. If the search finds a new design point, this point extends the
mixture, and the samples of the old mixture are discarded.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import scipy

from rockjax._risk.search import DesignPoints, design_points, merge_points

from ._base import AbstractMean

ORIGIN_WEIGHT = 0.1  # weight w_0 of the density around the origin
BATCH = 4096  # number of samples in memory at once
# Failing samples with larger weights are far from all design points; near a design point, weights are of the
# order of Φ(−β).
FAR_WEIGHT = 1.0
SEARCHES = 4  # largest number of samples from which the search of a round starts
# The tail consists of the largest TAIL_FACTOR·√n of the n weights of failing samples, at most a fifth of
# them.
TAIL_FACTOR = 3.0
MIN_TAIL = 10  # smallest number of weights in the fit; with fewer, the tail is taken to be light
MAX_SHAPE = 0.7  # largest shape k of a light tail
MAX_EXTENSIONS = 3  # largest number of searches for further design points


class Importance(AbstractMean):
    """Importance sampling; `extensions` is the number of searches for further design points so far."""

    def __init__(self, limit, points, rng):
        super().__init__(limit, points, rng)
        self.extensions = 0
        self._set_mixture(points)

    def _set_mixture(self, points: DesignPoints) -> None:
        """Make the mixture of these design points the sampling density, and discard all samples."""
        self.points = points
        share = scipy.stats.norm.cdf(-points.beta)
        weights = share / share.sum() if share.sum() > 0 else np.full(share.size, 1 / share.size)
        # The equal half gives distant design points enough samples.
        weights = 0.5 * (weights + 1 / weights.size)
        self.weights = np.concatenate([[ORIGIN_WEIGHT], (1 - ORIGIN_WEIGHT) * weights])
        self.centres = np.concatenate([np.zeros((1, self.limit.dimension)), points.u])
        self.count, self.total, self.sum_of_squares = 0, 0.0, 0.0
        self.failing_weights: list[np.ndarray] = []

    def has_light_tail(self) -> bool:
        weights = np.sort(np.concatenate([np.zeros(0), *self.failing_weights]))
        count = int(min(0.2 * weights.size, TAIL_FACTOR * math.sqrt(weights.size)))
        if count < MIN_TAIL:
            return True
        excess = weights[-count:] - weights[-count - 1]
        return float(scipy.stats.genpareto.fit(excess, floc=0)[0]) <= MAX_SHAPE

    def round(self, size: int) -> None:
        far_failures = [self._add_batch(min(BATCH, size - start)) for start in range(0, size, BATCH)]
        starts = np.concatenate(far_failures)[:SEARCHES]
        if len(starts) == 0 or self.extensions >= MAX_EXTENSIONS:
            return
        self.extensions += 1
        all_points = merge_points(self.points, design_points(self.limit, starts))
        if all_points.beta.size > self.points.beta.size:
            self._set_mixture(all_points)
            self.round(size)

    def _add_batch(self, count: int) -> np.ndarray:
        """Add `count` samples and return the failures that lie far from every design point."""
        index = self.rng.choice(self.weights.size, size=count, p=self.weights)
        u = self.centres[index] + self.rng.standard_normal((count, self.limit.dimension))
        # For each centre c of the mixture, ln[φ(u − c)/φ(u)] = c·u − |c|²/2.
        ratios = u @ self.centres.T - 0.5 * np.sum(self.centres**2, axis=1)
        log_ratio: Any = scipy.special.logsumexp(ratios, axis=1, b=self.weights)
        weight = np.exp(-log_ratio)
        failed = self.limit.values(u) <= 0
        self.add(np.where(failed, weight, 0.0))
        self.failing_weights.append(weight[failed])
        return u[failed & (weight > FAR_WEIGHT)]
