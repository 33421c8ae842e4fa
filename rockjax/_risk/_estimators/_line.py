"""Line sampling: failing segments of random lines parallel to the direction of a design point.

A line with the direction α_i of a design point contributes the normal probability of its failing segments.
All crossings with the surface of failure count, so survival windows are included. With several design points,
space is divided among them: u belongs to the design point with the largest α_i·u − β_i. Each line is cut off
at the boundary of its part of space, so no failing segment is counted twice or omitted.

The crossings move with a parameter y of the structure or the motion, and the probability changes by
dP/dy = −E Σ φ(c) (∂G/∂y)/|∂G/∂c|, summed over the crossings c of a line. Where G jumps across zero, its
derivatives do not determine how the crossing moves.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import scipy

from rockjax._risk.lines import crossings

from ._base import AbstractEstimator, ProbabilityEstimate, ProbabilitySlopes, lognormal_interval

FINE_RANGE, FINE_STEP, COARSE_STEP = (
    2.5,
    0.3,
    0.8,
)  # places on a line: every 0.3 within 2.5 of β, every 0.8 elsewhere
HALF_LENGTH = 7.5  # half the length of a line: Φ(−7.5) is 3e-14
LINE_SCENES = 40  # approximate number of scenes for a line
BATCH = 128  # lines in memory at once
JUMP = 1e-3  # G has jumped at a crossing if it is farther from zero than this share of |∂G/∂c|·σ


class _SurfacePoints(NamedTuple):
    """Crossings of lines with the surface of failure.

    - `u`: points, (k, d); `density`: φ(c), (k,); `G`: there, on the failing side, (k,)
    - `part`, `line`: index of the design point, and of the line among the lines of that design point, (k,)
    """

    u: np.ndarray
    density: np.ndarray
    G: np.ndarray
    part: np.ndarray
    line: np.ndarray


class _Lines(NamedTuple):
    """Lines u + cα parallel to a design point's direction, with c ≥ `low` inside the part of space that
    belongs to it.

    - `u`: (m, d), normal to α; `part`, `line`: index of the design point, and of the line among its lines,
      (m,)
    """

    u: np.ndarray
    low: np.ndarray
    part: np.ndarray
    line: np.ndarray


class Line(AbstractEstimator):
    def __init__(self, limit, points, rng):
        super().__init__(limit, points, rng)
        self.directions = points.u / points.beta[:, None]
        self.lines: list[np.ndarray] = [np.zeros(0) for _ in points.beta]
        self.surface_points: list[_SurfacePoints] = []

    def round(self, size: int) -> None:
        share = scipy.stats.norm.cdf(-self.points.beta)
        share = share / share.sum() if share.sum() > 0 else np.full(share.size, 1 / share.size)
        count = max(size // LINE_SCENES, 4)
        lines = self._draw(np.maximum(2, np.round(count * share)).astype(int))
        for start in range(0, lines.part.size, BATCH):
            self._add_lines(_Lines(*(y[start : start + BATCH] for y in lines)))

    def _add_lines(self, lines: _Lines) -> None:
        """Add the contributions and the crossings of lines."""
        beta, direction = self.points.beta[lines.part], self.directions[lines.part]
        pairs = zip(lines.low, beta, strict=True)
        positions = [
            self._scan_positions(low, max(HALF_LENGTH, b + FINE_RANGE), float(b)) for low, b in pairs
        ]
        crossed = crossings(self.limit, lines.u, direction, positions)
        # Failing stretches end at crossings; beyond the ends of a full line the state at its end continues.
        below = np.where(lines.low <= -HALF_LENGTH, 1.0, scipy.stats.norm.sf(lines.low))
        probability = np.where(crossed.fails_first, below, 0.0)
        np.add.at(
            probability,
            crossed.line,
            np.where(crossed.enters, 1.0, -1.0) * scipy.stats.norm.sf(crossed.position),
        )
        for i, values in enumerate(self.lines):
            of_part = lines.part == i
            values[lines.line[of_part]] = probability[of_part]
        u = lines.u[crossed.line] + crossed.position[:, None] * direction[crossed.line]
        where = lines.part[crossed.line], lines.line[crossed.line]
        self.surface_points.append(
            _SurfacePoints(u, scipy.stats.norm.pdf(crossed.position), crossed.G, *where)
        )

    def _draw(self, counts: np.ndarray) -> _Lines:
        """Draw `counts` new lines for each design point; lines that miss its part count, but are dropped."""
        part = np.repeat(np.arange(counts.size), counts)
        line = np.concatenate([np.arange(n) + self.lines[i].size for i, n in enumerate(counts)])
        for i, n in enumerate(counts):
            self.lines[i] = np.concatenate([self.lines[i], np.zeros(n)])
        alpha, beta = self.directions[part], self.points.beta
        u = self.rng.standard_normal((part.size, self.limit.dimension))
        u -= np.sum(u * alpha, axis=1, keepdims=True) * alpha
        # α_i·(u + cα_i) − β_i ≥ α_j·(u + cα_i) − β_j
        cosine = np.maximum(1 - alpha @ self.directions.T, 1e-12)
        bound = (u @ self.directions.T - beta + beta[part, None]) / cosine
        bound[np.arange(part.size), part] = -HALF_LENGTH
        low = np.maximum(bound.max(axis=1), -HALF_LENGTH)
        reached = low < np.maximum(HALF_LENGTH, beta[part] + FINE_RANGE)
        return _Lines(u[reached], low[reached], part[reached], line[reached])

    @staticmethod
    def _scan_positions(low: float, high: float, beta: float) -> np.ndarray:
        ends = np.clip([low, beta - FINE_RANGE, beta + FINE_RANGE, high], low, high)
        parts = [np.zeros(0)]
        for a, b, step in zip(ends[:-1], ends[1:], (COARSE_STEP, FINE_STEP, COARSE_STEP), strict=True):
            if b > a:
                parts.append(np.linspace(a, b, max(2, math.ceil((b - a) / step) + 1)))
        return np.unique(np.concatenate(parts))

    def estimate(self) -> ProbabilityEstimate:
        y = self.lines
        p = float(sum(part.mean() for part in y))
        variance = float(sum(part.var(ddof=1) / part.size for part in y))
        error, count = math.sqrt(variance), sum(part.size for part in y)
        effective = count / (1 + count * (error / p) ** 2) if p > 0 else 0.0
        return ProbabilityEstimate(p, error, lognormal_interval(p, error, count), effective)

    def slopes(self) -> ProbabilitySlopes | None:
        surface = _SurfacePoints(*(np.concatenate(ys) for ys in zip(*self.surface_points, strict=True)))
        derivatives = self.limit.with_sensitivities(surface.u) if surface.G.size else None
        if derivatives is None:
            return None
        self.limit.scenes += surface.G.size
        _, slope, by_name = derivatives
        slope_along = np.abs(np.sum(slope * self.directions[surface.part], axis=1))
        jumps = ~(np.abs(surface.G) < JUMP * slope_along)
        weight = np.where(jumps, 0.0, surface.density / np.where(jumps, 1.0, slope_along))
        total = float(np.sum(surface.density))
        result = {}
        for name, y in by_name.items():
            mean, variance = 0.0, 0.0
            for i, lines in enumerate(self.lines):
                of_part = surface.part == i
                changes = np.bincount(surface.line[of_part], -(weight * y)[of_part], minlength=len(lines))
                mean += float(changes.mean())
                variance += float(changes.var(ddof=1) / changes.size)
            result[name] = (mean, math.sqrt(variance))
        return ProbabilitySlopes(result, float(np.sum(surface.density[jumps])) / total if total > 0 else 0.0)
