"""Plot of the peaks under the motions of a set."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rockjax._outputs.base import worst_component
from rockjax._outputs.registry import VARIABLES
from rockjax._units import displayed

from ._outcomes import is_unfinished, survives
from ._style import COLOURS, plt, styled

if TYPE_CHECKING:
    import xarray

MAX_COLUMNS = 3  # largest number of panels in a row


@styled
def peaks(dataset: xarray.Dataset, outputs: Sequence[str] | None = None) -> Figure:
    """Plot the peaks under each motion of a set, a panel for each output.

    - `dataset`: peaks along the dim `motion`, as written by `rockjax peaks`
    - `outputs`: names of outputs such as `"peak_rotation"`; by default all peaks of the dataset

    Each panel shows the worst story or joint. For motions that overturn the columns, an open mark shows the
    peak until overturning. A cross at the left edge marks a motion whose scene did not finish. The dashed
    line is the median over the motions that the columns survive, if this median is finite. An arrow at the
    right edge marks a value that is not finite. For example, the friction demand is infinite if a joint
    opens.

    Raises `ValueError` for outputs that the dataset does not have, and for a dataset without peaks.
    """
    available = [name for name, (y, _) in VARIABLES.items() if name in dataset and y.until_overturning]
    names = available if outputs is None else list(outputs)
    if not names:
        raise ValueError(
            "plots.peaks: the dataset has no peaks to draw; request an output such as 'peak_rotation'"
        )
    for name in names:
        if name not in available:
            raise ValueError(f"plots.peaks: outputs must be among {', '.join(available)}; got {name!r}")
    labels = dataset["motion"].values.astype(str)
    columns = min(MAX_COLUMNS, len(names))
    rows = math.ceil(len(names) / columns)
    height = 0.9 + 0.19 * min(labels.size, 40)
    figure = plt.figure(figsize=(1.8 + 2.4 * columns, rows * height), layout="constrained")
    axes = figure.subplots(rows, columns, sharey=True, squeeze=False).ravel()
    for ax, name in zip(axes, names, strict=False):
        _draw(ax, dataset, name)
    for ax in axes[len(names) :]:
        ax.set_visible(False)
    step = math.ceil(labels.size / 40)  # longer lists of names would overlap
    for ax in axes:
        ax.set_yticks(np.arange(0, labels.size, step), labels[::step], fontsize="small")
    axes[0].set_ylim(labels.size - 0.5, -0.5)
    if axes[0].get_legend_handles_labels()[0]:
        axes[0].legend(loc="best", fontsize="small")
    return figure


def _draw(ax: Axes, data: xarray.Dataset, name: str) -> None:
    """Draw the values of an output, a mark for each motion."""
    variable, _ = VARIABLES[name]
    values = worst_component(name, data[name].values)
    survived, unfinished = survives(data).values, is_unfinished(data).values
    overturned = ~survived & ~unfinished
    rows, is_finite = np.arange(values.size), np.isfinite(values)
    with_line = rows[is_finite & ~unfinished]
    ax.hlines(with_line, 0, values[with_line], color="0.8", lw=0.8)
    for is_chosen, colour, face in ((survived, COLOURS[2], COLOURS[2]), (overturned, COLOURS[1], "white")):
        label = "until overturning" if face == "white" and overturned.any() else None
        finite_rows, infinite_rows = rows[is_chosen & is_finite], rows[is_chosen & ~is_finite]
        ax.plot(values[finite_rows], finite_rows, "o", ms=4, color=colour, mfc=face, label=label)
        at_edge = np.full(infinite_rows.size, 0.97)
        ax.plot(at_edge, infinite_rows, ">", ms=5, color=colour, mfc=face, transform=ax.get_yaxis_transform())
    if unfinished.any():
        at_edge = np.full(unfinished.sum(), 0.03)
        transform = ax.get_yaxis_transform()
        label = "did not finish"
        ax.plot(at_edge, rows[unfinished], "x", ms=5, color="0.4", transform=transform, label=label)
    median = np.median(values[survived]) if survived.any() else np.inf
    if np.isfinite(median):
        ax.axvline(float(median), color="0.4", ls="--", lw=0.8)
    unit = displayed(variable.unit)
    symbol = variable.symbol.replace("/", " / ") if variable.symbol else name
    ax.set_xlabel(f"{symbol} [{unit}]", fontsize="small")
    ax.grid(True, axis="x", alpha=0.3)
