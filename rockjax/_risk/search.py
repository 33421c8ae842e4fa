"""Design points: where the limit state comes closest to the origin of standard normal space.

A direction e on the unit sphere has a distance r(e): the least at which the ray r·e fails. A design point is
a local minimum of r. This form of the search stays on the limit state, sees windows of survival behind the
first failure, and needs no continuity of G: where the mode of failure changes, G jumps, but r is still a
distance. All directions of all starts go side by side:

1. at the point of a direction the gradient gives the normal, a = −∇G/|∇G|, of which a linear G has its design
   point;
2. directions between e and a, at several fractions of the way, are looked at, and the one with the least r is
   taken;
3. it ends where e and a agree, or where no fraction comes closer: at a jump of G, whose edge has no normal.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .limit_state import AbstractLimitState

FARTHEST = 9.0  # distance from the origin: Φ(−9) is 1e-19
RAY = 24  # places on a ray in the first look …
NARROW = 3  # … then rounds of
PARTS = 8  # divisions of the interval in which it first fails
FRACTIONS = 0.5 ** np.arange(7)  # of the way to the normal
OVERSHOOT = (1.5,)  # past it: a fixed-point step is short where the limit state bends away
ALIGNED = 1e-7  # 1 − cos of the angle between point and normal …
STEPS = 40  # … or this many steps
SAME = 0.99  # cosine of the angle between two design points that are one


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


def distances(limit: AbstractLimitState, directions: np.ndarray, farthest: float = FARTHEST) -> np.ndarray:
    """The least distance at which each ray fails, (m,); inf where none up to `farthest` does. Relative
    accuracy 1e-4."""
    return _narrowed(limit, directions, *_first_failure(limit, directions, farthest))


def _first_failure(limit: AbstractLimitState, directions: np.ndarray, farthest: float):
    at = np.linspace(0, farthest, RAY + 1)[1:]
    places = directions[:, None, :] * at[None, :, None]
    value = limit.values(places.reshape(-1, directions.shape[1])).reshape(len(directions), RAY)
    over = value <= 0
    first = np.argmax(over, axis=1)
    fails = over.any(axis=1)
    high = np.where(fails, at[first], np.inf)
    low = np.where(first > 0, at[first - 1], 0.0)
    above = np.where(first > 0, value[np.arange(len(value)), first - 1], np.inf)
    return low, high, above, np.where(fails, value[np.arange(len(value)), first], np.nan)


def _narrowed(limit: AbstractLimitState, directions: np.ndarray, low, high, above, below) -> np.ndarray:
    live = np.flatnonzero(np.isfinite(high))
    for _ in range(NARROW):
        if live.size == 0:
            break
        # Half of the places even, for certainty, the others close around the root of the straight line.
        part = np.tile(np.arange(1, PARTS) / PARTS, (live.size, 1))
        slope = above[live] - below[live]
        root = np.where(np.isfinite(slope) & (slope > 0), above[live] / np.where(slope > 0, slope, 1.0), 0.5)
        close = np.clip(root[:, None] + np.array([-1e-2, -1e-4, 1e-4, 1e-2]), 0, 1)
        part = np.sort(np.concatenate([part, close], axis=1), axis=1)
        at = low[live, None] + (high[live] - low[live])[:, None] * part
        places = directions[live, None, :] * at[..., None]
        value = limit.values(places.reshape(-1, directions.shape[1])).reshape(at.shape)
        at = np.concatenate([low[live, None], at, high[live, None]], axis=1)
        value = np.concatenate([above[live, None], value, below[live, None]], axis=1)
        first = np.argmax(value[:, 1:] <= 0, axis=1) + 1
        rows = np.arange(live.size)
        low[live], high[live] = at[rows, first - 1], at[rows, first]
        above[live], below[live] = value[rows, first - 1], value[rows, first]
    return high


def _unit(u: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(u, axis=-1, keepdims=True)
    return u / np.where(length > 0, length, 1.0)


def design_points(
    limit: AbstractLimitState, starts: np.ndarray, farthest: float = FARTHEST, steps: int = STEPS
) -> Found:
    """Local minima of |u| on the limit state, from starting directions (s, d)."""
    e = _unit(np.asarray(starts, float))
    r = distances(limit, e, farthest)
    # A start whose ray never fails goes where G falls the most.
    lost = ~np.isfinite(r)
    if lost.any():
        _, slope = limit.gradients(e[lost] * 1e-3)
        e[lost] = _unit(-slope)
        r[lost] = distances(limit, e[lost], farthest)
    live = np.isfinite(r)
    aligned = np.zeros(len(e), bool)
    normal = e.copy()
    active = live.copy()
    for _ in range(steps):
        at = np.flatnonzero(active)
        if at.size == 0:
            break
        _, slope = limit.gradients(e[at] * r[at, None])
        normal[at] = _unit(-slope)
        agree = np.sum(normal[at] * e[at], axis=1)
        aligned[at] = 1 - agree < ALIGNED
        active[at[aligned[at]]] = False
        at = at[~aligned[at]]
        if at.size == 0:
            continue
        fractions = np.concatenate([OVERSHOOT, FRACTIONS])
        way = normal[at] - e[at]
        tried = _unit(e[at, None, :] + fractions[None, :, None] * way[:, None, :])
        reach = distances(limit, tried.reshape(-1, limit.dimension), farthest).reshape(
            at.size, fractions.size
        )
        best = np.argmin(reach, axis=1)
        nearest = reach[np.arange(at.size), best]
        closer = nearest < r[at] * (1 - 1e-9)
        active[at[~closer]] = False
        moved = at[closer]
        e[moved], r[moved] = tried[np.arange(at.size), best][closer], nearest[closer]
    return _distinct(e[live], r[live], normal[live], aligned[live])


def _distinct(e: np.ndarray, r: np.ndarray, normal: np.ndarray, aligned: np.ndarray) -> Found:
    kept: list[int] = []
    for i in np.argsort(r):
        if not any(e[i] @ e[j] > SAME for j in kept):
            kept.append(int(i))
    return Found(e[kept] * r[kept, None], normal[kept], r[kept], aligned[kept])


def merged(a: Found, b: Found) -> Found:
    """The distinct design points of both."""
    u, normal, beta, aligned = (np.concatenate(pair) for pair in zip(a, b, strict=True))
    return _distinct(_unit(u), beta, normal, aligned)
