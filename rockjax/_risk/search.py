"""Design points: the points of failure closest to the origin of standard normal space.

A direction e on the unit sphere has a distance r(e): the least at which the ray r·e fails. A design point is
a local minimum of r. This form of the search stays on the limit state, sees windows of survival behind the
first failure, and needs no continuity of G: where the mode of failure changes, G jumps, but r is still a
distance. All directions of all starts advance side by side:

1. at the point of a direction the gradient gives the normal, a = −∇G/|∇G|, the direction of the design point
   of a linear G;
2. directions between e and a, at several fractions of the way, are evaluated, and the one with the least r is
   taken;
3. it ends where e and a agree, or where no fraction comes closer: at a jump of G, whose edge has no normal.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .limit_state import AbstractLimitState

MAX_BETA = 9.0  # greatest distance of a design point from the origin: Φ(−9) is 1e-19
START_FACTOR = 4.0  # times √d, the typical |u|: how far a first direction is followed
RAY = 24  # positions on a full ray
PARTIAL_RAY = 10  # positions on a ray up to a known distance of failure
NARROWING_ROUNDS = 3  # rounds in which the interval of the first failure is narrowed
PARTS = 8  # equal parts into which a round divides the interval
# Multiples of the last fraction of the way to the normal; a fixed point may lie past the normal.
FRACTIONS = np.array([1.5, 1.0, 0.5])
MIN_FRACTION = 1 / 64  # least fraction of the way to the normal
ALIGNED = 1e-9  # 1 − cos of the angle between point and normal below which a search ends
MAX_STEPS = 40  # greatest number of steps of a search
SAME_COSINE = 0.99  # two design points are equal if the cosine of their angle is larger


class DesignPoints(NamedTuple):
    """Design points, nearest first.

    - `u`: (k, d), on the failing side; `normal`: unit normals −∇G/|∇G|, (k, d)
    - `beta`: |u|, (k,); `aligned`: whether point and normal agree: a smooth minimum, else an edge where G
      jumps
    """

    u: np.ndarray
    normal: np.ndarray
    beta: np.ndarray
    aligned: np.ndarray


class _Bracket(NamedTuple):
    """Brackets of the first failure on rays, (m,) each.

    - `low`: the last position that survives; `high`: the first position that fails, inf if there is none
    - `G_low`, `G_high`: G at both
    """

    low: np.ndarray
    high: np.ndarray
    G_low: np.ndarray
    G_high: np.ndarray

    def root(self) -> np.ndarray:
        """Return the root of the straight line between the places."""
        drop = self.G_low - self.G_high
        usable = np.isfinite(drop) & (drop > 0)
        part = np.where(usable, self.G_low / np.where(usable, drop, 1.0), 1.0)
        high = np.where(np.isfinite(self.high), self.high, 0.0)
        return np.where(np.isfinite(self.high), self.low + (high - self.low) * part, np.inf)

    def at(self, rows) -> _Bracket:
        return _Bracket(*(y[rows] for y in self))


def _bracket(limit: AbstractLimitState, directions: np.ndarray, radii: np.ndarray) -> _Bracket:
    """Bracket the first failure of rays (m, d), evaluated at places `radii` (m, k) in ascending order."""
    points = directions[:, None, :] * radii[..., None]
    value = limit.values(points.reshape(-1, directions.shape[1])).reshape(radii.shape)
    over = value <= 0
    first, rows = np.argmax(over, axis=1), np.arange(len(radii))
    fails = over.any(axis=1)
    low = np.where(first > 0, radii[rows, first - 1], 0.0)
    G_low = np.where(first > 0, value[rows, first - 1], np.inf)
    return _Bracket(low, np.where(fails, radii[rows, first], np.inf), G_low, value[rows, first])


def _narrow(limit: AbstractLimitState, directions: np.ndarray, found: _Bracket) -> np.ndarray:
    """Return the distances at which rays fail, on the failing side."""
    low, high, G_low, G_high = (y.copy() for y in found)
    live = np.flatnonzero(np.isfinite(high))
    for _ in range(NARROWING_ROUNDS):
        if live.size == 0:
            break
        # Some places are evenly spaced, for certainty; the others are close to the root of the straight line.
        bracket = _Bracket(low, high, G_low, G_high).at(live)
        width = bracket.high - bracket.low
        root = (bracket.root() - bracket.low) / np.where(width > 0, width, 1.0)
        part = np.tile(np.arange(1, PARTS) / PARTS, (live.size, 1))
        close = np.clip(root[:, None] + np.array([-1e-2, -1e-4, 1e-4, 1e-2]), 0, 1)
        part = np.sort(np.concatenate([part, close], axis=1), axis=1)
        narrower = _bracket(limit, directions[live], bracket.low[:, None] + width[:, None] * part)
        inside = np.isfinite(narrower.high)
        first = narrower.low > 0  # else none of the places survived
        low[live] = np.where(
            inside, np.where(first, narrower.low, bracket.low), bracket.low + width * part[:, -1]
        )
        G_low[live] = np.where(inside & first, narrower.G_low, bracket.G_low)
        high[live] = np.where(inside, narrower.high, bracket.high)
        G_high[live] = np.where(inside, narrower.G_high, bracket.G_high)
    return high


def distances(
    limit: AbstractLimitState, directions: np.ndarray, max_distance: float = MAX_BETA
) -> np.ndarray:
    """Return the least distance at which each ray fails, (m,); inf if it survives up to `max_distance`."""
    radii = np.tile(np.linspace(0, max_distance, RAY + 1)[1:], (len(directions), 1))
    return _narrow(limit, directions, _bracket(limit, directions, radii))


def _unit(u: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(u, axis=-1, keepdims=True)
    return u / np.where(length > 0, length, 1.0)


def design_points(
    limit: AbstractLimitState, starts: np.ndarray, max_distance: float = MAX_BETA
) -> DesignPoints:
    """Return local minima of |u| on the limit state, from starting directions (s, d)."""
    if limit.mirrored:  # then so are the design points
        starts = starts[: (len(starts) + 1) // 2]
    e = _unit(np.asarray(starts, float))
    # In many dimensions a random direction fails only far beyond the distance of a design point.
    outer = max(max_distance, START_FACTOR * np.sqrt(limit.dimension))
    r = distances(limit, e, outer)
    # A start whose ray never fails follows the steepest descent of G.
    never_fails = ~np.isfinite(r)
    if never_fails.any():
        _, slope = limit.gradients(e[never_fails] * 1e-3)
        e[never_fails] = _unit(-slope)
        r[never_fails] = distances(limit, e[never_fails], outer)
    live = np.isfinite(r)
    e, r = e[live], r[live]
    normal, aligned = _descend(limit, e, r)
    near = r <= max_distance
    e, r, normal, aligned = e[near], r[near], normal[near], aligned[near]
    points = _keep_distinct(e, r, normal, aligned)
    if not limit.mirrored:
        return points
    e, r = np.concatenate([_unit(points.u), -_unit(points.u)]), np.tile(points.beta, 2)
    return _keep_distinct(e, r, np.concatenate([points.normal, -points.normal]), np.tile(points.aligned, 2))


def _descend(limit: AbstractLimitState, e: np.ndarray, r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Move directions e downhill (in place, with their distances r); return their normals, and which are
    aligned."""
    normal, aligned, fraction = e.copy(), np.zeros(len(e), bool), np.ones(len(e))
    has_moved = np.ones(len(e), bool)
    active = np.ones(len(e), bool)
    for _ in range(MAX_STEPS):
        new = np.flatnonzero(active & has_moved)
        if new.size:
            _, slope = limit.gradients(e[new] * r[new, None])
            normal[new] = _unit(-slope)
            aligned[new] = 1 - np.sum(normal[new] * e[new], axis=1) < ALIGNED
            active[new[aligned[new]]] = False
        at = np.flatnonzero(active)
        if at.size == 0:
            break
        nearest, direction, best_fraction = _step(limit, e[at], r[at], normal[at], fraction[at])
        closer = nearest < r[at] * (1 - 1e-10)
        improved = at[closer]
        e[improved], r[improved] = direction[closer], nearest[closer]
        has_moved[at] = closer
        fraction[at] = np.where(closer, np.clip(best_fraction, MIN_FRACTION, 1.5), 0.25 * fraction[at])
        active[at[fraction[at] < MIN_FRACTION]] = False
    return normal, aligned


def _step(limit: AbstractLimitState, e, r, normal, fraction) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the nearest failure in a few directions on the way to the normal: its distance, direction, and
    fraction."""
    fractions = fraction[:, None] * FRACTIONS
    candidates = _unit(e[:, None, :] + fractions[..., None] * (normal - e)[:, None, :])
    flat = candidates.reshape(-1, e.shape[1])
    # Places below the known distance, denser where the change is likely.
    part = np.concatenate([[0.4, 0.6], np.linspace(0.7, 1.0, PARTIAL_RAY - 2)])
    bracket = _bracket(limit, flat, np.repeat(r, FRACTIONS.size)[:, None] * part)
    best = np.argmin(bracket.root().reshape(fractions.shape), axis=1)
    rows = np.arange(len(e))
    chosen = rows * FRACTIONS.size + best
    return _narrow(limit, flat[chosen], bracket.at(chosen)), candidates[rows, best], fractions[rows, best]


def _keep_distinct(e: np.ndarray, r: np.ndarray, normal: np.ndarray, aligned: np.ndarray) -> DesignPoints:
    distinct: list[int] = []
    for i in np.argsort(r):
        if not any(e[i] @ e[j] > SAME_COSINE for j in distinct):
            distinct.append(int(i))
    return DesignPoints(e[distinct] * r[distinct, None], normal[distinct], r[distinct], aligned[distinct])


def merge_points(a: DesignPoints, b: DesignPoints) -> DesignPoints:
    """Return the distinct design points of both."""
    u, normal, beta, aligned = (np.concatenate(pair) for pair in zip(a, b, strict=True))
    return _keep_distinct(_unit(u), beta, normal, aligned)
