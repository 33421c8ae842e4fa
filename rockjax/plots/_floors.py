"""Plots of floor response spectra."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ._outcomes import is_unfinished, survives
from ._style import COLOURS, label_log_x, plt, styled

if TYPE_CHECKING:
    import xarray

MAX_COLUMNS = 3  # largest number of panels in a row
# Prefix of a variable's name → (label, line style).
CURVES: dict[str, tuple[str, dict[str, Any]]] = {
    "ground_": ("ground", {"color": "0.55", "linestyle": "--"}),
    "fixed_base_": ("fixed base", {"color": COLOURS[2], "linestyle": "-."}),
    "": ("podium", {"color": COLOURS[1], "linestyle": "-"}),
}
# Quantity → (axis label, whether it is drawn in units of g).
LABELS = {
    "pseudo_acceleration": ("pseudo-acceleration [g]", True),
    "absolute_acceleration": ("absolute acceleration [g]", True),
    "relative_displacement": ("relative displacement [m]", False),
}


@styled
def floor_spectrum(
    dataset: xarray.Dataset, quantity: str = "pseudo_acceleration", damping: float | None = None
) -> Figure:
    """Plot floor response spectra, a panel for each level.

    - `dataset`: dataset of [`rockjax.floor_spectrum`][]. If it was computed with `fixed_base=True`, the
      spectra of the ground and of the building fixed at its base are drawn as well
    - `quantity`: `"pseudo_acceleration"`, `"absolute_acceleration"` or `"relative_displacement"`
    - `damping`: ζ of the oscillators, by default the first of the dataset

    With several motions, curves are medians over the motions, and the spectrum of the podium under each
    motion is a thin line. Motions that overturn the podium, and scenes that did not finish, are left out of
    the spectra of the podium.

    In spectra of accelerations, a level without velocity jumps has a mark on the left axis at its peak
    acceleration. With several motions, the mark is at the median of the peaks under the motions that are not
    left out. Raises `ValueError` for another quantity or damping.
    """
    if quantity not in LABELS:
        raise ValueError(f"plots.floor_spectrum: quantity must be one of {tuple(LABELS)}, got {quantity!r}")
    dampings = dataset["damping"].values
    if damping is not None and not np.any(np.isclose(dampings, damping)):
        raise ValueError(f"plots.floor_spectrum: damping must be one of {dampings}, got {damping!r}")
    data = dataset.isel(damping=0 if damping is None else int(np.argmin(np.abs(dampings - damping))))
    label, in_g = LABELS[quantity]
    unit = float(data.attrs["g_m_s2"]) if in_g else 1.0
    levels = data["level"].values
    columns = 2 if levels.size == 4 else min(MAX_COLUMNS, levels.size)
    rows = -(-levels.size // columns)
    figure = plt.figure(figsize=(1.2 + 2.7 * columns, 0.6 + 2.5 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    first, T = axes[0], data["period"].values
    first.set(xscale="log", yscale="log", xlim=(T[0], T[-1]))
    for ax, level in zip(axes, levels, strict=False):
        for prefix in CURVES:
            _draw(ax, data, f"{prefix}{quantity}", prefix, level, unit)
        at_level = _drawn_motions(data.sel(level=level))
        if in_g and at_level["peak_acceleration"].size and not at_level["peak_velocity_jump"].any():
            peak = float(np.median(at_level["peak_acceleration"])) / unit
            ax.plot([0, 0.03], [peak, peak], color=COLOURS[1], lw=2, transform=ax.get_yaxis_transform())
        ax.set_title(f"story {level}" if str(level).isdigit() else str(level))
        ax.grid(True, alpha=0.3)
    for k in range(levels.size, axes.size):
        axes[k].set_visible(False)
        axes[k - columns].tick_params(labelbottom=True)
    label_log_x(first)
    axes[levels.size - 1].legend(loc="best")
    zeta = f"{float(data['damping']):.0%}"
    vertical = "vertical " if data.attrs.get("direction") == "vertical" else ""
    for k in range(levels.size):
        if k + columns >= levels.size:
            axes[k].set_xlabel(rf"period of the oscillator $T_e$ [s], $\zeta$ = {zeta}")
        if k % columns == 0:
            axes[k].set_ylabel(f"{vertical}{label}")
    return figure


def _drawn_motions(podium: xarray.Dataset) -> xarray.Dataset:
    """Return the data without the motions whose spectra of the podium are lower bounds."""
    return podium.isel(motion=survives(podium).values) if "motion" in podium.dims else podium


def _draw(ax: Axes, data: xarray.Dataset, name: str, prefix: str, level: Any, unit: float) -> None:
    """Draw the spectra of ground, fixed base or podium at a level, if the dataset has them.

    - `ax`: axes to draw into
    - `data`: dataset with a single damping ratio
    - `name`, `prefix`: name of the variable, and the prefix of this name, a key of `CURVES`
    - `level`: the level
    - `unit`: unit of the axis, in SI
    """
    if name not in data or (prefix == "fixed_base_" and level == "deck"):
        return
    label, line = CURVES[prefix]
    data = data if prefix else _drawn_motions(data)
    values = data[name].sel(level=level) if "level" in data[name].dims else data[name]
    if "motion" in values.dims:
        if not prefix:
            ax.plot(data["period"], values.values.T / unit, color=line["color"], ls="-", lw=0.4, alpha=0.5)
        if not values.sizes["motion"]:
            ax.plot([], [], label=f"{label}: no motion survives", **line)
            return
        values, label = values.median("motion"), f"{label}, median"
    elif not prefix and bool(is_unfinished(data)):
        label = f"{label}, did not finish"
    elif not prefix and bool(data["overturned"]):
        label = f"{label}, until overturning"
    ax.plot(data["period"], values.values / unit, label=label, **line)
