"""Line sampling: failing segments of random lines parallel to the direction of a design point.

Failure is G ≤ 0, with the limit state function G of a vector of independent standard normal numbers. The
surface of failure separates failing from surviving points.

Design point i has the direction α_i and the distance β_i from the origin. A line of this design point
consists of the points u + cα_i, with a random u normal to α_i and all numbers c. The line contributes the
probability that a standard normal c lies in a failing segment. All crossings of the line with the surface of
failure are used, so survival between failing segments is taken into account. Several design points divide
space into regions: a point u belongs to the region of the design point with the largest α_i·u − β_i. Each
line ends at the boundary of the region of its design point, so no failing segment is counted twice or
omitted.

If a parameter y of the structure or the motion changes, the crossings move. The derivative of the probability
is dP/dy = −E Σ φ(c) (∂G/∂y)/|∂G/∂c|. The sum is over the crossings c of a line, E is the mean over the lines,
φ is the standard normal density, and ∂G/∂c is the derivative of G along the line. Crossings at which G jumps
across zero are left out, because the derivatives of G do not determine how these crossings move.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import scipy

from rockjax._risk.lines import find_crossings

from ._base import AbstractEstimator, ProbabilityEstimate, ProbabilitySlopes, lognormal_interval

FINE_RANGE = 2.5  # within this distance of c = β, the positions on a line are closer together
FINE_STEP, COARSE_STEP = 0.3, 0.8  # largest distance between positions within this range and outside it
HALF_LENGTH = 7.5  # a full line extends from c = −HALF_LENGTH to at least HALF_LENGTH; Φ(−7.5) is 3e-14
LINE_SCENES = 40  # approximate number of scenes for a line
BATCH = 128  # number of lines in memory at once
# G is taken to jump at a crossing unless |G| on the failing side is below this multiple of |∂G/∂c|.
MAX_RESIDUAL = 1e-3


class _SurfacePoints(NamedTuple):
    """Crossings of lines with the surface of failure."""

    u: np.ndarray  # the points, on the failing side, shape (k, d)
    density: np.ndarray  # φ(c), shape (k,)
    G: np.ndarray  # G at u, shape (k,)
    region: np.ndarray  # index of the design point, shape (k,)
    line: np.ndarray  # index of the line among the lines of this design point, shape (k,)


class _Lines(NamedTuple):
    """Lines u + cα parallel to the direction α of a design point. The part of a line with c ≥ `low` is inside
    the region of this design point."""

    u: np.ndarray  # vectors normal to α, shape (m, d)
    low: np.ndarray  # least c inside the region, shape (m,)
    region: np.ndarray  # index of the design point, shape (m,)
    line: np.ndarray  # index of the line among the lines of this design point, shape (m,)


class Line(AbstractEstimator):
    """Line sampling.

    - `directions`: unit vectors of the design points, shape (points, d)
    - `contributions`: for each design point, the probability of the failing segments of each of its lines
    - `surface_points`: crossings of all lines with the surface of failure, in batches
    """

    def __init__(self, limit, points, rng):
        super().__init__(limit, points, rng)
        self.directions = points.u / points.beta[:, None]
        self.contributions: list[np.ndarray] = [np.zeros(0) for _ in points.beta]
        self.surface_points: list[_SurfacePoints] = []

    def round(self, size: int) -> None:
        share = scipy.stats.norm.cdf(-self.points.beta)
        share = share / share.sum() if share.sum() > 0 else np.full(share.size, 1 / share.size)
        count = max(size // LINE_SCENES, 4)
        lines = self._draw(np.maximum(2, np.round(count * share)).astype(int))
        for start in range(0, lines.region.size, BATCH):
            self._add_lines(_Lines(*(y[start : start + BATCH] for y in lines)))

    def _add_lines(self, lines: _Lines) -> None:
        """Add the contributions and the crossings of lines."""
        beta, direction = self.points.beta[lines.region], self.directions[lines.region]
        pairs = zip(lines.low, beta, strict=True)
        positions = [
            self._scan_positions(low, max(HALF_LENGTH, b + FINE_RANGE), float(b)) for low, b in pairs
        ]
        crossed = find_crossings(self.limit, lines.u, direction, positions)
        # The boundary of the region cuts off failing segments. G is assumed to keep its sign below
        # −HALF_LENGTH and above the last position.
        line_probability = np.where(lines.low <= -HALF_LENGTH, 1.0, scipy.stats.norm.sf(lines.low))
        probability = np.where(crossed.fails_first, line_probability, 0.0)
        np.add.at(
            probability,
            crossed.line,
            np.where(crossed.enters, 1.0, -1.0) * scipy.stats.norm.sf(crossed.position),
        )
        for i, contributions in enumerate(self.contributions):
            is_inside = lines.region == i
            contributions[lines.line[is_inside]] = probability[is_inside]
        u = lines.u[crossed.line] + crossed.position[:, None] * direction[crossed.line]
        density = scipy.stats.norm.pdf(crossed.position)
        self.surface_points.append(
            _SurfacePoints(u, density, crossed.G, lines.region[crossed.line], lines.line[crossed.line])
        )

    def _draw(self, counts: np.ndarray) -> _Lines:
        """Draw `counts` new lines for each design point, and return those that meet its region. The
        contributions of the other lines are zero."""
        region = np.repeat(np.arange(counts.size), counts)
        line = np.concatenate([np.arange(n) + self.contributions[i].size for i, n in enumerate(counts)])
        for i, n in enumerate(counts):
            self.contributions[i] = np.concatenate([self.contributions[i], np.zeros(n)])
        alpha, beta = self.directions[region], self.points.beta
        u = self.rng.standard_normal((region.size, self.limit.dimension))
        u -= np.sum(u * alpha, axis=1, keepdims=True) * alpha
        # In the region of design point i, α_i·(u + cα_i) − β_i ≥ α_j·(u + cα_i) − β_j for all j. With
        # α_i·u = 0, this gives a lower bound of c for each j.
        cosine_gap = np.maximum(1 - alpha @ self.directions.T, 1e-12)
        bound = (u @ self.directions.T - beta + beta[region, None]) / cosine_gap
        bound[np.arange(region.size), region] = -HALF_LENGTH
        low = np.maximum(bound.max(axis=1), -HALF_LENGTH)
        meets_region = low < np.maximum(HALF_LENGTH, beta[region] + FINE_RANGE)
        return _Lines(u[meets_region], low[meets_region], region[meets_region], line[meets_region])

    @staticmethod
    def _scan_positions(low: float, high: float, beta: float) -> np.ndarray:
        """Return the ascending positions from `low` to `high` at which a line is evaluated first; they are
        denser around `beta`."""
        ends = np.clip([low, beta - FINE_RANGE, beta + FINE_RANGE, high], low, high)
        positions = [np.zeros(0)]
        for a, b, step in zip(ends[:-1], ends[1:], (COARSE_STEP, FINE_STEP, COARSE_STEP), strict=True):
            if b > a:
                positions.append(np.linspace(a, b, max(2, math.ceil((b - a) / step) + 1)))
        return np.unique(np.concatenate(positions))

    def estimate(self) -> ProbabilityEstimate:
        p = float(sum(y.mean() for y in self.contributions))
        variance = float(sum(y.var(ddof=1) / y.size for y in self.contributions))
        error, count = math.sqrt(variance), sum(y.size for y in self.contributions)
        effective = count / (1 + count * (error / p) ** 2) if p > 0 else 0.0
        return ProbabilityEstimate(p, error, lognormal_interval(p, error, count), effective)

    def slopes(self) -> ProbabilitySlopes | None:
        surface = _SurfacePoints(*(np.concatenate(ys) for ys in zip(*self.surface_points, strict=True)))
        derivatives = self.limit.with_sensitivities(surface.u) if surface.G.size else None
        if derivatives is None:
            return None
        self.limit.scenes += surface.G.size
        _, slope, by_name = derivatives
        slope_along = np.abs(np.sum(slope * self.directions[surface.region], axis=1))
        jumps = ~(np.abs(surface.G) < MAX_RESIDUAL * slope_along)
        weight = np.where(jumps, 0.0, surface.density / np.where(jumps, 1.0, slope_along))
        total = float(np.sum(surface.density))
        result = {}
        for name, y in by_name.items():
            mean, variance = 0.0, 0.0
            for i, contributions in enumerate(self.contributions):
                is_inside = surface.region == i
                changes = np.bincount(
                    surface.line[is_inside], -(weight * y)[is_inside], minlength=contributions.size
                )
                mean += float(changes.mean())
                variance += float(changes.var(ddof=1) / changes.size)
            result[name] = (mean, math.sqrt(variance))
        return ProbabilitySlopes(result, float(np.sum(surface.density[jumps])) / total if total > 0 else 0.0)
