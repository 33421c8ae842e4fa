"""Plots of rocking spectra, and secondary axes with units (T_p in s, a_p in g) for all spectra.

Symbols are those of docs/model.md: T_p, ω_p = 2π/T_p and a_p are the period, the circular frequency and the
amplitude of a pulse, and p is the frequency parameter of the podium. η/γ is the mass of the superstructure
divided by the mass of the beam, and T_s is the period of the superstructure [s].
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colorbar import Colorbar
from matplotlib.contour import ContourSet
from matplotlib.figure import Figure

from ._outcomes import hatch_unfinished, is_unfinished, survives
from ._panel_layout import grid_of_panels, mass_label, period_label
from ._style import ACCELERATION_RATIO, FREQUENCY_RATIO, on_axes, styled

if TYPE_CHECKING:
    import xarray


@on_axes
def rocking_spectrum(dataset: xarray.Dataset, ax: Axes | None = None, levels=None) -> Axes:
    """Plot contours of peak rotation against ω_p/p and a_p/(g tan α). Overturned cells are blank. Cells of
    scenes that did not finish are hatched.

    - `dataset`: dataset of [`rockjax.rocking_spectrum`][]
    - `ax`: axes to draw into
    - `levels`: limits of the colours of max|θ|/α, by default 11 from 0 to 1, or to the `overturn_ratio` of
      the dataset if it is larger

    Raises `ValueError` for a spectrum with a single frequency or acceleration.
    """
    assert ax is not None
    highest = max(1.0, dataset.attrs.get("overturn_ratio", 1.0))
    levels = np.linspace(0.0, highest, 11) if levels is None else levels
    rotation = dataset["peak_rotation"].where(survives(dataset))
    x, y = plane_of("rocking_spectrum", dataset)
    ax.contourf(x, y, rotation.values, levels=levels, cmap="viridis_r", vmin=0, vmax=highest)
    hatch_unfinished(dataset, ax)
    ax.set(xlabel=FREQUENCY_RATIO, ylabel=ACCELERATION_RATIO, xlim=(x[0], x[-1]), ylim=(y[0], y[-1]))
    return ax


def plane_of(owner: str, dataset: xarray.Dataset) -> tuple[np.ndarray, np.ndarray]:
    """Return the values of ω_p/p and of a_p/(g tan α), for contours. `owner` is the name of the plot. Raises
    `ValueError` if there is only a single frequency or acceleration."""
    x, y = dataset["frequency_ratio"].values, dataset["acceleration_ratio"].values
    if min(x.size, y.size) < 2:
        raise ValueError(
            f"plots.{owner}: contours need at least two frequencies and two accelerations, got {x.size} and "
            f"{y.size}"
        )
    return x, y


def rotation_bar(axes: Axes | np.ndarray, cax: Axes | None = None, **bar) -> Colorbar:
    """Draw the colour bar of one or several rocking spectra.

    - `axes`: axes of the spectra; the bar is drawn beside them
    - `cax`: axes to draw the bar into; None to draw it beside `axes`
    - `bar`: arguments of `Figure.colorbar`

    Raises `ValueError` if the first axes have no spectrum.
    """
    first: Axes = np.ravel(np.asarray(axes, object))[0]
    contours = next((artist for artist in first.collections if isinstance(artist, ContourSet)), None)
    if contours is None:
        raise ValueError(
            "rotation_bar: the axes hold no rocking spectrum; draw one with plots.rocking_spectrum first"
        )
    position: dict[str, Any] = {"ax": axes} if cax is None else {"cax": cax}
    figure: Any = first.figure
    return figure.colorbar(
        contours, **position, **{"label": r"peak rotation $\max|\theta|\,/\,\alpha$", **bar}
    )


def dimensional_axes(
    dataset: xarray.Dataset, ax: Axes, period: bool = True, acceleration: bool = True
) -> Axes:
    """Add secondary axes: pulse period T_p at the top, pulse amplitude a_p [g] at the right.

    - `dataset`: spectrum with the attributes of its podium
    - `ax`: axes of the spectrum, with their limits set
    - `period`: whether to add the axis at the top
    - `acceleration`: whether to add the axis at the right
    """
    p = dataset.attrs["p_rad_s"]
    tan_alpha = math.tan(dataset.attrs["alpha_rad"])
    if period:
        upper = ax.secondary_xaxis("top", functions=(lambda r: _period(r, p), lambda T: _period(T, p)))
        upper.set_xlabel(r"$T_p$ [s]")
        low, high = ax.get_xlim()
        upper.set_xticks([T for T in (3, 2, 1, 0.8, 0.6, 0.5, 0.4) if low <= _period(T, p) <= high])
        upper.xaxis.set_major_formatter("{x:g}")
    if acceleration:
        scales: Any = (lambda ratio: ratio * tan_alpha, lambda a: a / tan_alpha)
        right = ax.secondary_yaxis("right", functions=scales)
        right.set_ylabel(r"$a_p$ [g]")
    return ax


def _period(ratio, p):
    """Return T_p for a given ω_p/p, or ω_p/p for a given T_p: each is 2π/p divided by the other."""
    with np.errstate(divide="ignore"):
        return 2 * math.pi / p / np.asarray(ratio, float)


@styled
def spectra(panels: xarray.Dataset) -> Figure:
    """Plot rocking spectra of several podiums: one row per η/γ, one column per T_s.

    This is the layout of Fig. 6 of the paper that docs/citing.md names. `panels` is a rocking spectrum with
    the further dims `eta_over_gamma` and `T_s`.
    """
    return draw_panels(panels, rocking_spectrum)


def draw_panels(panels: xarray.Dataset, draw: Callable[..., Axes], title: str = "", **bar) -> Figure:
    """Draw spectra with secondary axes and one colour bar: one row per η/γ, one column per T_s.

    - `panels`: spectrum with the further dims `eta_over_gamma` and `T_s`
    - `draw`: function (spectrum, axes) that draws one panel with Matplotlib's `contourf`
    - `title`: start of the figure's title, before the description of structure and pulse that
      `grid_of_panels` adds
    - `bar`: arguments of `rotation_bar`
    """
    rows, columns = panels.sizes["eta_over_gamma"], panels.sizes["T_s"]
    figure, axes, right_end = grid_of_panels(rows, columns, 2.7, 2.2, right=1.75, panels=panels, title=title)
    for i in range(rows):
        for j in range(columns):
            panel = panels.isel(eta_over_gamma=i, T_s=j)
            draw(panel, axes[i, j])
            label_panel(panels, panel, axes, i, j)
    bar_axes = figure.add_axes(
        (right_end + 0.75 / figure.get_figwidth(), 0.25, 0.16 / figure.get_figwidth(), 0.5)
    )
    rotation_bar(axes, cax=bar_axes, **bar)
    return figure


def label_panel(
    panels: xarray.Dataset, panel: xarray.Dataset, axes: np.ndarray, i: int, j: int, prefix: str = ""
) -> None:
    """Add secondary axes, title and labels to the panel in row i and column j.

    - `panels`, `panel`: spectrum of all panels, and spectrum of this panel
    - `axes`: axes of all panels, with limits set
    - `i`, `j`: row and column
    - `prefix`: start of the title
    """
    ax: Axes = axes[i, j]
    rows, columns = axes.shape
    dimensional_axes(panel, ax, period=i == 0, acceleration=j == columns - 1)
    ratio = float(panel.eta_over_gamma)
    labels = (mass_label(panels, ratio), period_label(panels, ratio, float(panel.T_s)))
    # Automatic positions of titles are slow, and needed only above a secondary axis.
    ax.set_title(prefix + ", ".join(dict.fromkeys(labels)), fontsize=10, y=None if i == 0 else 1.0)
    ax.set_xlabel(FREQUENCY_RATIO if i == rows - 1 else "")
    ax.set_ylabel(ACCELERATION_RATIO if j == 0 else "")
    style: dict[str, Any] = {"transform": ax.transAxes, "va": "top", "fontsize": 8, "color": "0.4"}
    notes = ["overturned"] if bool(panel["overturned"].any()) else []
    if bool(is_unfinished(panel).any()):
        notes.append("hatched: did not finish")
        style["bbox"] = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.5}
    if notes:
        ax.text(0.04, 0.93, "\n".join(notes), **style)
