"""Fragilities of contents as a table of component fragilities for pelicun, a program for loss assessment."""

from __future__ import annotations

import csv
import itertools
import math
from pathlib import Path
from typing import TYPE_CHECKING

from rockjax._files import write_atomically
from rockjax._motions.intensity import period_of

from .files import si_factor

if TYPE_CHECKING:
    import xarray

HEADINGS = "ID", "Incomplete", "Demand-Type", "Demand-Unit", "Demand-Offset", "Demand-Directional"
LIMIT_STATE = "Family", "Theta_0", "Theta_1"


def write_pelicun(path: str | Path, fragility: xarray.Dataset) -> Path:
    """Write fragilities of contents as a CSV table of component fragilities for pelicun, atomically.

    - `path`: file to write
    - `fragility`: dataset of [`rockjax.contents_fragility`][] for the measure PGA, PGV or Sa(T s)

    Each block of the contents is a component, whose `ID` is the name of the block. Each damage state is a
    limit state `LS1`, `LS2`, … with a lognormal curve: `Theta_0` is the median, in m/s² or m/s, and `Theta_1`
    the dispersion. The demand is the intensity of the ground motion at the location of the component
    (`Demand-Offset` 0) along the direction in which the component rocks (`Demand-Directional` 1). If a limit
    state has no curve, its cells are empty, and the component has `Incomplete` 1.

    Returns the path. Raises `ValueError` for other datasets and other measures.
    """
    owner = "write_pelicun"
    if getattr(fragility, "attrs", {}).get("kind") != "contents-fragility":
        raise ValueError(
            f"{owner}: fragility must come from rockjax.contents_fragility, got {type(fragility).__name__}"
        )
    measure = fragility.attrs["measure"]
    demand, unit = _demand_type(owner, measure), "mps" if measure == "PGV" else "mps2"
    factor = si_factor(owner, measure, fragility["intensity"].attrs["units"])
    curves = fragility[["median_capacity", "dispersion"]].transpose("contents", "damage_state")
    states = range(1, curves.sizes["damage_state"] + 1)
    rows = [[*HEADINGS, *(f"LS{k}-{name}" for k in states for name in LIMIT_STATE)]]
    for name in curves["contents"].values:
        block = curves.sel(contents=name)
        medians = (factor * block["median_capacity"]).values.tolist()
        dispersions = block["dispersion"].values.tolist()
        cells = [_limit_state(*pair) for pair in zip(medians, dispersions, strict=True)]
        incomplete = str(int(any(not cell[0] for cell in cells)))
        rows.append([str(name), incomplete, demand, unit, "0", "1", *itertools.chain(*cells)])

    def write(name: str) -> None:
        with open(name, "w", newline="", encoding="utf-8") as file:
            csv.writer(file, lineterminator="\n").writerows(rows)

    return write_atomically(path, write)


def _limit_state(median: float, dispersion: float) -> tuple[str, str, str]:
    """Return the cells of a limit state; empty cells if the limit state has no curve (a NaN median)."""
    return ("", "", "") if math.isnan(median) else ("lognormal", repr(median), repr(dispersion))


def _demand_type(owner: str, measure: str) -> str:
    """Return pelicun's demand type of an intensity measure."""
    period = period_of(owner, measure)
    if period is not None:
        return f"Spectral Acceleration|{period!r}"
    return {"PGA": "Peak Ground Acceleration", "PGV": "Peak Ground Velocity"}[measure]
