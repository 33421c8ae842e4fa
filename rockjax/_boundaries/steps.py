"""How close to each other scales have to be looked at, so that no window of overturning lies unseen between
two of them.

Two neighbours that both survive may be as far apart as a share `TRUST` of their reaches (how far the motion
of each goes on as it is, see `rockjax._batch.reach`): a window between them would have to open and close
against the derivatives of all turning points of both. Some windows are a few widths wide and have nothing
beside them that tells: so neighbours are `FARTHEST` apart at most. Where reaches are short, and where
nothing is known of them, places are as close as the width that is asked for. It is an estimate, not a
proof; `benchmarks/boundaries.py` tries every scale.

Places are whole numbers of spacings, so that steps divided again and again end at one spacing each, not at
parts of it.
"""

from __future__ import annotations

import math

import numpy as np

from .looked import Known, Look

SPACING = 0.95  # of the width asked for: a tolerance may move the ends of a window
TRUST = 0.25  # of the reaches of two neighbours
FARTHEST = 6  # spacings that neighbours are apart at most
PARTS = 16  # of an interval at once
ROUND = 2048  # scenes of all lines that go up side by side …
LEAST = 64  # … of one line at least
GRAZING = 1e-3  # a margin as low as this is worked out at the full accuracy


def spacing_for(width: float | None, size: float, resolution: int) -> float:
    """From one place to the next, so that no window of a share `width` of a range of that size lies between:
    a whole part of its `resolution` steps. inf without a width."""
    if width is None:
        return np.inf
    return size / resolution / math.ceil(1 / (resolution * SPACING * width))


def certain(known: Known, look: Look, spacing: float, first_only: bool) -> Known:
    """Until below the first change of each line no window of two spacings' width can be unseen, and the
    changes stand at the full accuracy."""
    while True:
        line, y, wanted = _missing(known, spacing)
        if line.size:
            known = known.and_also(look(line, y, False, wanted))
            continue
        at = _unsure(known, first_only)
        if at.size == 0:
            return known
        again = look(known.line[at], known.y[at], True, False)
        reach = np.where(known.margin[at] > 0, known.reach[at], again.reach)
        for old, new in zip(known, again._replace(reach=reach), strict=True):
            old[at] = new


def gaps(known: Known, spacing: float, top: float) -> np.ndarray:
    """The widest interval below the first change of each line that may overturn unseen."""
    widest = []
    for part in known.below():
        y, answered = known.y[part], ~np.isnan(known.margin[part])
        seen = np.diff(y) <= _allowed(known, part, spacing) * (1 + 1e-9)
        # What a step may hide: little where its ends say so, else anything up to its length.
        hides = np.where(seen, np.minimum(np.diff(y), spacing), np.diff(y))
        at = np.flatnonzero(answered)
        through = np.flatnonzero(np.diff(at) > 1)
        blind = np.diff(y[at])[through]
        kept = hides[answered[1:] & answered[:-1]]
        end = top - y[at[-1]] if known.margin[part][at[-1]] > 0 else 0.0
        widest.append(np.max(np.concatenate([[end], kept, blind])))
    return np.array(widest)


def _allowed(known: Known, part: slice, spacing: float) -> np.ndarray:
    """How long each step between neighbours may be: whole spacings."""
    reach = np.where(known.margin[part] > 0, known.reach[part], 0.0)
    return spacing * np.clip(np.floor(TRUST * (reach[1:] + reach[:-1]) / spacing), 1, FARTHEST)


def _missing(known: Known, spacing: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The next places of each line that are to be looked at, from below, and where their reaches will be
    needed: next to steps of more than one spacing."""
    lines, places, wanted = [np.zeros(0, int)], [np.zeros(0)], [np.zeros(0, bool)]
    if not np.isfinite(spacing):
        return lines[0], places[0], wanted[0]
    wide = []
    for part in known.below():
        step = np.diff(known.y[part])
        allowed = _allowed(known, part, spacing)
        at = np.flatnonzero(step > allowed * (1 + 1e-9))
        if at.size:
            parts = np.ceil(step[at] / allowed[at] * (1 - 1e-9)).astype(int)
            wide.append((part, at, np.clip(parts, 2, PARTS)))
    share = max(LEAST, ROUND // max(1, len(wide)))
    for part, at, parts in wide:
        y = known.y[part]
        # From below, for the first change may come to lie lower.
        at = at[: 1 + np.searchsorted(np.cumsum(parts - 1), share)]
        found, step = _between(y[at], y[at + 1], parts[: at.size], spacing)
        whole = np.bincount(step, minlength=at.size) + 1 >= np.round((y[at + 1] - y[at]) / spacing)
        places.append(found)
        lines.append(np.full(found.size, known.line[part.start]))
        wanted.append(~whole[step])
    return np.concatenate(lines), np.concatenate(places), np.concatenate(wanted)


def _between(
    low: np.ndarray, high: np.ndarray, parts: np.ndarray, spacing: float
) -> tuple[np.ndarray, np.ndarray]:
    """Whole numbers of spacings that divide steps of more than one spacing into so many parts each, about;
    and in which of the steps they lie."""
    step = np.repeat(np.arange(parts.size), parts - 1)
    first = np.cumsum(parts - 1) - (parts - 1)
    part = (np.arange(step.size) - first[step] + 1) / parts[step]
    whole = np.round((low[step] + (high - low)[step] * part) / spacing)
    new = np.append(True, (np.diff(whole) != 0) | (np.diff(step) != 0))[: step.size]
    return spacing * whole[new], step[new]


def _unsure(known: Known, first_only: bool) -> np.ndarray:
    """What a change or a low dip rests on, and is known at the looser accuracy only."""
    changes = known.first_changes() if first_only else known.changes()
    at = np.union1d(changes, changes + 1)
    low = [part.start + np.flatnonzero(known.margin[part] < GRAZING) for part in known.below()]
    at = np.union1d(at, np.concatenate(low)).astype(int)
    return at[~known.sharp[at]]
