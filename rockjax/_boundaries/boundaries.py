"""All boundaries between survival and overturning on given lines of a plane of scenes, by scans or along
branches."""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

import numpy as np

from rockjax._options import Options

from .branches import Branch, Slopes, trace
from .crossings import Crossings, Plane, margins, scan
from .implicit import PAST
from .verdict import NARROWEST


class Boundaries(NamedTuple):
    """Crossings on the lines x, and how they were found."""

    crossings: Crossings
    survives_at_once: np.ndarray  # at the lower end of each line
    dip: np.ndarray  # see `Scan`; 1 where no scan has looked
    certain: np.ndarray  # see `Scan`; NaN where no scan has looked
    cost: dict[str, int]
    branches: list[Branch]  # none from scans


def boundaries(
    plane: Plane,
    x: np.ndarray,
    y_range: tuple[float, float],
    method: Literal["scan", "trace"],
    scans: int,
    resolution: int,
    options: Options,
    progress: Any = False,
    width: float | None = NARROWEST,
) -> Boundaries:
    """Every change between survival and overturning along the lines x, from one end of `y_range` to the
    other."""
    if method == "trace":
        return _by_tracing(plane, x, y_range, scans, resolution, options, progress, width)
    found = scan(plane, x, y_range, resolution, options, progress, width=width)
    return Boundaries(
        found.crossings, found.survives_at_once, found.dip, found.certain, {"scenes": found.scenes}, []
    )


class _Guesses(NamedTuple):
    line: np.ndarray
    y: np.ndarray


def _by_tracing(
    plane: Plane, x, y_range, scans: int, resolution: int, options: Options, progress, width
) -> Boundaries:
    """From branches; lines are scanned where these do not add up to survival, overturning, survival …"""
    bottom, top = y_range
    traced = trace(
        plane, (x[0], x[-1]), y_range, scans=scans, resolution=resolution, options=options, progress=progress
    )
    guesses = _guesses(traced.branches, x)
    slopes = Slopes(plane, options)
    y = guesses.y.copy()
    for _ in range(3):
        value, _, slope = slopes(x[guesses.line], y)
        y = y - np.where(slope != 0, value / np.where(slope != 0, slope, 1.0), 0.0)
    value, _, slope = slopes(x[guesses.line], y)
    good = (np.abs(value) < 1e-9) & (np.abs(y - guesses.y) < 0.02 * (top - bottom)) & (y > bottom) & (y < top)
    line, y, overturns = guesses.line[good], y[good], slope[good] < 0
    order = np.lexsort((y, line))
    line, y, overturns = line[order], y[order], overturns[order]
    # Where two walks went along one branch.
    new = np.ones(line.size, bool)
    new[1:] = (line[1:] != line[:-1]) | (np.diff(y) > 1e-8 * (top - bottom))
    line, y, overturns = line[new], y[new], overturns[new]
    # From end to end survival and overturning alternate.
    ends = [margins(plane, x, np.full_like(x, end), options, progress)[0] > 0 for end in y_range]
    place = np.arange(line.size) - np.searchsorted(line, line)
    wrong = (ends[0] != ends[1]) != (np.bincount(line, minlength=x.size) % 2 == 1)
    wrong[line[overturns != (ends[0][line] == (place % 2 == 0))]] = True
    verdict, impacts, _ = margins(
        plane, x[line], y * np.where(overturns, 1 + PAST, 1 - PAST), options, progress
    )
    wrong[line[verdict > 0]] = True
    again = np.flatnonzero(wrong)
    keep = ~wrong[line]
    parts = [Crossings(line[keep], y[keep], overturns[keep], impacts[keep])]
    dip, certain = np.ones(x.size), np.full(x.size, np.nan)
    scenes = traced.scenes + line.size + 2 * x.size
    if again.size:
        found = scan(plane, x[again], y_range, resolution, options, progress, width=width)
        parts.append(found.crossings._replace(line=again[found.crossings.line]))
        dip[again], certain[again] = found.dip, found.certain
        scenes += found.scenes
    whole = [np.concatenate(pair) for pair in zip(*parts, strict=True)]
    order = np.lexsort((whole[1], whole[0]))
    cost = {
        "scenes": scenes,
        "scenes_with_derivatives": traced.scenes_with_derivatives + slopes.scenes,
        "frequencies_scanned": traced.scanned.size + again.size,
    }
    return Boundaries(
        Crossings(*(part[order] for part in whole)), ends[0], dip, certain, cost, traced.branches
    )


def _guesses(branches: list[Branch], x: np.ndarray) -> _Guesses:
    """Where the branches cross the lines x: by cubics through their points with their tangents."""
    lines, ys = [], []
    for branch in branches:
        for k in range(len(branch.x) - 1):
            a, b = branch.x[k], branch.x[k + 1]
            inside = np.flatnonzero(
                (x >= min(a, b)) & (x < max(a, b)) | (x == branch.x[k + 1]) & (k == len(branch.x) - 2)
            )
            if inside.size == 0 or a == b:
                continue
            z = (x[inside] - a) / (b - a)
            rise = branch.y[k + 1] - branch.y[k]
            with np.errstate(divide="ignore", invalid="ignore"):
                m = -(b - a) * branch.slope_x[k : k + 2] / branch.slope_y[k : k + 2]
            # Near a fold the tangent stands upright; the chord is as good.
            m = np.where(np.abs(m) < 5 * abs(rise), m, rise)
            lines.append(inside)
            # Cubic Hermite.
            ys.append(
                branch.y[k] + z * (m[0] + z * (3 * rise - 2 * m[0] - m[1] + z * (m[0] + m[1] - 2 * rise)))
            )
    if not lines:
        return _Guesses(np.zeros(0, int), np.zeros(0))
    return _Guesses(np.concatenate(lines), np.concatenate(ys))
