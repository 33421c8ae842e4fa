"""Pictures of rocking spectra and overturning spectra."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Literal

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colorbar import Colorbar
from matplotlib.contour import ContourSet
from matplotlib.figure import Figure

from rockjax._studies.spectra import minimum_overturning

from ._style import ACCELERATION_RATIO, FREQUENCY_RATIO, look, on_axes, styled

if TYPE_CHECKING:
    import xarray


@on_axes
def rocking_spectrum(dataset: xarray.Dataset, ax: Axes | None = None, levels=None) -> Axes:
    """Contours of peak rotation over ω_p/p and a_p/(g tan α); overturned cells are left blank."""
    assert ax is not None
    levels = np.arange(0, 1.01, 0.1) if levels is None else levels
    rotation = dataset["peak_rotation"].where(~dataset["overturned"])
    x, y = dataset["frequency_ratio"].values, dataset["acceleration_ratio"].values
    ax.contourf(x, y, rotation.values, levels=levels, cmap="viridis_r", vmin=0, vmax=1)
    ax.set(xlabel=FREQUENCY_RATIO, ylabel=ACCELERATION_RATIO, xlim=(x[0], x[-1]), ylim=(y[0], y[-1]))
    return ax


def rotation_bar(axes: Axes | np.ndarray, cax: Axes | None = None, **bar) -> Colorbar:
    """The colour bar of one rocking spectrum or of several in a figure, beside `axes` or in `cax`.

    `bar` are arguments of `Figure.colorbar`. Raises `ValueError` for axes without a spectrum.
    """
    first: Axes = np.ravel(np.asarray(axes, object))[0]
    contours = next((drawn for drawn in first.collections if isinstance(drawn, ContourSet)), None)
    if contours is None:
        raise ValueError("rotation_bar: the axes hold no rocking spectrum; draw one with plots.rocking_spectrum first")
    place: dict[str, Any] = {"ax": axes} if cax is None else {"cax": cax}
    figure: Any = first.figure
    return figure.colorbar(contours, **place, **{"label": r"peak rotation $\max|\theta|\,/\,\alpha$", **bar})


def dimensional_axes(dataset: xarray.Dataset, ax: Axes, period: bool = True, acceleration: bool = True) -> Axes:
    """Second axes: pulse period T_p on top, peak ground acceleration on the right."""
    p = dataset.attrs["p_rad_s"]
    unit = math.tan(dataset.attrs["alpha_rad"])
    if period:
        top = ax.secondary_xaxis("top", functions=(lambda r: _period(r, p), lambda T: _period(T, p)))
        top.set_xlabel(r"$T_p$ [s]")
        top.set_xticks([T for T in (3, 2, 1, 0.8, 0.6, 0.5, 0.4) if _inside(_period(T, p), ax.get_xlim())])
        top.xaxis.set_major_formatter("{x:g}")
    if acceleration:

        def times_unit(ratio):
            return ratio * unit

        def over_unit(a):
            return a / unit

        right = ax.secondary_yaxis("right", functions=(times_unit, over_unit))
        right.set_ylabel(r"$a_p$ [g]")
    return ax


def _inside(value, limits) -> bool:
    return limits[0] <= value <= limits[1]


def _period(ratio, p):
    """T_p from ω_p/p, and back: each is 2π/p over the other."""
    with np.errstate(divide="ignore"):
        return 2 * math.pi / p / np.asarray(ratio, float)


@on_axes
def overturning_curve(dataset: xarray.Dataset, ax: Axes | None = None, **line) -> Axes:
    """Minimum overturning acceleration over frequency, read off a rocking spectrum."""
    assert ax is not None
    least = minimum_overturning(dataset)
    ax.plot(dataset["frequency_ratio"], least, **line)
    ax.set(xlabel=FREQUENCY_RATIO, ylabel=ACCELERATION_RATIO)
    return ax


@styled
def spectra(panels: xarray.Dataset) -> Figure:
    """Rocking spectra in the layout of the paper's Fig. 6: η/γ down, T_s across.

    `panels` is a rocking spectrum with the further dims `eta_over_gamma` and `T_s`.
    """
    rows, columns = panels.sizes["eta_over_gamma"], panels.sizes["T_s"]
    figure, axes, rest = _panels(rows, columns, width=2.7, height=2.2, right=1.75)
    for i in range(rows):
        for j in range(columns):
            panel, ax = panels.isel(eta_over_gamma=i, T_s=j), axes[i, j]
            rocking_spectrum(panel, ax)
            dimensional_axes(panel, ax, period=i == 0, acceleration=j == columns - 1)
            ax.set_title(rf"$\eta/\gamma = {float(panel.eta_over_gamma):g}$, $T_s = {float(panel.T_s):g}$ s", fontsize=10)
            ax.set_xlabel(FREQUENCY_RATIO if i == rows - 1 else "")
            ax.set_ylabel(ACCELERATION_RATIO if j == 0 else "")
            if bool(panel["overturned"].any()):
                ax.text(0.04, 0.93, "overturned", transform=ax.transAxes, va="top", fontsize=8, color="0.4")
    bar = figure.add_axes((rest + 0.75 / figure.get_figwidth(), 0.25, 0.16 / figure.get_figwidth(), 0.5))
    rotation_bar(axes, cax=bar)
    figure.suptitle(_title(panels))
    return figure


@styled
def overturning_curves(panels: xarray.Dataset) -> Figure:
    """Minimum overturning acceleration in the layout of the paper's Fig. 7: one panel per η/γ, one curve per T_s."""
    return _curves(panels, overturning_curve, "Minimum overturning acceleration")


def _curves(panels: xarray.Dataset, draw, title: str) -> Figure:
    """One panel per η/γ, one curve per T_s."""
    count = panels.sizes["eta_over_gamma"]
    figure, grid, _ = _panels(1, count, width=3.9, height=3.1, right=0.75)
    axes = grid[0]
    for i, ax in enumerate(axes):
        for j in range(panels.sizes["T_s"]):
            panel = panels.isel(eta_over_gamma=i, T_s=j)
            draw(panel, ax, label=rf"$T_s = {float(panel.T_s):g}$ s", **look(j))
        x = panels["frequency_ratio"].values
        top = panels.attrs.get("max_acceleration_ratio") or float(panels["acceleration_ratio"].values[-1])
        ax.set(xlim=(x[0], x[-1]), ylim=(0, top), title=rf"$\eta/\gamma = {float(panels.eta_over_gamma[i]):g}$")
        ax.grid(alpha=0.3)
        dimensional_axes(panels, ax, acceleration=i == count - 1)
        if i:
            ax.set_ylabel("")
    axes[0].legend(title="superstructure", loc="upper left")
    _headed(figure, title, panels)
    return figure


@styled
def overturning_boundaries(panels: xarray.Dataset) -> Figure:
    """Exact minimum overturning curves in the layout of the paper's Fig. 7, windows of survival above them shaded.

    `panels` is an overturning spectrum with the further dims `eta_over_gamma` and `T_s`.
    """
    return _curves(panels, overturning_spectrum, "Overturning boundaries, windows of survival above them shaded")


@on_axes
def overturning_spectrum(dataset: xarray.Dataset, ax: Axes | None = None, **line) -> Axes:
    """Least overturning acceleration over frequency; where scenes survive above it again, in the same colour, shaded."""
    assert ax is not None
    x, minimum = dataset["frequency_ratio"].values, dataset["minimum"].values
    (curve,) = ax.plot(x, _broken(minimum), **line)
    boundaries = dataset["boundaries"].values
    # Overturn, survive, overturn …: a window of survival begins at every second boundary.
    edges = np.concatenate([[x[0]], 0.5 * (x[1:] + x[:-1]), [x[-1]]])
    for start, stop in zip(boundaries[:, 1::2].T, boundaries[:, 2::2].T, strict=False):
        at = np.flatnonzero(np.isfinite(start))
        top = np.where(np.isfinite(stop), stop, dataset.attrs["max_acceleration_ratio"])
        ax.bar(
            edges[at],
            (top - start)[at],
            np.diff(edges)[at],
            start[at],
            align="edge",
            color=curve.get_color(),
            alpha=0.45,
            lw=0,
        )
    ax.set(xlabel=FREQUENCY_RATIO, ylabel=ACCELERATION_RATIO)
    return ax


def _broken(curve: np.ndarray) -> np.ndarray:
    """A curve with a gap where it jumps."""
    jump = np.zeros(curve.shape, bool)
    step = np.abs(np.diff(curve)) / np.maximum(curve[:-1], 1e-300)
    around = np.fmax(np.r_[0, step[:-1]], np.r_[step[1:], 0])
    jump[1:] = (step > 0.05) & (step > 2.5 * around)
    return np.where(jump, np.nan, curve)


@styled
def sensitivities(panels: xarray.Dataset) -> Figure:
    """d a_ov/d ln y along the minimum overturning curves: parameters y down, η/γ across, one curve per T_s.

    `panels` is an overturning spectrum with sensitivities and the further dims `eta_over_gamma` and `T_s`.
    """
    rows, columns = panels.sizes["parameter"], panels.sizes["eta_over_gamma"]
    figure, axes, _ = _panels(rows, columns, width=3.9, height=2.4, right=0.3, sharey="row", left=0.85)
    for i, parameter in enumerate(panels["parameter"].values):
        for j in range(columns):
            ax = axes[i, j]
            for k in range(panels.sizes["T_s"]):
                panel = panels.isel(eta_over_gamma=j, T_s=k)
                slope = panel["sensitivity"].sel(parameter=parameter).values
                slope = np.where(np.isnan(_broken(panel["minimum"].values)), np.nan, slope)
                ax.plot(panel["frequency_ratio"], slope, label=rf"$T_s = {float(panel.T_s):g}$ s", **look(k))
            ax.axhline(0, color="0.7", lw=0.6, zorder=0)
            ax.set(xlim=(panels["frequency_ratio"].values[0], panels["frequency_ratio"].values[-1]))
            ax.set_xlabel(FREQUENCY_RATIO if i == rows - 1 else "")
            ax.grid(alpha=0.3)
            if i == 0:
                ax.set_title(rf"$\eta/\gamma = {float(panels.eta_over_gamma[j]):g}$", fontsize=10)
        finite = panels["sensitivity"].sel(parameter=parameter).values
        finite = finite[np.isfinite(finite)]
        if finite.size:
            lo, hi = np.percentile(finite, [2, 96])
            axes[i, 0].set_ylim(min(0, lo) - 0.05 * (hi - lo), max(0, hi) + 0.1 * (hi - lo))
        symbol = _SYMBOLS.get(str(parameter), str(parameter))
        axes[i, 0].set_ylabel(rf"$\partial a_{{ov}}/\partial\ln {symbol}\;/\;(g\,\tan\alpha)$")
    axes[0, 0].legend(title="superstructure", loc="upper left", fontsize=8)
    _headed(figure, "Sensitivity of the least overturning acceleration", panels)
    return figure


_SYMBOLS = {"alpha": r"\alpha", "gamma": r"\gamma", "eta": r"\eta", "lam": r"\lambda", "zeta": r"\zeta", "restitution": "e"}


def _panels(
    rows: int, columns: int, width: float, height: float, right: float, sharey: Literal["all", "row"] = "all", left=0.65
) -> tuple[Figure, np.ndarray, float]:
    """A figure of equal panels in inches, its axes, and where they end on the right (in parts of its width).

    Laid out by hand: solving for the layout takes longer than the drawing.
    """
    below, above, apart, stacked = 0.55, 1.05, 0.2, 0.45
    w = left + columns * width + (columns - 1) * apart + right
    h = below + rows * height + (rows - 1) * stacked + above
    figure = plt.figure(figsize=(w, h))
    spacing = {"wspace": apart / width, "hspace": stacked / height}
    sides = {"left": left / w, "right": 1 - right / w, "bottom": below / h, "top": 1 - above / h}
    axes = figure.subplots(rows, columns, sharex=True, sharey=sharey, squeeze=False, gridspec_kw=sides | spacing)
    return figure, axes, sides["right"]


def _headed(figure: Figure, title: str, panels: xarray.Dataset) -> None:
    """A title over the figure, in two lines where one would be wider."""
    wide = figure.get_figwidth() > 9
    figure.suptitle(f"{title}{', ' if wide else chr(10)}{_title(panels)}", fontsize=None if wide else 10)


def _title(panels: xarray.Dataset) -> str:
    a = panels.attrs
    return (
        rf"{a['pulse']} pulse, $\gamma = {a['gamma']:g}$, $R = {a['R_m']:.4g}$ m, "
        rf"$\tan\alpha = {math.tan(a['alpha_rad']):.4g}$"
    )
