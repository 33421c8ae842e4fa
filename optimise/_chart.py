"""Design charts: the smallest safe value of a design variable against the pulse period."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

import rockjax as rj
from rockjax._boundaries.boundary import BOUNDARY
from rockjax._boundaries.crossings import scan
from rockjax._checks import as_axis, require_positive
from rockjax._motions.convert import as_pulse
from rockjax._parameters.registry import as_variable, variable_attributes
from rockjax._responses.datasets import describe_options
from rockjax.internal import as_float, format_value, require_instance, require_whole

from ._variables import Structure, as_bounds, as_podium, make_variables, parameter, with_variables

if TYPE_CHECKING:
    import xarray
    from matplotlib.axes import Axes


def _check_axes(owner: str, T_p, a_p) -> tuple[np.ndarray, np.ndarray]:
    """Return periods and amplitudes as 1-D arrays; raise `ValueError` if they are invalid."""
    periods = as_axis(owner, "T_p", T_p, ascending=True)
    amplitudes = np.atleast_1d(np.asarray(as_float(a_p, f"{owner}: a_p")))
    require_positive(owner, T_p=periods, a_p=amplitudes)
    return periods, amplitudes


def design_chart(
    podium: Structure,
    vary: tuple[str, tuple[float, float]],
    pulse: Callable[[Any, Any], rj.AbstractExcitation],
    a_p: float | Sequence[float],
    T_p,
    *,
    resolution: int = 128,
    options: rj.Options = BOUNDARY,
    progress: Any = False,
) -> xarray.Dataset:
    """Return the smallest safe value of a design variable, such as α, for each pulse amplitude and period.

    A value is safe if the columns survive with this value and with all larger values up to the upper bound.
    The function cannot be called inside `jax.jit`.

    - `podium`: a `rockjax.Podium` or an `optimise.Dimensions`
    - `vary`: (name, (lowest, highest)) of the design variable, in the unit of the parameter, with names as in
      [`optimise.design`][]. All other parameters of `podium` keep their values
    - `pulse`: a pulse class such as `rockjax.Ricker`
    - `a_p`: one or several amplitudes of the pulse, > 0 [m/s²]
    - `T_p`: periods of the pulse, shape (n,), > 0, ascending [s]
    - `resolution`: number of equal intervals into which the range is divided, ≥ 4. The function first
      simulates the ends of the intervals, and then refines intervals in which the outcome may change
    - `options`: options of the simulations
    - `progress`: `True` for a progress bar, or any object with a method `update(n)`

    Returns a Dataset with the dimensions `a_p` and `T_p`. `smallest_safe_value` is NaN if the columns
    overturn at the upper bound, or if a simulation with this value or a larger one did not finish.
    `boundaries` contains the values of the variable at which survival changes to overturning or back,
    ascending along a further dimension `boundary` and padded with NaN. Two changes are missing if no
    simulated value lies between them. Raises `ValueError` for invalid inputs, and `RuntimeError` if there is
    a period at which no simulation finishes.
    """
    import xarray

    owner = "design_chart"
    try:
        name, pair = vary
        low, high = as_bounds(owner, name, pair)
    except (TypeError, ValueError):
        raise ValueError(
            f"{owner}: vary must be a pair (name, (lowest, highest)) "
            f'such as ("alpha", (0.1, 0.3)), got {vary!r}'
        ) from None
    make_variables(podium, {name: (low, high)}, owner)  # raises for an unknown name and invalid bounds
    pulse = as_pulse(owner, pulse)
    require_instance(owner, "options", options, rj.Options, "rockjax.Options")
    periods, amplitudes = _check_axes(owner, T_p, a_p)
    require_whole(owner, "resolution", resolution, 4)
    boundary_tables, smallest_safe_value, scene_counts = [], [], []
    for amplitude in amplitudes:

        def scene(period, value, amplitude=amplitude):
            structure = with_variables(podium, {name: value})
            return as_podium(structure), pulse(amplitude, period)

        scanned = scan(scene, periods, (low, high), resolution, options, progress, width=None)
        boundaries, _ = scanned.crossings.table(periods.size)
        boundary_tables.append(boundaries)
        smallest_safe_value.append(
            _smallest_safe_value(boundaries, scanned.lower_end_survives, scanned.last_unfinished, low)
        )
        scene_counts.append(scanned.scenes)
    boundary_count = max(table.shape[1] for table in boundary_tables)
    pad = lambda table: np.pad(table, ((0, 0), (0, boundary_count - table.shape[1])), constant_values=np.nan)
    unit = parameter(podium, name).unit
    safe, boundaries = np.stack(smallest_safe_value), np.stack(list(map(pad, boundary_tables)))
    changes = f"{name} at changes between survival and overturning"
    return xarray.Dataset(
        {
            "smallest_safe_value": as_variable(
                ("a_p", "T_p"), safe, unit, f"smallest {name} above which all values survive"
            ),
            "boundaries": as_variable(("a_p", "T_p", "boundary"), boundaries, unit, changes),
        },
        coords={
            "a_p": ("a_p", amplitudes, variable_attributes("a_p")),
            "T_p": ("T_p", periods, variable_attributes("T_p")),
        },
        attrs={
            "title": "Design chart",
            "kind": "design-chart",
            "pulse": getattr(pulse, "__name__", repr(pulse)),
            "varied": name,
            "lowest": low,
            "highest": high,
            "scenes": int(sum(scene_counts)),
            **describe_options(options),
        },
    )


def _smallest_safe_value(
    boundaries: np.ndarray, lower_end_survives: np.ndarray, last_unfinished: np.ndarray, low: float
) -> np.ndarray:
    """Return the smallest safe value at each period: the last boundary, or `low` if there is no boundary. It
    is NaN if the columns overturn at the upper bound, or if the outcome of this value or a larger one is
    unknown.

    - `boundaries`: boundaries at each period (periods, boundaries), ascending, padded with NaN
    - `lower_end_survives`: whether the columns survive at the lower bound `low` (periods,)
    - `last_unfinished`: largest value whose simulation did not finish (periods,); −inf if there is none
    """
    counts = np.sum(np.isfinite(boundaries), axis=1)
    # An odd number of boundaries means that survival differs between the two ends of the range.
    upper_end_survives = lower_end_survives ^ (counts % 2 == 1)
    last_boundary = boundaries[np.arange(len(counts)), np.maximum(counts - 1, 0)]
    smallest = np.where(counts > 0, last_boundary, low)
    return np.where(upper_end_survives & (last_unfinished < smallest), smallest, np.nan)


def plot_chart(chart: xarray.Dataset, ax: Axes | None = None) -> Axes:
    """Plot the smallest safe value against the pulse period, one curve for each amplitude.

    - `chart`: a Dataset of [`optimise.design_chart`][]; `ax`: axes to draw in, by default those of a new
      figure

    Dots mark all other changes between survival and overturning (`boundaries`). Returns the axes. Raises
    `ValueError` if `chart` is not such a Dataset.
    """
    if "smallest_safe_value" not in getattr(chart, "data_vars", ()):
        raise ValueError(f"plot_chart: chart must come from optimise.design_chart, got {format_value(chart)}")
    import matplotlib.pyplot as plt

    from rockjax.plots import COLOURS, STYLES

    ax = ax or plt.figure(figsize=(6, 4), layout="constrained").add_subplot()
    T_p = chart["T_p"].values
    for k, amplitude in enumerate(chart["a_p"].values):
        colour, style = COLOURS[k % len(COLOURS)], STYLES[k % len(STYLES)]
        selected = chart.sel(a_p=amplitude)
        smallest_safe_value = selected["smallest_safe_value"].values
        ax.plot(T_p, smallest_safe_value, color=colour, ls=style, label=rf"$a_p = {amplitude:g}$ m/s$^2$")
        for boundary in selected["boundaries"].values.T:
            ax.plot(T_p, np.where(boundary == smallest_safe_value, np.nan, boundary), ".", ms=2, color=colour)
    unit = chart["smallest_safe_value"].attrs["units"]
    label = chart.attrs["varied"] if unit == "1" else f"{chart.attrs['varied']} [{unit}]"
    ax.set(xlabel=r"$T_p$ [s]", ylabel=f"smallest safe {label}", xlim=(T_p[0], T_p[-1]))
    ax.grid(alpha=0.3)
    ax.legend()
    return ax
