"""A probability of failure for many structures from one sample: rays through samples that fail.

The ray of a direction e fails along some of its length, between its crossings r with the surface of failure:
q(e) = Σ ±Q(r), with Q the upper tail of |u|, the chi distribution. P = E q(e). The directions of samples that
fail have the density q₀/P₀ over that of all, so that for another structure, and u multiplied by k,

    P(k) = P₀ E[q(e; k)/q₀(e)],

a mean over the same directions. It moves as smoothly as the crossings do, with derivatives by the implicit
function theorem, and what is missed or misplaced of P₀ is common to all structures.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy

from ._estimators._subset import Subset
from .limit_state import AbstractLimitState
from .lines import Division, narrowed
from .structure import OfStructure

SPACING = 0.3  # of places on a ray, where one standard deviation of |u| is 0.71
LOW, HIGH = 1e-7, 1e-9  # shares of |u| below and above which nobody looks
WIDER = 1.1  # range of k that is looked at, both ways, before it is known where it ends
FARTHEST_FACTOR = 100.0  # on u, both ways
NEARLY = 0.7  # of ln P: near enough to the probability that is asked for
MAX_SCENES = 10_000_000  # of the sample that rays are drawn from
TRIALS = 12  # factors on u
TRIED, SHARE = 200, 0.1  # samples of a level in the runs of a trial, and which of them fail it
COARSE = Division(rounds=0)
FINE = Division(rounds=4, parts=4, close=0.01, enough=0.03)  # Newton's step does the rest, but for
SHARP = Division(rounds=3, parts=16)  # where G jumps
HEAVIEST = 5.0  # weight, times the median
JUMP = 1e-4  # of r: where Newton's step from a crossing that is known so well goes farther, G jumps


class Scaled(AbstractLimitState):
    """A limit state of motions that stand for a factor times u."""

    def __init__(self, limit: AbstractLimitState, factor: float):
        super().__init__(limit.dimension)
        self.limit, self.factor = limit, factor

    def _values(self, u):
        return self.limit.values(self.factor * u)

    def _gradients(self, u):
        value, slope = self.limit.gradients(self.factor * u)
        return value, self.factor * slope


class Rays(NamedTuple):
    """Directions with their weights: P(k) ≈ Σ weight·q(e; k).

    - `directions`: (m, d); `weights`: P₀/(m q₀), (m,)
    - `factor`: k at which they were sampled; `cov`: coefficient of variation of P₀; `scenes`: they took
    """

    directions: np.ndarray
    weights: np.ndarray
    factor: float
    cov: float
    scenes: int


class Cut(NamedTuple):
    """The factor k on u with which a probability of failure is the one asked for.

    - `factor`: k; `steepness`: −d ln P/d ln k there, negative for a P that rises with k
    - `sensitivities`: d ln k/d ln y, in the order of the names
    - `jumps`: the share of dP/d ln k from crossings at which G jumps, of which derivatives know nothing
    - `effective`: effective number of rays
    """

    factor: float
    steepness: float
    sensitivities: np.ndarray
    jumps: float
    effective: float


def rays_at(limit: AbstractLimitState, probability: float, count: int, cov: float, seed: int) -> Rays:
    """Rays through samples that fail, of motions as much stronger or weaker that they fail with about this
    probability. Raises `ValueError` where no factor on u leads there."""
    before = limit.scenes
    if limit.values(np.zeros((1, limit.dimension)))[0] <= 0:
        raise ValueError("the limit state has failed at u = 0 already")
    rng = np.random.default_rng([seed, 3])
    factor, sampled = _strength(limit, probability, rng)
    known = sampled.run(cov, MAX_SCENES, 500, lambda _: None)
    if not sampled.converged(known, cov):
        raise ValueError(
            f"{MAX_SCENES} scenes reach a coefficient of variation of {known.cov:.2g} of a probability near "
            f"{probability:g}, {cov:g} was asked for; raise cov"
        )
    u, weights = _drawn(sampled, count, rng)
    size = np.linalg.norm(u, axis=1)
    scan = _Scan(limit, u / size[:, None], factor)
    scan.narrow(FINE)
    # A sample in a window narrower than the distance of two places tells nothing of its ray.
    before_it = scan.r < factor * size[scan.line]
    seen = scan.always + np.bincount(scan.line[before_it], scan.sign[before_it], minlength=size.size) > 0.5
    e, weights = u[seen] / size[seen, None], weights[seen] / scan.shares(factor)[seen]
    # A narrow window has a large weight, and elsewhere it may be wide: its ray would speak for all others.
    weights = np.minimum(weights, HEAVIEST * np.median(weights))
    weights *= known.probability / float(weights @ scan.shares(factor)[seen])
    return Rays(e, weights, factor, known.cov, limit.scenes - before)


def _drawn(sampled: Subset, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """So many different failing samples of all runs, with their weights in P."""
    total = sum(run.samples for run in sampled.runs)
    runs = [
        (np.unique(run.failing, axis=0), run.probability * run.samples / total)
        for run in sampled.runs
        if len(run.failing)
    ]
    parts, weights = [], []
    for k, (u, p) in enumerate(runs):
        size = min(count // len(runs) + (k < count % len(runs)), len(u))
        parts.append(u[rng.choice(len(u), size=size, replace=False)])
        weights.append(np.full(size, p / max(size, 1)))
    return np.concatenate(parts), np.concatenate(weights)


def _strength(limit: AbstractLimitState, probability: float, rng) -> tuple[float, Subset]:
    """A factor on u with which failure has nearly this probability, and a first run there."""
    wanted, factor = -float(scipy.stats.norm.ppf(probability)), 1.0
    known: list[tuple[float, float]] = []  # ln k and −Φ⁻¹(P)
    for _ in range(TRIALS):
        sampled = Subset(Scaled(limit, factor), None, rng, TRIED, SHARE)  # pyright: ignore[reportArgumentType]
        sampled.round(1)
        found = sampled.estimate().probability
        if found > 0 and abs(math.log(found / probability)) < NEARLY:
            return factor, sampled
        index = -float(scipy.stats.norm.ppf(min(max(found, 1e-30), 1 - 1e-3)))
        known.append((math.log(factor), index))
        # In proportion to 1/k if G were plane; else as the last two say.
        step = math.log(max(index, 0.5) / max(wanted, 0.5)) if wanted != index else 0.1
        if len(known) > 1 and abs(known[-1][1] - known[-2][1]) > 1e-3:
            (a, at_a), (b, at_b) = known[-2:]
            slope = (at_b - at_a) / (b - a)
            step = (wanted - index) / slope if slope < 0 else step
        elif (index - wanted) * step <= 0:
            step = math.copysign(0.3, index - wanted)
        factor *= math.exp(min(max(step, -1.1), 1.1))
        if not 1 / FARTHEST_FACTOR < factor < FARTHEST_FACTOR:
            break
    raise ValueError(
        f"no motions up to {FARTHEST_FACTOR:g} times as strong or as weak fail with a probability near "
        f"{probability:g}"
    )


class _Scan:
    """Where rays cross the surface of failure, looked at as far as is asked for."""

    def __init__(self, limit: AbstractLimitState, directions: np.ndarray, guess: float):
        self.limit, self.directions = limit, directions
        d = directions.shape[1]
        self.ends = float(scipy.stats.chi.ppf(LOW, d)), float(scipy.stats.chi.isf(HIGH, d))
        # Places are the same for all structures: what is seen does not depend on where a search began.
        self.step = SPACING / math.sqrt(d)
        self.first = self.after = math.floor(math.log(self.ends[0] * guess / WIDER) / self.step)
        self.G = np.zeros((len(directions), 0))
        self.reach(guess / WIDER, guess * WIDER)

    def reach(self, low: float, high: float) -> None:
        """Look at all that matters for factors k from `low` to `high`."""
        first = min(self.first, math.floor(math.log(self.ends[0] * low) / self.step))
        after = max(self.after, math.ceil(math.log(self.ends[1] * high) / self.step) + 1)
        below, above = self._look(first, self.first), self._look(self.after, after)
        self.G, self.first, self.after = np.concatenate([below, self.G, above], axis=1), first, after
        self.narrow(COARSE)

    def narrow(self, how: Division) -> None:
        """Find the crossings between places."""
        m, r = len(self.directions), self._places(self.first, self.after)
        parts = np.repeat(np.arange(m), r.size), np.tile(r, m), self.G.ravel()
        found = narrowed(self.limit, np.zeros_like(self.directions), self.directions, *parts, how)
        self.line, self.r, self.other, _, enters = found
        self.sign = np.where(enters, 1.0, -1.0)
        self.always = (self.G[:, 0] <= 0).astype(float)  # below the first place

    def sharpen(self, of: np.ndarray) -> None:
        """Narrow some crossings down to where nothing but the crossing itself is left."""
        if of.size == 0:
            return
        ends = np.sort(np.stack([self.r[of], self.other[of]], axis=1), axis=1)
        e = self.directions[self.line[of]]
        line = np.repeat(np.arange(of.size), 2)
        value = self.limit.values(e[line] * ends.reshape(-1, 1))
        found = narrowed(self.limit, np.zeros_like(e), e, line, ends.ravel(), value, SHARP)
        # Windows in between are far narrower than what a scan sees.
        first = np.unique(found[0], return_index=True)[1]
        self.r[of[found[0][first]]] = found[1][first]

    def _places(self, first: int, after: int) -> np.ndarray:
        return np.exp(self.step * np.arange(first, after))

    def _look(self, first: int, after: int) -> np.ndarray:
        r = self._places(first, after)
        u = self.directions[:, None, :] * r[:, None]
        return self.limit.values(u.reshape(-1, u.shape[-1])).reshape(len(self.directions), r.size)

    def shares(self, k: float) -> np.ndarray:
        """q(e; k) of every ray, (m,)."""
        tail = self.sign * scipy.stats.chi.sf(self.r / k, self.directions.shape[1])
        return self.always + np.bincount(self.line, tail, minlength=len(self.directions))


def factor_of(limit: OfStructure, rays: Rays, probability: float, names: Sequence[str], guess: float) -> Cut:
    """The factor on u with which a structure fails with this probability, and how it moves with the
    logarithms of named parameters. Where it would be farther than `FARTHEST_FACTOR`, that, without
    derivatives."""
    scan, k = _located(limit, rays, probability, guess)
    if not 1 / FARTHEST_FACTOR < k < FARTHEST_FACTOR:
        return Cut(k, 0.0, np.zeros(len(names)), 0.0, 0.0)
    scan.narrow(FINE)
    of_ray = rays.weights[scan.line]
    jumps, along, slopes = _polished(limit, rays, scan, names)
    d = rays.directions.shape[1]
    k = _root(scan, rays.weights, probability, k)
    # dP/d ln k = Σ ± weight φ(r/k) r/k
    push = of_ray * scan.sign * scipy.stats.chi.pdf(scan.r / k, d) * scan.r / k
    smooth = np.where(jumps, 0.0, push)
    moved = -slopes / np.where(jumps, 1.0, along)[:, None]  # d ln r/d ln y
    share = rays.weights * scan.shares(k)
    total = float(np.sum(np.abs(push)))
    return Cut(
        factor=k,
        steepness=float(np.sum(push)) / probability,
        sensitivities=smooth @ moved / np.sum(smooth),
        jumps=float(np.sum(np.abs(push[jumps]))) / total,
        effective=float(share.sum() ** 2 / np.sum(share**2)),
    )


def _polished(
    limit: OfStructure, rays: Rays, scan: _Scan, names: Sequence[str]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Move crossings to where they are, by Newton's steps: at which G jumps (k,), and of G there the
    derivatives by ln r (k,) and by the logarithms of named parameters (k, names)."""

    def newton(width) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        value, along, slopes = limit.log_slopes(rays.directions[scan.line] * scan.r[:, None], names)
        step = -value / np.where(along == 0, np.inf, along)
        jumps = (along == 0) | ~(np.abs(step) <= width)
        scan.r = scan.r * np.exp(np.where(jumps, 0.0, step))
        return jumps, along, slopes

    jumps, _, _ = newton(np.abs(scan.r - scan.other) / scan.r)
    scan.sharpen(np.flatnonzero(jumps))  # where Newton's step leaves the interval, that is divided on
    return newton(JUMP)


def _located(limit, rays: Rays, probability: float, guess: float) -> tuple[_Scan, float]:
    """A scan that reaches far enough, and about where k is."""
    scan, low, high = _Scan(limit, rays.directions, guess), guess / WIDER, guess * WIDER
    while True:
        at_low, at_high = (float(rays.weights @ scan.shares(k)) for k in (low, high))
        if at_low < probability <= at_high:
            return scan, _root(scan, rays.weights, probability, math.sqrt(low * high))
        if at_low >= probability:
            low /= WIDER**2
        if at_high < probability:
            high *= WIDER**2
        if low < 1 / FARTHEST_FACTOR or high > FARTHEST_FACTOR:
            return scan, FARTHEST_FACTOR if at_high < probability else 1 / FARTHEST_FACTOR
        scan.reach(low, high)


def probability_at(limit: AbstractLimitState, rays: Rays, factor: float) -> float:
    """P of motions that stand for a factor times u."""
    scan = _Scan(limit, rays.directions, factor)
    scan.narrow(FINE)
    return float(rays.weights @ scan.shares(factor))


def _root(scan: _Scan, weights: np.ndarray, probability: float, guess: float) -> float:
    """Where P(k) is the one asked for, near a guess; what lies beyond the scan is as at its ends."""

    def off(log_k: float) -> float:
        return math.log(max(float(weights @ scan.shares(math.exp(log_k))), 1e-300) / probability)

    low = high = math.log(guess)
    while off(low) > 0 and low > -10:
        low -= 0.05
    while off(high) < 0 and high < 10:
        high += 0.05
    return math.exp(float(scipy.optimize.brentq(off, low, high, xtol=1e-14)))  # pyright: ignore[reportArgumentType]
