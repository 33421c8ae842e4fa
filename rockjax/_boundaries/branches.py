"""Branches of the overturning boundary in a plane of scenes, traced by continuation along their own tangents.

A branch is a curve M(x, y) = 0 of the overturning margin M. Its tangent is exact, from the derivatives of M;
a step along it is corrected by Newton's method along the gradient, so folds are points like others. Points
are kept on M = ε just inside the safe side: where the boundary between two ways of overturning is all there
is, M jumps, no such point exists, and the branch has come to its corner. All branches of a plane step side by
side, as one batch.
"""

from __future__ import annotations

import itertools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rockjax._engine.solve import solve
from rockjax._options import Options
from rockjax._results import REST

from .crossings import Plane, scan
from .verdict import margin_options

INSIDE = 1e-9  # ε, in units of the margin
CORRECTIONS = 5
FIRST, LONGEST, SHORTEST = 0.004, 0.04, 1e-6  # steps, in parts of the plane
TURN = 0.35  # of the tangent in one step [rad]
SAME = 1e-5  # parts of the plane: the same point
LANES = 32  # scenes with their derivatives, side by side


class Branch(NamedTuple):
    """A branch, point by point; its ends are an edge of the plane, a corner, or each other."""

    x: np.ndarray
    y: np.ndarray
    slope_x: np.ndarray  # ∂M/∂x …
    slope_y: np.ndarray  # … and ∂M/∂y, together normal to the branch, towards the safe side
    ends: tuple[str, str]


class Traced(NamedTuple):
    branches: list[Branch]
    scanned: np.ndarray  # x of the lines that were scanned
    scenes: int
    scenes_with_derivatives: int


class Slopes:
    """The margin and its derivatives (∂M/∂x, ∂M/∂y) at points of a plane, in batches of one size."""

    def __init__(self, plane: Plane, options: Options):
        self.scenes = 0
        wanted = margin_options(options, True)

        def margin(point):
            (floats, _), _ = solve(*plane(point[0], point[1]), REST, None, wanted)
            return floats["margin"], floats["margin"]

        self._batch = jax.jit(jax.vmap(jax.jacfwd(margin, has_aux=True)))

    def __call__(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        self.scenes += x.size
        points = np.stack([x, y], axis=1)
        parts = []
        for start in range(0, len(points), LANES):
            part = points[start : start + LANES]
            # What fills up the batch repeats its last point.
            filled = np.concatenate([part, np.repeat(part[-1:], LANES - len(part), axis=0)])
            slope, value = self._batch(jnp.asarray(filled))
            parts.append(np.concatenate([np.asarray(value)[:, None], np.asarray(slope)], axis=1)[: len(part)])
        found = np.concatenate(parts) if parts else np.zeros((0, 3))
        return found[:, 0], found[:, 1], found[:, 2]


class _Walk:
    """One branch in one direction: forward has the safe side on the left."""

    def __init__(self, point: np.ndarray, gradient: np.ndarray, direction: float):
        self.points, self.gradients = [point], [gradient]
        self.tangent = direction * _along(gradient)
        self.length = FIRST
        self.end = ""  # or why it has ended
        self.next = -1  # the start that it has come to

    def guess(self) -> np.ndarray:
        return self.points[-1] + self.length * self.tangent

    def advance(self, point: np.ndarray, gradient: np.ndarray, arrived: bool) -> None:
        """Take a corrected step, or try a shorter one."""
        tangent = (
            np.sign(_along(self.gradients[-1]) @ self.tangent) * _along(gradient) if arrived else self.tangent
        )
        turn = abs(_angle(self.tangent, tangent))
        if arrived and turn < TURN and np.hypot(*(point - self.guess())) < 0.5 * self.length:
            self.points.append(point)
            self.gradients.append(gradient)
            self.tangent = tangent
            self.length = min(LONGEST, self.length * (1.6 if turn < 0.4 * TURN else 1.0))
            if not (0 <= point[0] <= 1 and 0 <= point[1] <= 1):
                self.end = "edge"
            return
        self.length *= 0.4
        if self.length < SHORTEST:
            self.end = "corner"


def _along(gradient: np.ndarray) -> np.ndarray:
    """The unit tangent that has the safe side on its left."""
    return np.array([gradient[1], -gradient[0]]) / np.hypot(*gradient)


def trace(
    plane: Plane,
    x_range: tuple[float, float],
    y_range: tuple[float, float],
    *,
    scans: int,
    resolution: int,
    options: Options,
    progress: Any = False,
) -> Traced:
    """All branches of the overturning boundary over a rectangle, from full scans of `scans` lines x = const.

    The scans show that on their lines no branch is missed; one that lies between two of them entirely is.
    """
    slopes = Slopes(plane, options)
    size = np.array([x_range[1] - x_range[0], y_range[1] - y_range[0]])
    origin = np.array([x_range[0], y_range[0]])

    def look(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Margins and gradients at points (n, 2) of the unit square."""
        value, *gradient = slopes(*(origin + points * size).T)
        return value, np.stack(gradient, axis=1) * size

    lines = np.linspace(0, 1, scans)
    found = scan(plane, x_range[0] + lines * size[0], y_range, resolution, options, progress, width=None)
    starts = np.stack([lines[found.crossings.line], (found.crossings.y - origin[1]) / size[1]], axis=1)
    branches = [line.branch(origin, size) for line in _follow(starts, look)]
    branches.sort(key=lambda branch: (branch.x.min(), branch.y.min()))
    return Traced(branches, x_range[0] + lines * size[0], found.scenes, slopes.scenes)


class _Line(NamedTuple):
    """A branch in the unit square."""

    points: np.ndarray
    gradients: np.ndarray
    ends: tuple[str, str]

    def branch(self, origin: np.ndarray, size: np.ndarray) -> Branch:
        x, y = (origin + self.points * size).T
        slope_x, slope_y = (self.gradients / size).T
        return Branch(x, y, slope_x, slope_y, self.ends)

    def passes(self, point: np.ndarray, gradient: np.ndarray) -> bool:
        """Whether a point with its gradient lies on it."""
        a, step = self.points[:-1], np.diff(self.points, axis=0)
        part = np.sum((point - a) * step, axis=1) / np.maximum(np.sum(step**2, axis=1), 1e-300)
        part = np.clip(part, 0, 1)
        apart = np.hypot(*(a + part[:, None] * step - point).T)
        chord = np.hypot(*step.T)
        turn = np.abs([_angle(g, h) for g, h in itertools.pairwise(self.gradients)])
        # How far a smooth curve may be from its chord; another branch as close as that has its safe side
        # elsewhere.
        near = apart < SAME + 0.3 * chord * turn
        aligned = np.array(
            [abs(_angle(g, gradient)) < TURN + t for g, t in zip(self.gradients, turn, strict=False)]
        )
        return bool(np.any(near & aligned))


def _angle(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.arctan2(a[0] * b[1] - a[1] * b[0], a @ b))


def _follow(starts: np.ndarray, look) -> list[_Line]:
    """The branches through the starts."""
    points, gradients, good = _correct(starts, look, reach=1e-3)
    begins = list(zip(points[good], gradients[good], strict=True))
    # Forward from every start to the next one; then back from those that no walk has come to.
    forward = [_Walk(*begin, 1.0) for begin in begins]
    _walk(forward, begins, look)
    reached = {w.next for w in forward}
    back = {k: _Walk(*begin, -1.0) for k, begin in enumerate(begins) if k not in reached}
    _walk(list(back.values()), [], look)
    lines, used = [], set()
    for first in [*back, *range(len(begins))]:
        if first in used:
            continue
        chain, k = [], first
        while k >= 0 and k not in used:
            used.add(k)
            chain.append(forward[k])
            k = forward[k].next
        before = back.get(first)
        points = [*(before.points[:0:-1] if before else []), *(p for w in chain for p in w.points)]
        normals = [*(before.gradients[:0:-1] if before else []), *(g for w in chain for g in w.gradients)]
        closed = before is None
        if closed:
            points, normals = [*points, points[0]], [*normals, normals[0]]
        ends = ("closed", "closed") if before is None else (before.end, chain[-1].end)
        if len(points) > 1:
            lines.append(_Line(np.array(points), np.array(normals), ends))
    return lines


def _walk(walks: list[_Walk], begins: list, look) -> None:
    """All walks to their ends, side by side."""
    while active := [w for w in walks if not w.end]:
        corrected = _correct(np.array([w.guess() for w in active]), look, reach=LONGEST)
        for w, point, gradient, arrived in zip(active, *corrected, strict=True):
            count = len(w.points)
            w.advance(point, gradient, bool(arrived))
            if len(w.points) == count:
                continue
            last = _Line(np.array(w.points[-2:]), np.array(w.gradients[-2:]), ("", ""))
            for k, begin in enumerate(begins):
                own = begin[0] is w.points[0]
                if (count > 4 if own else True) and last.passes(*begin):
                    w.end, w.next = "met", k
                    w.points.pop()
                    w.gradients.pop()
                    break


def _correct(points: np.ndarray, look, reach: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points moved along the gradient to M = ε, the gradients there, and which of them arrived."""
    points = points.copy()
    gradients = np.zeros_like(points)
    arrived = np.zeros(len(points), bool)
    going = np.arange(len(points))
    start = points.copy()
    for _ in range(CORRECTIONS):
        value, gradient = look(points[going])
        size2 = np.sum(gradient**2, axis=1)
        usable = np.isfinite(value) & (size2 > 0) & np.all(np.isfinite(gradient), axis=1)
        done = usable & (value > 0) & (np.abs(value - INSIDE) < 0.5 * INSIDE)
        arrived[going[done]] = True
        gradients[going[done]] = gradient[done]
        step = np.where(usable, (value - INSIDE) / np.where(usable, size2, 1.0), 0.0)[:, None] * gradient
        move = going[usable & ~done]
        points[move] -= step[usable & ~done]
        far = np.hypot(*(points[move] - start[move]).T) > reach
        going = move[~far]
        if going.size == 0:
            break
    return points, gradients, arrived
