"""Importance sampling: samples from normals around the design points, each weighted by how likely it was at
the origin.

The density is a mixture h(u) = Σ w_i φ(u − u_i) + w_0 φ(u) with w_i in proportion to Φ(−β_i). With φ itself
in it no weight φ/h exceeds 1/w_0, whatever lies where no design point was found. The weights know only the
projections on the design points, so they do not degenerate with the dimension.

Where failure has little to do with the design points, as for rocking, the weights of failing samples have a
heavy tail: few of them make up most of the sum, and those that were not drawn are missing. The shape k of a
generalised Pareto distribution fitted to the largest weights tells (Vehtari et al. 2024): above 0.7 neither
the estimate nor its spread means much.

A failing sample with a large weight lies where no design point is near. A search from there finds the one
that is missing; then the mixture is widened, and the samples of the old one are forgotten.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import scipy

from rockjax._risk.search import Found, design_points, merged

from ._base import AbstractMean

ORIGIN = 0.1  # w_0
BATCH = 4096
FAR = 1.0  # weight of a failure that no design point explains; at one of them it is Φ(−β) or so
SEARCHES = 4  # new starts in a round at most, and
TAIL = 3.0  # times √n: so many of n weights are the largest, at most a fifth of them, and at least
TAIL_LEAST = 10
HEAVY = 0.7  # k of a tail that is too heavy
WIDENED = 3  # times at most that the mixture is widened


class Importance(AbstractMean):
    def __init__(self, limit, found, rng):
        super().__init__(limit, found, rng)
        self.widened = 0
        self._around(found)

    def _around(self, found: Found) -> None:
        self.found = found
        share = scipy.stats.norm.cdf(-found.beta)
        weights = share / share.sum() if share.sum() > 0 else np.full(share.size, 1 / share.size)
        # Far and near ones alike get enough samples to be seen.
        weights = 0.5 * (weights + 1 / weights.size)
        self.weights = np.concatenate([[ORIGIN], (1 - ORIGIN) * weights])
        self.centres = np.concatenate([np.zeros((1, self.limit.dimension)), found.u])
        self.count, self.total, self.squares = 0, 0.0, 0.0
        self.failing: list[np.ndarray] = []

    def has_light_tail(self) -> bool:
        weights = np.sort(np.concatenate([np.zeros(0), *self.failing]))
        count = int(min(0.2 * weights.size, TAIL * math.sqrt(weights.size)))
        if count < TAIL_LEAST:
            return True
        excess = weights[-count:] - weights[-count - 1]
        return float(scipy.stats.genpareto.fit(excess, floc=0)[0]) <= HEAVY

    def round(self, size: int) -> None:
        unexplained = [self._batch(min(BATCH, size - start)) for start in range(0, size, BATCH)]
        starts = np.concatenate(unexplained)[:SEARCHES]
        if len(starts) == 0 or self.widened >= WIDENED:
            return
        self.widened += 1
        more = merged(self.found, design_points(self.limit, starts))
        if more.beta.size > self.found.beta.size:
            self._around(more)
            self.round(size)

    def _batch(self, count: int) -> np.ndarray:
        """Add so many samples; returns those failures that no design point explains."""
        which = self.rng.choice(self.weights.size, size=count, p=self.weights)
        u = self.centres[which] + self.rng.standard_normal((count, self.limit.dimension))
        # ln φ(u − c)/φ(u) = c·u − |c|²/2
        ratios = u @ self.centres.T - 0.5 * np.sum(self.centres**2, axis=1)
        known: Any = scipy.special.logsumexp(ratios, axis=1, b=self.weights)
        weight = np.exp(-known)
        failed = self.limit.values(u) <= 0
        self.add(np.where(failed, weight, 0.0))
        self.failing.append(weight[failed])
        return u[failed & (weight > FAR)]
