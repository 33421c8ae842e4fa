"""All changes between survival and overturning along lines of scenes, by scanning them and narrowing every change down."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import numpy as np

from rockjax._batch.batch import peak_responses
from rockjax._excitations.base import AbstractExcitation
from rockjax._options import Options
from rockjax._structures import Podium

from .boundary import CLOSE, divisions, doubt, has_margin, judge, margin_options

# A plane of scenes: (x, y) → podium and excitation, for numbers, arrays that broadcast, and tracers alike.
Plane = Callable[[Any, Any], tuple[Podium, AbstractExcitation]]

DOUBT = 0.1  # of 1, to be on the safe side
DIVES = 8  # closer looks where the margin is not resolved …
PARTS = 4  # … each dividing an interval into so many …
FINEST = 1e-6  # … down to this part of the line
NARROW = 12  # divisions of a bracket at most
SHARE = 12  # scenes to divide a bracket


class Crossings(NamedTuple):
    """Changes between survival and overturning, in the order of x, then y."""

    line: np.ndarray  # which of the lines x = const
    y: np.ndarray
    overturns: np.ndarray  # going up in y: True survive → overturn, False the way back
    impacts: np.ndarray  # before overturning, on the overturned side

    def table(self, lines: int) -> tuple[np.ndarray, np.ndarray]:
        """y and impacts of each line in a row, shape (lines, most of a line), filled up with NaN and −1."""
        counts = np.bincount(self.line, minlength=lines)
        order = np.arange(self.line.size) - np.searchsorted(self.line, self.line)
        shape = (lines, max(1, int(counts.max())))
        y, impacts = np.full(shape, np.nan), np.full(shape, -1, np.int32)
        y[self.line, order], impacts[self.line, order] = self.y, self.impacts
        return y, impacts


class Scan(NamedTuple):
    crossings: Crossings
    survives_at_once: np.ndarray  # at the lower end of each line
    dip: np.ndarray  # least dip of the margin among the survivors below the first crossing of each line, at most 1
    scenes: int


class _Known(NamedTuple):
    """Scenes looked at, sorted by line and y."""

    line: np.ndarray
    y: np.ndarray
    margin: np.ndarray
    impacts: np.ndarray

    def and_also(self, more: _Known) -> _Known:
        both = [np.concatenate(pair) for pair in zip(self, more, strict=True)]
        order = np.lexsort((both[1], both[0]))
        return _Known(*(y[order] for y in both))


def scan(
    plane: Plane,
    x,
    y_range: tuple[float, float],
    resolution: int,
    options: Options,
    progress: Any = False,
    look_closer: Literal["everywhere", "below"] = "everywhere",
    finest: float = FINEST,
) -> Scan:
    """Every change along the lines x = const, y from one end of `y_range` to the other.

    Each line is looked at in `resolution` + 1 places first, and closer where the margin bends so much between neighbours
    that it may cross zero unseen: everywhere, or only below the first change found; down to the part `finest` of a line.
    Changes are then narrowed down to a relative width of 1e-12.
    """
    x = np.asarray(x, float)
    scenes = 0

    def look(line: np.ndarray, y: np.ndarray) -> _Known:
        nonlocal scenes
        scenes += line.size
        margin, impacts = margins(plane, x[line], y, options, progress)
        return _Known(line, y, margin, impacts)

    lines = np.arange(x.size)
    grid = np.linspace(*y_range, resolution + 1)
    known = look(np.repeat(lines, grid.size), np.tile(grid, x.size))
    for _ in range(DIVES):
        line, y = _closer(known, finest * abs(y_range[1] - y_range[0]), look_closer == "below")
        if line.size == 0:
            break
        known = known.and_also(look(line, y))
    starts = known.margin[np.searchsorted(known.line, lines)] > 0
    crossings = _narrowed(known, look)
    return Scan(crossings, starts, _dip(known, crossings, x.size), scenes)


def margins(plane: Plane, x: np.ndarray, y: np.ndarray, options: Options, progress: Any = False):
    """Overturning margins (or what stands for them, see `judge`) and impacts of scenes (x, y), on all cores."""
    if x.size == 0:
        return np.zeros(0), np.zeros(0, int)
    margin = has_margin(options)
    peaks = peak_responses(*plane(x, y), options=margin_options(options, margin), progress=progress)
    floats = {"margin": np.asarray(peaks.margin), "peak_rotation": np.asarray(peaks.peak_rotation)}
    value = judge(floats, np.asarray(peaks.overturned), float(options.overturn_ratio), margin, np)
    return np.broadcast_to(value, x.shape), np.broadcast_to(np.asarray(peaks.impacts), x.shape)


def _closer(known: _Known, finest: float, below: bool) -> tuple[np.ndarray, np.ndarray]:
    """Places inside every interval between neighbours in which the margin may do what they do not show."""
    line, y, margin = known.line, known.y, known.margin
    # The ends of a line have no neighbour on one side, nothing is known of the curvature across them.
    doubtful = doubt(y, margin, line[1:] == line[:-1], np) > DOUBT
    if below:  # up to the first change of each line
        changes = np.cumsum(np.r_[False, ((margin[1:] > 0) != (margin[:-1] > 0)) & (line[1:] == line[:-1])])
        doubtful &= changes[1:] == changes[np.searchsorted(line, line[1:])]
    at = np.flatnonzero(doubtful & (np.diff(y) > finest))
    part = np.arange(1, PARTS) / PARTS
    return np.repeat(line[at], part.size), (y[at, None] + (y[at + 1] - y[at])[:, None] * part).ravel()


def _dip(known: _Known, crossings: Crossings, lines: int) -> np.ndarray:
    first = np.full(lines, np.inf)
    np.minimum.at(first, crossings.line, crossings.y)
    line, margin = known.line, known.margin
    here = margin[1:-1]
    dips = (line[:-2] == line[2:]) & (here > 0) & (here <= margin[:-2]) & (here < margin[2:])
    dips &= known.y[2:] < first[line[1:-1]]
    lowest = np.ones(lines)
    np.minimum.at(lowest, line[1:-1][dips], here[dips])
    return lowest


def _narrowed(known: _Known, look: Callable[[np.ndarray, np.ndarray], _Known]) -> Crossings:
    over = known.margin <= 0
    at = np.flatnonzero((over[:-1] != over[1:]) & (known.line[:-1] == known.line[1:]))
    line, overturns = known.line[at], ~over[at]
    safe, fallen = np.where(overturns, at, at + 1), np.where(overturns, at + 1, at)
    # The end that survives, the end that does not, and what is known there.
    y = np.stack([known.y[safe], known.y[fallen]])
    margin = np.stack([known.margin[safe], known.margin[fallen]])
    impacts = known.impacts[fallen].copy()
    for _ in range(NARROW):
        wide = np.flatnonzero(np.abs(y[0] - y[1]) > CLOSE * np.abs(y).max(axis=0))
        if wide.size == 0:
            break
        places = divisions(*y[:, wide], *margin[:, wide], count=SHARE, xp=np)
        # From the surviving end to the other one.
        places = np.sort(places, axis=1)
        places = np.where((y[0] < y[1])[wide, None], places, places[:, ::-1])
        found = look(np.repeat(line[wide], SHARE), places.ravel())
        value, hits = found.margin.reshape(places.shape), found.impacts.reshape(places.shape)
        pad = lambda first, middle, last: np.concatenate([first[:, None], middle, last[:, None]], axis=1)
        places = pad(y[0, wide], places, y[1, wide])
        value = pad(margin[0, wide], value, margin[1, wide])
        hits = pad(impacts[wide], hits, impacts[wide])
        first = np.argmax(value <= 0, axis=1)
        rows = np.arange(wide.size)
        y[0, wide], y[1, wide] = places[rows, first - 1], places[rows, first]
        margin[0, wide], margin[1, wide] = value[rows, first - 1], value[rows, first]
        impacts[wide] = hits[rows, first]
    return Crossings(line, y.mean(axis=0), overturns, impacts)
