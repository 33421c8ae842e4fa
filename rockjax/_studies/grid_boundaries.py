"""Overturning boundaries of a rocking spectrum, by bisection between grid points with different outcomes.

The outcome of a grid point is survival or overturning. Grid points whose scenes did not finish have no
outcome and are left out. Scenes of the bisection that do not finish count as survivals, and cause a
`RuntimeWarning`. The bisection runs the programs that are compiled for the grid. It misses boundaries between
two neighbouring grid points with the same outcome; the search of [`rockjax.overturning_spectrum`][] is not
bound to a grid.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from rockjax._batch.batch import responses, warn_of_failures
from rockjax._boundaries.crossings import Crossings
from rockjax._excitations.base import AbstractExcitation
from rockjax._options import Options
from rockjax._parameters.registry import as_variable
from rockjax._parameters.variants import pulse_period
from rockjax._responses.datasets import derived_numbers
from rockjax._responses.simulate import REST
from rockjax._results import Interrupted, outcomes
from rockjax._roots import bisect
from rockjax._structures import Podium

from .spectra import boundary_axis, group_by_structure, stack_podiums

if TYPE_CHECKING:
    import xarray

HALVINGS = 14  # number of bisections, which narrow a grid interval to 6e-5 of its length


def with_boundaries(
    spectra: Sequence[xarray.Dataset],
    podiums: Sequence[Podium],
    pulse: Callable[[Any, Any], AbstractExcitation],
    *,
    options: Options,
    progress: Any = False,
) -> list[xarray.Dataset]:
    """Return rocking spectra with the variables `minimum` and `boundaries` of overturning spectra added.

    - `spectra`: result of [`rockjax.rocking_spectra`][]
    - `podiums`, `pulse`, `options`: arguments with which `spectra` were computed
    - `progress`: `True` for progress bars, or any object with a method `update(number_of_scenes)`

    If the lowest acceleration whose scene finished already overturns the columns, it is the first boundary.
    Ctrl-C raises [`rockjax.Interrupted`][]; its `partial` is the list of the unchanged spectra.
    """
    with_boundary: dict[int, xarray.Dataset] = {}
    for members in group_by_structure(podiums).values():
        group = [spectra[k] for k in members]
        # The axes are podium, frequency and acceleration.
        outcome = np.stack([outcomes(data).values.T for data in group])
        ratios = group[0]["acceleration_ratio"].values
        finished = np.nonzero(np.isfinite(outcome))
        overturned, finished_ratio = outcome[finished] == 1, ratios[finished[2]]
        is_lowest = np.diff(finished[0] * outcome.shape[1] + finished[1], prepend=-1) > 0
        overturned_from_start = np.flatnonzero(is_lowest & overturned)
        above = np.flatnonzero(~is_lowest & np.diff(overturned, prepend=False))  # grid points above a change
        podium_index, column = finished[0][above], finished[1][above]
        boundaries = np.zeros(0)
        if above.size:
            overturns = _outcome_function(
                [podiums[k] for k in members], group, pulse, podium_index, column, options, progress
            )
            low_outcome = overturned[above - 1]
            has_low_outcome = lambda ratio, low_outcome=low_outcome, overturns=overturns: (
                overturns(ratio) == low_outcome
            )
            try:
                low, high = bisect(
                    has_low_outcome, finished_ratio[above - 1], finished_ratio[above], HALVINGS
                )
            except Interrupted:
                raise Interrupted("stopped while boundaries were narrowed down", list(spectra)) from None
            boundaries = 0.5 * (low + high)
        for j, (k, data) in enumerate(zip(members, group, strict=True)):
            is_own, start = podium_index == j, overturned_from_start[finished[0][overturned_from_start] == j]
            columns = np.concatenate([finished[1][start], column[is_own]])
            values = np.concatenate([finished_ratio[start], boundaries[is_own]])
            order = np.argsort(columns, kind="stable")
            with_boundary[k] = _add_boundaries(data, columns[order], values[order])
    return [with_boundary[k] for k in range(len(podiums))]


def _outcome_function(
    podiums: Sequence[Podium],
    spectra: Sequence[xarray.Dataset],
    pulse,
    podium_index: np.ndarray,
    column: np.ndarray,
    options: Options,
    progress: Any,
) -> Callable[[np.ndarray], np.ndarray]:
    """Return a function that solves one scene in each of n grid intervals. Its argument is the acceleration
    ratio of each scene, and its result is True for the scenes that overturn, both of shape (n,).

    - `podiums`, `spectra`: podiums whose pytrees have the same structure, and the spectra of these podiums
    - `pulse`, `options`, `progress`: as for `with_boundaries`
    - `podium_index`, `column`: indices of the podium and of the frequency of each interval, shape (n,)
    """
    derived = [derived_numbers(podium) for podium in podiums]
    g_tan_alpha = np.array([constants["g_tan_alpha_m_s2"] for constants in derived])[podium_index]
    p = np.array([constants["p_rad_s"] for constants in derived])[podium_index]
    T_p = pulse_period(p, spectra[0]["frequency_ratio"].values[column])
    combined = stack_podiums(podiums, lambda values: values[podium_index])

    def overturns(ratio: np.ndarray) -> np.ndarray:
        motions = pulse(ratio * g_tan_alpha, T_p)
        peaks = responses(combined, motions, REST, None, options, progress, threading.Event())
        warn_of_failures(peaks, stacklevel=2)
        return np.broadcast_to(np.asarray(peaks.overturned), ratio.shape)

    return overturns


def _add_boundaries(data: xarray.Dataset, column: np.ndarray, boundaries: np.ndarray) -> xarray.Dataset:
    """Return a spectrum with its boundaries added. The arguments `column` (index of the frequency) and
    `boundaries` are ordered by frequency and then by acceleration."""
    zeros = np.zeros(column.size, int)
    table, _ = Crossings(column, boundaries, zeros > 0, zeros).table(data.sizes["frequency_ratio"])
    least = "least overturning a_p/(g tan α), bisected between grid points"
    changes = "a_p/(g tan α) at changes of the outcome between neighbouring grid points"
    return data.assign(
        minimum=as_variable("frequency_ratio", table[:, 0], "1", least),
        boundaries=as_variable(("frequency_ratio", "boundary"), table, "1", changes),
    ).assign_coords(boundary=boundary_axis(table))
