"""Changes between survival and overturning, narrowed down, all of them side by side.

A margin that goes through zero smoothly is prolonged through the places known around the change, and the
next ones are put as close beside its zero as polynomials of two orders agree. Where it jumps, brackets are
divided evenly.
"""

from __future__ import annotations

import numpy as np

from .first import WIDTH
from .looked import Known, Look

MOST = 24  # divisions of a bracket
SHARE = 3  # scenes to divide one, more where lanes would be idle: few of them tell the most each
CLOSER = 0.05  # of a bracket is left where a polynomial knows the root; else it is divided evenly
AGREED = 0.25  # of the difference between two orders: how far from its zero a polynomial may be
UNKNOWN = 0.05  # of the bracket, where a straight line is all there is
SPREAD = 4.0  # from one place beside the zero to the next, where there are several


def narrowed(
    known: Known, at: np.ndarray, look: Look, close: float, lanes: int
) -> tuple[np.ndarray, np.ndarray]:
    """(y, impacts) of the changes between the places `at` and the next ones, to a relative width of `close`.

    `lanes`: so many scenes at once cost what one does. Impacts are those on the overturned side.
    """
    line, overturns = known.line[at], known.margin[at] > 0
    # Two places before the change and two behind it, from the surviving side on.
    places = at[:, None] + np.where(overturns[:, None], np.arange(-1, 3), np.arange(2, -2, -1))
    inside = np.clip(places, 0, known.line.size - 1)
    y, impacts = known.y[inside], known.impacts[inside]
    margin = np.where(
        (inside == places) & (known.line[inside] == line[:, None]), known.margin[inside], np.nan
    )
    smooth = np.ones(line.size, bool)
    for _ in range(MOST):
        wide = np.flatnonzero(np.abs(y[:, 2] - y[:, 1]) > close * np.abs(y[:, 1:3]).max(axis=1))
        if wide.size == 0:
            break
        share = min(max(SHARE, lanes // wide.size), WIDTH)
        root, error = zero(y[wide], margin[wide])
        where = _places(y[wide], root, np.where(smooth[wide], error, np.nan), close, share)
        found = look(np.repeat(line[wide], share), where.ravel(), True)
        more = (
            part.reshape(where.shape) for part in (where, np.nan_to_num(found.margin, nan=1.0), found.impacts)
        )
        rows = [
            np.concatenate([old[wide, :2], new, old[wide, 2:]], axis=1)
            for old, new in zip((y, margin, impacts), more, strict=True)
        ]
        first = 2 + np.argmax(rows[1][:, 2:-1] <= 0, axis=1)
        chosen = first[:, None] + np.arange(-2, 2)
        size = np.abs(y[wide, 2] - y[wide, 1])
        for old, new in zip((y, margin, impacts), rows, strict=True):
            old[wide] = np.take_along_axis(new, chosen, axis=1)
        size_now, middle = np.abs(y[wide, 2] - y[wide, 1]), 0.5 * (y[wide, 1] + y[wide, 2])
        smooth[wide] = (np.abs(root - middle) <= 0.5 * size_now) | (size_now < CLOSER * size)
    return 0.5 * (y[:, 1] + y[:, 2]), impacts[:, 2]


def zero(y: np.ndarray, margin: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where the margin through rows of four places vanishes between the middle two, and how far from there it
    may be.

    By inverse interpolation of the highest order that the places allow: margins that are known (not NaN) and
    fall all the way.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        straight = _through(y[:, 1:3], margin[:, 1:3])
        left, right = _through(y[:, :3], margin[:, :3]), _through(y[:, 1:], margin[:, 1:])
        all_four = _through(y, margin)
    low, high = np.minimum(y[:, 1], y[:, 2]), np.maximum(y[:, 1], y[:, 2])
    root, error = straight, UNKNOWN * (high - low)
    root = np.where(np.isfinite(root), root, 0.5 * (low + high))
    for better in (left, right, all_four):
        usable = (better >= low) & (better <= high)
        error = np.where(usable, AGREED * np.abs(better - root), error)
        root = np.where(usable, better, root)
    return root, error


def _through(y: np.ndarray, margin: np.ndarray) -> np.ndarray:
    """The polynomial y(margin) through all places of a row, at 0 (Neville's scheme); NaN where margins do not
    fall."""
    found = y
    for order in range(1, y.shape[1]):
        a, b = margin[:, :-order], margin[:, order:]
        found = (b * found[:, :-1] - a * found[:, 1:]) / (b - a)
    return np.where(np.all(np.diff(margin, axis=1) < 0, axis=1), found[:, 0], np.nan)


def _places(y: np.ndarray, root: np.ndarray, error: np.ndarray, close: float, count: int) -> np.ndarray:
    """`count` places inside each bracket, from the surviving end on: beside the root, the others evenly; all
    evenly where the error is NaN."""
    start, size = y[:, 1, None], (y[:, 2] - y[:, 1])[:, None]
    near = 3 * count // 8
    spaced = count - 2 * near
    least = 0.4 * close * np.abs(y[:, 1:3]).max(axis=1)
    beside = np.maximum(error, least)[:, None] * SPREAD ** np.arange(near)
    part = lambda n: np.broadcast_to(np.arange(1, n + 1) / (n + 1), (y.shape[0], n))
    mixed = np.concatenate(
        [part(spaced), *((root[:, None] + way * beside - start) / size for way in (-1, 1))], axis=1
    )
    parts = np.where(np.isnan(error)[:, None], part(count), mixed)
    return start + size * np.sort(np.clip(parts, 0.0, 1.0), axis=1)
