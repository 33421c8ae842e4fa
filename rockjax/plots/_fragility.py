"""Pictures of ensembles: curves of incremental dynamic analysis, and fragility curves."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from rockjax._repr import units

from ._style import COLOURS, on_axes

if TYPE_CHECKING:
    import xarray


def _label(name: str, of: str) -> str:
    return f"{name} [{units(of) or '–'}]"


@on_axes
def incremental_dynamic_analysis(dataset: xarray.Dataset, ax: Axes | None = None) -> Axes:
    """Intensity over peak rotation, a curve for each record; where a record overturns there is no point.

    Crosses on the right are the least intensities that overturn, dots beside them where survival returns and ends again.
    `dataset` is from [`rockjax.incremental_dynamic_analysis`][].
    """
    assert ax is not None
    ratio = dataset.attrs["overturn_ratio"]
    levels = dataset["intensity"].values
    rotation = dataset["peak_rotation"].where(~dataset["overturned"]).values
    boundaries = dataset["boundaries"].values
    for row, places in zip(rotation, boundaries, strict=True):
        ax.plot(np.r_[0, row], np.r_[0, levels], "-", marker=".", ms=3, lw=0.7, color="0.55")
        ax.plot(ratio, places[0], "x", color=COLOURS[1], ms=6, zorder=3)
        further = places[1:][np.isfinite(places[1:])]
        ax.plot(np.full(further.size, 1.05 * ratio), further, ".", ms=3, color=COLOURS[2], zorder=3)
    marks = [
        Line2D([], [], color="0.55", marker=".", ms=3, lw=0.7, label="records, where they survive"),
        Line2D([], [], color=COLOURS[1], marker="x", ls="", label="first overturning"),
        Line2D([], [], color=COLOURS[2], marker=".", ls="", label="further changes of the verdict"),
    ]
    ax.legend(handles=marks, loc="lower right")
    ax.set(
        xlabel=r"peak rotation $\max|\theta|\,/\,\alpha$",
        ylabel=_label(dataset.attrs["measure"], dataset["intensity"].attrs["units"]),
        xlim=(0, 1.1 * ratio),
        ylim=(0, levels[-1]),
    )
    ax.grid(alpha=0.3)
    return ax


@on_axes
def fragility(dataset: xarray.Dataset, ax: Axes | None = None, label: str | None = None, colour: str = COLOURS[2]) -> Axes:
    """Probability of overturning over intensity with its confidence band, over the shares that were observed.

    `dataset` is from [`rockjax.fragility`][]. Crosses are the first overturning
    of the records, circles the shares at the levels. Several may be drawn into one `ax`, each with a `label` and a `colour`.
    """
    assert ax is not None
    x = dataset["at"].values
    median, dispersion = float(dataset["median_capacity"]), float(dataset["dispersion"])
    in_units = f"{median:.3g} {units(dataset['at'].attrs['units'])}".rstrip()
    fit = rf"median {in_units}, $\beta$ = {dispersion:.2g}"
    if "lower" in dataset:
        ax.fill_between(x, dataset["lower"], dataset["upper"], color=colour, alpha=0.2, lw=0)
    ax.plot(x, dataset["probability"], color=colour, label=fit if label is None else f"{label}: {fit}")
    capacity = np.sort(dataset["capacity"].values[np.isfinite(dataset["capacity"].values)])
    total = dataset["capacity"].size
    marks = ("first overturning of the records", "overturned at a level") if label is None else (None, None)
    # Steps of the empirical distribution, in the middle of each.
    share = (np.arange(capacity.size) + 0.5) / total
    ax.plot(capacity, share, "x", ms=5, color=colour, label=marks[0])
    ax.plot(dataset["intensity"], dataset["observed"], "o", ms=4, mfc="none", color=colour, label=marks[1])
    ax.set(
        xlabel=_label(dataset.attrs["measure"], dataset["at"].attrs["units"]),
        ylabel="probability of overturning",
        xlim=(0, x[-1]),
        ylim=(-0.02, 1.02),
    )
    ax.grid(alpha=0.3)
    ax.legend(loc="lower right")
    return ax
