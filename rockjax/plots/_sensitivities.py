"""Plots of sensitivity spectra: derivatives of peak rotations in the plane of a rocking spectrum. Symbols are
those of docs/model.md."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm
from matplotlib.figure import Figure

from ._outcomes import hatch_unfinished, survives
from ._panel_layout import grid_of_panels
from ._spectra import label_panel
from ._style import ACCELERATION_RATIO, FREQUENCY_RATIO, OVERTURNED_COLOUR, on_axes, styled, symbol_for

if TYPE_CHECKING:
    import xarray

# Limits of the colours, nearly logarithmic on both sides of zero, because derivatives grow without bound
# towards the overturning boundary.
STEPS = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
LEVELS = (*(-step for step in reversed(STEPS)), *STEPS)
COLOUR_MAP = "RdBu_r"


@on_axes
def sensitivity_spectrum(
    dataset: xarray.Dataset, ax: Axes | None = None, parameter: str | None = None, levels=LEVELS
) -> Axes:
    """Plot ∂(max|θ|/α)/∂ ln y, with a parameter y, against ω_p/p and a_p/(g tan α). Cells are red where
    a larger y increases the rotation.

    - `dataset`: rocking spectrum with sensitivities
    - `ax`: axes to draw into
    - `parameter`: name of y, by default the first of the spectrum
    - `levels`: limits of the colours

    Overturned cells are grey, and cells of scenes that did not finish are hatched. Raises `ValueError` for a
    spectrum without the parameter.
    """
    assert ax is not None
    slope, norm = _slope(dataset, parameter), BoundaryNorm(np.asarray(levels), 256, extend="both")
    x, y = dataset["frequency_ratio"].values, dataset["acceleration_ratio"].values
    values = slope.where(survives(dataset)).transpose("acceleration_ratio", "frequency_ratio")
    ax.set_facecolor(OVERTURNED_COLOUR)
    ax.pcolormesh(x, y, values.values, norm=norm, cmap=COLOUR_MAP, shading="nearest", rasterized=True)
    hatch_unfinished(dataset, ax)
    ax.set(xlabel=FREQUENCY_RATIO, ylabel=ACCELERATION_RATIO, xlim=(x[0], x[-1]), ylim=(y[0], y[-1]))
    return ax


def _slope(dataset: xarray.Dataset, parameter: str | None) -> xarray.DataArray:
    """Return the sensitivities to a parameter; None stands for the first parameter of the dataset."""
    available = list(map(str, dataset["parameter"].values)) if "peak_rotation_sensitivity" in dataset else []
    if not available or (parameter is not None and parameter not in available):
        requested = f"{parameter!r}, only to {available}" if available else "any parameter"
        raise ValueError(
            "sensitivity_spectrum: the dataset has no sensitivities of the peak rotation to "
            f"{requested}; compute them with rockjax.rocking_spectrum(…, "
            "sensitivities=[…])"
        )
    return dataset["peak_rotation_sensitivity"].sel(
        parameter=available[0] if parameter is None else parameter
    )


@styled
def sensitivity_spectra(panels: xarray.Dataset) -> Figure:
    """Plot sensitivities of peak rotations: one column per T_s, one row per η/γ, and one block of rows per
    parameter.

    `panels` is a rocking spectrum with sensitivities and the further dims `eta_over_gamma` and `T_s`.
    """
    parameters, ratios = list(map(str, panels["parameter"].values)), panels.sizes["eta_over_gamma"]
    rows, columns = len(parameters) * ratios, panels.sizes["T_s"]
    figure, axes, right_end = grid_of_panels(rows, columns, 2.7, 2.2, right=1.75, panels=panels)
    for i, j in np.ndindex(rows, columns):
        parameter = parameters[i // ratios]
        panel = panels.isel(eta_over_gamma=i % ratios, T_s=j)
        sensitivity_spectrum(panel, cast(Axes, axes[i, j]), parameter)
        label_panel(panels, panel, axes, i, j, rf"$\ln {symbol_for(parameter)}$: ")
    _draw_colour_bar(figure, right_end)
    return figure


def _draw_colour_bar(figure: Figure, right_end: float) -> None:
    """Draw one colour bar to the right of all panels."""
    width, height = figure.get_figwidth(), figure.get_figheight()
    bar_height = min(0.8, 3.5 / height)
    bounds = (right_end + 0.75 / width, 0.5 - bar_height / 2, 0.16 / width, bar_height)
    colours = ScalarMappable(BoundaryNorm(LEVELS, 256, extend="both"), COLOUR_MAP)
    bar = figure.colorbar(colours, cax=figure.add_axes(bounds), ticks=LEVELS, spacing="uniform", format="%g")
    bar.set_label(r"$\partial(\max|\theta|\,/\,\alpha)\,/\,\partial\ln y$")
