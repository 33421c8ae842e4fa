"""Probabilities of failure of several structures, along rays through the failing samples of one structure.

A vector u of independent standard normal numbers determines the ground motion. The surface of failure
separates the points u at which the structure fails, G(u) ≤ 0, from the points at which it survives. A ray is
a half-line from the origin u = 0 in a direction e. The ray crosses the surface of failure at distances r from
the origin. The probability of failure of the ray is q(e) = Σ ±Q(r), summed over the crossings: + where the
ray enters failure, − where it leaves failure. Q(r) is the probability that |u| > r (the upper tail of the chi
distribution). The probability of failure of the structure is the mean over all directions, P = E q(e). If
motions are multiplied by a factor k, the ray has q(e; k) = Σ ±Q(r/k).

Rays are drawn through failing samples of a first structure, with the index 0. Their directions have the
density q₀/P₀ relative to the uniform distribution of directions. For another structure, with u multiplied by
k, the probability of failure is therefore

    P(k) = P₀ E[q(e; k)/q₀(e)],

where the mean E is over these directions. P(k) is as smooth as the distances r of the crossings. Derivatives
of r follow from the implicit function theorem. The sampling error of P₀ is common to all structures.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy

from ._estimators._subset import Subset
from .limit_state import AbstractLimitState
from .lines import Division, narrow_crossings
from .structure import StructureLimitState

# Distance between positions on a ray near |u| = √d. If the dimension d is high, |u| scatters around √d with
# the standard deviation 0.71.
SPACING = 0.3
BELOW_SCAN, ABOVE_SCAN = 1e-7, 1e-9  # probabilities that |u| lies below and above the scanned part of a ray
RANGE_FACTOR = 1.1  # factor by which the scanned range of k is extended on both sides
MAX_FACTOR = 100.0  # largest factor k on u; the smallest is 1/MAX_FACTOR
LOG_TOLERANCE = 0.7  # accepted difference of ln P from its target
MAX_SCENES = 10_000_000  # largest number of scenes of the sample from which rays are drawn
TRIALS = 12  # largest number of trial factors on u; each trial is a subset simulation
TRIAL_SAMPLES = 200  # number of samples of a level in a trial
TRIAL_SHARE = 0.1  # share of these samples that passes to the next level
UNREFINED = Division(rounds=0)  # crossings are not narrowed down
# Makes crossings accurate enough for the start of Newton's method.
REFINED = Division(rounds=4, parts=4, root_offset=0.01, min_share=0.03)
SHARP = Division(rounds=3, parts=16)  # for crossings at which a Newton step fails and G may jump
MAX_WEIGHT = 5.0  # largest weight of a ray, divided by the median weight
JUMP_STEP = 1e-4  # G is taken to jump at a crossing if the last Newton step exceeds this share of r


class ScaledLimitState(AbstractLimitState):
    """A limit state of motions that are multiplied by a factor."""

    def __init__(self, limit: AbstractLimitState, factor: float):
        super().__init__(limit.dimension)
        self.limit, self.factor = limit, factor

    def _values(self, u):
        return self.limit.values(self.factor * u)

    def _gradients(self, u):
        value, slope = self.limit.gradients(self.factor * u)
        return value, self.factor * slope


class Rays(NamedTuple):
    """Directions of rays, with weights such that P(k) ≈ Σ weight·q(e; k) for any structure and factor k.

    - `directions`: unit vectors e, shape (m, d)
    - `weights`: about P₀/(m q₀), but large weights are limited, shape (m,)
    - `factor`: factor k on the motions under which the first structure was sampled
    - `cov`: coefficient of variation of the sampled P₀
    - `scenes`: number of scenes (evaluations of the limit state) that the sample and the rays needed
    """

    directions: np.ndarray
    weights: np.ndarray
    factor: float
    cov: float
    scenes: int


class FactorSolution(NamedTuple):
    """The factor k on u at which a structure fails with the target probability.

    - `factor`: k
    - `sensitivities`: d ln k/d ln y for the named parameters y, in the order of the names
    - `jumps`: share of the crossings at which G jumps, weighted by their contributions to dP/d ln k. The
      sensitivities leave these crossings out
    - `effective`: effective number of rays, (Σ x)²/Σ x² for the contributions x of the rays to P
    """

    factor: float
    sensitivities: np.ndarray
    jumps: float
    effective: float


def sample_rays(limit: AbstractLimitState, probability: float, count: int, cov: float, seed: int) -> Rays:
    """Scale motions until a structure fails with a target probability, and draw rays through failing samples.

    - `limit`: limit state of the structure, which must survive at u = 0
    - `probability`: target probability of failure, in (0, 1), which the scaled motions reach approximately
    - `count`: largest number of failing samples through which rays are drawn
    - `cov`: largest accepted coefficient of variation of the sampled probability

    Raises `ValueError` if the limit state fails at u = 0, if no factor on u leads to the probability, and if
    `cov` is not reached within `MAX_SCENES`.
    """
    scenes_before = limit.scenes
    if limit.values(np.zeros((1, limit.dimension)))[0] <= 0:
        raise ValueError(
            "the limit state fails at u = 0, without any motion; raise the limit, or start from another "
            "structure"
        )
    rng = np.random.default_rng([seed, 3])
    factor, estimator = _find_factor(limit, probability, rng)
    estimate = estimator.run(cov, MAX_SCENES, 500, lambda _: None)
    if not estimator.has_converged(estimate, cov):
        raise ValueError(
            f"in {MAX_SCENES} scenes, the coefficient of variation of a probability near {probability:g} is "
            f"{estimate.cov:.2g}, not {cov:g}; raise cov"
        )
    u, weights = _draw_failing(estimator, count, rng)
    radius = np.linalg.norm(u, axis=1)
    scan = _RayScan(limit, u / radius[:, None], factor)
    scan.narrow(REFINED)
    # The scan of a ray may miss a narrow range of failure that contains its sample; such rays are left out.
    before_sample = scan.r < factor * radius[scan.line]
    is_failing = (
        scan.fails_at_start
        + np.bincount(scan.line[before_sample], scan.sign[before_sample], minlength=radius.size)
        > 0.5
    )
    e = u[is_failing] / radius[is_failing, None]
    weights = weights[is_failing] / scan.probabilities(factor)[is_failing]
    # A ray that fails only in a narrow range of r has a large weight. For another structure this range may be
    # wide, and this ray would then dominate P. The weights are therefore limited.
    weights = np.minimum(weights, MAX_WEIGHT * np.median(weights))
    weights *= estimate.probability / float(weights @ scan.probabilities(factor)[is_failing])
    return Rays(e, weights, factor, estimate.cov, limit.scenes - scenes_before)


def _draw_failing(estimator: Subset, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Draw up to `count` different failing samples from all runs, and return them with their shares of P."""
    total = sum(run.samples for run in estimator.runs)
    runs = [
        (np.unique(run.failing, axis=0), run.probability * run.samples / total)
        for run in estimator.runs
        if len(run.failing)
    ]
    samples, weights = [], []
    for k, (u, p) in enumerate(runs):
        size = min(count // len(runs) + (k < count % len(runs)), len(u))
        samples.append(u[rng.choice(len(u), size=size, replace=False)])
        weights.append(np.full(size, p / max(size, 1)))
    return np.concatenate(samples), np.concatenate(weights)


def _find_factor(limit: AbstractLimitState, probability: float, rng) -> tuple[float, Subset]:
    """Return a factor on u at which the structure fails with about the given probability, and the estimator
    of this probability after one round."""
    target_beta, factor = -float(scipy.stats.norm.ppf(probability)), 1.0
    trials: list[tuple[float, float]] = []  # ln k and the reliability index −Φ⁻¹(P)
    for _ in range(TRIALS):
        estimator = Subset(ScaledLimitState(limit, factor), None, rng, TRIAL_SAMPLES, TRIAL_SHARE)  # pyright: ignore[reportArgumentType]
        estimator.round(1)
        trial_probability = estimator.estimate().probability
        if trial_probability > 0 and abs(math.log(trial_probability / probability)) < LOG_TOLERANCE:
            return factor, estimator
        beta = -float(scipy.stats.norm.ppf(min(max(trial_probability, 1e-30), 1 - 1e-3)))
        trials.append((math.log(factor), beta))
        # The first step takes the reliability index as proportional to 1/k, as for a plane surface of
        # failure. Later steps use the secant through the last two trials.
        step = math.log(max(beta, 0.5) / max(target_beta, 0.5)) if target_beta != beta else 0.1
        if len(trials) > 1 and abs(trials[-1][1] - trials[-2][1]) > 1e-3:
            (a, at_a), (b, at_b) = trials[-2:]
            slope = (at_b - at_a) / (b - a)
            step = (target_beta - beta) / slope if slope < 0 else step
        elif (beta - target_beta) * step <= 0:
            step = math.copysign(0.3, beta - target_beta)
        factor *= math.exp(min(max(step, -1.1), 1.1))
        if not 1 / MAX_FACTOR < factor < MAX_FACTOR:
            break
    raise ValueError(
        f"no factor on the motion between {1 / MAX_FACTOR:g} and {MAX_FACTOR:g} leads to a probability of "
        f"failure near {probability:g}; give another probability, limit or podium"
    )


class _RayScan:
    """Scan of rays for crossings with the surface of failure, which can be extended.

    Positions on a ray are the distances r = exp(`step`·i) for integers `first` ≤ i < `stop`. The attributes
    `line`, `r` and `survivor` describe the crossings, as `line`, `position` and `survivor` of `LineCrossings`
    do. The attribute `sign` of a crossing is 1 if the ray enters failure there, and −1 if it leaves failure.

    - `limit`: limit state
    - `directions`: unit vectors e of the rays, shape (m, d)
    - `guess`: factor k on u around which the rays are scanned first
    """

    def __init__(self, limit: AbstractLimitState, directions: np.ndarray, guess: float):
        self.limit, self.directions = limit, directions
        d = directions.shape[1]
        # Ends of the range of |u| that is scanned for k = 1.
        self.ends = float(scipy.stats.chi.ppf(BELOW_SCAN, d)), float(scipy.stats.chi.isf(ABOVE_SCAN, d))
        # Positions are integer powers of exp(step), so the guess changes only their range.
        self.step = SPACING / math.sqrt(d)
        self.first = self.stop = math.floor(math.log(self.ends[0] * guess / RANGE_FACTOR) / self.step)
        self.G = np.zeros((len(directions), 0))
        self.extend(guess / RANGE_FACTOR, guess * RANGE_FACTOR)

    def extend(self, low: float, high: float) -> None:
        """Extend the scan to the positions r that are needed for factors k from `low` to `high`."""
        first = min(self.first, math.floor(math.log(self.ends[0] * low) / self.step))
        stop = max(self.stop, math.ceil(math.log(self.ends[1] * high) / self.step) + 1)
        below, above = self._evaluate(first, self.first), self._evaluate(self.stop, stop)
        self.G, self.first, self.stop = np.concatenate([below, self.G, above], axis=1), first, stop
        self.narrow(UNREFINED)

    def narrow(self, division: Division) -> None:
        """Find the crossings between positions, and narrow them down with the settings `division`."""
        m, r = len(self.directions), self._radii(self.first, self.stop)
        scanned = np.repeat(np.arange(m), r.size), np.tile(r, m), self.G.ravel()
        self.line, self.r, self.survivor, _, enters = narrow_crossings(
            self.limit, np.zeros_like(self.directions), self.directions, *scanned, division
        )
        self.sign = np.where(enters, 1.0, -1.0)
        self.fails_at_start = (self.G[:, 0] <= 0).astype(float)  # 1 if a ray fails at its first position

    def sharpen(self, rows: np.ndarray) -> None:
        """Narrow the crossings with the indices `rows` further, with the settings `SHARP`."""
        if rows.size == 0:
            return
        ends = np.sort(np.stack([self.r[rows], self.survivor[rows]], axis=1), axis=1)
        e = self.directions[self.line[rows]]
        line = np.repeat(np.arange(rows.size), 2)
        value = self.limit.values(e[line] * ends.reshape(-1, 1))
        crossed_line, r, *_ = narrow_crossings(
            self.limit, np.zeros_like(e), e, line, ends.ravel(), value, SHARP
        )
        # If an interval has several crossings, they are far closer together than the positions of the scan,
        # so only the first crossing is used.
        first = np.unique(crossed_line, return_index=True)[1]
        self.r[rows[crossed_line[first]]] = r[first]

    def _radii(self, first: int, stop: int) -> np.ndarray:
        """Return the positions r with the integers `first` ≤ i < `stop`, shape (positions,)."""
        return np.exp(self.step * np.arange(first, stop))

    def _evaluate(self, first: int, stop: int) -> np.ndarray:
        """Return G on all rays at the positions with the integers `first` ≤ i < `stop`, shape (rays,
        positions)."""
        r = self._radii(first, stop)
        u = self.directions[:, None, :] * r[:, None]
        return self.limit.values(u.reshape(-1, u.shape[-1])).reshape(len(self.directions), r.size)

    def probabilities(self, k: float) -> np.ndarray:
        """Return the probability of failure q(e; k) of every ray, shape (m,)."""
        signed_tails = self.sign * scipy.stats.chi.sf(self.r / k, self.directions.shape[1])
        return self.fails_at_start + np.bincount(self.line, signed_tails, minlength=len(self.directions))


def solve_factor(
    limit: StructureLimitState, rays: Rays, probability: float, names: Sequence[str], guess: float
) -> FactorSolution:
    """Return the factor on u at which a structure fails with the target probability, and its sensitivities d
    ln k/d ln y for the parameters y in `names`. `guess` is the first value of the factor. A factor below
    1/`MAX_FACTOR` or above `MAX_FACTOR` is replaced by this limit, with zero sensitivities."""
    scan, k = _scan_near(limit, rays, probability, guess)
    if not 1 / MAX_FACTOR < k < MAX_FACTOR:
        return FactorSolution(k, np.zeros(len(names)), 0.0, 0.0)
    scan.narrow(REFINED)
    weight = rays.weights[scan.line]
    jumps, along_ray, slopes = _move_to_roots(limit, rays, scan, names)
    d = rays.directions.shape[1]
    k = _root(scan, rays.weights, probability, k)
    # dP/d ln k = Σ ± weight φ(r/k) r/k, summed over the crossings, with the density φ of |u|.
    rate = weight * scan.sign * scipy.stats.chi.pdf(scan.r / k, d) * scan.r / k
    smooth_rate = np.where(jumps, 0.0, rate)
    log_r_slopes = -slopes / np.where(jumps, 1.0, along_ray)[:, None]  # d ln r/d ln y
    contributions = rays.weights * scan.probabilities(k)
    total = float(np.sum(np.abs(rate)))
    return FactorSolution(
        factor=k,
        sensitivities=smooth_rate @ log_r_slopes / np.sum(smooth_rate),
        jumps=float(np.sum(np.abs(rate[jumps]))) / total,
        effective=float(contributions.sum() ** 2 / np.sum(contributions**2)),
    )


def _move_to_roots(
    limit: StructureLimitState, rays: Rays, scan: _RayScan, names: Sequence[str]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Move the k crossings of a scan in place to the roots of G by Newton steps.

    Returns a mask of the crossings at which G jumps, shape (k,), and derivatives of G at all crossings: with
    respect to ln r, shape (k,), and with respect to the logarithms of the parameters, shape (k, names).
    """

    def newton(max_step) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        value, along_ray, slopes = limit.log_slopes(rays.directions[scan.line] * scan.r[:, None], names)
        step = -value / np.where(along_ray == 0, np.inf, along_ray)
        jumps = (along_ray == 0) | ~(np.abs(step) <= max_step)
        scan.r = scan.r * np.exp(np.where(jumps, 0.0, step))
        return jumps, along_ray, slopes

    jumps, _, _ = newton(np.abs(scan.r - scan.survivor) / scan.r)
    scan.sharpen(np.flatnonzero(jumps))  # crossings whose Newton step would leave their interval
    return newton(JUMP_STEP)


def _scan_near(limit, rays: Rays, probability: float, guess: float) -> tuple[_RayScan, float]:
    """Return a scan that is wide enough for the target probability, and the approximate factor k, limited to
    the range from 1/`MAX_FACTOR` to `MAX_FACTOR`. Arguments are as for `solve_factor`."""
    scan, low, high = _RayScan(limit, rays.directions, guess), guess / RANGE_FACTOR, guess * RANGE_FACTOR
    while True:
        at_low, at_high = (float(rays.weights @ scan.probabilities(k)) for k in (low, high))
        if at_low < probability <= at_high:
            return scan, _root(scan, rays.weights, probability, math.sqrt(low * high))
        if at_low >= probability:
            low /= RANGE_FACTOR**2
        if at_high < probability:
            high *= RANGE_FACTOR**2
        if low < 1 / MAX_FACTOR or high > MAX_FACTOR:
            return scan, MAX_FACTOR if at_high < probability else 1 / MAX_FACTOR
        scan.extend(low, high)


def probability_at(limit: AbstractLimitState, rays: Rays, factor: float) -> float:
    """Return the probability of failure of a limit state whose motions are multiplied by `factor`."""
    scan = _RayScan(limit, rays.directions, factor)
    scan.narrow(REFINED)
    return float(rays.weights @ scan.probabilities(factor))


def _root(scan: _RayScan, weights: np.ndarray, probability: float, guess: float) -> float:
    """Return the factor k at which P(k) equals the target probability, starting from `guess`. `weights` are
    those of the rays in P(k), shape (m,). Beyond the outermost positions of the scan, a ray is assumed to
    fail or survive as it does there."""

    def log_error(log_k: float) -> float:
        return math.log(max(float(weights @ scan.probabilities(math.exp(log_k))), 1e-300) / probability)

    low = high = math.log(guess)
    while log_error(low) > 0 and low > -10:
        low -= 0.05
    while log_error(high) < 0 and high < 10:
        high += 0.05
    return math.exp(float(scipy.optimize.brentq(log_error, low, high, xtol=1e-14)))  # pyright: ignore[reportArgumentType]
