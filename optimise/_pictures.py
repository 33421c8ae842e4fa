"""Pictures of a design. The functions return axes or a figure, which they neither show nor save."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

import rockjax as rj
from rockjax.internal import DIMENSIONS, AnyMotion, as_excitation, displayed, find_parameter, require_instance

from ._answer import Design, check_design

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


MARKERS = "osD^vP"  # markers of the starts
MAX_STARTS = 8  # largest number of starts in the legend


def convergence(design: Design, ax: Axes | None = None) -> Axes:
    """Plot the objective against the iteration, one line for every start (starting point); return the axes.

    - `design`: a result of [`optimise.design`][]; `ax`: axes to draw in, by default those of a new figure

    Iterates that satisfy the targets have filled markers. The start that gave the design has a black line.
    """
    check_design("convergence", design)
    import matplotlib.pyplot as plt
    from matplotlib.lines import Line2D
    from matplotlib.ticker import MaxNLocator

    from rockjax.plots import COLOURS, STYLES

    ax = ax or plt.figure(figsize=(7.5, 4), layout="constrained").add_subplot()
    others = [start for start in range(len(design.starts)) if start != design.best]
    legend_entries = []
    for k, start in reversed(list(enumerate([design.best, *others]))):
        rows = [row for row in design.history if row.start == start]
        if not rows:
            continue
        colour, marker = COLOURS[k % len(COLOURS)], MARKERS[k % len(MARKERS)]
        iteration, objective, margin = np.array(
            [(row.iteration, row.objective, row.margin) for row in rows]
        ).T
        line_style = {
            "color": colour,
            "ls": STYLES[k % len(STYLES)],
            "lw": 0.9 if k else 1.6,
            "zorder": 2 + (k == 0),
        }
        ax.plot(iteration, objective, **line_style)
        is_satisfied = margin >= 0
        for subset, face in ((is_satisfied, colour), (~is_satisfied, "white")):
            ax.plot(
                iteration[subset],
                objective[subset],
                marker,
                ms=4.5,
                color=colour,
                mfc=face,
                zorder=line_style["zorder"],
            )
        label = f"start {start}" + (", the design" if k == 0 and others else "")
        legend_entries.append(Line2D([], [], marker=marker, ms=4.5, label=label, **line_style))
    # The start that gave the design is drawn last, over the others, and comes first in the legend.
    del legend_entries[: max(0, len(legend_entries) - MAX_STARTS)]
    legend_entries = legend_entries[::-1]
    legend_entries.append(Line2D([], [], marker="o", ls="", ms=4.5, color="0.4", label="targets satisfied"))
    legend_entries.append(
        Line2D([], [], marker="o", ls="", ms=4.5, color="0.4", mfc="white", label="not satisfied")
    )
    objective_label = f"design: {design.objective:.4g}"
    legend_entries.append(
        ax.axhline(design.objective, color="0.5", lw=0.8, ls=(0, (1, 3)), label=objective_label)
    )
    parameter = find_parameter(design.minimised) or DIMENSIONS.get(design.minimised)
    unit = displayed(parameter.unit) if parameter else ""
    ax.set(xlabel="iteration", ylabel=f"{design.minimised} [{unit}]" if unit else design.minimised)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.grid(alpha=0.3)
    ax.legend(handles=legend_entries, loc="center left", bbox_to_anchor=(1.01, 0.5))
    return ax


def before_after(
    before: rj.Podium, design: Design, excitation: AnyMotion, options: rj.Options = rj.Options()
) -> Figure:
    """Plot θ/α of the podium before and after the design under a ground motion, and the motion itself.

    - `before`: the podium before the design; `design`: a result of [`optimise.design`][]
    - `excitation`: the ground motion; `options`: options of the simulations

    The picture ends when both the motion and rocking have ended, at most 60 s after the start of the motion.
    Returns the figure.
    """
    check_design("before_after", design)
    require_instance("before_after", "before", before, rj.Podium, "a rockjax.Podium")
    excitation = as_excitation("before_after", excitation)
    require_instance("before_after", "options", options, rj.Options, "rockjax.Options")
    import matplotlib.pyplot as plt

    from rockjax.plots import COLOURS, ROTATION

    figure = plt.figure(figsize=(8, 5), layout="constrained")
    axes = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    rocking_ends = []
    for podium, label, colour, style in (
        (before, "before", COLOURS[1], "--"),
        (design.podium, "after", COLOURS[2], "-"),
    ):
        response = rj.simulate(podium, excitation, options=options)
        t = np.linspace(float(response.times[0]), float(response.stats.end_time), 4000)
        outcome = (
            "overturns"
            if bool(response.overturned)
            else rf"peak {float(response.peak_rotation):.3g} $\alpha$"
        )
        ratio = np.asarray(response(t).theta) / float(podium.alpha)
        axes[0].plot(t, ratio, color=colour, ls=style, lw=1.2, label=f"{label}: {outcome}")
        rocking_times = t[np.abs(ratio) > 1e-3]
        rocking_ends.append(rocking_times[-1] if len(rocking_times) else t[0])
    start, support_end = (float(t) for t in excitation.support)
    end = min(max(*rocking_ends, min(support_end, start + 60.0)), start + 60.0)
    t = np.linspace(start, end, 4000)
    axes[1].plot(t, np.asarray(excitation(t)) / float(before.g), color=COLOURS[0], lw=1.2)
    for ax in axes:
        ax.axhline(0, color="0.7", lw=0.6, zorder=0)
    axes[0].set_ylabel(ROTATION)
    axes[0].legend(loc="best")
    axes[1].set(ylabel=r"$\ddot u_g$ [g]", xlabel="time [s]", xlim=(start, end))
    return figure
