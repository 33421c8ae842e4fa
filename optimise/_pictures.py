"""Pictures of a design. Nothing is shown or saved here."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

import rockjax as rj
from rockjax._checks import of_kind
from rockjax._motions.convert import AnyMotion, as_excitation

from ._answer import Design, check_design

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def convergence(design: Design, ax: Axes | None = None) -> Axes:
    """Objective over iterations, a line for every start, filled dots where the targets held; the chosen start is black."""
    check_design("convergence", design)
    import matplotlib.pyplot as plt
    from matplotlib.ticker import MaxNLocator

    from rockjax.plots import COLOURS

    ax = ax or plt.figure(figsize=(6, 4), layout="constrained").add_subplot()
    for start in reversed(range(len(design.starts))):
        rows = [row for row in design.history if row.start == start]
        if not rows:
            continue
        best = start == design.best
        colour = COLOURS[0] if best else "0.7"
        numbers = np.array([(row.iteration, row.objective, row.margin) for row in rows])
        ax.plot(numbers[:, 0], numbers[:, 1], color=colour, lw=1.4 if best else 0.8, zorder=2 if best else 1)
        held = numbers[:, 2] >= 0
        for rows_, face in ((numbers[held], colour), (numbers[~held], "white")):
            ax.plot(rows_[:, 0], rows_[:, 1], "o", ms=4, color=colour, mfc=face, zorder=2 if best else 1)
    ax.plot([], [], "o", color=COLOURS[0], ms=4, label="targets hold")
    ax.plot([], [], "o", color=COLOURS[0], mfc="white", ms=4, label="not yet")
    ax.axhline(design.objective, color=COLOURS[2], lw=0.8, ls="--", label=f"design: {design.objective:.4g}")
    ax.set(xlabel="iteration", ylabel=design.minimised)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.grid(alpha=0.3)
    ax.legend()
    return ax


def before_after(before: rj.Podium, design: Design, excitation: AnyMotion) -> Figure:
    """Rotation of the structure before and after under one motion, each over its own α, and the motion."""
    check_design("before_after", design)
    of_kind("before_after", "before", before, rj.Podium, "a rockjax.Podium")
    excitation = as_excitation("before_after", excitation)
    import matplotlib.pyplot as plt

    from rockjax.plots import COLOURS, ROTATION

    figure = plt.figure(figsize=(8, 5), layout="constrained")
    axes = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    ends = []
    for podium, label, colour, style in ((before, "before", COLOURS[1], "--"), (design.podium, "after", COLOURS[2], "-")):
        response = rj.simulate(podium, excitation)
        t = np.linspace(float(response.times[0]), float(response.stats.end_time), 4000)
        fate = "overturns" if bool(response.overturned) else rf"peak {float(response.peak_rotation):.3g} $\alpha$"
        ratio = np.asarray(response(t).theta) / float(podium.alpha)
        axes[0].plot(t, ratio, color=colour, ls=style, lw=1.2, label=f"{label}: {fate}")
        moving = t[np.abs(ratio) > 1e-3]
        ends.append(moving[-1] if len(moving) else t[0])
    start, support_end = (float(t) for t in excitation.support)
    end = min(max(*ends, min(support_end, start + 60.0)), start + 60.0)
    t = np.linspace(start, end, 4000)
    axes[1].plot(t, np.asarray(excitation(t)) / float(before.g), color=COLOURS[0], lw=1.2)
    for ax in axes:
        ax.axhline(0, color="0.7", lw=0.6, zorder=0)
    axes[0].set_ylabel(ROTATION)
    axes[0].legend(loc="best")
    axes[1].set(ylabel=r"$\ddot u_g$ [g]", xlabel="time [s]", xlim=(start, end))
    return figure
