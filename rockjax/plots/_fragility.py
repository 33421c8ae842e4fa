"""Plots of suites of records: incremental dynamic analysis, and fragility curves of podiums and blocks."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from rockjax._units import displayed, displayed_or_empty

from ._outcomes import is_unfinished, survives
from ._style import COLOURS, on_axes, plt, styled

if TYPE_CHECKING:
    import xarray

# Legends are placed above the axes, where they hide nothing.
LEGEND_ABOVE: dict[str, Any] = {
    "loc": "lower left",
    "bbox_to_anchor": (0.0, 1.01),
    "borderaxespad": 0.0,
    "frameon": False,
}
MAX_COLUMNS = 3  # largest number of panels in a row
BAND_OPACITY = 0.2  # opacity of confidence bands


def _with_unit(name: str, unit: str) -> str:
    return f"{name} [{displayed(unit)}]"


@on_axes
def incremental_dynamic_analysis(dataset: xarray.Dataset, ax: Axes | None = None) -> Axes:
    """Plot intensity against peak rotation, one curve for each record, with points at the levels of intensity
    that the columns survive.

    The right edge is the limit state. There, crosses mark the least overturning intensities, and dashes mark
    the boundaries of the survival windows above these intensities. Scenes that did not finish are left out,
    and the legend gives their number. `dataset` is from [`rockjax.incremental_dynamic_analysis`][].
    """
    assert ax is not None
    ratio = dataset.attrs["overturn_ratio"]
    levels = dataset["intensity"].values
    rotation = dataset["peak_rotation"].where(survives(dataset)).values
    boundaries = dataset["boundaries"].values
    for row in rotation:
        ax.plot(np.r_[0, row], np.r_[0, levels], "-", marker=".", ms=3, lw=0.7, color="0.55")
    further_boundaries = boundaries[:, 1:][np.isfinite(boundaries[:, 1:])]
    limit_style = {"ls": "none", "clip_on": False}
    ax.plot(
        np.full(further_boundaries.size, ratio),
        further_boundaries,
        "_",
        ms=9,
        mew=0.6,
        color=COLOURS[2],
        zorder=3,
        **limit_style,
    )
    ax.plot(
        np.full(len(boundaries), ratio),
        boundaries[:, 0],
        "x",
        ms=6,
        color=COLOURS[1],
        zorder=4,
        **limit_style,
    )
    marks = [
        Line2D([], [], color="0.55", marker=".", ms=3, lw=0.7, label="records, at levels that they survive")
    ]
    marks.append(Line2D([], [], color=COLOURS[1], marker="x", ls="", label="first overturning of a record"))
    if further_boundaries.size:
        windows_label = "boundaries of survival windows"
        marks.append(Line2D([], [], color=COLOURS[2], marker="_", ls="", label=windows_label))
    unfinished = is_unfinished(dataset)
    if bool(unfinished.any()):
        label = f"left out: {int(unfinished.sum())} of {unfinished.size} scenes, which did not finish"
        marks.append(Line2D([], [], ls="", label=label))
    ax.legend(handles=marks, **LEGEND_ABOVE)
    ax.set(
        xlabel=r"peak rotation $\max|\theta|\,/\,\alpha$",
        ylabel=_with_unit(dataset.attrs["measure"], dataset["intensity"].attrs["units"]),
        xlim=(0, ratio),
        ylim=(0, levels[-1]),
    )
    ax.grid(alpha=0.3)
    return ax


@on_axes
def fragility(
    dataset: xarray.Dataset, ax: Axes | None = None, label: str | None = None, colour: str = COLOURS[2]
) -> Axes:
    """Plot the probability of overturning against intensity, with the confidence band (if the dataset has
    one) and with observed fractions.

    - `dataset`: dataset of [`rockjax.fragility`][]
    - `ax`: axes to draw into; several curves may share the same axes
    - `label`: name of the curve in the legend
    - `colour`: colour of the curve

    Crosses mark the least overturning intensity of each record. Circles mark the fraction of records that
    overturn the columns at each level of intensity. If the curve has a limit state in addition to
    overturning, records beyond this limit count as overturning; the vertical axis names the limit state.
    """
    assert ax is not None
    x = dataset["at"].values
    median, dispersion = float(dataset["median_capacity"]), float(dataset["dispersion"])
    median_text = f"{median:.3g} {displayed_or_empty(dataset['at'].attrs['units'])}".rstrip()
    fit_text = rf"median {median_text}, $\beta$ = {dispersion:.2g}"
    curve_label = fit_text if label is None else f"{label}: {fit_text}"
    if "lower" in dataset:
        ax.fill_between(x, dataset["lower"], dataset["upper"], color=colour, alpha=BAND_OPACITY, lw=0)
        confidence = dataset.attrs.get("confidence")
        curve_label += ", with its band" if confidence is None else f", with its {confidence:.0%} band"
    ax.plot(x, dataset["probability"], color=colour, label=curve_label)
    label, word = _failure_label(dataset), "overturning"
    if label != "probability of overturning":
        word = "failure"
    values = dataset["capacity"].values
    capacity = np.sort(values[np.isfinite(values)])
    # Crosses lie at the mid-heights of the steps of the empirical distribution.
    fraction = (np.arange(capacity.size) + 0.5) / values.size
    ax.plot(capacity, fraction, "x", ms=5, color=colour, label=f"first {word} of the records")
    observed, levels = dataset["observed"].values, dataset["intensity"].values
    ax.plot(
        levels,
        observed,
        "o",
        ms=4,
        mfc="none",
        color=colour,
        label=_describe_fractions(capacity, values.size, levels, observed, word),
    )
    ax.set(
        xlabel=_with_unit(dataset.attrs["measure"], dataset["at"].attrs["units"]),
        ylabel=label,
        xlim=(0, x[-1]),
        ylim=(-0.02, 1.02),
    )
    ax.grid(alpha=0.3)
    _legend(ax)
    return ax


def _failure_label(dataset: xarray.Dataset) -> str:
    """Return the label of the vertical axis of a fragility curve, which names the limit state."""
    ratio = float(dataset.attrs.get("overturn_ratio", 1.0))
    event = "overturning" if ratio == 1 else f"|θ|/α ≥ {ratio:g}"
    limit = dataset.attrs.get("limit_state")
    return f"probability of {event}" + (f"\nor {limit}" if limit else "")


@styled
def contents_fragility(dataset: xarray.Dataset) -> Figure:
    """Plot the fragility curves of blocks on floors, with confidence bands and observed fractions; a panel
    for each block.

    `dataset` is from [`rockjax.contents_fragility`][]. For damage states without a curve, only the observed
    fractions are drawn.
    """
    names = dataset["contents"].values
    rows = -(-names.size // MAX_COLUMNS)
    columns = min(MAX_COLUMNS, names.size)
    figure = plt.figure(figsize=(1.2 + 2.9 * columns, 0.9 + 2.5 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    for ax, name in zip(axes, names, strict=False):
        block_data = dataset.sel(contents=name)
        for k, state in enumerate(dataset["damage_state"].values):
            curve, colour = block_data.sel(damage_state=state), COLOURS[k % len(COLOURS)]
            if "lower" in curve:
                ax.fill_between(
                    curve["at"], curve["lower"], curve["upper"], color=colour, alpha=BAND_OPACITY, lw=0
                )
            label = _state_label(state, dataset)
            ax.plot(curve["at"], curve["probability"], color=colour, label=label)
            ax.plot(curve["intensity"], curve["observed"], "o", ms=4, mfc="none", color=colour)
        ax.set_title(str(name))
        ax.grid(alpha=0.3)
    measure = _with_unit(dataset.attrs["measure"], dataset["at"].attrs["units"])
    for k in range(axes.size):
        axes[k].set_visible(k < names.size)
        if k + columns >= names.size:
            axes[k].set_xlabel(measure)
            axes[k].tick_params(labelbottom=True)
        if k % columns == 0:
            axes[k].set_ylabel("probability")
    axes[0].set(xlim=(0, float(dataset["at"][-1])), ylim=(-0.02, 1.02))
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=4, frameon=False)
    return figure


def _state_label(state: float, dataset: xarray.Dataset) -> str:
    """Return the legend entry of a damage state, which is a threshold of max|φ|/α_c, with the rotation φ and
    the slenderness α_c of the block. A block overturns where max|φ|/α_c reaches its `overturn_ratio`."""
    if state == 0:
        return "rocks"
    if "contents_overturn_ratio" in dataset and np.all(dataset["contents_overturn_ratio"] == state):
        return "overturns"
    multiple = "" if state == 1 else f"{state:g} "
    return rf"$|\varphi|$ reaches {multiple}$\alpha_c$"


def _describe_fractions(
    capacity: np.ndarray, records: int, levels: np.ndarray, observed: np.ndarray, word: str
) -> str:
    """Return the legend entry of the fractions of records that overturn or fail at the levels of intensity.

    At some levels, the fraction may be lower than the fraction of records whose least overturning intensity
    is at most the level. Then the entry gives the reason.

    - `capacity`: least overturning intensities, ascending
    - `records`: number of records
    - `levels`, `observed`: levels of intensity, and the fractions of records that overturn at these levels
    - `word`: "overturning" or "failure"
    """
    fractions = np.searchsorted(capacity, levels, side="right") / records
    if np.all(observed >= fractions - 1e-9):
        return f"share with {word} at a level"
    return f"share with {word} at a level, lower because\nsome records survive again above their first {word}"


def _legend(ax: Axes) -> None:
    """Draw a legend: first each curve with its band, then the marks, which are the same for all curves and
    therefore grey."""
    entries: list[tuple[Any, str]] = []
    marks: dict[Any, str] = {}
    for handle, text in zip(*ax.get_legend_handles_labels(), strict=True):
        if isinstance(handle, Line2D) and (marker := handle.get_marker()) != "None":
            marks[marker] = max(marks.get(marker, ""), text, key=len)
        elif isinstance(handle, Line2D) and text.endswith("band"):
            entries.append(((Patch(facecolor=handle.get_color(), alpha=BAND_OPACITY), handle), text))
        else:
            entries.append((handle, text))
    entries += [
        (Line2D([], [], color="0.3", marker=marker, mfc="none", ls=""), text)
        for marker, text in marks.items()
    ]
    ax.legend([handle for handle, _ in entries], [text for _, text in entries], **LEGEND_ABOVE)
