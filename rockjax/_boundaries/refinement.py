"""Points along lines of scenes: the spacing of points, and the search for windows between points.

A scene is one podium under one motion. A line is a set of scenes in which only y varies, such as the factor
on the motion. A window is an interval of y in which scenes overturn. The search must find every window wider
than a requested width; the spacing is slightly less than this width. The edge distance of a scene is the
estimated change of y at which the scene could overturn (see `_batch/edge_distance.py`).

The distance of two neighbours that both survive is limited in two ways. It is at most `DISTANCE_SHARE` times
the sum of both edge distances: a window between such neighbours would contradict the edge distances. It is
also at most `MAX_SPACINGS` spacings, because windows that are a few spacings wide may have no effect on the
scenes beside them. If edge distances are short or unknown, neighbours are one spacing apart. These limits are
estimates, not proofs. For comparison, `benchmarks/boundaries.py` solves scenes in steps of a quarter of the
requested width.

The points of this search are whole multiples of the spacing, so that repeated divisions of a step end at
exactly one spacing. The margin of a scene is positive if it survives and negative if it overturns (see
docs/overturning.md). A dip is a minimum of the margin along a line. The first change of a line is the least y
at which survival turns into overturning.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from .first import DIPS

# Spacing divided by the requested width. It is less than 1 because errors of scenes may move the ends of a
# window.
SPACING_SHARE = 0.95
DISTANCE_SHARE = 0.25  # allowed distance of two neighbours divided by the sum of their edge distances
MAX_SPACINGS = 6  # largest distance of neighbours, in spacings
MAX_PARTS = 16  # largest number of parts into which an interval is divided at once
# A round solves at most about ROUND_SCENES scenes. This limit is shared equally among the lines. If there are
# many lines, the limit for each line is MIN_LINE_SCENES instead.
ROUND_SCENES = 2048
MIN_LINE_SCENES = 64
GRAZING = 1e-3  # scenes with a margin below this are solved at full accuracy
MIN_PARTS = 4  # least number of parts of an interval beside a dip; more if there are few such intervals


class SolvedScenes(NamedTuple):
    """Solved scenes, sorted by line and y; arrays of one shape."""

    line: np.ndarray  # index of the line
    y: np.ndarray  # position on the line
    margin: np.ndarray  # signed margin; NaN if the scene did not finish
    impacts: np.ndarray  # number of impacts
    edge_distance: np.ndarray  # estimated change of y at which the scene could overturn; 0 if unknown
    accurate: np.ndarray  # True if solved at full accuracy

    def merged_with(self, other: SolvedScenes) -> SolvedScenes:
        merged = SolvedScenes(*(np.concatenate(pair) for pair in zip(self, other, strict=True)))
        order = np.lexsort((merged.y, merged.line))
        return SolvedScenes(*(y[order] for y in merged))

    def finished(self) -> SolvedScenes:
        return SolvedScenes(*(y[~np.isnan(self.margin)] for y in self))

    def changes(self, first_only: bool = False) -> np.ndarray:
        """Return the indices of scenes whose next scene on the line has the other outcome; if `first_only`,
        only the first such index of each line."""
        overturns = self.margin <= 0
        k = np.flatnonzero((overturns[:-1] != overturns[1:]) & (self.line[:-1] == self.line[1:]))
        return k[np.unique(self.line[k], return_index=True)[1]] if first_only else k

    def below_first_change(self) -> list[slice]:
        """Return a slice of scenes for each line: from the last scene in which the columns do not lift to the
        first scene that overturns, or to the end of the line if no scene overturns.

        In full contact the response is proportional to the motion. Therefore, if the columns do not lift
        at one scale of the motion, they do not lift at any lower scale.
        """
        slices = []
        for start, end in itertools.pairwise([0, *(np.flatnonzero(np.diff(self.line)) + 1), self.line.size]):
            margin = self.margin[start:end]
            overturned = np.flatnonzero(margin <= 0)
            stop = overturned[0] + 1 if overturned.size else end - start
            not_lifted = np.flatnonzero(margin[:stop] == 1)
            slices.append(slice(start + (not_lifted[-1] if not_lifted.size else 0), start + stop))
        return slices


# (line, y, whether at full accuracy) ↦ solved scenes
SolveScenes = Callable[[np.ndarray, np.ndarray, bool], SolvedScenes]


def spacing_for(width: float | None, size: float, resolution: int) -> float:
    """Return the spacing of points with which every window wider than `width` is found.

    - `width`: width of a window divided by `size`; None to omit the search, with inf as the result
    - `size`: length of the range of y
    - `resolution`: number of equal steps of the range; the spacing is a step divided by a whole number
    """
    if width is None:
        return np.inf
    return size / resolution / math.ceil(1 / (resolution * SPACING_SHARE * width))


def resolve_windows(
    solved: SolvedScenes, solve: SolveScenes, spacing: float, first_only: bool
) -> SolvedScenes:
    """Solve further scenes until, below the first change of each line, neighbours are close enough to show
    every window wider than the requested width.

    - `solved`: scenes solved so far
    - `solve`: (line, y, whether at full accuracy) ↦ solved scenes
    - `spacing`: result of `spacing_for`; inf to omit the search for windows
    - `first_only`: True to confirm only the first change of each line, False to confirm all

    Returns all scenes. Scenes at changes, scenes with a small margin, and scenes that do not finish below the
    first change are solved at full accuracy.
    """
    while True:
        line, y = _next_points(solved, spacing)
        if line.size:
            solved = solved.merged_with(solve(line, y, False))
            continue
        rows = _unconfirmed(solved, first_only)
        if rows.size == 0:
            return solved
        confirmed = solve(solved.line[rows], solved.y[rows], True)
        # Scenes that survived keep the edge distances from which the steps beside them were chosen.
        edge_distance = np.where(solved.margin[rows] > 0, solved.edge_distance[rows], confirmed.edge_distance)
        for old, new in zip(solved, confirmed._replace(edge_distance=edge_distance), strict=True):
            old[rows] = new


def widest_gaps(solved: SolvedScenes, spacing: float, line_end: float) -> np.ndarray:
    """Return, for each line, the width of the widest window below the first change that may have been missed.

    - `solved`: the solved scenes
    - `spacing`: result of `spacing_for`
    - `line_end`: upper end of the lines
    """
    widest = []
    for below in solved.below_first_change():
        y, finished = solved.y[below], ~np.isnan(solved.margin[below])
        is_allowed = np.diff(y) <= _allowed_steps(solved, below, spacing) * (1 + 1e-9)
        # A step of an allowed length may hide a window as wide as the spacing. A longer step may hide a
        # window as wide as the step.
        widest_hidden = np.where(is_allowed, np.minimum(np.diff(y), spacing), np.diff(y))
        finished_indices = np.flatnonzero(finished)
        across_unfinished = np.flatnonzero(np.diff(finished_indices) > 1)
        unfinished = np.diff(y[finished_indices])[across_unfinished]
        hidden = widest_hidden[finished[1:] & finished[:-1]]
        last = finished_indices[-1]
        above_last = line_end - y[last] if solved.margin[below][last] > 0 else 0.0
        widest.append(np.max(np.concatenate([[above_last], hidden, unfinished])))
    return np.array(widest)


def unfinished_range(solved: SolvedScenes, count: int, line_start: float) -> tuple[np.ndarray, np.ndarray]:
    """Return, for each of `count` lines, the largest y of a finished scene below the first scene that did not
    finish, and the largest y of a scene that did not finish.

    - `solved`: scenes in any order
    - `line_start`: lower end of the lines, returned if no scene below the first unfinished one finished

    The second result is −inf for a line whose scenes all finished.
    """
    is_finished = ~np.isnan(solved.margin)
    line, y = solved.line[~is_finished], solved.y[~is_finished]
    first, last, finished_to = np.full(count, np.inf), np.full(count, -np.inf), np.full(count, line_start)
    np.minimum.at(first, line, y)
    np.maximum.at(last, line, y)
    below = is_finished & (solved.y < first[solved.line])
    np.maximum.at(finished_to, solved.line[below], solved.y[below])
    return finished_to, last


def _allowed_steps(solved: SolvedScenes, below: slice, spacing: float) -> np.ndarray:
    """Return the allowed length of each step between neighbours of a slice, a whole number of spacings."""
    edge_distance = np.where(solved.margin[below] > 0, solved.edge_distance[below], 0.0)
    return spacing * np.clip(
        np.floor(DISTANCE_SHARE * (edge_distance[1:] + edge_distance[:-1]) / spacing), 1, MAX_SPACINGS
    )


def _next_points(solved: SolvedScenes, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Return lines and positions of the scenes to solve next, the lowest first."""
    lines, points = [np.zeros(0, int)], [np.zeros(0)]
    divisions = []
    for below in solved.below_first_change() if np.isfinite(spacing) else ():
        step = np.diff(solved.y[below])
        allowed = _allowed_steps(solved, below, spacing)
        too_long = np.flatnonzero(step > allowed * (1 + 1e-9))
        if too_long.size:
            parts = np.ceil(step[too_long] / allowed[too_long] * (1 - 1e-9)).astype(int)
            divisions.append((below, too_long, np.clip(parts, 2, MAX_PARTS)))
    scenes_per_line = max(MIN_LINE_SCENES, ROUND_SCENES // max(1, len(divisions)))
    for below, too_long, parts in divisions:
        y = solved.y[below]
        # The lowest steps come first, because they may contain a lower change.
        chosen = too_long[: 1 + np.searchsorted(np.cumsum(parts - 1), scenes_per_line)]
        between = [
            np.linspace(y[k], y[k + 1], n + 1)[1:-1]
            for k, n in zip(chosen, parts[: chosen.size], strict=True)
        ]
        points.append(spacing * np.unique(np.round(np.concatenate(between) / spacing)))
        lines.append(np.full(points[-1].size, solved.line[below.start]))
    return np.concatenate(lines), np.concatenate(points)


def _unconfirmed(solved: SolvedScenes, first_only: bool) -> np.ndarray:
    """Return the indices of the scenes on both sides of a change and, below the first change of each line, of
    the scenes that have a small margin or did not finish, as far as they are not yet solved at full
    accuracy."""
    changes = solved.changes(first_only)
    doubtful = [
        below.start + np.flatnonzero(~(solved.margin[below] >= GRAZING))
        for below in solved.below_first_change()
    ]
    indices = np.union1d(np.union1d(changes, changes + 1), np.concatenate(doubtful)).astype(int)
    return indices[~solved.accurate[indices]]


def find_dips(solved: SolvedScenes) -> np.ndarray:
    """Return the indices of all minima of the margin among the survivors below the first change of each
    line."""
    dips, margin = np.zeros(0, int), solved.margin
    for below in solved.below_first_change():
        k = np.arange(below.start + 1, below.stop - 1)
        survives = (margin[k - 1] > 0) & (margin[k] > 0) & (margin[k + 1] > 0)
        dips = np.append(dips, k[survives & (margin[k] <= margin[k - 1]) & (margin[k] < margin[k + 1])])
    return dips


def points_around_dips(
    solved: SolvedScenes, lanes: int, may_open: bool = False
) -> tuple[np.ndarray, np.ndarray, int]:
    """Return points on both sides of the dips that may be the lowest dip of their line, for at most `DIPS`
    dips of each line.

    - `solved`: the solved scenes
    - `lanes`: number of scenes that a batch solves together
    - `may_open`: True to choose only dips in which a window may open

    Returns lines and positions of the points, and the number of parts into which they divide the steps
    beside a dip.
    """
    dips, margin = find_dips(solved), solved.margin
    # The depth is an estimate of the minimum: the margin of the dip, minus the distance by which it lies
    # below the mean of its two neighbours.
    depth = 2 * margin[dips] - 0.5 * (margin[dips - 1] + margin[dips + 1])
    is_candidate = depth < (0.0 if may_open else least_dip(solved)[solved.line[dips]])
    dips, depth = dips[is_candidate], depth[is_candidate]
    order = np.lexsort((depth, solved.line[dips]))
    line = solved.line[dips[order]]
    dips = dips[order[np.arange(line.size) - np.searchsorted(line, line) < DIPS]]
    left = np.concatenate([dips - 1, dips])
    parts = max(MIN_PARTS, 1 + lanes // max(left.size, 1))
    size = solved.y[left + 1] - solved.y[left]
    points = solved.y[left, None] + size[:, None] * np.arange(1, parts) / parts
    return np.repeat(solved.line[left], parts - 1), points.ravel(), parts


def least_dip(solved: SolvedScenes) -> np.ndarray:
    """Return the least margin at the dips of each line, or 1 for a line without dips."""
    dips = find_dips(solved)
    least = np.ones(solved.line[-1] + 1)
    np.minimum.at(least, solved.line[dips], solved.margin[dips])
    return least
