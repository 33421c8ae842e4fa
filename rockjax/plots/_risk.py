"""Plots of risk: hazard, fragility and contributions of intensities, and the response at a design point."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from rockjax._responses.simulate import simulate
from rockjax._risk.annual import MIN_EXTRAPOLATED
from rockjax._units import displayed

from ._response import response
from ._style import COLOURS, label_log_x, plt, styled

if TYPE_CHECKING:
    import xarray

    from rockjax._risk.rocking import DesignPoint
    from rockjax._structures import Podium


@styled
def risk(dataset: xarray.Dataset) -> Figure:
    """Plot hazard curve, fragility curve and contributions of intensities to the failure rate.

    `dataset` is from [`rockjax.disaggregation`][].
    """
    x, density = dataset["intensity"].values, dataset["density"].values
    # All intensities below `low` together contribute a thousandth of the failure rate, and so do all
    # intensities above `high`.
    integral = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(np.log(x)))])
    low, high = np.interp([1e-3, 1 - 1e-3], integral / integral[-1], x)
    figure = plt.figure(figsize=(5.6, 6.4), layout="constrained")
    axes = figure.subplots(3, 1, sharex=True)
    axes[0].loglog(x, dataset["hazard"], color=COLOURS[0])
    axes[0].plot(dataset["point"], dataset["given"], "o", ms=4, color=COLOURS[0], label="given points")
    axes[0].legend(loc="upper right")
    axes[0].set(ylabel="annual rate of\nexceedance λ [1/year]")
    is_shown = (x > 0.5 * low) & (x < 2 * high)
    rates = dataset["hazard"].values[is_shown]
    axes[0].set_ylim(0.5 * rates.min(), 2 * rates.max())
    axes[1].semilogx(x, dataset["fragility"], color=COLOURS[2])
    axes[1].set(ylabel="probability of\noverturning F [–]", ylim=(-0.02, 1.02))
    median, dispersion = dataset.attrs["median"], dataset.attrs["dispersion"]
    unit = dataset["intensity"].attrs["units"]
    axes[1].set_title(rf"median {median:.3g} {displayed(unit)}, $\beta$ = {dispersion:.2g}", loc="left")
    axes[2].fill_between(x, density, color=COLOURS[1], alpha=0.3, lw=0)
    axes[2].semilogx(x, density, color=COLOURS[1])
    axes[2].set(ylabel="contribution per unit\nof ln(intensity) [–]", ylim=(0, None))
    frequency = dataset.attrs["frequency_per_year"]
    years = float(f"{1 / frequency:.3g}")
    beyond = dataset.attrs.get("extrapolated", 0.0)
    note = f",\n{beyond:.0%} of it from beyond the given points" if beyond > MIN_EXTRAPOLATED else ""
    title = rf"$\lambda_f$ = {frequency:.3g} per year, once in {years:g} years{note}"
    axes[2].set_title(title, loc="left")
    axes[2].set(xlabel=f"{dataset.attrs['measure']} [{displayed(unit)}]", xlim=(0.5 * low, 2 * high))
    label_log_x(axes[2])
    for ax in axes:
        ax.grid(alpha=0.3, which="both")
    return figure


@styled
def design_point(point: DesignPoint, podium: Podium) -> Figure:
    """Plot the response of a podium to the motion of a design point, which lies on the limit state.

    - `point`: one of the design points of the podium from [`rockjax.design_points`][]
    - `podium`: the podium
    """
    figure = response(simulate(podium, point.record))
    impacts = "1 impact" if point.mode == 1 else f"{point.mode} impacts"
    suffix = "" if point.smooth else ", at an edge of the limit state"
    figure.suptitle(rf"Design point: $\beta$ = {point.beta:.2f}, {impacts}{suffix}")
    return figure
