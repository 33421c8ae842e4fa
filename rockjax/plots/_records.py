"""Plot of record spectra: responses of structures of all sizes to records."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from ._style import COLOURS, plt, styled

if TYPE_CHECKING:
    import xarray

MAX_COLOURS = 6  # with more records, all curves are grey and the medians are drawn


@styled
def record_spectrum(dataset: xarray.Dataset) -> Figure:
    """Plot two quantities against the frequency parameter p, with a curve for each record: the PGA of the
    record divided by its least overturning PGA (`demand`), and the largest displacement of the top of the
    columns.

    `dataset` is from [`rockjax.record_spectrum`][]. With more than six records, the curves are grey and
    medians are added. In the medians, a demand of NaN counts as 0, and the displacement of a structure that
    overturns counts as infinite; the median displacement is missing where a scene did not finish.
    """
    p, names = dataset["p"].values, dataset["record"].values
    figure = plt.figure(figsize=(5.6, 5.6), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    is_coloured = len(names) <= MAX_COLOURS
    for k, name in enumerate(names):
        style = {
            "color": COLOURS[k % len(COLOURS)] if is_coloured else "0.7",
            "lw": 1.3 if is_coloured else 0.8,
        }
        upper.plot(p, dataset["demand"][k], label=str(name) if is_coloured else None, **style)
        lower.plot(p, dataset["top_displacement"][k], **style)
    if not is_coloured:
        # The demand is NaN if the least overturning PGA is above the searched range. The displacement is NaN
        # if the structure overturns or the scene did not finish.
        median = np.median(np.nan_to_num(dataset["demand"].values, nan=0.0), axis=0)
        upper.plot(p, np.where(median > 0, median, np.nan), color=COLOURS[0], label="median")
        median_survives = np.sum(~dataset["overturned"].values, axis=0) > len(names) / 2
        values = np.where(dataset["overturned"], np.inf, dataset["top_displacement"])
        lower.plot(p, np.where(median_survives, np.median(values, axis=0), np.nan), color=COLOURS[0])
    upper.axhline(1.0, color="0.4", lw=0.8, ls=(0, (4, 3)))
    upper.annotate("overturns", (p[0], 1.0), (2, 3), textcoords="offset points", color="0.4", fontsize=8)
    upper.set(ylabel="PGA / least\noverturning PGA [–]", ylim=(0, None))
    upper.legend(loc="best")
    lower.set(ylabel=r"$\max|u_b|$ of the top [m]", xlabel=r"frequency parameter $p$ [rad/s]")
    lower.set(ylim=(0, None), xlim=(p[0], p[-1]))
    for ax in (upper, lower):
        ax.grid(alpha=0.3)
    return figure
