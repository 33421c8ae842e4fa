"""Scenes that a search has looked at along its lines, and the dips of the margin among them."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from .first import DIPS

LEAST_PARTS = 4  # of an interval beside a dip; more where lanes would be idle


class Known(NamedTuple):
    """Scenes looked at, sorted by line and y."""

    line: np.ndarray
    y: np.ndarray
    margin: np.ndarray  # NaN where a scene has ended without an answer
    impacts: np.ndarray
    reach: np.ndarray  # how far y may change as far as the scene tells, 0 where it tells nothing
    sharp: np.ndarray  # at the full accuracy

    def and_also(self, more: Known) -> Known:
        both = [np.concatenate(pair) for pair in zip(self, more, strict=True)]
        order = np.lexsort((both[1], both[0]))
        return Known(*(y[order] for y in both))

    def answered(self) -> Known:
        return Known(*(y[~np.isnan(self.margin)] for y in self))

    def changes(self) -> np.ndarray:
        """Where the next one of the same line has another verdict."""
        over = self.margin <= 0
        return np.flatnonzero((over[:-1] != over[1:]) & (self.line[:-1] == self.line[1:]))

    def first_changes(self) -> np.ndarray:
        at = self.changes()
        return at[np.unique(self.line[at], return_index=True)[1]]

    def below(self) -> list[slice]:
        """Of every line: from the last place where the columns never lift up to the first that overturns.

        Columns at rest feel the motion in proportion: below a scale that does not lift them none does.
        """
        parts = []
        for start, end in itertools.pairwise([0, *(np.flatnonzero(np.diff(self.line)) + 1), self.line.size]):
            margin = self.margin[start:end]
            over = np.flatnonzero(margin <= 0)
            stop = over[0] + 1 if over.size else end - start
            still = np.flatnonzero(margin[:stop] == 1)
            parts.append(slice(start + (still[-1] if still.size else 0), start + stop))
        return parts


# (line, y, at the full accuracy?, where reaches are wanted) → what is known there
Look = Callable[[np.ndarray, np.ndarray, bool, np.ndarray | bool], Known]


def lowest(known: Known) -> np.ndarray:
    """The middles of the dips among the survivors below the first change of each line."""
    here, margin = np.zeros(0, int), known.margin
    for part in known.below():
        k = np.arange(part.start + 1, part.stop - 1)
        survives = (margin[k - 1] > 0) & (margin[k] > 0) & (margin[k + 1] > 0)
        here = np.append(here, k[survives & (margin[k] <= margin[k - 1]) & (margin[k] < margin[k + 1])])
    return here


def around_dips(
    known: Known, lanes: int, may_open: bool = False
) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """Places on both sides of the dips of each line that may be the lowest, or only of those in which a
    window may open: lines, places, how far they are apart, and into how many parts they divide the steps
    there.

    `lanes`: so many scenes at once cost what one does.
    """
    here, margin = lowest(known), known.margin
    # Straight lines on either side, prolonged, would meet there.
    depth = 2 * margin[here] - 0.5 * (margin[here - 1] + margin[here + 1])
    may_be = depth < (0.0 if may_open else dip(known)[known.line[here]])
    here, depth = here[may_be], depth[may_be]
    order = np.lexsort((depth, known.line[here]))
    line = known.line[here[order]]
    here = here[order[np.arange(line.size) - np.searchsorted(line, line) < DIPS]]
    left = np.concatenate([here - 1, here])
    start, size = known.y[left, None], (known.y[left + 1] - known.y[left])[:, None]
    parts = max(LEAST_PARTS, 1 + lanes // max(left.size, 1))
    inside = np.arange(1, parts) / parts
    apart = np.broadcast_to(size / parts, (left.size, inside.size))
    return np.repeat(known.line[left], inside.size), (start + size * inside).ravel(), apart.ravel(), parts


def dip(known: Known) -> np.ndarray:
    """The least margin in a dip of each line, 1 without any."""
    here = lowest(known)
    least = np.ones(known.line[-1] + 1)
    np.minimum.at(least, known.line[here], known.margin[here])
    return least
