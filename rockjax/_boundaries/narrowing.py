"""Changes between survival and overturning, narrowed down, all of them side by side.

A margin that goes through zero smoothly is prolonged through the places known around the change, and the
next ones are put as close beside its zero as polynomials of two orders agree. Where it jumps, brackets are
divided evenly.
"""

from __future__ import annotations

import numpy as np

from .looked import Known, Look

MOST = 64  # divisions of a bracket
BESIDE = 2  # scenes where a polynomial knows the root; one halves a bracket, more where lanes would be idle
CLOSER = 0.05  # of a bracket is left where a polynomial knows the root; else it is divided evenly …
RIGHT = 2  # … until the polynomial has been right so many times in a row: once may be chance
AGREED = 0.25  # of the difference between two orders: how far from its zero a polynomial may be
UNKNOWN = 0.05  # of the bracket, where a straight line is all there is
SPREAD = 3.0  # from one place beside the zero to the next, where there are several


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
    known_of = (y, margin, impacts)
    right = np.full(line.size, RIGHT)  # times in a row
    for _ in range(MOST):
        wide = np.flatnonzero(np.abs(y[:, 2] - y[:, 1]) > close * np.abs(y[:, 1:3]).max(axis=1))
        if wide.size == 0:
            break
        size = np.abs(y[wide, 2] - y[wide, 1])
        root, error = zero(y[wide], margin[wide])
        share, of = lanes // wide.size, right[wide] >= RIGHT
        jumps, curves = wide[~of], wide[of]
        parts = [
            (jumps, _evenly(y[jumps], max(share, 1))),
            (curves, _beside(y[curves], root[of], error[of], close, max(share, BESIDE))),
        ]
        asked = np.concatenate([np.repeat(line[rows], where.shape[1]) for rows, where in parts])
        found = look(asked, np.concatenate([where.ravel() for _, where in parts]), True, False)
        told, start = (found.y, np.nan_to_num(found.margin, nan=1.0), found.impacts), 0
        for rows, where in parts:
            of_rows = slice(start, start + where.size)
            more = [values[of_rows].reshape(where.shape) for values in told]
            _put_between(known_of, rows, more)
            start += where.size
        size_now, middle = np.abs(y[wide, 2] - y[wide, 1]), 0.5 * (y[wide, 1] + y[wide, 2])
        again = np.where(np.abs(root - middle) <= 0.5 * size_now, right[wide] + 1, 0)
        right[wide] = np.where(size_now < CLOSER * size, RIGHT, again)
    return 0.5 * (y[:, 1] + y[:, 2]), impacts[:, 2]


def _put_between(known: tuple[np.ndarray, ...], rows: np.ndarray, more: list[np.ndarray]) -> None:
    """Keep the four places around the change nearest to survival, of those of `rows` and more between the
    middle two."""
    whole = [
        np.concatenate([old[rows, :2], new, old[rows, 2:]], axis=1)
        for old, new in zip(known, more, strict=True)
    ]
    first = 2 + np.argmax(whole[1][:, 2:-1] <= 0, axis=1)
    for old, new in zip(known, whole, strict=True):
        old[rows] = np.take_along_axis(new, first[:, None] + np.arange(-2, 2), axis=1)


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


def _evenly(y: np.ndarray, count: int) -> np.ndarray:
    """`count` places inside each bracket, from the surviving end on."""
    return y[:, 1, None] + (y[:, 2] - y[:, 1])[:, None] * np.arange(1, count + 1) / (count + 1)


def _beside(y: np.ndarray, root: np.ndarray, error: np.ndarray, close: float, count: int) -> np.ndarray:
    """The same, most of them close to the root on both of its sides."""
    start, size = y[:, 1, None], (y[:, 2] - y[:, 1])[:, None]
    near = max(1, 3 * count // 8)
    least = 0.4 * close * np.abs(y[:, 1:3]).max(axis=1)
    apart = np.maximum(error, least)[:, None] * SPREAD ** np.arange(near)
    sides = [(root[:, None] + way * apart - start) / size for way in (-1, 1)]
    parts = np.concatenate([(_evenly(y, count - 2 * near) - start) / size, *sides], axis=1)
    return start + size * np.sort(np.clip(parts, 0.0, 1.0), axis=1)
