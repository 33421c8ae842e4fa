"""Places along lines of scenes: their spacing, and the refinement of changes between them.

Two neighbours that both survive may be a share `TRUST` of their reaches apart (the distance over which the
motion of each continues unchanged, see `rockjax._batch.reach`): a window between them would have to open and
close against the derivatives of all turning points of both. Some windows are a few widths wide and
neighbouring scenes show no sign of them, so neighbours are at most `FARTHEST` spacings apart. Where reaches
are short or unknown, places are as close as the requested width. This is an estimate, not a proof;
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

SPACING = 0.95  # of the requested width, because the tolerance may move the ends of a window
TRUST = 0.25  # share of the reaches of two neighbours by which they may be apart
FARTHEST = 6  # greatest distance of neighbours, in spacings
PARTS = 16  # parts into which an interval is divided at once
ROUND = 2048  # scenes of a round, of all lines side by side …
LEAST = 64  # … but at least this many of one line
GRAZING = 1e-3  # margins below this are computed at full accuracy
LEAST_PARTS = 4  # parts of an interval beside a dip; more if lanes would be idle


class Known(NamedTuple):
    """Scenes that were solved, sorted by line and y; arrays of one shape."""

    line: np.ndarray
    y: np.ndarray
    margin: np.ndarray  # NaN where a scene did not finish
    impacts: np.ndarray
    reach: np.ndarray  # distance in y over which the motion continues unchanged, 0 if unknown
    sharp: np.ndarray  # whether solved at full accuracy

    def and_also(self, more: Known) -> Known:
        both = [np.concatenate(pair) for pair in zip(self, more, strict=True)]
        order = np.lexsort((both[1], both[0]))
        return Known(*(y[order] for y in both))

    def answered(self) -> Known:
        return Known(*(y[~np.isnan(self.margin)] for y in self))

    def changes(self, first_only: bool = False) -> np.ndarray:
        """Return the places whose next place on the same line has the other outcome."""
        over = self.margin <= 0
        at = np.flatnonzero((over[:-1] != over[1:]) & (self.line[:-1] == self.line[1:]))
        return at[np.unique(self.line[at], return_index=True)[1]] if first_only else at

    def below(self) -> list[slice]:
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
Look = Callable[[np.ndarray, np.ndarray, bool], Known]


def spacing_for(width: float | None, size: float, resolution: int) -> float:
    """Return the distance of places such that no window of a share `width` of a range of length `size` lies
    between two of them: a whole fraction of its `resolution` steps. inf without a width."""
    if width is None:
        return np.inf
    return size / resolution / math.ceil(1 / (resolution * SPACING * width))


def certain(known: Known, look: Look, spacing: float, first_only: bool) -> Known:
    """Add places until no window wider than two spacings below the first change of a line can be unseen.

    - `known`: scenes solved so far
    - `look`: (line, y, at full accuracy) → solved scenes
    - `spacing`: from `spacing_for`; inf to skip the search for windows
    - `first_only`: confirm only the first change of each line

    Returns all scenes; those at changes and at low dips are solved at full accuracy.
    """
    while True:
        line, y = _missing(known, spacing)
        if line.size:
            known = known.and_also(look(line, y, False))
            continue
        at = _unsure(known, first_only)
        if at.size == 0:
            return known
        again = look(known.line[at], known.y[at], True)
        reach = np.where(known.margin[at] > 0, known.reach[at], again.reach)
        for old, new in zip(known, again._replace(reach=reach), strict=True):
            old[at] = new


def gaps(known: Known, spacing: float, top: float) -> np.ndarray:
    """Return the widest interval below the first change of each line that may overturn unseen."""
    widest = []
    for part in known.below():
        y, answered = known.y[part], ~np.isnan(known.margin[part])
        seen = np.diff(y) <= _allowed(known, part, spacing) * (1 + 1e-9)
        # A step that its reaches allow may hide a window of one spacing, any other one of its own length.
        hides = np.where(seen, np.minimum(np.diff(y), spacing), np.diff(y))
        at = np.flatnonzero(answered)
        through = np.flatnonzero(np.diff(at) > 1)
        blind = np.diff(y[at])[through]
        kept = hides[answered[1:] & answered[:-1]]
        end = top - y[at[-1]] if known.margin[part][at[-1]] > 0 else 0.0
        widest.append(np.max(np.concatenate([[end], kept, blind])))
    return np.array(widest)


def _allowed(known: Known, part: slice, spacing: float) -> np.ndarray:
    """Return the allowed length of each step between neighbours, in whole spacings."""
    reach = np.where(known.margin[part] > 0, known.reach[part], 0.0)
    return spacing * np.clip(np.floor(TRUST * (reach[1:] + reach[:-1]) / spacing), 1, FARTHEST)


def _missing(known: Known, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the next places of each line that have to be solved, from below: (line, y)."""
    lines, places = [np.zeros(0, int)], [np.zeros(0)]
    wide = []
    for part in known.below() if np.isfinite(spacing) else ():
        step = np.diff(known.y[part])
        allowed = _allowed(known, part, spacing)
        at = np.flatnonzero(step > allowed * (1 + 1e-9))
        if at.size:
            parts = np.ceil(step[at] / allowed[at] * (1 - 1e-9)).astype(int)
            wide.append((part, at, np.clip(parts, 2, PARTS)))
    share = max(LEAST, ROUND // max(1, len(wide)))
    for part, at, parts in wide:
        y = known.y[part]
        # From below, because a lower first change may be found.
        at = at[: 1 + np.searchsorted(np.cumsum(parts - 1), share)]
        between = [
            np.linspace(y[k], y[k + 1], n + 1)[1:-1] for k, n in zip(at, parts[: at.size], strict=True)
        ]
        places.append(spacing * np.unique(np.round(np.concatenate(between) / spacing)))
        lines.append(np.full(places[-1].size, known.line[part.start]))
    return np.concatenate(lines), np.concatenate(places)


def _unsure(known: Known, first_only: bool) -> np.ndarray:
    """Return the places that determine a change or a low dip, but are solved at the looser accuracy only."""
    changes = known.changes(first_only)
    at = np.union1d(changes, changes + 1)
    low = [part.start + np.flatnonzero(known.margin[part] < GRAZING) for part in known.below()]
    at = np.union1d(at, np.concatenate(low)).astype(int)
    return at[~known.sharp[at]]


def lowest(known: Known) -> np.ndarray:
    """Return the middles of the dips among the survivors below the first change of each line."""
    here, margin = np.zeros(0, int), known.margin
    for part in known.below():
        k = np.arange(part.start + 1, part.stop - 1)
        survives = (margin[k - 1] > 0) & (margin[k] > 0) & (margin[k + 1] > 0)
        here = np.append(here, k[survives & (margin[k] <= margin[k - 1]) & (margin[k] < margin[k + 1])])
    return here


def around_dips(known: Known, lanes: int, may_open: bool = False) -> tuple[np.ndarray, np.ndarray, int]:
    """Return places on both sides of the dips of each line that may be the lowest.

    - `lanes`: number of scenes that the batch solves side by side
    - `may_open`: only of dips in which a window may open

    Returns lines, places, and the number of parts into which they divide the steps there.
    """
    here, margin = lowest(known), known.margin
    # Extended straight lines from both sides would meet there.
    depth = 2 * margin[here] - 0.5 * (margin[here - 1] + margin[here + 1])
    may_be = depth < (0.0 if may_open else dip(known)[known.line[here]])
    here, depth = here[may_be], depth[may_be]
    order = np.lexsort((depth, known.line[here]))
    line = known.line[here[order]]
    here = here[order[np.arange(line.size) - np.searchsorted(line, line) < DIPS]]
    left = np.concatenate([here - 1, here])
    parts = max(LEAST_PARTS, 1 + lanes // max(left.size, 1))
    size = known.y[left + 1] - known.y[left]
    places = known.y[left, None] + size[:, None] * np.arange(1, parts) / parts
    return np.repeat(known.line[left], parts - 1), places.ravel(), parts


def dip(known: Known) -> np.ndarray:
    """Return the least margin in a dip of each line, 1 without any."""
    here = lowest(known)
    least = np.ones(known.line[-1] + 1)
    np.minimum.at(least, known.line[here], known.margin[here])
    return least
