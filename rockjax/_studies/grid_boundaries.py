"""Boundaries of overturning from a rocking spectrum: what changes between neighbours of its grid, narrowed
down.

These scenes are of the same kind as those of the grid, so nothing new is compiled. What lies between two
neighbours of the grid that end alike is not seen; [`rockjax.overturning_spectrum`][] looks closer.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from rockjax._batch.batch import responses
from rockjax._excitations.base import AbstractExcitation
from rockjax._options import Options
from rockjax._parameters.variants import pulse_period
from rockjax._responses.datasets import derived_numbers
from rockjax._responses.simulate import REST
from rockjax._results import Interrupted
from rockjax._structures import Podium

if TYPE_CHECKING:
    import xarray

PARTS = 5  # of an interval, each time …
ROUNDS = 6  # … so many times: 6e-5 of the grid's spacing


def with_boundaries(
    spectra: Sequence[xarray.Dataset],
    podiums: Sequence[Podium],
    pulse: Callable[[Any, Any], AbstractExcitation],
    *,
    options: Options,
    progress: Any = False,
) -> list[xarray.Dataset]:
    """Rocking spectra with the further variables `minimum` and `boundaries`, as in an overturning spectrum
    (host).

    Arguments are those of [`rockjax.rocking_spectra`][], whose answer `spectra` is. A column of the grid that
    overturns in its lowest row has its first boundary there. Ctrl-C raises [`rockjax.Interrupted`][] with the
    spectra as they were.
    """
    kinds: dict[Any, list[int]] = {}
    for k, podium in enumerate(podiums):
        kinds.setdefault(jax.tree.structure(podium), []).append(k)
    found: dict[int, xarray.Dataset] = {}
    for members in kinds.values():
        group = [spectra[k] for k in members]
        overturned = np.stack([data["overturned"].values for data in group])
        y = group[0]["acceleration_ratio"].values
        which, row, column = np.nonzero(overturned[:, 1:] != overturned[:, :-1])
        order = np.lexsort((row, column, which))
        which, row, column = which[order], row[order], column[order]
        places = np.empty(0)
        if which.size:
            below = overturned[which, row, column]
            overturns = _overturns(
                [podiums[k] for k in members], group, pulse, which, column, options, progress
            )
            try:
                places = _narrowed(y[row], y[row + 1], below, overturns)
            except Interrupted:
                raise Interrupted("stopped while boundaries were narrowed down", list(spectra)) from None
        for j, (k, data) in enumerate(zip(members, group, strict=True)):
            mine = which == j
            found[k] = _added(data, column[mine], places[mine], overturned[j, 0], y[0])
    return [found[k] for k in range(len(podiums))]


def _overturns(
    podiums: Sequence[Podium],
    spectra: Sequence[xarray.Dataset],
    pulse,
    which,
    column,
    options: Options,
    progress: Any,
) -> Callable[[np.ndarray], np.ndarray]:
    """A function: acceleration ratios, one row per interval → whether they overturn."""
    derived = [derived_numbers(podium) for podium in podiums]
    unit = np.array([numbers["g_tan_alpha_m_s2"] for numbers in derived])[which, None]
    p = np.array([numbers["p_rad_s"] for numbers in derived])[which]
    T_p = (pulse_period(p, spectra[0]["frequency_ratio"].values[column]))[:, None]
    # One number where it is common to all, as for the grid: the same program.
    pick = lambda *y: y[0] if len(set(map(float, y))) == 1 else np.asarray(y)[which, None]
    together = jax.tree.map(pick, *(podium.split() for podium in podiums))

    def overturns(ratio: np.ndarray) -> np.ndarray:
        peaks = responses(
            together, pulse(ratio * unit, T_p), REST, None, options, progress, threading.Event()
        )
        return np.broadcast_to(np.asarray(peaks.overturned), ratio.shape)

    return overturns


def _narrowed(low: np.ndarray, high: np.ndarray, below: np.ndarray, overturns) -> np.ndarray:
    """The first place in each interval where the verdict is no longer that at its lower end."""
    each = np.arange(low.size)
    for _ in range(ROUNDS):
        places = low[:, None] + (high - low)[:, None] * np.arange(PARTS + 1) / PARTS
        changed = np.ones((low.size, PARTS), bool)
        changed[:, :-1] = overturns(places[:, 1:-1]) != below[:, None]
        first = np.argmax(changed, axis=1)
        low, high = places[each, first], places[each, first + 1]
    return 0.5 * (low + high)


def _added(
    data: xarray.Dataset,
    column: np.ndarray,
    places: np.ndarray,
    overturned_at_once: np.ndarray,
    lowest: float,
):
    at_once = np.flatnonzero(overturned_at_once)
    column = np.concatenate([at_once, column])
    places = np.concatenate([np.full(at_once.size, lowest), places])
    order = np.argsort(column, kind="stable")
    column, places = column[order], places[order]
    count = np.bincount(column, minlength=data.sizes["frequency_ratio"])
    table = np.full((count.size, max(1, int(count.max(initial=0)))), np.nan)
    table[column, np.arange(column.size) - np.searchsorted(column, column)] = places
    ratio = {
        "units": "1",
        "long_name": "a_p/(g tan α) where survival changes, between neighbours of the grid",
    }
    least = ratio | {"long_name": "least overturning a_p/(g tan α) that the grid shows"}
    return data.assign(
        minimum=("frequency_ratio", table[:, 0], least),
        boundaries=(("frequency_ratio", "boundary"), table, ratio),
    ).assign_coords(
        boundary=("boundary", np.arange(1, table.shape[1] + 1), {"long_name": "boundaries from below"})
    )
