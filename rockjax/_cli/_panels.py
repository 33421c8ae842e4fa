"""Spectra of several podiums, one for each combination of mass ratio η/γ and period T_s."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ._run import Console

if TYPE_CHECKING:
    import xarray


def make_pulse(name: str, vertical_ratio: float | None) -> Any:
    """Return the function (a_p [m/s²], T_p [s]) ↦ ground motion for one kind of pulse.

    - `name`: name of the kind, such as "ricker"
    - `vertical_ratio`: vertical divided by horizontal acceleration [–]; None for no vertical motion
    """
    from rockjax._excitations.ground import GroundMotion
    from rockjax._excitations.pulses import PULSES

    pulse = PULSES[name]
    return pulse if vertical_ratio is None else GroundMotion.in_proportion(pulse, vertical_ratio)


def combine_panels(datasets: list, ratios: list[float], periods: list[float], zeta: float) -> xarray.Dataset:
    """Return the spectra of all panels as one dataset with two more dims, `eta_over_gamma` and `T_s`.

    - `datasets`: the spectra in the order of `Panels`: all periods of the first mass ratio, then all periods
      of the second, …
    - `ratios`: mass ratios η/γ [–]
    - `periods`: periods T_s [s]; 0 for a rigid superstructure
    - `zeta`: damping ratio [–]
    """
    import numpy as np
    import xarray

    next_spectra = iter(datasets)
    # The number of overturning boundaries differs between the spectra. `fill_value` pads the shorter ones.
    concat_options = {
        "combine_attrs": "drop_conflicts",
        "join": "outer",
        "fill_value": {"impacts": -1, "boundaries": np.nan},
        "coords": "different",
        "compat": "equals",
        "data_vars": "all",
    }
    rows = [
        xarray.concat(
            [next(next_spectra).assign_coords(T_s=period, eta_over_gamma=ratio) for period in periods],
            "T_s",
            **concat_options,
        )
        for ratio in ratios
    ]
    panels = xarray.concat(rows, "eta_over_gamma", **concat_options)
    panels.attrs["zeta"] = zeta
    panels["T_s"].attrs = {
        "units": "s",
        "long_name": "longest period T_s of the superstructure, 0 is rigid",
    }
    panels["eta_over_gamma"].attrs = {"units": "1", "long_name": "mass ratio η/γ"}
    return panels


def report_minima(
    console: Console,
    lowest: xarray.DataArray,
    ratios: list[float],
    periods: list[float],
) -> None:
    """Print the least overturning acceleration of each podium, and add it to the JSON object.

    - `console`: prints the lines
    - `lowest`: least a_p/(g tan α) that overturns the columns [–], with dims `eta_over_gamma` and `T_s`
    - `ratios`: mass ratios η/γ [–]
    - `periods`: periods T_s [s]; 0 for a rigid superstructure
    """
    values = lowest.transpose("eta_over_gamma", "T_s").values
    for ratio, row in zip(ratios, values, strict=True):
        line = ", ".join(f"T_s = {T:g} s: {value:.4f}" for T, value in zip(periods, row, strict=True))
        console.say(f"least overturning a_p/(g tan α), η/γ = {ratio:g}: {line}")
    console.json_object["least_overturning"] = [
        {"eta_over_gamma": ratio, "T_s": T, "acceleration_ratio": value}
        for ratio, row in zip(ratios, values.tolist(), strict=True)
        for T, value in zip(periods, row, strict=True)
    ]
