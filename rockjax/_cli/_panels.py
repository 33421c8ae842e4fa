"""Panels of many podiums: combined datasets and their summary."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ._run import Report

if TYPE_CHECKING:
    import xarray


def make_pulse(name: str, vertical_ratio: float | None) -> Any:
    """Return the function (a_p, T_p) → motion of a pulse by name."""
    from rockjax._excitations.ground import GroundMotion
    from rockjax._excitations.pulses import PULSES

    kind = PULSES[name]
    return kind if vertical_ratio is None else GroundMotion.in_proportion(kind, vertical_ratio)


def combine_panels(datasets: list, ratios: list[float], periods: list[float], zeta: float) -> xarray.Dataset:
    """Return the datasets of panels combined, with the dims `eta_over_gamma` and `T_s`.

    - `datasets`: of the panels, η/γ outermost
    - `ratios`: mass ratios η/γ [–]; `periods`: T_s, 0 for rigid [s]; `zeta`: damping ratio [–]
    """
    import numpy as np
    import xarray

    remaining = iter(datasets)
    # Panels may differ in the number of boundaries.
    join = {
        "combine_attrs": "drop_conflicts",
        "join": "outer",
        "fill_value": {"impacts": -1, "boundaries": np.nan},
        "coords": "different",
        "compat": "equals",
        "data_vars": "all",
    }
    rows = [
        xarray.concat(
            [next(remaining).assign_coords(T_s=period, eta_over_gamma=ratio) for period in periods],
            "T_s",
            **join,
        )
        for ratio in ratios
    ]
    panels = xarray.concat(rows, "eta_over_gamma", **join)
    panels.attrs["zeta"] = zeta
    panels["T_s"].attrs = {
        "units": "s",
        "long_name": "superstructure period T_s, the longest of several, 0 is rigid",
    }
    panels["eta_over_gamma"].attrs = {"units": "1", "long_name": "mass ratio η/γ"}
    return panels


def report_minima(
    report: Report,
    lowest: xarray.DataArray,
    ratios: list[float],
    periods: list[float],
    where: str,
    digits: str,
) -> None:
    """Report the least overturning acceleration of each panel.

    - `report`: receives the lines; `lowest`: least a_p/(g tan α) over `eta_over_gamma` and `T_s`
    - `ratios`: mass ratios η/γ [–]; `periods`: T_s [s]
    - `where`: words after the name of the quantity; `digits`: format of the numbers
    """
    values = lowest.transpose("eta_over_gamma", "T_s").values
    for ratio, row in zip(ratios, values, strict=True):
        line = ", ".join(f"T_s = {T:g} s: {value:{digits}}" for T, value in zip(periods, row, strict=True))
        report.say(f"least overturning a_p/(g tan α){where}, η/γ = {ratio:g}: {line}")
    report.facts["least_overturning"] = [
        {"eta_over_gamma": ratio, "T_s": T, "acceleration_ratio": value}
        for ratio, row in zip(ratios, values.tolist(), strict=True)
        for T, value in zip(periods, row, strict=True)
    ]
