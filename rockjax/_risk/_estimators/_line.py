"""Line sampling: along random lines parallel to a design point, where is failure, and how likely is that?

A line with the direction α_i of a design point contributes the normal probability of its failing stretches:
every crossing on it counts, so windows of survival do. Where there are several design points, space is
divided among them: u belongs to the one with the largest α_i·u − β_i, which cuts every line once, and the
parts add up. So nothing is counted twice or left out.

The crossings are points of the surface of failure, and where they move with a number y of the structure or
the ground the probability changes: dP/dy = −E Σ φ(c) (∂G/∂y)/|∂G/∂c| over the crossings c of a line, a
surface integral. Where G jumps across zero no derivative says where the jump moves to.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.stats import norm

from ._base import AbstractEstimator, Estimate, Slopes, lognormal_interval

NEAR, FINE, COARSE = 2.5, 0.3, 0.8  # places on a line: every 0.3 within 2.5 of β, every 0.8 elsewhere
REACH = 7.5  # of the lines, at both ends: Φ(−7.5) is 3e-14
NARROW, PARTS = 3, 8  # rounds of divisions of an interval with a crossing
JUMP = 1e-3  # of |∂G/∂c| times σ: G that far from zero at a crossing has jumped there


class _Crossings(NamedTuple):
    """Where lines cross the surface of failure.

    - `u`: points, (k, d); `density`: φ(c), (k,); `G`: there, on the failing side, (k,)
    - `part`, `line`: which design point's line, and which of them, (k,)
    """

    u: np.ndarray
    density: np.ndarray
    G: np.ndarray
    part: np.ndarray
    line: np.ndarray


class Line(AbstractEstimator):
    def __init__(self, limit, found, rng):
        super().__init__(limit, found, rng)
        self.directions = found.u / found.beta[:, None]
        self.lines: list[list[float]] = [[] for _ in found.beta]
        self.crossings: list[_Crossings] = []

    def round(self, size: int) -> None:
        share = norm.cdf(-self.found.beta)
        share = share / share.sum() if share.sum() > 0 else np.full(share.size, 1 / share.size)
        count = max(size // 40, 4)
        for i, part in enumerate(share):
            for _ in range(max(2, round(count * part))):
                self.lines[i].append(self._line(i))

    def _line(self, i: int) -> float:
        alpha, beta = self.directions[i], self.found.beta
        u = self.rng.standard_normal(self.limit.dimension)
        u -= (u @ alpha) * alpha
        low = -REACH
        # α_i·(u + cα_i) − β_i ≥ α_j·(u + cα_i) − β_j
        for j, other in enumerate(self.directions):
            if j != i:
                low = max(low, (other @ u - beta[j] + beta[i]) / max(1 - float(other @ alpha), 1e-12))
        high = max(REACH, beta[i] + NEAR)
        if low >= high:
            return 0.0
        probability, c, G = self._failing(u, alpha, self._places(low, high, float(beta[i])))
        where = np.full(c.size, i), np.full(c.size, len(self.lines[i]))
        self.crossings.append(_Crossings(u + c[:, None] * alpha, norm.pdf(c), G, *where))
        return probability

    @staticmethod
    def _places(low: float, high: float, beta: float) -> np.ndarray:
        stops = np.clip([low, beta - NEAR, beta + NEAR, high], low, high)
        parts = [np.zeros(0)]
        for a, b, step in zip(stops[:-1], stops[1:], (COARSE, FINE, COARSE), strict=True):
            if b > a:
                parts.append(np.linspace(a, b, max(2, math.ceil((b - a) / step) + 1)))
        return np.unique(np.concatenate(parts))

    def _failing(
        self, u: np.ndarray, alpha: np.ndarray, c: np.ndarray
    ) -> tuple[float, np.ndarray, np.ndarray]:
        """The normal probability of the failing stretches of a line; its crossings, and G at them."""
        value = self._look(u, alpha, c)
        for _ in range(NARROW):
            over = value <= 0
            at = np.flatnonzero(over[1:] != over[:-1])
            if at.size == 0:
                break
            drop = value[at] - value[at + 1]
            root = np.clip(value[at] / np.where(drop == 0, 1.0, drop), 0, 1)
            part = np.concatenate(
                [np.tile(np.arange(1, PARTS) / PARTS, (at.size, 1)), root[:, None] + np.array([-1e-3, 1e-3])],
                axis=1,
            )
            new = (c[at, None] + (c[at + 1] - c[at])[:, None] * np.clip(part, 0, 1)).ravel()
            both = np.concatenate([c, new]), np.concatenate([value, self._look(u, alpha, new)])
            order = np.argsort(both[0], kind="stable")
            c, value = both[0][order], both[1][order]
        over = value <= 0
        # Stretches between places count with both ends failing, half where one does; what is beyond the last
        # goes on.
        mass = norm.sf(c[:-1]) - norm.sf(c[1:])
        inside = float(mass @ (0.5 * (over[1:].astype(float) + over[:-1])))
        beyond = (float(norm.sf(c[-1])) if over[-1] else 0.0) + (
            float(norm.cdf(c[0])) if over[0] and c[0] <= -REACH else 0.0
        )
        at = np.flatnonzero(over[1:] != over[:-1])
        at = np.where(over[at], at, at + 1)
        return inside + beyond, c[at], value[at]

    def _look(self, u: np.ndarray, alpha: np.ndarray, c: np.ndarray) -> np.ndarray:
        return self.limit.values(u[None] + c[:, None] * alpha[None])

    def estimate(self) -> Estimate:
        y = [np.array(line) for line in self.lines]
        p = float(sum(part.mean() for part in y))
        variance = float(sum(part.var(ddof=1) / part.size for part in y))
        error, count = math.sqrt(variance), sum(part.size for part in y)
        effective = count / (1 + count * (error / p) ** 2) if p > 0 else 0.0
        return Estimate(p, error, lognormal_interval(p, error, count), effective)

    def slopes(self) -> Slopes | None:
        all_of = _Crossings(*(np.concatenate(ys) for ys in zip(*self.crossings, strict=True)))
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
