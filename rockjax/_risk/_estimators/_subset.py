"""Subset simulation (Au & Beck 2001): a rare event as a chain of frequent ones. Needs no derivative and no
design point.

Samples below a level of G, a tenth of those above, are moved by conditional sampling (Papaioannou et al.
2015), u' = ρu + √(1 − ρ²) ξ, and kept where they stay below it. A run ends at the level 0; runs are
independent. The estimate has a bias of the order of its squared coefficient of variation.
"""

from __future__ import annotations

import math

import numpy as np

from ._base import AbstractEstimator, Estimate, lognormal_interval

SHARE = 0.1  # of the samples that fail a level
SAMPLES = 1000  # of a level
LEVELS = 40  # of a run: P = 1e-40
ACCEPTED = 0.44  # share of moves to aim for


class Subset(AbstractEstimator):
    needs_design_points = False

    def __init__(self, limit, found, rng):
        super().__init__(limit, found, rng)
        self.runs: list[float] = []
        self.variances: list[float] = []  # relative, of each run
        self.failing: list[np.ndarray] = []  # samples that fail, of each run

    def round(self, size: int) -> None:
        before = self.limit.scenes
        while True:
            p, variance = self._run()
            self.runs.append(p)
            self.variances.append(variance)
            if self.limit.scenes - before >= size:
                return

    def _run(self) -> tuple[float, float]:
        u = self.rng.standard_normal((SAMPLES, self.limit.dimension))
        g = self.limit.values(u)
        probability, variance, rho, chains = 1.0, 0.0, 0.8, SAMPLES
        for _ in range(LEVELS):
            level = max(float(np.quantile(g, SHARE, method="lower")), 0.0)
            below = g <= level
            share = float(below.mean())
            variance += _relative_variance(below, chains)
            probability *= share
            if level == 0.0:
                self.failing.append(u[below])
                return probability, variance
            seeds = np.flatnonzero(below)[: round(SHARE * SAMPLES)]
            chains = seeds.size
            u, g, rho = self._chains(u[seeds], g[seeds], level, rho)
        self.failing.append(np.zeros((0, self.limit.dimension)))
        return 0.0, math.inf

    def _chains(self, u, g, level: float, rho: float):
        us, gs = [u], [g]
        for _ in range(round(1 / SHARE) - 1):
            candidate = rho * u + math.sqrt(1 - rho**2) * self.rng.standard_normal(u.shape)
            value = self.limit.values(candidate)
            stays = value <= level
            u, g = np.where(stays[:, None], candidate, u), np.where(stays, value, g)
            us.append(u)
            gs.append(g)
            # Shorter moves where too few are kept, longer ones where too many are.
            spread = math.sqrt(1 - rho**2) * math.exp(float(stays.mean()) - ACCEPTED)
            rho = math.sqrt(max(1 - min(spread, 1.0) ** 2, 0.0))
        return np.concatenate(us), np.concatenate(gs), rho

    def estimate(self) -> Estimate:
        p, count = float(np.mean(self.runs)), len(self.runs)
        if p == 0:
            return Estimate(0.0, 0.0, (0.0, SHARE**2), 0.0)
        each = float(np.mean(self.variances))
        if count >= 8:  # enough of them to tell their spread
            each = float(np.var(self.runs, ddof=1)) / p**2
        error = p * math.sqrt(each / count)
        return Estimate(
            p, error, lognormal_interval(p, error, count), min((p / error) ** 2, 1e9) if error > 0 else 1e9
        )


def _relative_variance(below: np.ndarray, chains: int) -> float:
    """Of the share of a level, from samples in chains one after the other, with their correlation (Au & Beck
    2001)."""
    n, p = below.size, float(below.mean())
    if p in (0.0, 1.0):
        return 0.0
    length = n // chains
    x = below[: length * chains].reshape(length, chains).astype(float)
    correlation = 0.0
    for lag in range(1, length):
        r = float((x[:-lag] * x[lag:]).mean()) - p**2
        correlation += 2 * (1 - lag / length) * r / (p * (1 - p))
    return (1 - p) / (p * n) * (1 + max(correlation, 0.0))
