"""Plots of overturning boundaries: least overturning accelerations, windows of survival above them, and
sensitivities.

As a function of frequency, the boundary has several branches. The least acceleration jumps where another
branch becomes the lowest. Symbols are those of docs/model.md: η/γ is the mass of the superstructure divided
by the mass of the beam, and T_s is the period of the superstructure [s].
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from ._outcomes import is_unfinished
from ._panel_layout import grid_of_panels, legend_beside, mass_label, period_label
from ._spectra import dimensional_axes
from ._style import ACCELERATION_RATIO, FREQUENCY_RATIO, curve_style, on_axes, styled, symbol_for

if TYPE_CHECKING:
    import xarray


@on_axes
def overturning_curve(dataset: xarray.Dataset, ax: Axes | None = None, **line) -> Axes:
    """Plot the minimum overturning acceleration of a rocking spectrum against frequency.

    If the spectrum has the variable `boundaries` (boundaries that were bisected between grid points), it is
    drawn like an overturning spectrum. Otherwise the curve has steps between grid points.

    - `dataset`: dataset of [`rockjax.rocking_spectrum`][]
    - `ax`: axes to draw into
    - `line`: arguments of `Axes.plot` or `Axes.step`
    """
    assert ax is not None
    if "boundaries" in dataset:
        return overturning_spectrum(dataset, ax, **line)
    from rockjax._studies.spectra import minimum_overturning  # imports JAX, which other plots do not need

    x, least = dataset["frequency_ratio"].values, minimum_overturning(dataset).values
    curve = ax.step(x, least, where="mid", **line)[0]
    _mark_ends(ax, x, least, _searched_up_to(dataset).min(), curve.get_color())
    ax.set(xlabel=FREQUENCY_RATIO, ylabel=ACCELERATION_RATIO)
    return ax


@styled
def overturning_curves(panels: xarray.Dataset) -> Figure:
    """Plot least overturning accelerations against frequency: one panel per η/γ, one curve per T_s.

    `panels` is a rocking spectrum with the further dims `eta_over_gamma` and `T_s`.
    """
    note = "" if "boundaries" in panels else ", read off the grid"
    return _draw_curves(panels, overturning_curve, f"Minimum overturning acceleration{note}")


@styled
def overturning_boundaries(panels: xarray.Dataset) -> Figure:
    """Plot overturning spectra, with windows of survival shaded: one panel per η/γ, one curve per T_s.

    `panels` is an overturning spectrum with the further dims `eta_over_gamma` and `T_s`.
    """
    return _draw_curves(panels, overturning_spectrum, "Overturning boundaries")


def _draw_curves(panels: xarray.Dataset, draw, title: str) -> Figure:
    """Draw one panel per η/γ, with one curve per T_s."""
    count = panels.sizes["eta_over_gamma"]
    figure, grid, _ = grid_of_panels(1, count, 3.9, 3.1, right=2.85, panels=panels, title=title)
    axes = grid[0]
    x = panels["frequency_ratio"].values
    for i, ax in enumerate(axes):
        ratio = float(panels.eta_over_gamma[i])
        for j in range(panels.sizes["T_s"]):
            panel = panels.isel(eta_over_gamma=i, T_s=j)
            draw(panel, ax, label=period_label(panels, ratio, float(panel.T_s)), **curve_style(j))
        ax.set(xlim=(x[0], x[-1]), ylim=(0, _search_end(panels)), title=mass_label(panels, ratio))
        ax.grid(alpha=0.3)
        dimensional_axes(panels, ax, acceleration=i == count - 1)
        if i:
            ax.set_ylabel("")
    legend_beside(figure, grid, distance=0.7)
    return figure


def _search_end(dataset: xarray.Dataset) -> float:
    """Return the largest a_p/(g tan α) of the search for boundaries."""
    return float(dataset.attrs.get("max_acceleration_ratio") or dataset["acceleration_ratio"].values[-1])


def _searched_up_to(dataset: xarray.Dataset) -> np.ndarray:
    """Return the largest a_p/(g tan α) of the search at each frequency, shape (n,). In a rocking spectrum,
    this is the largest acceleration whose scene finished, or 0 if no scene did."""
    if "overturned" not in dataset:
        return np.full(dataset.sizes["frequency_ratio"], _search_end(dataset))
    finished = dataset["acceleration_ratio"].where(~is_unfinished(dataset))
    return finished.max("acceleration_ratio").fillna(0.0).values


@on_axes
def overturning_spectrum(dataset: xarray.Dataset, ax: Axes | None = None, **line) -> Axes:
    """Plot the least overturning acceleration against frequency, with windows of survival above it shaded.

    Dotted lines mark jumps of the least acceleration to another branch of the boundary. Triangles mark ends
    of the curve. At the next frequency beyond an end, no searched acceleration overturns. `ax.legend()`
    explains lines and marks.

    - `dataset`: dataset of [`rockjax.overturning_spectrum`][]
    - `ax`: axes to draw into
    - `line`: arguments of `Axes.plot`
    """
    assert ax is not None
    x, minimum = dataset["frequency_ratio"].values, dataset["minimum"].values
    curve = _draw_with_jumps(ax, x, minimum, _find_jumps(minimum), **line)
    highest = _searched_up_to(dataset)
    _mark_ends(ax, x, minimum, highest.min(), curve.get_color())
    windows = _survival_polygons(x, dataset["boundaries"].values, highest)
    if windows:
        ax.add_collection(PolyCollection(windows, facecolor=curve.get_color(), edgecolor="none", alpha=0.4))
        _add_legend_entry(
            ax,
            "windows of survival",
            lambda label: ax.add_collection(PolyCollection([], fc="0.6", label=label)),
        )
    ax.set(xlabel=FREQUENCY_RATIO, ylabel=ACCELERATION_RATIO)
    return ax


def _survival_polygons(
    x: np.ndarray, boundaries: np.ndarray, highest: np.ndarray
) -> list[list[tuple[float, float]]]:
    """Return the polygons of the windows of survival.

    - `x`: frequencies, shape (n,)
    - `boundaries`: boundaries at each frequency, ascending, shape (n, largest number of boundaries), padded
      with NaN
    - `highest`: end of a window that has no upper boundary, at each frequency, shape (n,)

    At each frequency, the columns survive below the first boundary, and the outcome changes at every
    boundary. Windows of survival therefore extend from the second boundary to the third, from the fourth to
    the fifth, and so on.
    A window is connected to the overlapping windows at the next frequency. If there are none, it ends
    half-way to the next frequency.
    """
    windows: list[list[tuple[float, float]]] = []
    for row, end in zip(boundaries, highest, strict=True):
        starts, ends = row[1::2], row[2::2]
        ends = np.append(ends, np.full(starts.size - ends.size, np.nan))
        windows.append(
            [(a, end if np.isnan(b) else b) for a, b in zip(starts, ends, strict=True) if np.isfinite(a)]
        )
    polygons = []
    for k in range(x.size - 1):
        left_windows, right_windows, middle = windows[k], windows[k + 1], 0.5 * (x[k] + x[k + 1])
        matched = [(w, v) for w in left_windows for v in right_windows if w[0] < v[1] and v[0] < w[1]]
        polygons += [[(x[k], w[0]), (x[k], w[1]), (x[k + 1], v[1]), (x[k + 1], v[0])] for w, v in matched]
        unmatched = [(x[k], w) for w in left_windows if w not in [w for w, _ in matched]]
        unmatched += [(x[k + 1], v) for v in right_windows if v not in [v for _, v in matched]]
        polygons += [[(xk, w[0]), (xk, w[1]), (middle, w[1]), (middle, w[0])] for xk, w in unmatched]
    return polygons


def _find_jumps(curve: np.ndarray) -> np.ndarray:
    """Return the indices of the points before jumps of a curve. A jump is a relative step of more than 5 %
    that is also more than 2.5 times as large as the step on either side."""
    step = np.abs(np.diff(curve)) / np.maximum(curve[:-1], 1e-300)
    neighbours = np.fmax(np.r_[0, step[:-1]], np.r_[step[1:], 0])
    return np.flatnonzero((step > 0.05) & (step > 2.5 * neighbours))


def _draw_with_jumps(ax: Axes, x: np.ndarray, y: np.ndarray, jumps: np.ndarray, **line) -> Any:
    """Draw a line with dotted segments at its jumps; return the line.

    - `ax`: axes to draw into
    - `x`, `y`: points of the line, shape (n,)
    - `jumps`: indices of the points before the jumps
    - `line`: arguments of `Axes.plot`
    """
    (curve,) = ax.plot(np.insert(x, jumps + 1, np.nan), np.insert(y, jumps + 1, np.nan), **line)
    bridge = {"ls": (0, (1, 2)), "lw": 0.8}
    for k in jumps:
        ax.plot(x[k : k + 2], y[k : k + 2], color=curve.get_color(), **bridge)
    if jumps.size:
        _add_legend_entry(
            ax, "jump to another branch", lambda label: ax.plot([], [], color="0.4", label=label, **bridge)
        )
    return curve


def _mark_ends(ax: Axes, x: np.ndarray, minimum: np.ndarray, highest: float, colour: Any) -> None:
    """Draw triangles at the ends of a curve.

    - `ax`, `colour`: axes to draw into, and colour of the curve
    - `x`, `minimum`: points of the curve, shape (n,); `minimum` is not finite where nothing overturns
    - `highest`: end of the search, for the legend. Beyond an end of the curve, no acceleration up to
      `highest` overturns
    """
    is_finite = np.isfinite(minimum)
    ends = is_finite & ~(np.r_[True, is_finite[:-1]] & np.r_[is_finite[1:], True])
    if ends.any():
        mark = {"marker": "^", "ms": 5, "mfc": "none", "ls": "none"}
        ax.plot(x[ends], minimum[ends], color=colour, **mark)
        _add_legend_entry(
            ax,
            f"ends: no overturning beyond,\nup to {highest:g}",
            lambda label: ax.plot([], [], color="0.4", label=label, **mark),
        )


def _add_legend_entry(ax: Axes, label: str, draw: Callable[[str], Any]) -> None:
    """Add a legend entry that stands for the marks of all curves, unless the axes already have it."""
    if label not in ax.get_legend_handles_labels()[1]:
        draw(label)


@styled
def sensitivities(panels: xarray.Dataset) -> Figure:
    """Plot derivatives of the least overturning acceleration with respect to the logarithms of parameters y:
    one row of panels per parameter, one column per η/γ, one curve per T_s.

    `panels` is an overturning spectrum with sensitivities and the further dims `eta_over_gamma` and `T_s`.
    """
    rows, columns = panels.sizes["parameter"], panels.sizes["eta_over_gamma"]
    title = "Sensitivity of the least overturning acceleration"
    figure, axes, _ = grid_of_panels(
        rows, columns, 3.9, 2.4, right=2.4, panels=panels, title=title, sharey="row", left=0.85
    )
    for i, parameter in enumerate(panels["parameter"].values):
        for j in range(columns):
            ax, ratio = axes[i, j], float(panels.eta_over_gamma[j])
            for k in range(panels.sizes["T_s"]):
                panel = panels.isel(eta_over_gamma=j, T_s=k)
                slope = panel["sensitivity"].sel(parameter=parameter).values
                jumps = _find_jumps(panel["minimum"].values)
                label = period_label(panels, ratio, float(panel.T_s))
                _draw_with_jumps(
                    ax, panel["frequency_ratio"].values, slope, jumps, label=label, **curve_style(k)
                )
            ax.axhline(0, color="0.7", lw=0.6, zorder=0)
            ax.set(xlim=(panels["frequency_ratio"].values[0], panels["frequency_ratio"].values[-1]))
            ax.set_xlabel(FREQUENCY_RATIO if i == rows - 1 else "")
            ax.grid(alpha=0.3)
            if i == 0:
                ax.set_title(mass_label(panels, ratio), fontsize=10)
        _set_limits(axes[i, 0], panels["sensitivity"].sel(parameter=parameter).values)
        symbol = symbol_for(str(parameter))
        axes[i, 0].set_ylabel(rf"$\partial a_{{ov}}/\partial\ln {symbol}\;/\;(g\,\tan\alpha)$")
    legend_beside(figure, axes, distance=0.15)
    return figure


def _set_limits(ax: Axes, values: np.ndarray) -> None:
    """Set limits of the vertical axis. They exclude the very large values at the ends of branches."""
    finite = values[np.isfinite(values)]
    if finite.size:
        lo, hi = np.percentile(finite, [2, 96])
        height = hi - lo or 1.0
        ax.set_ylim(min(0, lo) - 0.05 * height, max(0, hi) + 0.1 * height)
