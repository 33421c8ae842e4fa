"""Places along lines of scenes: their spacing, and the refinement of changes between them.

Two neighbours that both survive may be `DISTANCE_SHARE` of their edge distances apart (the distance over
which the motion of each continues unchanged, see `rockjax._batch.edge_distance`): a window between them would
have to open and close against the derivatives of all turning points of both. Some windows are a few widths
wide and neighbouring scenes show no sign of them, so neighbours are at most `MAX_SPACINGS` apart. Where edge
distances are short or unknown, places are as close as the requested width. This is an estimate, not a proof;
`benchmarks/boundaries.py` tries every scale.

Places are whole multiples of the spacing, so that repeated divisions of a step end at exactly one spacing.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from .first import DIPS

SPACING_SHARE = 0.95  # of the requested width, because the tolerance may move the ends of a window
DISTANCE_SHARE = 0.25  # share of the edge distances of two neighbours by which they may be apart
MAX_SPACINGS = 6  # greatest distance of neighbours, in spacings
MAX_PARTS = 16  # parts into which an interval is divided at once
ROUND_SCENES = 2048  # scenes of a round, of all lines side by side …
MIN_LINE_SCENES = 64  # … but at least this many of one line
GRAZING = 1e-3  # margins below this are computed at full accuracy
MIN_PARTS = 4  # parts of an interval beside a dip; more if lanes would be idle


class SolvedScenes(NamedTuple):
    """Scenes that were solved, sorted by line and y; arrays of one shape."""

    line: np.ndarray
    y: np.ndarray
    margin: np.ndarray  # NaN where a scene did not finish
    impacts: np.ndarray
    edge_distance: np.ndarray  # distance in y over which the motion continues unchanged, 0 if unknown
    sharp: np.ndarray  # whether solved at full accuracy

    def merged_with(self, other: SolvedScenes) -> SolvedScenes:
        both = [np.concatenate(pair) for pair in zip(self, other, strict=True)]
        order = np.lexsort((both[1], both[0]))
        return SolvedScenes(*(y[order] for y in both))

    def finished(self) -> SolvedScenes:
        return SolvedScenes(*(y[~np.isnan(self.margin)] for y in self))

    def changes(self, first_only: bool = False) -> np.ndarray:
        """Return the places whose next place on the same line has the other outcome."""
        over = self.margin <= 0
        at = np.flatnonzero((over[:-1] != over[1:]) & (self.line[:-1] == self.line[1:]))
        return at[np.unique(self.line[at], return_index=True)[1]] if first_only else at

    def below_first_change(self) -> list[slice]:
        """Return for each line the slice from the last place at which the columns never lift to the first
        that overturns.

        Columns at rest respond in proportion to the motion, so nothing lifts them below a scale that does
        not.
        """
        parts = []
        for start, end in itertools.pairwise([0, *(np.flatnonzero(np.diff(self.line)) + 1), self.line.size]):
            margin = self.margin[start:end]
            over = np.flatnonzero(margin <= 0)
            stop = over[0] + 1 if over.size else end - start
            still = np.flatnonzero(margin[:stop] == 1)
            parts.append(slice(start + (still[-1] if still.size else 0), start + stop))
        return parts


# (line, y, at the full accuracy?) → scenes solved there
SolveScenes = Callable[[np.ndarray, np.ndarray, bool], SolvedScenes]


def spacing_for(width: float | None, size: float, resolution: int) -> float:
    """Return the distance of places such that no window of a share `width` of a range of length `size` lies
    between two of them: a whole fraction of its `resolution` steps. inf without a width."""
    if width is None:
        return np.inf
    return size / resolution / math.ceil(1 / (resolution * SPACING_SHARE * width))


def resolve_windows(
    solved: SolvedScenes, solve: SolveScenes, spacing: float, first_only: bool
) -> SolvedScenes:
    """Add places until no window wider than two spacings below the first change of a line can be unseen.

    - `solved`: scenes solved so far
    - `solve`: (line, y, at full accuracy) → solved scenes
    - `spacing`: from `spacing_for`; inf to skip the search for windows
    - `first_only`: confirm only the first change of each line

    Returns all scenes; those at changes and at low dips are solved at full accuracy.
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
        edge_distance = np.where(solved.margin[rows] > 0, solved.edge_distance[rows], confirmed.edge_distance)
        for old, new in zip(solved, confirmed._replace(edge_distance=edge_distance), strict=True):
            old[rows] = new


def widest_gaps(solved: SolvedScenes, spacing: float, top: float) -> np.ndarray:
    """Return the widest interval below the first change of each line that may overturn unseen."""
    widest = []
    for part in solved.below_first_change():
        y, finished = solved.y[part], ~np.isnan(solved.margin[part])
        allowed = np.diff(y) <= _allowed_steps(solved, part, spacing) * (1 + 1e-9)
        # A step that edge distances allow may hide a window of one spacing, others one of their own length.
        widest_hidden = np.where(allowed, np.minimum(np.diff(y), spacing), np.diff(y))
        at = np.flatnonzero(finished)
        through = np.flatnonzero(np.diff(at) > 1)
        unfinished = np.diff(y[at])[through]
        hidden = widest_hidden[finished[1:] & finished[:-1]]
        end = top - y[at[-1]] if solved.margin[part][at[-1]] > 0 else 0.0
        widest.append(np.max(np.concatenate([[end], hidden, unfinished])))
    return np.array(widest)


def _allowed_steps(solved: SolvedScenes, part: slice, spacing: float) -> np.ndarray:
    """Return the allowed length of each step between neighbours, in whole spacings."""
    edge_distance = np.where(solved.margin[part] > 0, solved.edge_distance[part], 0.0)
    return spacing * np.clip(
        np.floor(DISTANCE_SHARE * (edge_distance[1:] + edge_distance[:-1]) / spacing), 1, MAX_SPACINGS
    )


def _next_points(solved: SolvedScenes, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the next places of each line that have to be solved, from below: (line, y)."""
    lines, points = [np.zeros(0, int)], [np.zeros(0)]
    wide = []
    for part in solved.below_first_change() if np.isfinite(spacing) else ():
        step = np.diff(solved.y[part])
        allowed = _allowed_steps(solved, part, spacing)
        at = np.flatnonzero(step > allowed * (1 + 1e-9))
        if at.size:
            parts = np.ceil(step[at] / allowed[at] * (1 - 1e-9)).astype(int)
            wide.append((part, at, np.clip(parts, 2, MAX_PARTS)))
    share = max(MIN_LINE_SCENES, ROUND_SCENES // max(1, len(wide)))
    for part, at, parts in wide:
        y = solved.y[part]
        # From below, because a lower first change may be found.
        at = at[: 1 + np.searchsorted(np.cumsum(parts - 1), share)]
        between = [
            np.linspace(y[k], y[k + 1], n + 1)[1:-1] for k, n in zip(at, parts[: at.size], strict=True)
        ]
        points.append(spacing * np.unique(np.round(np.concatenate(between) / spacing)))
        lines.append(np.full(points[-1].size, solved.line[part.start]))
    return np.concatenate(lines), np.concatenate(points)


def _unconfirmed(solved: SolvedScenes, first_only: bool) -> np.ndarray:
    """Return the places that determine a change or a low dip, but are solved at the looser accuracy only."""
    changes = solved.changes(first_only)
    at = np.union1d(changes, changes + 1)
    low = [part.start + np.flatnonzero(solved.margin[part] < GRAZING) for part in solved.below_first_change()]
    at = np.union1d(at, np.concatenate(low)).astype(int)
    return at[~solved.sharp[at]]


def find_dips(solved: SolvedScenes) -> np.ndarray:
    """Return the middles of the dips among the survivors below the first change of each line."""
    at, margin = np.zeros(0, int), solved.margin
    for part in solved.below_first_change():
        k = np.arange(part.start + 1, part.stop - 1)
        survives = (margin[k - 1] > 0) & (margin[k] > 0) & (margin[k + 1] > 0)
        at = np.append(at, k[survives & (margin[k] <= margin[k - 1]) & (margin[k] < margin[k + 1])])
    return at


def points_around_dips(
    solved: SolvedScenes, lanes: int, may_open: bool = False
) -> tuple[np.ndarray, np.ndarray, int]:
    """Return places on both sides of the dips of each line that may be the lowest.

    - `lanes`: number of scenes that the batch solves side by side
    - `may_open`: only of dips in which a window may open

    Returns lines, places, and the number of parts into which they divide the steps there.
    """
    at, margin = find_dips(solved), solved.margin
    # Extended straight lines from both sides would meet there.
    depth = 2 * margin[at] - 0.5 * (margin[at - 1] + margin[at + 1])
    may_be = depth < (0.0 if may_open else least_dip(solved)[solved.line[at]])
    at, depth = at[may_be], depth[may_be]
    order = np.lexsort((depth, solved.line[at]))
    line = solved.line[at[order]]
    at = at[order[np.arange(line.size) - np.searchsorted(line, line) < DIPS]]
    left = np.concatenate([at - 1, at])
    parts = max(MIN_PARTS, 1 + lanes // max(left.size, 1))
    size = solved.y[left + 1] - solved.y[left]
    points = solved.y[left, None] + size[:, None] * np.arange(1, parts) / parts
    return np.repeat(solved.line[left], parts - 1), points.ravel(), parts


def least_dip(solved: SolvedScenes) -> np.ndarray:
    """Return the least margin in a dip of each line, 1 without any."""
    at = find_dips(solved)
    least = np.ones(solved.line[-1] + 1)
    np.minimum.at(least, solved.line[at], solved.margin[at])
    return least
