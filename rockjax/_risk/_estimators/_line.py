"""Line sampling: failing stretches of random lines parallel to the direction of a design point.

A line with the direction α_i of a design point contributes the normal probability of its failing stretches.
Every crossing on it counts, so windows of survival are included. With several design points, space is divided
among them: u belongs to the one with the largest α_i·u − β_i. This cuts every line once, and the parts add
up, so nothing is counted twice or omitted.

The crossings are points of the surface of failure. The probability changes as they move with a number y of
the structure or the ground: dP/dy = −E Σ φ(c) (∂G/∂y)/|∂G/∂c| over the crossings c of a line, a surface
integral. Where G jumps across zero, no derivative tells how the jump moves.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import scipy

from rockjax._risk.lines import crossings

from ._base import AbstractEstimator, Estimate, Slopes, lognormal_interval

NEAR, FINE, COARSE = 2.5, 0.3, 0.8  # places on a line: every 0.3 within 2.5 of β, every 0.8 elsewhere
REACH = 7.5  # half the length of a line: Φ(−7.5) is 3e-14
SCENES = 40  # scenes of a line, approximately
BATCH = 128  # lines in memory at once
JUMP = 1e-3  # G has jumped at a crossing if it is farther from zero than this share of |∂G/∂c|·σ


class _Found(NamedTuple):
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
    def __init__(self, limit, found, rng):
        super().__init__(limit, found, rng)
        self.directions = found.u / found.beta[:, None]
        self.lines: list[np.ndarray] = [np.zeros(0) for _ in found.beta]
        self.found_on_lines: list[_Found] = []

    def round(self, size: int) -> None:
        share = scipy.stats.norm.cdf(-self.found.beta)
        share = share / share.sum() if share.sum() > 0 else np.full(share.size, 1 / share.size)
        count = max(size // SCENES, 4)
        lines = self._drawn(np.maximum(2, np.round(count * share)).astype(int))
        for start in range(0, lines.part.size, BATCH):
            self._follow(_Lines(*(y[start : start + BATCH] for y in lines)))

    def _follow(self, lines: _Lines) -> None:
        """Add the contributions and the crossings of lines."""
        beta, direction = self.found.beta[lines.part], self.directions[lines.part]
        pairs = zip(lines.low, beta, strict=True)
        places = [self._places(low, max(REACH, b + NEAR), float(b)) for low, b in pairs]
        met = crossings(self.limit, lines.u, direction, places)
        # Failing stretches end at crossings; beyond the ends of a full line the state at its end continues.
        below = np.where(lines.low <= -REACH, 1.0, scipy.stats.norm.sf(lines.low))
        probability = np.where(met.fails_first, below, 0.0)
        np.add.at(probability, met.line, np.where(met.enters, 1.0, -1.0) * scipy.stats.norm.sf(met.place))
        for i, of in enumerate(self.lines):
            mine = lines.part == i
            of[lines.line[mine]] = probability[mine]
        u = lines.u[met.line] + met.place[:, None] * direction[met.line]
        where = lines.part[met.line], lines.line[met.line]
        self.found_on_lines.append(_Found(u, scipy.stats.norm.pdf(met.place), met.G, *where))

    def _drawn(self, counts: np.ndarray) -> _Lines:
        """Draw `counts` new lines for each design point; lines that miss its part count, but are dropped."""
        part = np.repeat(np.arange(counts.size), counts)
        line = np.concatenate([np.arange(n) + self.lines[i].size for i, n in enumerate(counts)])
        for i, n in enumerate(counts):
            self.lines[i] = np.concatenate([self.lines[i], np.zeros(n)])
        alpha, beta = self.directions[part], self.found.beta
        u = self.rng.standard_normal((part.size, self.limit.dimension))
        u -= np.sum(u * alpha, axis=1, keepdims=True) * alpha
        # α_i·(u + cα_i) − β_i ≥ α_j·(u + cα_i) − β_j
        along = np.maximum(1 - alpha @ self.directions.T, 1e-12)
        bound = (u @ self.directions.T - beta + beta[part, None]) / along
        bound[np.arange(part.size), part] = -REACH
        low = np.maximum(bound.max(axis=1), -REACH)
        kept = low < np.maximum(REACH, beta[part] + NEAR)
        return _Lines(u[kept], low[kept], part[kept], line[kept])

    @staticmethod
    def _places(low: float, high: float, beta: float) -> np.ndarray:
        stops = np.clip([low, beta - NEAR, beta + NEAR, high], low, high)
        parts = [np.zeros(0)]
        for a, b, step in zip(stops[:-1], stops[1:], (COARSE, FINE, COARSE), strict=True):
            if b > a:
                parts.append(np.linspace(a, b, max(2, math.ceil((b - a) / step) + 1)))
        return np.unique(np.concatenate(parts))

    def estimate(self) -> Estimate:
        y = self.lines
        p = float(sum(part.mean() for part in y))
        variance = float(sum(part.var(ddof=1) / part.size for part in y))
        error, count = math.sqrt(variance), sum(part.size for part in y)
        effective = count / (1 + count * (error / p) ** 2) if p > 0 else 0.0
        return Estimate(p, error, lognormal_interval(p, error, count), effective)

    def slopes(self) -> Slopes | None:
        all_of = _Found(*(np.concatenate(ys) for ys in zip(*self.found_on_lines, strict=True)))
        known = self.limit.with_sensitivities(all_of.u) if all_of.G.size else None
        if known is None:
            return None
        self.limit.scenes += all_of.G.size
        _, slope, named = known
        along = np.abs(np.sum(slope * self.directions[all_of.part], axis=1))
        jumps = ~(np.abs(all_of.G) < JUMP * along)
        weight = np.where(jumps, 0.0, all_of.density / np.where(jumps, 1.0, along))
        total = float(np.sum(all_of.density))
        found = {}
        for name, y in named.items():
            mean, variance = 0.0, 0.0
            for i, lines in enumerate(self.lines):
                mine = all_of.part == i
                moved = np.bincount(all_of.line[mine], -(weight * y)[mine], minlength=len(lines))
                mean += float(moved.mean())
                variance += float(moved.var(ddof=1) / moved.size)
            found[name] = (mean, math.sqrt(variance))
        return Slopes(found, float(np.sum(all_of.density[jumps])) / total if total > 0 else 0.0)
