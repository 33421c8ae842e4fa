"""Subset simulation (Au & Beck 2001): the probability of a rare event as a product of larger probabilities.

The method needs neither derivatives nor design points. Failure is G(u) ≤ 0, with the limit state function G
of a vector u of independent standard normal numbers. A run descends through levels of G. At each level, the
samples with the lowest G (one twentieth by default) are the starts of chains. A chain proposes a move of u,
and accepts the move if the new G does not exceed the level. Moves follow conditional sampling (Papaioannou et
al. 2015): u' = √(1 − s²) u + s ξ, with the size s of the move and standard normal ξ. Each component of u
moves with the probability 1/4. If u has fewer than 40 components, the probability is higher, so that ten move
on average, or all if there are at most ten. Long moves of few components decorrelate the samples sooner than
short moves of all components. A run ends at the level 0. It ends without failure if it does
not reach this level within `MAX_LEVELS` levels, or if all samples of a level have the same G.

The samples of a run are correlated within their chains and across levels. The error that is estimated from
one run neglects the correlation across levels, so it serves only as a lower bound. Therefore a round consists
of several independent runs, and their spread gives the error. The runs share batches. The estimate has a bias
of the order of the squared coefficient of variation of a run.
"""

from __future__ import annotations

import math
from collections.abc import Generator
from typing import NamedTuple

import numpy as np
import scipy

from ._base import CONFIDENCE, MIN_ROUNDS, AbstractEstimator, ProbabilityEstimate, lognormal_interval

SHARE = 0.05  # default share of the samples that pass to the next level
RUNS = 6  # number of independent runs of a round
SAMPLES = 1500  # default number of samples of a level in the first round
MIN_SAMPLES = 800  # smallest number of samples of a level in later rounds
# Largest ratio of the number of samples of a level to the largest number in earlier rounds. A small ratio
# leads to more rounds, which estimate the spread better.
MAX_GROWTH = 2
MAX_ENTRIES = 5e7  # largest number of array entries of the samples in memory at once
MAX_LEVELS = 40  # largest number of levels of a run
MOVE_SHARE = 0.25  # mean share of the components that a move changes
MIN_MOVED = 10  # smallest mean number of changed components; all are changed if u has fewer
ACCEPTED_SHARE = 0.35  # target of the share of accepted moves
UPPER_PROBABILITY = 0.5 + CONFIDENCE / 2  # probability of values below the upper end of the interval


class _Run(NamedTuple):
    """A completed run."""

    probability: float  # estimate of P; 0 if no level reached failure
    variance: float  # relative variance of `probability`, estimated from this run alone
    samples: int  # number of samples per level
    failing: np.ndarray  # the failing samples, shape (k, d)


class Subset(AbstractEstimator):
    """Subset simulation.

    - `samples`: number of samples of a level in the first round, in which `round` ignores `size`
    - `share`: share of the samples that pass to the next level
    """

    needs_design_points = False

    def __init__(self, limit, points, rng, samples: int = SAMPLES, share: float = SHARE):
        super().__init__(limit, points, rng)
        self.share = share
        self.first_samples = samples
        self.runs: list[_Run] = []
        self.spent = 0  # number of scenes of all runs

    def round(self, size: int) -> None:
        before, samples = self.limit.scenes, self.first_samples
        if self.runs:
            scenes_per_sample = self.spent / sum(run.samples for run in self.runs)
            max_samples = max(SAMPLES, MAX_ENTRIES / (RUNS * self.limit.dimension))
            largest = max(run.samples for run in self.runs)
            max_samples = min(max_samples, MAX_GROWTH * largest)
            # Runs with less than half of the samples of the largest run would add almost no information.
            samples = int(min(max(size / (RUNS * scenes_per_sample), MIN_SAMPLES, largest / 2), max_samples))
        self.runs += self._complete_runs([self._run(samples) for _ in range(RUNS)])
        self.spent += self.limit.scenes - before

    def _complete_runs(self, runs: list[Generator[np.ndarray, np.ndarray, _Run]]) -> list[_Run]:
        """Complete the runs; G of the samples that they request is evaluated in common batches."""
        ended: list[_Run] = []
        pending = [(run, next(run)) for run in runs]
        while pending:
            values = self.limit.values(np.concatenate([u for _, u in pending]))
            values_of_runs = np.split(values, np.cumsum([len(u) for _, u in pending])[:-1])
            still_pending = []
            for (run, _), g in zip(pending, values_of_runs, strict=True):
                try:
                    still_pending.append((run, run.send(g)))
                except StopIteration as end:
                    ended.append(end.value)
            pending = still_pending
        return ended

    def _run(self, samples: int) -> Generator[np.ndarray, np.ndarray, _Run]:
        """Perform a run: a generator that yields samples u, receives their G, and returns the run."""
        u = self.rng.standard_normal((samples, self.limit.dimension))
        g = yield u
        probability, variance, move_size, chains = 1.0, 0.0, 0.6, samples
        for _ in range(MAX_LEVELS):
            level = max(float(np.quantile(g, self.share, method="lower")), 0.0)
            is_below = g <= level
            if level > 0 and is_below.all():
                # Almost all samples have the largest G, such as 1 for motions that lift no column. Only the
                # samples with a smaller G lead to failure.
                is_below = g < level
                if not is_below.any():
                    break
                level = max(float(g[is_below].max()), 0.0)
            variance += _relative_variance(is_below, chains)
            probability *= float(is_below.mean())
            if level == 0.0:
                return _Run(probability, variance, samples, u[is_below])
            # Rejected moves repeat samples, so more samples than needed may be at or below the level. Choose
            # at random among them, because the first samples of a chain have moved the least. If there are
            # fewer samples than needed, several chains start from the same sample.
            chosen = np.resize(self.rng.permutation(np.flatnonzero(is_below)), round(self.share * samples))
            chains = chosen.size
            u, g, move_size = yield from self._chains(u[chosen], g[chosen], level, move_size)
        return _Run(0.0, math.inf, samples, np.zeros((0, self.limit.dimension)))

    def _chains(self, u, g, level: float, move_size: float):
        """Advance chains: a generator that yields candidates and receives their G. Returns the samples of all
        chains, their G, and the size of the next move.

        - `u`, `g`: first sample of each chain, shape (chains, d), and G of these samples, shape (chains,)
        - `level`: largest accepted G; `move_size`: size s of the first move, in (0, 1]
        """
        us, gs = [u], [g]
        move_share = max(MOVE_SHARE, MIN_MOVED / self.limit.dimension)
        for _ in range(round(1 / self.share) - 1):
            step = np.where(self.rng.random(u.shape) < move_share, move_size, 0.0)
            candidate = np.sqrt(1 - step**2) * u + step * self.rng.standard_normal(u.shape)
            value = yield candidate
            accepted = value <= level
            u, g = np.where(accepted[:, None], candidate, u), np.where(accepted, value, g)
            us.append(u)
            gs.append(g)
            # Shorten the next moves if too few are accepted, and lengthen them if too many are.
            move_size = min(move_size * math.exp(float(accepted.mean()) - ACCEPTED_SHARE), 1.0)
        return np.concatenate(us), np.concatenate(gs), move_size

    def is_exhausted(self) -> bool:
        """Return True after at least `MIN_ROUNDS` rounds, if no run has reached failure."""
        return len(self.runs) >= MIN_ROUNDS * RUNS and all(run.probability == 0 for run in self.runs)

    def estimate(self) -> ProbabilityEstimate:
        # Runs with far fewer samples than the largest vary too much. They only helped to choose its size.
        largest = max(run.samples for run in self.runs)
        runs = [run for run in self.runs if run.samples >= largest / 4]
        p = np.array([run.probability for run in runs])
        weight = np.array([run.samples for run in runs], float)
        weight /= weight.sum()
        mean = float(weight @ p)
        if mean == 0:
            # No run reached failure: it had MAX_LEVELS levels, or all samples of a level had the same G. The
            # upper end of the interval, share², is far above the probabilities at which this happens.
            return ProbabilityEstimate(0.0, 0.0, (0.0, self.share**2), 0.0)
        # Runs are weighted by their numbers of samples, because the variance of a run is proportional to
        # 1/samples. A few runs may agree by chance, so the error is at least that of the estimated variances.
        spread = float(np.sum(weight * (p - mean) ** 2)) / (p.size - 1)
        least_variance = float(np.sum((weight * p) ** 2 * [_finite(run.variance) for run in runs]))
        # The spread of a few runs is itself uncertain. Therefore the error is multiplied by the ratio of the
        # quantiles of Student's t distribution and the normal distribution.
        error = math.sqrt(max(spread, least_variance)) * float(
            scipy.stats.t.ppf(UPPER_PROBABILITY, p.size - 1) / scipy.stats.norm.ppf(UPPER_PROBABILITY)
        )
        effective = min((mean / error) ** 2, 1e9) if error > 0 else 1e9
        return ProbabilityEstimate(mean, error, lognormal_interval(mean, error, p.size), effective)


def _finite(variance: float) -> float:
    """Return a variance, or 0 instead of inf."""
    return variance if math.isfinite(variance) else 0.0


def _relative_variance(is_below: np.ndarray, chains: int) -> float:
    """Return the relative variance of the share of samples at or below a level (Au & Beck 2001). `is_below`,
    shape (n,), lists the first samples of all chains, then the second ones, …; the correlation along each
    chain increases the variance."""
    n, p = is_below.size, float(is_below.mean())
    if p in (0.0, 1.0):
        return 0.0
    length = n // chains
    x = is_below[: length * chains].reshape(length, chains).astype(float)
    correlation = 0.0
    for lag in range(1, length):
        r = float((x[:-lag] * x[lag:]).mean()) - p**2
        correlation += 2 * (1 - lag / length) * r / (p * (1 - p))
    return (1 - p) / (p * n) * (1 + max(correlation, 0.0))
