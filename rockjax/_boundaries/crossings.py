"""All changes between survival and overturning along lines of scenes, by scanning them and narrowing every
change down."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import numpy as np

from rockjax import _results as results
from rockjax._batch.batch import LANES, peak_responses
from rockjax._excitations.base import AbstractExcitation
from rockjax._options import Options
from rockjax._progress import bar
from rockjax._structures import Podium

from .first import CLOSE, DIPS, WIDTH, divisions
from .verdict import NARROWEST, has_margin, looking, margin_options, signed_margin

# A plane of scenes: (x, y) → podium and excitation, for numbers, arrays that broadcast, and tracers alike.
Plane = Callable[[Any, Any], tuple[Podium, AbstractExcitation]]

DOUBTFUL = 0.1  # of 1, to be on the safe side
REFINEMENT_ROUNDS = 8  # closer looks where the margin is not resolved …
PARTS = 4  # … each dividing an interval into so many …
FINEST = 1e-6  # … down to this part of the line
SHARE = 8  # scenes to divide a bracket, more where lanes would be idle
SPACING = 0.95  # of the width asked for: a tolerance may move the ends of a window
ROUND = 2048  # scenes of all lines that go up side by side …
LEAST = 64  # … of one line at least
QUARTERS = np.array([0.25, 0.5, 0.75])  # of an interval beside a dip …
ZOOMS = 4  # … so many times
NARROW = 24  # divisions of a bracket at most
NOISE = 0.1  # of the tolerance: a bracket as narrow, as a share of the scale, tells no more
GRAZING = 1e-3  # a margin as low as this is worked out at the full accuracy


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
    # Least dip of the margin among the survivors below the first crossing of each line, at most 1.
    dip: np.ndarray
    certain: np.ndarray  # of each line: below its first crossing no wider interval overturns
    scenes: int


class _Known(NamedTuple):
    """Scenes looked at, sorted by line and y."""

    line: np.ndarray
    y: np.ndarray
    margin: np.ndarray  # NaN where a scene has ended without an answer
    impacts: np.ndarray
    sharp: np.ndarray  # at the full accuracy

    def and_also(self, more: _Known) -> _Known:
        both = [np.concatenate(pair) for pair in zip(self, more, strict=True)]
        order = np.lexsort((both[1], both[0]))
        return _Known(*(y[order] for y in both))

    def answered(self) -> _Known:
        return _Known(*(y[~np.isnan(self.margin)] for y in self))

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


# (line, y, at the full accuracy?) → what is known there
Look = Callable[[np.ndarray, np.ndarray, bool], _Known]


def scan(
    plane: Plane,
    x,
    y_range: tuple[float, float],
    resolution: int,
    options: Options,
    progress: Any = False,
    look_closer: Literal["everywhere", "below", "first"] = "everywhere",
    width: float | None = NARROWEST,
) -> Scan:
    """Changes along the lines x = const, y from one end of `y_range` to the other.

    Each line is looked at in `resolution` + 1 places first. `"everywhere"` looks closer where the margin
    bends so much between neighbours that it may cross zero unseen. Below the first change, places are then so
    close that no interval wider than `width` times the range is missed (a motion must be proportional to y
    there); None leaves that out. All changes found, or the `"first"` of each line only, are narrowed down to
    a relative width of 1e-12.
    """
    x = np.asarray(x, float)
    scenes = 0
    y_range = min(y_range), max(y_range)
    size = y_range[1] - y_range[0]
    loose = looking(options, NARROWEST if width is None else width, np)

    with bar(None, "scenes", progress, unit_scale=True) as counter:

        def look(line: np.ndarray, y: np.ndarray, sharp: bool) -> _Known:
            nonlocal scenes
            scenes += line.size
            # What fills up a small batch is at rest and costs nothing, while small batches are a program of
            # their own.
            rest = 0 if width is None else max(0, 2 * LANES + 1 - line.size)
            x_all, y_all = np.append(x[line], np.repeat(x[:1], rest)), np.append(y, np.full(rest, y_range[0]))
            margin, impacts = margins(plane, x_all, y_all, options if sharp else loose, counter)
            margin, impacts = margin[: line.size], impacts[: line.size]
            return _Known(line, y, margin, impacts, np.full(line.size, sharp))

        lines = np.arange(x.size)
        grid = np.linspace(*y_range, resolution + 1)
        known = look(np.repeat(lines, grid.size), np.tile(grid, x.size), False)
        if look_closer == "everywhere":
            known = _refined(known, look, FINEST * size)
        spacing = np.inf if width is None else SPACING * width * size
        known = _certain(known, look, spacing, look_closer == "first")
        for _ in range(ZOOMS):
            known = known.and_also(look(*_around_dips(known), False))
        known = _certain(known, look, spacing, look_closer == "first")
        answered = known.answered()
        if np.unique(answered.line).size < x.size:
            raise RuntimeError(
                "no scene of a line has ended with an answer; raise options.max_steps or loosen rtol"
            )
        starts = answered.margin[np.searchsorted(answered.line, lines)] > 0
        changes = answered.first_changes() if look_closer == "first" else answered.changes()
        crossings = _narrowed(answered, changes, look, max(CLOSE, NOISE * float(options.rtol)))
    return Scan(crossings, starts, _dip(answered), _gaps(answered, y_range[1]), scenes)


def margins(plane: Plane, x: np.ndarray, y: np.ndarray, options: Options, progress: Any = False):
    """Overturning margins (or what stands for them, see `signed_margin`), NaN without an answer, and impacts
    of scenes (x, y), on all cores."""
    if x.size == 0:
        return np.zeros(0), np.zeros(0, int)
    podiums, motions = plane(x, y)
    margin = has_margin(options, podiums)
    peaks = peak_responses(podiums, motions, options=margin_options(options, margin), progress=progress)
    floats = {"margin": np.asarray(peaks.margin), "peak_rotation": np.asarray(peaks.peak_rotation)}
    value = signed_margin(floats, np.asarray(peaks.overturned), float(options.overturn_ratio), margin, np)
    value = np.where(np.asarray(results.code_of(peaks.result)) > results.OVERTURNED, np.nan, value)
    # Copies: what is solved again more sharply is put in their place.
    return tuple(np.array(np.broadcast_to(y, x.shape)) for y in (value, np.asarray(peaks.impacts)))


def curvature_indicator(y: np.ndarray, margin: np.ndarray, together: np.ndarray) -> np.ndarray:
    """How far the margin may bend away between neighbours, over what is between it and zero: (n−1,) for n
    places.

    Up to 1 the margin cannot cross zero unseen (or, between neighbours on both sides of the boundary, more
    than once), as far as second differences tell. `together` says which neighbours belong to one line.
    """
    h = np.where(together, y[1:] - y[:-1], 1.0)
    h = np.where(h > 0, h, 1.0)
    slope = np.where(together, (margin[1:] - margin[:-1]) / h, 0.0)
    inner = together[1:] & together[:-1]
    # The ends of a line have no neighbour on one side, nothing is known of the curvature across them.
    # Half the second derivative.
    bend = np.where(inner, np.abs(slope[1:] - slope[:-1]) / (h[1:] + h[:-1]), 0.0)
    bend = np.maximum(np.append(0.0, bend), np.append(bend, 0.0))
    left, right = margin[:-1], margin[1:]
    apart = (left > 0) != (right > 0)
    spare = np.where(apart, np.abs(left - right), 2 * np.minimum(np.abs(left), np.abs(right)))
    return np.where(together & (h > 0), bend * h**2 / np.maximum(spare, 1e-300), 0.0)


def _refined(known: _Known, look: Look, finest: float) -> _Known:
    """And places inside every interval between neighbours in which the margin may do what they do not
    show."""
    part = np.arange(1, PARTS) / PARTS
    for _ in range(REFINEMENT_ROUNDS):
        line, y, margin = known.line, known.y, np.nan_to_num(known.margin, nan=1.0)
        doubtful = curvature_indicator(y, margin, line[1:] == line[:-1]) > DOUBTFUL
        at = np.flatnonzero(doubtful & (np.diff(y) > finest))
        if at.size == 0:
            break
        places = (y[at, None] + (y[at + 1] - y[at])[:, None] * part).ravel()
        known = known.and_also(look(np.repeat(line[at], part.size), places, False))
    return known


def _certain(known: _Known, look: Look, spacing: float, first_only: bool) -> _Known:
    """Until below the first change no step is wider than `spacing`, and the changes stand at the full
    accuracy."""
    while True:
        line, y = _missing(known, spacing)
        if line.size:
            known = known.and_also(look(line, y, False))
            continue
        at = _unsure(known, first_only)
        if at.size == 0:
            return known
        again = look(known.line[at], known.y[at], True)
        for old, new in zip(known, again, strict=True):
            old[at] = new


def _missing(known: _Known, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """The next places of each line that are to be looked at, from below."""
    parts = known.below()
    wide = [part for part in parts if np.any(np.diff(known.y[part]) > spacing)]
    lines, places = [], []
    for part in wide:
        y = known.y[part]
        more: list[np.ndarray] = []
        share = max(LEAST, ROUND // len(wide))
        for k in np.flatnonzero(np.diff(y) > spacing):
            steps = int(np.ceil((y[k + 1] - y[k]) / spacing))
            more.append(y[k] + (y[k + 1] - y[k]) * np.arange(1, min(steps, share + 1)) / steps)
            share -= more[-1].size
            if share <= 0:
                break
        places.append(np.concatenate(more))
        lines.append(np.full(places[-1].size, known.line[part.start]))
    if not wide:
        return np.zeros(0, int), np.zeros(0)
    return np.concatenate(lines), np.concatenate(places)


def _unsure(known: _Known, first_only: bool) -> np.ndarray:
    """What a change or a low dip rests on, and is known at the looser accuracy only."""
    changes = known.first_changes() if first_only else known.changes()
    at = np.union1d(changes, changes + 1)
    low = [part.start + np.flatnonzero(known.margin[part] < GRAZING) for part in known.below()]
    at = np.union1d(at, np.concatenate(low)).astype(int)
    return at[~known.sharp[at]]


def _lowest(known: _Known) -> np.ndarray:
    """The middles of the dips among the survivors below the first change of each line."""
    here, margin = np.zeros(0, int), known.margin
    for part in known.below():
        k = np.arange(part.start + 1, part.stop - 1)
        survives = (margin[k - 1] > 0) & (margin[k] > 0) & (margin[k + 1] > 0)
        here = np.append(here, k[survives & (margin[k] <= margin[k - 1]) & (margin[k] < margin[k + 1])])
    return here


def _around_dips(known: _Known) -> tuple[np.ndarray, np.ndarray]:
    """Places on both sides of the dips of each line that may be the lowest."""
    here, margin = _lowest(known), known.margin
    # Straight lines on either side, prolonged, would meet there.
    depth = 2 * margin[here] - 0.5 * (margin[here - 1] + margin[here + 1])
    may_be = depth < _dip(known)[known.line[here]]
    here, depth = here[may_be], depth[may_be]
    order = np.lexsort((depth, known.line[here]))
    line = known.line[here[order]]
    here = here[order[np.arange(line.size) - np.searchsorted(line, line) < DIPS]]
    left = np.concatenate([here - 1, here])
    start, size = known.y[left, None], (known.y[left + 1] - known.y[left])[:, None]
    return np.repeat(known.line[left], QUARTERS.size), (start + size * QUARTERS).ravel()


def _dip(known: _Known) -> np.ndarray:
    here = _lowest(known)
    lowest = np.ones(known.line[-1] + 1)
    np.minimum.at(lowest, known.line[here], known.margin[here])
    return lowest


def _gaps(known: _Known, top: float) -> np.ndarray:
    """The widest step between neighbours below the first change of each line."""
    widest = []
    for part in known.below():
        y = known.y[part]
        end = top if known.margin[part.stop - 1] > 0 else y[-1]
        widest.append(np.max(np.diff(np.append(y, end))))
    return np.array(widest)


def _narrowed(known: _Known, at: np.ndarray, look: Look, close: float) -> Crossings:
    over = known.margin <= 0
    line, overturns = known.line[at], ~over[at]
    safe, fallen = np.where(overturns, at, at + 1), np.where(overturns, at + 1, at)
    # The end that survives, the end that does not, and what is known there.
    y = np.stack([known.y[safe], known.y[fallen]])
    margin = np.stack([known.margin[safe], known.margin[fallen]])
    impacts = known.impacts[fallen].copy()
    for _ in range(NARROW):
        wide = np.flatnonzero(np.abs(y[0] - y[1]) > close * np.abs(y).max(axis=0))
        if wide.size == 0:
            break
        share = min(max(SHARE, 2 * LANES // wide.size), WIDTH)
        places = divisions(*y[:, wide], *margin[:, wide], count=share, xp=np)
        # From the surviving end to the other one.
        places = np.sort(places, axis=1)
        places = np.where((y[0] < y[1])[wide, None], places, places[:, ::-1])
        found = look(np.repeat(line[wide], share), places.ravel(), True)
        value = np.nan_to_num(found.margin, nan=1.0).reshape(places.shape)
        hits = found.impacts.reshape(places.shape)
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
