"""Search for design points: the failing points at which the distance |u| from the origin is locally least.

A point is a vector u of standard normal numbers. It fails if G(u) ≤ 0, with the limit state function G. For a
unit vector e, r(e) is the least distance at which the ray in direction e fails. A design point is a local
minimum of r(e). The search stays on the surface of failure and does not need a continuous G. Where the mode
of failure (for rocking, the number of impacts) changes, G jumps, but r(e) is still defined. Searches from
several starting directions advance together:

1. The gradient of G at the point r·e gives the normal a = −∇G/|∇G|. If G is linear, the design point lies in
   the direction a.
2. The search evaluates r in directions between e and a, and somewhat beyond a. The direction with the least r
   becomes the new e.
3. A search ends if e and a agree, or if none of these directions has a smaller r, even close to e. The second
   case usually is an edge of the surface, where G jumps.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .limit_state import AbstractLimitState

MAX_BETA = 9.0  # largest distance of a design point from the origin; Φ(−9) is 1e-19
# Rays in starting directions are at least this many times √d long; √d is the typical |u| in d dimensions.
START_FACTOR = 4.0
RAY_POSITIONS = 24  # number of positions on a full ray
# Number of positions on the ray of a candidate direction. The ray ends at the distance r at which the present
# direction e fails.
PARTIAL_RAY_POSITIONS = 10
NARROWING_ROUNDS = 3  # number of rounds in which the interval of the first failure is narrowed
PARTS = 8  # number of equal parts into which a round divides the interval
# `_step` evaluates directions at these multiples of its argument `fraction`, which is a fraction of the way
# from e to the normal. The best direction may lie beyond the normal.
FRACTIONS = np.array([1.5, 1.0, 0.5])
MIN_FRACTION = 1 / 64  # a search ends if it would need a smaller fraction of the way
ALIGNED = 1e-9  # e and the normal agree if 1 minus the cosine of the angle between them is below this value
MAX_STEPS = 40  # largest number of steps of a search
SAME_COSINE = 0.99  # two design points count as equal if the cosine of the angle between them is larger


class DesignPoints(NamedTuple):
    """Design points, nearest first.

    - `u`: the points, which fail, shape (k, d)
    - `normal`: unit normals −∇G/|∇G| at the points, shape (k, d)
    - `beta`: distances |u| from the origin, shape (k,)
    - `aligned`: True if u and the normal have the same direction (a smooth minimum), shape (k,). Otherwise
      the point usually is at an edge, where G jumps
    """

    u: np.ndarray
    normal: np.ndarray
    beta: np.ndarray
    aligned: np.ndarray


class _Bracket(NamedTuple):
    """Brackets of the first failure on rays, as arrays of shape (m,)."""

    low: np.ndarray  # the last surviving position before the failure; 0 if the first position fails
    high: np.ndarray  # the first position that fails; inf if there is none
    G_low: np.ndarray  # G at `low`; inf if `low` is 0, where G is not evaluated
    G_high: np.ndarray  # G at `high`

    def root(self) -> np.ndarray:
        """Return the root of the straight line through the values of G at both ends. It is `high` if G is
        infinite at an end, and inf if there is no failure."""
        drop = self.G_low - self.G_high
        is_usable = np.isfinite(drop) & (drop > 0)
        fraction = np.where(is_usable, self.G_low / np.where(is_usable, drop, 1.0), 1.0)
        high = np.where(np.isfinite(self.high), self.high, 0.0)
        return np.where(np.isfinite(self.high), self.low + (high - self.low) * fraction, np.inf)

    def select(self, rows) -> _Bracket:
        """Return the brackets with these indices."""
        return _Bracket(*(y[rows] for y in self))


def _bracket_failure(limit: AbstractLimitState, directions: np.ndarray, radii: np.ndarray) -> _Bracket:
    """Bracket the first failure on rays.

    - `directions`: unit vectors, shape (m, d)
    - `radii`: ascending positions on each ray at which G is evaluated, shape (m, k)
    """
    points = directions[:, None, :] * radii[..., None]
    value = limit.values(points.reshape(-1, directions.shape[1])).reshape(radii.shape)
    fails = value <= 0
    first, rows = np.argmax(fails, axis=1), np.arange(len(radii))
    low = np.where(first > 0, radii[rows, first - 1], 0.0)
    high = np.where(fails.any(axis=1), radii[rows, first], np.inf)
    return _Bracket(low, high, np.where(first > 0, value[rows, first - 1], np.inf), value[rows, first])


def _narrow(limit: AbstractLimitState, directions: np.ndarray, bracket: _Bracket) -> np.ndarray:
    """Narrow brackets, and return the distances at which rays fail, shape (m,); inf if there is no
    failure."""
    failing = np.flatnonzero(np.isfinite(bracket.high))
    directions, narrow = directions[failing], bracket.select(failing)
    for _ in range(NARROWING_ROUNDS if failing.size else 0):
        # Evenly spaced positions narrow every bracket. If G is smooth, positions close to the root of the
        # straight line through G at both ends narrow the bracket further.
        wide, width = narrow, narrow.high - narrow.low
        root = (wide.root() - wide.low) / np.where(width > 0, width, 1.0)
        even = np.tile(np.arange(1, PARTS) / PARTS, (failing.size, 1))
        close = np.clip(root[:, None] + np.array([-1e-2, -1e-4, 1e-4, 1e-2]), 0, 1)
        fractions = np.sort(np.concatenate([even, close], axis=1), axis=1)
        positions = wide.low[:, None] + width[:, None] * fractions
        inside = _bracket_failure(limit, directions, positions)
        fails, survives = np.isfinite(inside.high), inside.low > 0
        narrow = _Bracket(
            np.where(fails, np.where(survives, inside.low, wide.low), positions[:, -1]),
            np.where(fails, inside.high, wide.high),
            np.where(fails & survives, inside.G_low, wide.G_low),
            np.where(fails, inside.G_high, wide.G_high),
        )
    distance = bracket.high.copy()
    distance[failing] = narrow.high
    return distance


def distances(limit: AbstractLimitState, directions: np.ndarray, max_distance: float) -> np.ndarray:
    """Return the least distance at which each ray, given by a unit vector, fails, shape (m,); inf for no
    failure up to `max_distance`."""
    radii = np.tile(np.linspace(0, max_distance, RAY_POSITIONS + 1)[1:], (len(directions), 1))
    return _narrow(limit, directions, _bracket_failure(limit, directions, radii))


def _unit(u: np.ndarray) -> np.ndarray:
    """Return vectors divided by their lengths."""
    length = np.linalg.norm(u, axis=-1, keepdims=True)
    return u / np.where(length > 0, length, 1.0)


def design_points(limit: AbstractLimitState, starts: np.ndarray) -> DesignPoints:
    """Return local minima of |u| ≤ `MAX_BETA` on the surface of failure of a limit state that survives at
    u = 0. If the limit state is mirrored, G(−u) = G(u), only the first half of the starting directions,
    shape (s, d), is used."""
    if limit.mirrored:  # if u is a design point, −u is one too
        starts = starts[: (len(starts) + 1) // 2]
    e = _unit(np.asarray(starts, float))
    # In high dimensions a random direction fails only far beyond the distance of a design point.
    ray_length = max(MAX_BETA, START_FACTOR * np.sqrt(limit.dimension))
    r = distances(limit, e, ray_length)
    # If a ray does not fail, its direction is replaced by the steepest descent of G at a point of the ray
    # near the origin.
    never_fails = ~np.isfinite(r)
    if never_fails.any():
        _, slope = limit.gradients(e[never_fails] * 1e-3)
        e[never_fails] = _unit(-slope)
        r[never_fails] = distances(limit, e[never_fails], ray_length)
    fails = np.isfinite(r)
    e, r = e[fails], r[fails]
    normal, aligned = _descend(limit, e, r)
    is_near = r <= MAX_BETA
    e, r, normal, aligned = e[is_near], r[is_near], normal[is_near], aligned[is_near]
    points = _keep_distinct(e, r, normal, aligned)
    if not limit.mirrored:
        return points
    e, r = np.concatenate([_unit(points.u), -_unit(points.u)]), np.tile(points.beta, 2)
    return _keep_distinct(e, r, np.concatenate([points.normal, -points.normal]), np.tile(points.aligned, 2))


def _descend(limit: AbstractLimitState, e: np.ndarray, r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Move directions e and their distances r, in place, to local minima of r. Returns the normals, shape (s,
    d), and a mask of the directions that agree with their normals, shape (s,)."""
    normal, aligned, fraction = e.copy(), np.zeros(len(e), bool), np.ones(len(e))
    has_moved = np.ones(len(e), bool)
    is_active = np.ones(len(e), bool)
    for _ in range(MAX_STEPS):
        moved = np.flatnonzero(is_active & has_moved)
        if moved.size:
            _, slope = limit.gradients(e[moved] * r[moved, None])
            normal[moved] = _unit(-slope)
            aligned[moved] = 1 - np.sum(normal[moved] * e[moved], axis=1) < ALIGNED
            is_active[moved[aligned[moved]]] = False
        active = np.flatnonzero(is_active)
        if active.size == 0:
            break
        nearest, direction, best_fraction = _step(
            limit, e[active], r[active], normal[active], fraction[active]
        )
        is_closer = nearest < r[active] * (1 - 1e-10)
        improved = active[is_closer]
        e[improved], r[improved] = direction[is_closer], nearest[is_closer]
        has_moved[active] = is_closer
        fraction[active] = np.where(
            is_closer, np.clip(best_fraction, MIN_FRACTION, 1.5), 0.25 * fraction[active]
        )
        is_active[active[fraction[active] < MIN_FRACTION]] = False
    return normal, aligned


def _step(limit: AbstractLimitState, e, r, normal, fraction) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Evaluate directions on the way from each e to its normal, and return the nearest failure: its distance,
    its direction, and its fraction of the way.

    - `e`, `r`: directions, shape (s, d), and the distances at which they fail, shape (s,)
    - `normal`: unit normals at these failures, shape (s, d)
    - `fraction`: fraction of the way that `FRACTIONS` multiplies, shape (s,): the best fraction of the
      previous step, or a quarter of the previous `fraction` if r did not decrease
    """
    fractions = fraction[:, None] * FRACTIONS
    candidates = _unit(e[:, None, :] + fractions[..., None] * (normal - e)[:, None, :])
    directions = candidates.reshape(-1, e.shape[1])
    # Positions as fractions of the distance r at which e fails, denser near r, where failure is more likely.
    positions = np.concatenate([[0.4, 0.6], np.linspace(0.7, 1.0, PARTIAL_RAY_POSITIONS - 2)])
    bracket = _bracket_failure(limit, directions, np.repeat(r, FRACTIONS.size)[:, None] * positions)
    best = np.argmin(bracket.root().reshape(fractions.shape), axis=1)
    rows = np.arange(len(e))
    chosen = rows * FRACTIONS.size + best
    nearest = _narrow(limit, directions[chosen], bracket.select(chosen))
    return nearest, candidates[rows, best], fractions[rows, best]


def _keep_distinct(e: np.ndarray, r: np.ndarray, normal: np.ndarray, aligned: np.ndarray) -> DesignPoints:
    """Return the design points, nearest first. Of points in nearly the same direction, the nearest
    remains."""
    distinct: list[int] = []
    for i in np.argsort(r):
        if not any(e[i] @ e[j] > SAME_COSINE for j in distinct):
            distinct.append(int(i))
    return DesignPoints(e[distinct] * r[distinct, None], normal[distinct], r[distinct], aligned[distinct])


def merge_points(a: DesignPoints, b: DesignPoints) -> DesignPoints:
    """Return the union of two sets of design points, nearest first, without points in nearly the same
    direction."""
    u, normal, beta, aligned = (np.concatenate(pair) for pair in zip(a, b, strict=True))
    return _keep_distinct(_unit(u), beta, normal, aligned)
