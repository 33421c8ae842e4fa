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

FARTHEST = 9.0  # greatest distance of a design point from the origin: Φ(−9) is 1e-19
BEYOND = 4.0  # times √d, the typical |u|: how far a first direction is followed
RAY = 24  # places on a full ray …
AGAIN = 10  # … and on the part of a ray below a known distance
NARROW = 3  # rounds of narrowing the interval of the first failure …
PARTS = 8  # … each dividing it into this many parts
# Multiples of the last fraction of the way to the normal; a fixed point may lie past the normal.
WAYS = np.array([1.5, 1.0, 0.5])
SHORTEST = 1 / 64  # least fraction of the way to the normal
ALIGNED = 1e-9  # 1 − cos of the angle between point and normal …
STEPS = 40  # … or this many steps
SAME = 0.99  # two design points are equal if the cosine of their angle is larger


class Found(NamedTuple):
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
    """First failures of rays: the last place that survives and the first that fails (inf if none), with G at
    both."""

    low: np.ndarray
    high: np.ndarray
    above: np.ndarray
    below: np.ndarray

    def root(self) -> np.ndarray:
        """Return the root of the straight line between the places."""
        drop = self.above - self.below
        usable = np.isfinite(drop) & (drop > 0)
        part = np.where(usable, self.above / np.where(usable, drop, 1.0), 1.0)
        high = np.where(np.isfinite(self.high), self.high, 0.0)
        return np.where(np.isfinite(self.high), self.low + (high - self.low) * part, np.inf)

    def at(self, rows) -> _Bracket:
        return _Bracket(*(y[rows] for y in self))


def _bracket(limit: AbstractLimitState, directions: np.ndarray, at: np.ndarray) -> _Bracket:
    """Bracket the first failure of rays (m, d), evaluated at places `at` (m, k) in ascending order."""
    places = directions[:, None, :] * at[..., None]
    value = limit.values(places.reshape(-1, directions.shape[1])).reshape(at.shape)
    over = value <= 0
    first, rows = np.argmax(over, axis=1), np.arange(len(at))
    fails = over.any(axis=1)
    low = np.where(first > 0, at[rows, first - 1], 0.0)
    above = np.where(first > 0, value[rows, first - 1], np.inf)
    return _Bracket(low, np.where(fails, at[rows, first], np.inf), above, value[rows, first])


def _narrowed(limit: AbstractLimitState, directions: np.ndarray, found: _Bracket) -> np.ndarray:
    """Return the distances at which rays fail, on the failing side."""
    low, high, above, below = (y.copy() for y in found)
    live = np.flatnonzero(np.isfinite(high))
    for _ in range(NARROW):
        if live.size == 0:
            break
        # Some places are evenly spaced, for certainty; the others are close to the root of the straight line.
        now = _Bracket(low, high, above, below).at(live)
        width = now.high - now.low
        root = (now.root() - now.low) / np.where(width > 0, width, 1.0)
        part = np.tile(np.arange(1, PARTS) / PARTS, (live.size, 1))
        close = np.clip(root[:, None] + np.array([-1e-2, -1e-4, 1e-4, 1e-2]), 0, 1)
        part = np.sort(np.concatenate([part, close], axis=1), axis=1)
        more = _bracket(limit, directions[live], now.low[:, None] + width[:, None] * part)
        inside = np.isfinite(more.high)
        first = more.low > 0  # else none of the places survived
        low[live] = np.where(inside, np.where(first, more.low, now.low), now.low + width * part[:, -1])
        above[live] = np.where(inside & first, more.above, now.above)
        high[live] = np.where(inside, more.high, now.high)
        below[live] = np.where(inside, more.below, now.below)
    return high


def distances(limit: AbstractLimitState, directions: np.ndarray, farthest: float = FARTHEST) -> np.ndarray:
    """Return the least distance at which each ray fails, (m,); inf if it survives up to `farthest`."""
    at = np.tile(np.linspace(0, farthest, RAY + 1)[1:], (len(directions), 1))
    return _narrowed(limit, directions, _bracket(limit, directions, at))


def _unit(u: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(u, axis=-1, keepdims=True)
    return u / np.where(length > 0, length, 1.0)


def design_points(limit: AbstractLimitState, starts: np.ndarray, farthest: float = FARTHEST) -> Found:
    """Return local minima of |u| on the limit state, from starting directions (s, d)."""
    if limit.mirrored:  # then so are the design points
        starts = starts[: (len(starts) + 1) // 2]
    e = _unit(np.asarray(starts, float))
    # In many dimensions a random direction fails only far beyond the distance of a design point.
    outer = max(farthest, BEYOND * np.sqrt(limit.dimension))
    r = distances(limit, e, outer)
    # A start whose ray never fails follows the steepest descent of G.
    lost = ~np.isfinite(r)
    if lost.any():
        _, slope = limit.gradients(e[lost] * 1e-3)
        e[lost] = _unit(-slope)
        r[lost] = distances(limit, e[lost], outer)
    live = np.isfinite(r)
    e, r = e[live], r[live]
    normal, aligned = _descend(limit, e, r)
    near = r <= farthest
    e, r, normal, aligned = e[near], r[near], normal[near], aligned[near]
    found = _distinct(e, r, normal, aligned)
    if not limit.mirrored:
        return found
    e, r = np.concatenate([_unit(found.u), -_unit(found.u)]), np.tile(found.beta, 2)
    return _distinct(e, r, np.concatenate([found.normal, -found.normal]), np.tile(found.aligned, 2))


def _descend(limit: AbstractLimitState, e: np.ndarray, r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Move directions e downhill (in place, with their distances r); return their normals, and which are
    aligned."""
    normal, aligned, fraction = e.copy(), np.zeros(len(e), bool), np.ones(len(e))
    fresh = np.ones(len(e), bool)
    active = np.ones(len(e), bool)
    for _ in range(STEPS):
        new = np.flatnonzero(active & fresh)
        if new.size:
            _, slope = limit.gradients(e[new] * r[new, None])
            normal[new] = _unit(-slope)
            aligned[new] = 1 - np.sum(normal[new] * e[new], axis=1) < ALIGNED
            active[new[aligned[new]]] = False
        at = np.flatnonzero(active)
        if at.size == 0:
            break
        nearest, direction, way = _step(limit, e[at], r[at], normal[at], fraction[at])
        closer = nearest < r[at] * (1 - 1e-10)
        moved = at[closer]
        e[moved], r[moved] = direction[closer], nearest[closer]
        fresh[at] = closer
        fraction[at] = np.where(closer, np.clip(way, SHORTEST, 1.5), 0.25 * fraction[at])
        active[at[fraction[at] < SHORTEST]] = False
    return normal, aligned


def _step(limit: AbstractLimitState, e, r, normal, fraction) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the nearest failure in a few directions on the way to the normal: its distance, direction, and
    fraction."""
    ways = fraction[:, None] * WAYS
    tried = _unit(e[:, None, :] + ways[..., None] * (normal - e)[:, None, :])
    flat = tried.reshape(-1, e.shape[1])
    # Places below the known distance, denser where the change is likely.
    part = np.concatenate([[0.4, 0.6], np.linspace(0.7, 1.0, AGAIN - 2)])
    found = _bracket(limit, flat, np.repeat(r, WAYS.size)[:, None] * part)
    best = np.argmin(found.root().reshape(ways.shape), axis=1)
    rows = np.arange(len(e))
    chosen = rows * WAYS.size + best
    return _narrowed(limit, flat[chosen], found.at(chosen)), tried[rows, best], ways[rows, best]


def _distinct(e: np.ndarray, r: np.ndarray, normal: np.ndarray, aligned: np.ndarray) -> Found:
    kept: list[int] = []
    for i in np.argsort(r):
        if not any(e[i] @ e[j] > SAME for j in kept):
            kept.append(int(i))
    return Found(e[kept] * r[kept, None], normal[kept], r[kept], aligned[kept])


def merged(a: Found, b: Found) -> Found:
    """Return the distinct design points of both."""
    u, normal, beta, aligned = (np.concatenate(pair) for pair in zip(a, b, strict=True))
    return _distinct(_unit(u), beta, normal, aligned)
