"""Figures of several panels: their layout, and titles that describe structure and pulse. Symbols are those of
docs/model.md."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.artist import Artist
from matplotlib.figure import Figure

from ._style import symbol_for

if TYPE_CHECKING:
    import xarray


ONE_LINE_WIDTH = 9.0  # width above which title and description share a line [inches]


def grid_of_panels(
    rows: int,
    columns: int,
    width: float,
    height: float,
    right: float,
    panels: xarray.Dataset,
    title: str = "",
    sharey: Literal["all", "row"] = "all",
    left=0.65,
) -> tuple[Figure, np.ndarray, float]:
    """Make a figure of panels of equal size below a title that describes structure and pulse.

    - `rows`, `columns`: numbers of panels
    - `width`, `height`: size of each panel [inches]
    - `left`, `right`: margins of the figure [inches]
    - `panels`: dataset with the attributes for the description
    - `title`: text before the description
    - `sharey`: as in `Figure.subplots`

    Returns the figure, its axes, and the right end of the axes divided by the width of the figure. The layout
    is explicit, because automatic layout takes longer than the drawing.
    """
    column_gap, row_gap = 0.2, 0.45
    w = left + columns * width + (columns - 1) * column_gap + right
    heading = panels_title(panels)
    if title:
        heading = f"{title}, {heading}" if w > ONE_LINE_WIDTH else f"{title}\n{heading}"
    below, above = 0.55, 1.05 + 0.2 * max(heading.count("\n") - 1, 0)  # 1.05 is enough for two lines
    h = below + rows * height + (rows - 1) * row_gap + above
    figure = plt.figure(figsize=(w, h))  # [inches]
    spacing = {"wspace": column_gap / width, "hspace": row_gap / height}
    sides = {"left": left / w, "right": 1 - right / w, "bottom": below / h, "top": 1 - above / h}
    axes = figure.subplots(
        rows, columns, sharex=True, sharey=sharey, squeeze=False, gridspec_kw=sides | spacing
    )
    # A constant distance from the upper edge, 0.09 inches, also in tall figures.
    figure.suptitle(heading, y=1 - 0.09 / h, fontsize=10 if title and w <= ONE_LINE_WIDTH else None)
    return figure, axes, sides["right"]


def legend_beside(figure: Figure, axes: np.ndarray, distance: float) -> None:
    """Draw one legend for all panels, `distance` inches to the right of the last panel."""
    entries: dict[str, Artist] = {}
    for ax in axes.flat:
        handles, labels = ax.get_legend_handles_labels()
        entries |= {
            label: handle for label, handle in zip(labels, handles, strict=True) if label not in entries
        }
    x = axes[0, -1].get_position().x1 + distance / figure.get_figwidth()
    # Curves come first. `_boundaries.py` also adds entries for jumps of curves, for ends of curves, and for
    # windows of survival. The labels of these entries begin with the words below.
    ordered = sorted(entries, key=lambda label: label.split()[0] in ("jump", "ends:", "windows"))
    figure.legend([entries[label] for label in ordered], ordered, loc="center left", bbox_to_anchor=(x, 0.5))


def panels_title(panels: xarray.Dataset) -> str:
    """Return a description of structure and pulse."""
    attributes = panels.attrs
    beam = "" if _is_block(panels) else rf"$\gamma = {attributes['gamma']:g}$, "
    stories = f", {attributes['stories']:g} stories" if "stories" in attributes else ""
    alpha = attributes["alpha_rad"]
    columns = rf"$R = {attributes['R_m']:.4g}$ m, $\tan\alpha = {math.tan(alpha):.4g}$"
    # With a vertical component, the attribute is "NAME with vertical ratio r".
    pulse_name, vertical, ratio = attributes["pulse"].partition(" with ")
    motion = f"{pulse_name} pulse{vertical}{ratio}" + ("\n" if vertical else ", ")
    return f"{motion}{beam}{columns}{stories}{_describe_devices(attributes)}"


def _describe_devices(attributes: Mapping[str, Any]) -> str:
    """Return a line break and a line that lists tendons, dampers and inerters with their parameters; an empty
    string without such devices."""
    descriptions = []
    for device in json.loads(attributes.get("restrainers", "[]")):
        from rockjax._parameters.variants import find_parameter  # imports JAX, which other plots do not need

        device_class = device["kind"]
        entries = {field: find_parameter(f"restrainers.{device_class}.{field}") for field in device}
        # Parameters of value 0 are omitted, and so is the exponent 1 of a linear damper.
        parameters = [
            rf"${symbol_for(entry.name)} = {device[field]:.3g}$"
            for field, entry in entries.items()
            if entry is not None and device[field] and not (field == "exponent" and device[field] == 1)
        ]
        descriptions.append(" ".join([device_class.lower(), ", ".join(parameters)]))
    return "\n" + "; ".join(descriptions) if descriptions else ""


def mass_label(panels: xarray.Dataset, ratio: float) -> str:
    """Return the label of the mass of a superstructure; `ratio` is η/γ."""
    if ratio == 0:
        return "solitary block" if _is_block(panels) else "no superstructure"
    if math.isinf(ratio):
        eta = panels.attrs.get("eta")
        return r"$\gamma = 0$" if eta is None else rf"$\gamma = 0$, $\eta = {eta:g}$"
    return rf"$\eta/\gamma = {ratio:g}$"


def period_label(panels: xarray.Dataset, ratio: float, T_s: float) -> str:
    """Return the label of a superstructure with the mass ratio η/γ = `ratio` and the period `T_s` [s]. The
    label is the period, or states that the superstructure is rigid or absent."""
    if T_s > 0:
        return rf"$T_s = {T_s:g}$ s"
    return r"rigid, $T_s = 0$" if ratio else mass_label(panels, ratio)


def _is_block(panels: xarray.Dataset) -> bool:
    """Return whether all panels are of a solitary block, without beam and superstructure."""
    ratios = (
        np.atleast_1d(panels["eta_over_gamma"].values) if "eta_over_gamma" in panels.coords else np.zeros(1)
    )
    return panels.attrs["gamma"] == 0 and not np.any(ratios) and not panels.attrs.get("eta")
