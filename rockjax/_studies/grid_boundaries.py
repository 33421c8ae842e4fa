"""Boundaries of overturning from a rocking spectrum: changes between neighbours of its grid, narrowed down.

These scenes are of the same kind as those of the grid, so nothing new is compiled. Boundaries between two
neighbours of the grid with the same outcome are not found; [`rockjax.overturning_spectrum`][] searches more
closely.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from rockjax._batch.batch import responses
from rockjax._boundaries.crossings import Crossings
from rockjax._excitations.base import AbstractExcitation
from rockjax._options import Options
from rockjax._parameters.variants import pulse_period
from rockjax._responses.datasets import derived_numbers
from rockjax._responses.simulate import REST
from rockjax._results import Interrupted
from rockjax._roots import bisect
from rockjax._structures import Podium

from .spectra import boundary_axis, group_by_structure, stack_podiums

if TYPE_CHECKING:
    import xarray

HALVINGS = 14  # to 6e-5 of the grid's spacing


def with_boundaries(
    spectra: Sequence[xarray.Dataset],
    podiums: Sequence[Podium],
    pulse: Callable[[Any, Any], AbstractExcitation],
    *,
    options: Options,
    progress: Any = False,
) -> list[xarray.Dataset]:
    """Add the variables `minimum` and `boundaries` to rocking spectra, as in an overturning spectrum (host).

    - `spectra`: result of [`rockjax.rocking_spectra`][]
    - `podiums`, `pulse`, `options`: those of the spectra
    - `progress`: `True` for progress bars, or anything with `update(number_of_scenes)`

    A column of the grid that overturns in its lowest row has its first boundary there. Ctrl-C raises
    [`rockjax.Interrupted`][] with the unchanged spectra.
    """
    found: dict[int, xarray.Dataset] = {}
    for members in group_by_structure(podiums).values():
        group = [spectra[k] for k in members]
        overturned = np.stack([data["overturned"].values.T for data in group])  # podium, frequency, amplitude
        y = group[0]["acceleration_ratio"].values
        which, column, row = np.nonzero(np.diff(overturned, axis=2))
        boundaries = np.zeros(0)
        if which.size:
            overturns = _overturns(
                [podiums[k] for k in members], group, pulse, which, column, options, progress
            )
            low_outcome = overturned[which, column, row]
            has_low_outcome = lambda ratio, low_outcome=low_outcome, overturns=overturns: (
                overturns(ratio) == low_outcome
            )
            try:
                low, high = bisect(has_low_outcome, y[row], y[row + 1], HALVINGS)
            except Interrupted:
                raise Interrupted("stopped while boundaries were narrowed down", list(spectra)) from None
            boundaries = 0.5 * (low + high)
        for j, (k, data) in enumerate(zip(members, group, strict=True)):
            of_podium, overturns_first = which == j, np.flatnonzero(overturned[j, :, 0])
            line = np.concatenate([overturns_first, column[of_podium]])
            order = np.argsort(line, kind="stable")
            sorted_boundaries = np.concatenate([np.full(overturns_first.size, y[0]), boundaries[of_podium]])
            found[k] = _add_boundaries(data, line[order], sorted_boundaries[order])
    return [found[k] for k in range(len(podiums))]


def _overturns(
    podiums: Sequence[Podium],
    spectra: Sequence[xarray.Dataset],
    pulse,
    which: np.ndarray,
    column: np.ndarray,
    options: Options,
    progress: Any,
) -> Callable[[np.ndarray], np.ndarray]:
    """Return a function: acceleration ratio of each interval → whether it overturns."""
    derived = [derived_numbers(podium) for podium in podiums]
    unit = np.array([numbers["g_tan_alpha_m_s2"] for numbers in derived])[which]
    p = np.array([numbers["p_rad_s"] for numbers in derived])[which]
    T_p = pulse_period(p, spectra[0]["frequency_ratio"].values[column])
    combined = stack_podiums(podiums, lambda numbers: numbers[which])

    def overturns(ratio: np.ndarray) -> np.ndarray:
        motions = pulse(ratio * unit, T_p)
        peaks = responses(combined, motions, REST, None, options, progress, threading.Event())
        return np.broadcast_to(np.asarray(peaks.overturned), ratio.shape)

    return overturns


def _add_boundaries(data: xarray.Dataset, column: np.ndarray, boundaries: np.ndarray) -> xarray.Dataset:
    zeros = np.zeros(column.size, int)
    table, _ = Crossings(column, boundaries, zeros > 0, zeros).table(data.sizes["frequency_ratio"])
    ratio = {
        "units": "1",
        "long_name": "a_p/(g tan α) where survival changes, between neighbours of the grid",
    }
    least = ratio | {"long_name": "least overturning a_p/(g tan α) that the grid shows"}
    return data.assign(
        minimum=("frequency_ratio", table[:, 0], least),
        boundaries=(("frequency_ratio", "boundary"), table, ratio),
    ).assign_coords(boundary=boundary_axis(table))
