"""Crossings of straight lines with the surface of failure, in the space of standard normal vectors u.

Failure is G(u) ≤ 0, with the limit state function G. All lines are evaluated together, in batches. G is
evaluated at positions c along each line. The interval between two neighbouring positions is divided further
if one of them survives and the other fails. A range of c in which a line survives or fails may be missed only
if it lies between two neighbouring positions.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from rockjax._roots import points_near_root

from .limit_state import AbstractLimitState


class Division(NamedTuple):
    """Settings for the division of intervals with a crossing.

    An interval is divided into `parts` equal parts. It is also divided at two positions around the root of
    its secant, the straight line through the values of G at both ends.

    - `rounds`: largest number of successive divisions
    - `parts`: number of equal parts of a division
    - `root_offset`: distance of the two positions from the root, divided by the length of the interval [–]
    - `min_share`: intervals narrower than this share of the narrowest initial interval with a crossing are
      not divided again [–]
    """

    rounds: int = 3
    parts: int = 8
    root_offset: float = 1e-3
    min_share: float = 0.0


class LineCrossings(NamedTuple):
    """The k crossings of m lines with the surface of failure, in ascending order along each line.

    - `line`: index of the line, shape (k,)
    - `position`: position c of the crossing on the line, slightly on the failing side, shape (k,)
    - `survivor`: the nearest evaluated position on the surviving side, shape (k,)
    - `G`: value of G at `position`, shape (k,)
    - `enters`: True if the line enters failure with ascending c, False if it leaves failure, shape (k,)
    - `fails_first`: whether each line fails at its first position, shape (m,)
    """

    line: np.ndarray
    position: np.ndarray
    survivor: np.ndarray
    G: np.ndarray
    enters: np.ndarray
    fails_first: np.ndarray


class _Intervals(NamedTuple):
    """The k intervals between positions `a` < `b` on lines. `G_a` and `G_b` are the values of G at the ends.

    All fields have the shape (k,).
    """

    line: np.ndarray
    a: np.ndarray
    b: np.ndarray
    G_a: np.ndarray
    G_b: np.ndarray

    def with_crossing(self) -> _Intervals:
        """Return the intervals with one surviving and one failing end."""
        return self.select((self.G_a <= 0) != (self.G_b <= 0))

    def select(self, rows: np.ndarray) -> _Intervals:
        """Return the intervals with the indices `rows`, or those for which the mask `rows` is True."""
        return _Intervals(*(y[rows] for y in self))

    def inner_points(self, division: Division) -> np.ndarray:
        """Return the positions at which the intervals are divided, shape (k, positions)."""
        fraction = points_near_root(self.G_a, self.G_b, division.parts - 1, division.root_offset)
        return self.a[:, None] + (self.b - self.a)[:, None] * fraction


def find_crossings(
    limit: AbstractLimitState,
    origin: np.ndarray,
    direction: np.ndarray,
    positions: Sequence[np.ndarray],
) -> LineCrossings:
    """Return the crossings of the lines origin + c·direction, shape (m, d) each, with the surface of failure.
    For each line, `positions` contains an array of the values of c at which the line is evaluated,
    ascending."""
    sizes = np.array([len(c) for c in positions])
    line, c = np.repeat(np.arange(len(positions)), sizes), np.concatenate([*positions, np.zeros(0)])
    value = limit.values(origin[line] + c[:, None] * direction[line])
    fails_first = value[np.cumsum(sizes) - sizes] <= 0
    return LineCrossings(*narrow_crossings(limit, origin, direction, line, c, value), fails_first)


def narrow_crossings(
    limit: AbstractLimitState,
    origin: np.ndarray,
    direction: np.ndarray,
    line: np.ndarray,
    c: np.ndarray,
    value: np.ndarray,
    division: Division = Division(),
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Find the crossings between positions at which G has been evaluated, and narrow them down. Returns
    `line`, `position`, `survivor`, `G` and `enters` as in `LineCrossings`.

    - `origin`, `direction`: origin and direction of each line, shape (m, d) each
    - `line`, `c`, `value`: index of the line of each position, position and value of G there; in ascending
      order along each line, shape (k,) each
    """
    is_same_line = line[1:] == line[:-1]
    neighbours = _Intervals(line[:-1], c[:-1], c[1:], value[:-1], value[1:])
    intervals = neighbours.select(is_same_line).with_crossing()
    min_width = division.min_share * (intervals.b - intervals.a).min(initial=1e300)
    finished = [intervals.select(np.zeros(intervals.line.size, bool))]
    for _ in range(division.rounds):
        if intervals.line.size == 0:
            break
        inside = intervals.inner_points(division)
        row_lines = np.repeat(intervals.line, inside.shape[1])
        inner_values = limit.values(origin[row_lines] + inside.reshape(-1, 1) * direction[row_lines]).reshape(
            inside.shape
        )
        position = np.concatenate([intervals.a[:, None], inside, intervals.b[:, None]], axis=1)
        values = np.concatenate([intervals.G_a[:, None], inner_values, intervals.G_b[:, None]], axis=1)
        row_lines = np.repeat(intervals.line, inside.shape[1] + 1)
        ends = (position[:, :-1], position[:, 1:], values[:, :-1], values[:, 1:])
        intervals = _Intervals(row_lines, *(y.ravel() for y in ends)).with_crossing()
        is_wide = intervals.b - intervals.a > min_width
        finished.append(intervals.select(~is_wide))
        intervals = intervals.select(is_wide)
    intervals = _Intervals(*(np.concatenate(ys) for ys in zip(*finished, intervals, strict=True)))
    intervals = intervals.select(np.lexsort((intervals.a, intervals.line)))
    enters = intervals.G_b <= 0
    position, survivor = (
        np.where(enters, intervals.b, intervals.a),
        np.where(enters, intervals.a, intervals.b),
    )
    return intervals.line, position, survivor, np.where(enters, intervals.G_b, intervals.G_a), enters
