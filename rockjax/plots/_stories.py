"""Plots of the response of a building along its height."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rockjax._responses.datasets import podium_of
from rockjax._responses.peak import UNTIL_OVERTURNING
from rockjax._responses.response import Response
from rockjax._units import MM_PER_M

from ._histories import as_history
from ._style import curve_style, styled

if TYPE_CHECKING:
    import xarray


@styled
def stories(
    response: Response | xarray.Dataset,
    figure: Figure | None = None,
    *,
    label: str | None = None,
    beside: Mapping[str, Response | xarray.Dataset] | None = None,
) -> Figure:
    """Plot the largest story drifts and floor accelerations of a building along its height.

    - `response`: a [`rockjax.Response`][] or its dataset
    - `figure`: figure to draw into, by default a new one
    - `label`: name of the response in the legend
    - `beside`: dict label → further response of the same building

    Drifts are divided by the heights of the stories if the building has heights. The label of a response that
    overturns ends with "until overturning". Raises `ValueError` for a response without stories.
    """
    figure = figure or plt.figure(figsize=(8, 4), layout="constrained")
    drift_axes, acceleration_axes = axes = figure.subplots(1, 2, sharey=True)
    responses = [(label, response), *(beside or {}).items()]
    for k, (name, item) in enumerate(responses):
        _draw_over_height(as_history(item), name, curve_style(k), drift_axes, acceleration_axes)
    if drift_axes.get_legend_handles_labels()[0]:
        drift_axes.legend(loc="best", fontsize="small")
    for ax in axes:
        ax.set_xlim(0, 1.06 * ax.dataLim.x1)
        ax.grid(True, alpha=0.3)
    return figure


def _draw_over_height(
    data: xarray.Dataset,
    label: str | None,
    style: dict[str, Any],
    drift_axes: Axes,
    acceleration_axes: Axes,
) -> None:
    """Draw the largest drifts and floor accelerations of one response.

    - `data`: history of the response
    - `label`: name in the legend, or None
    - `style`: arguments of the plot functions
    - `drift_axes`, `acceleration_axes`: axes to draw into
    """
    if bool(data["overturned"]):
        label = f"{label}, {UNTIL_OVERTURNING}" if label else UNTIL_OVERTURNING
    if "peak_drift" not in data or "peak_floor_acceleration" not in data:
        raise ValueError("plots.stories: expected the response of a building, a rockjax.ShearBuilding")
    building: Any = podium_of(data.attrs).superstructure
    drifts = data["peak_drift"].values
    has_heights = building.heights is not None
    heights = np.asarray(building.heights) if has_heights else np.ones(drifts.size)
    levels = np.append(0.0, np.cumsum(heights))
    values = drifts / heights * 100 if has_heights else drifts * MM_PER_M
    drift_axes.stairs(values, levels, orientation="horizontal", baseline=None, label=label, lw=1.5, **style)
    g = data.attrs["g_m_s2"]
    acceleration_axes.plot(data["peak_floor_acceleration"].values / g, levels[1:], marker="o", ms=4, **style)
    drift_axes.set(
        xlabel="largest drift / story height [%]" if has_heights else "largest drift [mm]",
        ylabel="height above the beam [m]" if has_heights else "story",
        ylim=(0, levels[-1] * 1.05),
    )
    acceleration_axes.set(xlabel="largest floor acceleration [g]")
