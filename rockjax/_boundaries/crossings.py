"""Changes between survival and overturning along lines of scenes.

A scene is one podium under one motion. A line is a set of scenes with the same x and varying y; for example,
x is the period and y the amplitude of a pulse. Lines are scanned first, and every change is then enclosed in
a narrow bracket. The margin of a scene is positive if the scene survives and negative if it overturns (see
docs/overturning.md). A dip is a minimum of the margin along a line.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.core import Tracer

from rockjax import _results as results
from rockjax._batch.batch import LANES, raw_responses
from rockjax._batch.executors import workers
from rockjax._excitations.base import AbstractExcitation
from rockjax._machine.threads import submit
from rockjax._options import Options
from rockjax._progress import bar
from rockjax._roots import Brackets, narrow_brackets
from rockjax._structures import Podium

from .first import BRACKET_TOLERANCE
from .margin import DEFAULT_WIDTH, has_margin, margin_options, scan_options, signed_margin
from .refinement import (
    SolvedScenes,
    SolveScenes,
    least_dip,
    points_around_dips,
    resolve_windows,
    spacing_for,
    unfinished_range,
    widest_gaps,
)

# A plane of scenes: (x, y) ↦ (podium, excitation). x and y are scalars, arrays that broadcast, or tracers.
Plane = Callable[[Any, Any], tuple[Podium, AbstractExcitation]]

# Intervals with a larger `curvature_indicator` are refined. In theory an indicator below 1 would suffice.
MAX_CURVATURE_INDICATOR = 0.1
REFINEMENT_ROUNDS = 8  # largest number of rounds that refine curved intervals
PARTS = 4  # number of parts into which a round divides a curved interval
MIN_INTERVAL = 1e-6  # intervals shorter than this fraction of the line are not refined

DIP_DIVISIONS = 256  # intervals beside the lowest dips are divided into at least this number of parts
WINDOW_DIVISIONS = 16  # replaces `DIP_DIVISIONS` if only dips that may reach below zero are refined
BRACKET_RTOL_SHARE = 0.1  # a bracket is narrow enough if its width is at most this fraction of rtol·y


class Crossings(NamedTuple):
    """Changes between survival and overturning, sorted by line and y; arrays of one shape."""

    line: np.ndarray  # index of the line
    y: np.ndarray  # position of the change
    overturns: np.ndarray  # True if scenes just above y overturn, False if scenes just below y do
    impacts: np.ndarray  # number of impacts before overturning, on the overturned side

    def table(self, lines: int) -> tuple[np.ndarray, np.ndarray]:
        """Return y and impacts with a row for each of the `lines` lines, shape (lines, largest number of
        changes on a line), padded with NaN and −1."""
        counts = np.bincount(self.line, minlength=lines)
        order = np.arange(self.line.size) - np.searchsorted(self.line, self.line)
        shape = (lines, max(1, int(counts.max())))
        y, impacts = np.full(shape, np.nan), np.full(shape, -1, np.int32)
        y[self.line, order], impacts[self.line, order] = self.y, self.impacts
        return y, impacts

    def first(self, lines: int) -> tuple[np.ndarray, np.ndarray]:
        """Return y and impacts of the first change of each of the `lines` lines, shape (lines,); inf and −1
        for a line without changes."""
        y, impacts = (values[:, 0] for values in self.table(lines))
        return np.where(np.isnan(y), np.inf, y), impacts


def precompile_scan(
    plane: Plane, x, y_range: tuple[float, float], options: Options, width: float = DEFAULT_WIDTH
) -> None:
    """In another thread, load or compile the program for the scenes of a `scan`.

    - `plane`, `x`, `y_range`, `options`, `width`: as for `scan`
    """
    x = np.asarray(x, float)

    def solve() -> None:
        has_distances = _has_edge_distances(plane, x[:1], max(y_range), options)
        y = np.full(1, min(y_range))
        margins(plane, x[:1], y, scan_options(options, width, np), has_distances=has_distances)

    submit(solve)


class Scan(NamedTuple):
    """Result of a scan; its arrays have shape (lines,). A dip is a minimum of the margin as a
    function of y."""

    crossings: Crossings
    lower_end_survives: np.ndarray  # True for lines whose lowest scene (of those that finished) survives
    dip: np.ndarray  # lowest dip below the first change of each line; 1 for a line without dips
    # Largest width in y of an overturning interval below the first change that may have been missed.
    certain_width: np.ndarray
    scenes: int  # number of solved scenes
    finished_to: np.ndarray  # largest y of a finished scene below the first scene that did not finish
    last_unfinished: np.ndarray  # largest y of a scene that did not finish; −inf if all scenes finished


def scan(
    plane: Plane,
    x,
    y_range: tuple[float, float],
    resolution: int,
    options: Options,
    progress: Any = False,
    refine_curved: bool = True,
    first_only: bool = False,
    width: float | None = DEFAULT_WIDTH,
    dips: bool = True,
) -> Scan:
    """Find the changes between survival and overturning along lines x = const.

    - `plane`: (x, y) ↦ (podium, excitation)
    - `x`: positions of the lines, shape (lines,)
    - `y_range`: ends of the lines, the same for all
    - `resolution`: number of equal intervals of each line; the ends of these intervals are evaluated first
    - `options`: options of the scenes on both sides of a change and of scenes with small margins. All other
      scenes are solved less accurately (`scan_options`)
    - `progress`: `True` for a progress bar, or any object with a method `update(number_of_scenes)`
    - `refine_curved`: True to refine intervals in which the margin is so curved that it may cross zero
      unnoticed; ignored with `first_only`
    - `first_only`: True to return only the first change of each line
    - `width`: resolution of the search as a fraction of the range. If the motion is proportional to y, the
      search is designed to find every overturning interval below the first change that is wider than this
      fraction. None omits the search for intervals between the grid points
    - `dips`: True to refine the lowest dips of the margin. If False, only dips in which an overturning
      interval may open are refined, and `Scan.dip` is approximate

    Changes are enclosed in brackets of a relative width of 1e-12 or, if this is larger, of a tenth of
    `options.rtol`. The first change of a line (`first_only`) does not depend on the other lines of the scan,
    not even by rounding, unless the scan misses a window. Raises `RuntimeError` if there is a line on which
    no scene finishes.
    """
    x = np.asarray(x, float)
    batches: list[SolvedScenes] = []  # all solved scenes
    y_range = min(y_range), max(y_range)
    size = y_range[1] - y_range[0]
    coarse = scan_options(options, DEFAULT_WIDTH if width is None else width, np)
    has_distances = width is not None and _has_edge_distances(plane, x[:1], y_range[1], options)

    with bar(None, "scenes", progress, unit_scale=True) as counter:

        def solve(line: np.ndarray, y: np.ndarray, accurate: bool) -> SolvedScenes:
            result = margins(plane, x[line], y, options if accurate else coarse, counter, has_distances)
            batches.append(SolvedScenes(line, y, *result, np.full(line.size, accurate)))
            return batches[-1]

        lines = np.arange(x.size)
        grid = np.linspace(*y_range, resolution + 1)
        solved = solve(np.repeat(lines, grid.size), np.tile(grid, x.size), False)
        if refine_curved and not first_only:
            solved = _refine_curved(solved, solve, MIN_INTERVAL * size)
        spacing = spacing_for(width, size, resolution)
        solved = resolve_windows(solved, solve, spacing, first_only)
        divided = 1
        while divided < (DIP_DIVISIONS if dips else WINDOW_DIVISIONS):
            line, y, parts = points_around_dips(solved, LANES, may_open=not dips)
            if line.size == 0:
                break
            solved, divided = solved.merged_with(solve(line, y, False)), divided * parts
        solved = resolve_windows(solved, solve, spacing, first_only)
        finished = solved.finished()
        if np.unique(finished.line).size < x.size:
            raise RuntimeError("no scene of a line finished; raise options.max_steps or loosen rtol")
        lower_end_survives = finished.margin[np.searchsorted(finished.line, lines)] > 0
        changes = finished.changes(first_only)
        line, overturns = finished.line[changes], finished.margin[changes] > 0
        survivor = np.where(overturns, changes, changes + 1)
        overturned = np.where(overturns, changes + 1, changes)

        def evaluate(rows: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            result = solve(np.repeat(line[rows], y.shape[1]), y.ravel(), True)
            return result.margin.reshape(y.shape), result.impacts.reshape(y.shape)

        y, margin = finished.y, finished.margin
        brackets = Brackets(
            y[survivor], y[overturned], margin[survivor], margin[overturned], finished.impacts[overturned]
        )
        tolerance = max(BRACKET_TOLERANCE, BRACKET_RTOL_SHARE * float(options.rtol))
        brackets = narrow_brackets(brackets, evaluate, tolerance, LANES * min(2, workers()))
        position = 0.5 * (brackets.a + brackets.b)
        if first_only:
            position = _on_grid(position, overturns, tolerance, evaluate)
        crossings = Crossings(line, position, overturns, brackets.output_at_b)
    gaps = widest_gaps(solved, spacing, y_range[1])
    # `solved` has the accurate solutions of scenes that were solved twice.
    final = [solved, *(batch for batch in batches if batch.accurate.all())]
    every = SolvedScenes(*map(np.concatenate, zip(*final, strict=True)))
    ends = unfinished_range(every, x.size, y_range[0])
    count = sum(batch.y.size for batch in batches)
    return Scan(crossings, lower_end_survives, least_dip(finished), gaps, count, *ends)


def margins(
    plane: Plane,
    x: np.ndarray,
    y: np.ndarray,
    options: Options,
    progress: Any = False,
    has_distances: bool = False,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return signed margins (see `signed_margin`), numbers of impacts, and edge distances of scenes, each
    of shape (n,).

    - `plane`: (x, y) ↦ (podium, excitation)
    - `x`, `y`: positions of the scenes, shape (n,)
    - `options`: options of the scenes
    - `progress`: `True` for a progress bar, or any object with a method `update(number_of_scenes)`
    - `has_distances`: True to compute edge distances: the estimated change of y at which the scene could
      overturn (see `_batch/edge_distance.py`); False to return zeros instead

    If a scene does not finish, its margin is NaN and its edge distance 0.
    """
    if x.size == 0:
        return np.zeros(0), np.zeros(0, int), np.zeros(0)
    podiums, motions = plane(x, y)
    uses_margin = has_margin(options, podiums)
    search_options = margin_options(options, uses_margin)
    floats, integers = raw_responses(podiums, motions, search_options, progress, has_distances)
    overturned, impacts, codes = (integers[name] for name in ("overturned", "impacts", "code"))
    edge_distance = np.zeros(x.shape)
    if has_distances:
        # The batch returns a distance in ln y; the factor |y| converts it to a distance in y.
        with np.errstate(invalid="ignore"):
            edge_distance = np.where(
                np.isnan(floats["edge_distance"]), 0.0, floats["edge_distance"]
            ) * np.abs(y)
    value = signed_margin(floats, overturned, float(options.overturn_ratio), uses_margin, np)
    failed = results.did_not_finish(codes)
    value, edge_distance = (
        np.where(failed, np.nan, value),
        np.where(failed, 0.0, np.nan_to_num(edge_distance, posinf=np.inf)),
    )
    # The results are copied to writable arrays, into which results at full accuracy are written later.
    value, impacts, edge_distance = (
        np.array(np.broadcast_to(y, x.shape)) for y in (value, impacts, edge_distance)
    )
    return value, impacts, edge_distance


def _on_grid(
    y: np.ndarray,
    overturns: np.ndarray,
    tolerance: float,
    evaluate: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]],
) -> np.ndarray:
    """Return the positions of changes as centres of intervals of a grid, (n,).

    Narrowed brackets depend on the number of brackets that are narrowed together. The intervals do not,
    because the points of the grid depend on the magnitude of y and on the tolerance only.

    - `y`: positions of the changes, (n,), with a relative error of at most half the tolerance
    - `overturns`: `Crossings.overturns`, (n,); `tolerance`: relative length of the intervals
    - `evaluate`: (indices of changes, y) ↦ (margins, numbers of impacts); the last two have the shape of y
    """
    is_used = np.flatnonzero(y)
    if is_used.size == 0:
        return y
    length = np.exp2(np.floor(np.log2(tolerance * np.abs(y[is_used]))))
    index = np.floor(y[is_used] / length)[:, None] + np.arange(-2, 4)
    margin, _ = evaluate(is_used, index * length[:, None])
    is_above = (margin <= 0) == overturns[is_used, None]  # whether a point has the outcome above the change
    is_above &= ~np.isnan(margin)
    first = np.argmax(is_above, axis=1)
    centre = (index[np.arange(first.size), first] - 0.5) * length
    found = y.copy()
    found[is_used] = np.where(first > 0, centre, y[is_used])  # 0: no change between the points
    return found


def _has_edge_distances(plane: Plane, x: np.ndarray, max_y: float, options: Options) -> bool:
    """Return whether scenes have edge distances. This requires that the overturning margin applies
    (`has_margin`), that the podium is the same for all y, and that the motion is proportional to y."""
    at_max, at_half = plane(x, np.full(1, max_y)), plane(x, np.full(1, 0.5 * max_y))
    if not has_margin(options, at_max[0]):
        return False
    equal_if_scaled = at_max, (at_half[0], at_half[1].scaled(np.full(1, 2.0)))
    leaves, structures = zip(*map(jax.tree.flatten, equal_if_scaled), strict=True)
    if structures[0] != structures[1]:
        return False
    # Under a JAX transformation the number of samples of a record is a tracer. This number does not depend on
    # y and need not be compared.
    pairs = [pair for pair in zip(*leaves, strict=True) if not any(isinstance(y, Tracer) for y in pair)]
    return all(a is b or np.allclose(np.asarray(a), np.asarray(b), rtol=1e-6, atol=0.0) for a, b in pairs)


def curvature_indicator(y: np.ndarray, margin: np.ndarray, same_line: np.ndarray) -> np.ndarray:
    """Return, for each pair of neighbouring scenes, the deviation of the margin from a straight line between
    them, up to a constant factor, divided by the distance of the margin from zero, shape (n−1,).

    - `y`, `margin`: positions and margins, sorted by line and y, shape (n,)
    - `same_line`: True for neighbours that belong to the same line, shape (n−1,)

    The curvature of the margin is estimated from second differences. If the indicator is at most 1, a margin
    with this curvature does not cross zero between neighbours with the same outcome, and crosses zero only
    once between neighbours with different outcomes.
    """
    h = np.where(same_line, y[1:] - y[:-1], 1.0)
    h = np.where(h > 0, h, 1.0)
    slope = np.where(same_line, (margin[1:] - margin[:-1]) / h, 0.0)
    inner = same_line[1:] & same_line[:-1]
    # Half of the second derivative of the margin with respect to y, set to 0 at the ends of a line, where the
    # derivative is unknown.
    half_curvature = np.where(inner, np.abs(slope[1:] - slope[:-1]) / (h[1:] + h[:-1]), 0.0)
    half_curvature = np.maximum(np.append(0.0, half_curvature), np.append(half_curvature, 0.0))
    left, right = margin[:-1], margin[1:]
    changes_sign = (left > 0) != (right > 0)
    distance = np.where(changes_sign, np.abs(left - right), 2 * np.minimum(np.abs(left), np.abs(right)))
    return np.where(same_line & (h > 0), half_curvature * h**2 / np.maximum(distance, 1e-300), 0.0)


def _refine_curved(solved: SolvedScenes, solve: SolveScenes, finest: float) -> SolvedScenes:
    """Solve further scenes in every interval in which the margin may cross zero unnoticed, unless the
    interval is at most `finest` long."""
    fractions = np.arange(1, PARTS) / PARTS
    for _ in range(REFINEMENT_ROUNDS):
        line, y, margin = solved.line, solved.y, np.nan_to_num(solved.margin, nan=1.0)
        doubtful = curvature_indicator(y, margin, line[1:] == line[:-1]) > MAX_CURVATURE_INDICATOR
        left = np.flatnonzero(doubtful & (np.diff(y) > finest))
        if left.size == 0:
            break
        points = (y[left, None] + (y[left + 1] - y[left])[:, None] * fractions).ravel()
        solved = solved.merged_with(solve(np.repeat(line[left], fractions.size), points, False))
    return solved
