"""Figures of many panels: their layout, and titles that describe structure and pulse."""

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


ONE_LINE_WIDTH = 9.0  # width above which a title has one line [inches]


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
    """Make a figure of equal panels below a title that describes structure and pulse.

    - `rows`, `columns`: of panels
    - `width`, `height`: of each panel; `left`, `right`: margins [inches]
    - `panels`: dataset with the attributes for the title
    - `title`: text before the description
    - `sharey`: as in `Figure.subplots`

    Returns the figure, its axes, and the right end of the axes as a share of the width. The layout is
    explicit, because solving for it takes longer than the drawing.
    """
    gap_across, gap_down = 0.2, 0.45
    w = left + columns * width + (columns - 1) * gap_across + right
    head = panels_title(panels)
    if title:  # on its own line if one line for both would be too wide
        head = f"{title}, {head}" if w > ONE_LINE_WIDTH else f"{title}\n{head}"
    # Room for two lines of the title above the axes at the top, and for more.
    below, above = 0.55, 1.05 + 0.2 * max(head.count("\n") - 1, 0)
    h = below + rows * height + (rows - 1) * gap_down + above
    figure = plt.figure(figsize=(w, h))
    spacing = {"wspace": gap_across / width, "hspace": gap_down / height}
    sides = {"left": left / w, "right": 1 - right / w, "bottom": below / h, "top": 1 - above / h}
    axes = figure.subplots(
        rows, columns, sharex=True, sharey=sharey, squeeze=False, gridspec_kw=sides | spacing
    )
    figure.suptitle(head, fontsize=10 if title and w <= ONE_LINE_WIDTH else None)
    return figure, axes, sides["right"]


def legend_beside(figure: Figure, axes: np.ndarray, beside: float) -> None:
    """Draw one legend for all panels, to the right of the last one by `beside` inches, where it covers
    nothing."""
    entries: dict[str, Artist] = {}
    for ax in axes.flat:
        handles, labels = ax.get_legend_handles_labels()
        entries |= {
            label: handle for label, handle in zip(labels, handles, strict=True) if label not in entries
        }
    x = axes[0, -1].get_position().x1 + beside / figure.get_figwidth()
    # Curves first, then the marks.
    ordered = sorted(entries, key=lambda label: label.split()[0] in ("jump", "ends:", "windows"))
    figure.legend([entries[label] for label in ordered], ordered, loc="center left", bbox_to_anchor=(x, 0.5))


def panels_title(panels: xarray.Dataset) -> str:
    a = panels.attrs
    beam = "" if _is_block(panels) else rf"$\gamma = {a['gamma']:g}$, "
    stories = f", {a['stories']:g} stories" if "stories" in a else ""
    columns = rf"$R = {a['R_m']:.4g}$ m, $\tan\alpha = {math.tan(a['alpha_rad']):.4g}$"
    pulse_name, vertical, ratio = a["pulse"].partition(" with ")
    motion = f"{pulse_name} pulse{vertical}{ratio}" + ("\n" if vertical else ", ")
    return f"{motion}{beam}{columns}{stories}{_describe_devices(a)}"


def _describe_devices(attributes: Mapping[str, Any]) -> str:
    """Return the devices and their parameters on a new line; empty if there are no devices."""
    descriptions = []
    for device in json.loads(attributes.get("restrainers", "[]")):
        from rockjax._parameters.variants import find_parameter  # imports JAX, which other plots do not need

        device_class = device["kind"]
        entries = {field: find_parameter(f"restrainers.{device_class}.{field}") for field in device}
        # Numbers that are 0 are omitted, as is the exponent 1 of a linear damper.
        numbers = [
            rf"${symbol_for(entry.name)} = {device[field]:.3g}$"
            for field, entry in entries.items()
            if entry is not None and device[field] and not (field == "exponent" and device[field] == 1)
        ]
        descriptions.append(" ".join([device_class.lower(), ", ".join(numbers)]))
    return "\n" + "; ".join(descriptions) if descriptions else ""


def mass_label(panels: xarray.Dataset, ratio: float) -> str:
    """Return the name of the superstructure from η/γ."""
    if ratio == 0:
        return "solitary block" if _is_block(panels) else "no superstructure"
    if math.isinf(ratio):
        eta = panels.attrs.get("eta")
        return r"$\gamma = 0$" if eta is None else rf"$\gamma = 0$, $\eta = {eta:g}$"
    return rf"$\eta/\gamma = {ratio:g}$"


def period_label(panels: xarray.Dataset, ratio: float, T_s: float) -> str:
    """Return the description of the superstructure, from η/γ and its period."""
    if T_s > 0:
        return rf"$T_s = {T_s:g}$ s"
    return r"rigid, $T_s = 0$" if ratio else mass_label(panels, ratio)


def _is_block(panels: xarray.Dataset) -> bool:
    ratios = (
        np.atleast_1d(panels["eta_over_gamma"].values) if "eta_over_gamma" in panels.coords else np.zeros(1)
    )
    return panels.attrs["gamma"] == 0 and not np.any(ratios) and not panels.attrs.get("eta")
