"""Crossings of straight lines through standard normal space with the surface of failure; all lines are one
batch.

Each line is evaluated at its own places. Intervals whose ends differ between survival and failure are divided
further, so windows of survival wider than the distance of two places are found.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from rockjax._roots import points_near_root

from .limit_state import AbstractLimitState


class Division(NamedTuple):
    """Division of intervals with a crossing.

    At most `rounds` times, an interval is divided at `parts` even places and at distance `close` on both
    sides of the root of the straight line [share of the interval], until it is smaller than `enough` times
    the narrowest.
    """

    rounds: int = 3
    parts: int = 8
    close: float = 1e-3
    enough: float = 0.0


class Crossings(NamedTuple):
    """Crossings of lines with the surface of failure, along each line in ascending order.

    - `line`: index of the line, (k,); `place`: c on it, on the failing side, (k,); `G`: there, (k,)
    - `other`: the nearest evaluated place on the surviving side, (k,)
    - `enters`: whether failure begins there, (k,)
    - `fails_first`, `fails_last`: whether the lines fail at their first and last place, (m,)
    """

    line: np.ndarray
    place: np.ndarray
    other: np.ndarray
    G: np.ndarray
    enters: np.ndarray
    fails_first: np.ndarray
    fails_last: np.ndarray


class _Intervals(NamedTuple):
    """Intervals (k,) between places `a` < `b` of lines, with G at both."""

    line: np.ndarray
    a: np.ndarray
    b: np.ndarray
    at_a: np.ndarray
    at_b: np.ndarray

    def changing(self) -> _Intervals:
        """Return the intervals whose ends differ between survival and failure."""
        rows = (self.at_a <= 0) != (self.at_b <= 0)
        return self.chosen(rows)

    def chosen(self, rows: np.ndarray) -> _Intervals:
        return _Intervals(*(y[rows] for y in self))

    def divided(self, how: Division) -> np.ndarray:
        """Return places inside, (k, places): even ones for certainty, two around the root of the straight
        line."""
        part = points_near_root(self.at_a, self.at_b, how.parts - 1, how.close)
        return self.a[:, None] + (self.b - self.a)[:, None] * part


def crossings(
    limit: AbstractLimitState,
    origin: np.ndarray,
    direction: np.ndarray,
    places: Sequence[np.ndarray],
    how: Division = Division(),
) -> Crossings:
    """Return the crossings of the lines origin + c·direction with the surface of failure.

    - `limit`: limit state
    - `origin`, `direction`: of each line, (m, d)
    - `places`: values of c at which each line is evaluated, ascending, one array per line
    - `how`: division of the intervals with a crossing
    """
    sizes = np.array([len(c) for c in places])
    line, c = np.repeat(np.arange(len(places)), sizes), np.concatenate([*places, np.zeros(0)])
    value = limit.values(origin[line] + c[:, None] * direction[line])
    ends = np.cumsum(sizes)
    first, last = value[ends - sizes] <= 0, value[ends - 1] <= 0
    return Crossings(*narrow_crossings(limit, origin, direction, line, c, value, how), first, last)


def narrow_crossings(
    limit: AbstractLimitState,
    origin: np.ndarray,
    direction: np.ndarray,
    line: np.ndarray,
    c: np.ndarray,
    value: np.ndarray,
    how: Division = Division(),
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Narrow down the crossings between places at which G is known.

    - `limit`: limit state
    - `origin`, `direction`: of each line, (m, d)
    - `line`: index of the line of each place, ascending, (k,); `c`: the place, ascending on each line, (k,)
    - `value`: G at the places, (k,)
    - `how`: division of the intervals with a crossing

    Returns `line`, `place`, `other`, `G` and `enters` as in `Crossings`.
    """
    same = line[1:] == line[:-1]
    parts = (line[:-1], c[:-1], c[1:], value[:-1], value[1:])
    now = _Intervals(*(y[same] for y in parts)).changing()
    narrow = how.enough * (now.b - now.a).min(initial=1e300)
    done = [now.chosen(np.zeros(now.line.size, bool))]
    for _ in range(how.rounds):
        if now.line.size == 0:
            break
        inside = now.divided(how)
        of = np.repeat(now.line, inside.shape[1])
        found = limit.values(origin[of] + inside.reshape(-1, 1) * direction[of]).reshape(inside.shape)
        place = np.concatenate([now.a[:, None], inside, now.b[:, None]], axis=1)
        known = np.concatenate([now.at_a[:, None], found, now.at_b[:, None]], axis=1)
        of = np.repeat(now.line, inside.shape[1] + 1)
        ends = (place[:, :-1], place[:, 1:], known[:, :-1], known[:, 1:])
        now = _Intervals(of, *(y.ravel() for y in ends)).changing()
        wide = now.b - now.a > narrow
        done.append(now.chosen(~wide))
        now = now.chosen(wide)
    now = _Intervals(*(np.concatenate(ys) for ys in zip(*done, now, strict=True)))
    now = now.chosen(np.lexsort((now.a, now.line)))
    enters = now.at_b <= 0
    place, other = np.where(enters, now.b, now.a), np.where(enters, now.a, now.b)
    return now.line, place, other, np.where(enters, now.at_b, now.at_a), enters
