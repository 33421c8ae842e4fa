"""What a design says of itself: a table, and pictures. Nothing is shown or saved here."""

from __future__ import annotations

import html as _html
from typing import TYPE_CHECKING

import numpy as np

import rockjax as rj
from rockjax import _tables
from rockjax._repr import readable

from . import _variables
from ._objectives import AbstractObjective
from ._results import NAMES, RESULTS

MARKERS = "osD^vP"  # of starts in the picture of the convergence
MOST_STARTS = 8  # in its legend

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from ._answer import Design
    from ._problem import Problem


def _account(design: Design) -> tuple[str, list[list[str]], list[list[str]]]:
    """Headline, rows of the variables, rows of the targets; the first row of each is its heading."""
    state = "satisfied" if design.satisfied else "not satisfied"
    headline = f"{NAMES[int(design.result._value)]}, targets {state}; {design.minimised} = {design.objective:.6g}"
    variables = [["variable", "value", "unit", "bounds"]]
    for name, value in design.variables.items():
        low, high = design.bounds[name]
        at = " (at bound)" if min(value - low, high - value) <= 1e-6 * (high - low) else ""
        variables.append([name, f"{value:.6g}", design.units[name], f"{low:g} … {high:g}{at}"])
    targets = [["target", "worst margin", "of", "price"]]
    for name, margins in design.margins.items():
        price = float(np.sum(design.multipliers[name]))
        shown = "0" if abs(price) <= 1e-9 * abs(design.objective) else f"{price:.4g}"
        targets.append([name, f"{float(np.min(margins)):+.3g}", str(len(margins)), shown])
    return headline, variables, targets


def table(design: Design) -> str:
    """The design in lines: variables, targets with their worst margins and prices, what it took."""
    headline, variables, targets = _account(design)
    lines = [f"Design: {headline}"]
    for rows in (variables, targets):
        lines += _aligned(rows)
    lines += [f"  {sentence}" for sentence in _remarks(design)]
    return "\n".join(lines)


def problem(asked: Problem) -> str:
    """What a file asks for in lines: variables where they start, targets with their scenes, sets of motions."""
    wanted = asked.minimise
    if wanted is None:
        least = "the nearest design"
    elif isinstance(wanted, AbstractObjective):
        least = f"least {wanted.describe()}"
    else:
        least = f"least {getattr(wanted, '__name__', 'objective')}"
    box = _variables.variables(asked.podium, asked.vary)
    start = box.values(box.start())
    rows = [["variable", "start", "unit", "bounds"]]
    for name, value, unit in zip(box.names, start, box.units, strict=True):
        low, high = asked.vary[name]
        rows.append([name, f"{float(value):.6g}", unit, f"{low:g} … {high:g}"])
    targets = [["target", "scenes"], *([target.name or target.describe(), str(target.scenes)] for target in asked.targets)]
    sets = [["motions", "count"], *([name, str(len(motions))] for name, motions in asked.motions.items())]
    lines = [f"Problem: {least}", f"  {readable(asked.podium)}"]
    return "\n".join([*lines, *_aligned(rows), *_aligned(targets), *_aligned(sets)])


def _aligned(rows: list[list[str]]) -> list[str]:
    """Rows under their heading; nothing where there is only that."""
    return [f"  {line}" for line in _tables.lines(rows)] if len(rows) > 1 else []


def _remarks(design: Design) -> list[str]:
    remarks = [RESULTS[design.result]]
    remarks += [f"not satisfied: {name}, short by {-value:.3g}" for name, value in design.failing.items()]
    good = sum(outcome.satisfied for outcome in design.starts)
    if len(design.starts) > 1:
        remarks.append(f"{good} of {len(design.starts)} starts satisfied the targets; best: start {design.best}")
    cost = design.stats
    remarks.append(
        f"{cost.iterations} iterations, {cost.evaluations} evaluations, {cost.scenes} scenes, {cost.seconds:.1f} s"
    )
    return remarks


def html(design: Design) -> str:
    """The same as a table of a notebook."""
    headline, *tables = _account(design)
    parts = [f"<p><b>Design</b>: {_html.escape(headline)}</p>"]
    parts += [_tables.html(rows, heads="row") for rows in tables if len(rows) > 1]
    parts += [f"<p>{_html.escape(sentence)}</p>" for sentence in _remarks(design)]
    return "".join(parts)


def convergence(design: Design, ax: Axes | None = None) -> Axes:
    """Objective over iterations, a line for every start, filled marks where the targets held; the chosen start is black."""
    import matplotlib.pyplot as plt
    from matplotlib.lines import Line2D
    from matplotlib.ticker import MaxNLocator

    from rockjax.plots import COLOURS, STYLES

    ax = ax or plt.figure(figsize=(7.5, 4), layout="constrained").add_subplot()
    others = [start for start in range(len(design.starts)) if start != design.best]
    entries = []
    for k, start in reversed(list(enumerate([design.best, *others]))):
        rows = [row for row in design.history if row.start == start]
        if not rows:
            continue
        colour, marker = COLOURS[k % len(COLOURS)], MARKERS[k % len(MARKERS)]
        numbers = np.array([(row.iteration, row.objective, row.margin) for row in rows])
        look = {"color": colour, "ls": STYLES[k % len(STYLES)], "lw": 0.9 if k else 1.6, "zorder": 2 + (k == 0)}
        ax.plot(numbers[:, 0], numbers[:, 1], **look)
        held = numbers[:, 2] >= 0
        for some, face in ((numbers[held], colour), (numbers[~held], "white")):
            ax.plot(some[:, 0], some[:, 1], marker, ms=4.5, color=colour, mfc=face, zorder=look["zorder"])
        label = f"start {start}" + (", the design" if k == 0 and others else "")
        entries.append(Line2D([], [], marker=marker, ms=4.5, label=label, **look))
    del entries[: max(0, len(entries) - MOST_STARTS)]
    entries = entries[::-1]
    entries.append(Line2D([], [], marker="o", ls="", ms=4.5, color="0.4", label="filled: targets hold"))
    entries.append(Line2D([], [], marker="o", ls="", ms=4.5, color="0.4", mfc="white", label="open: not yet"))
    reached = f"design: {design.objective:.4g}"
    entries.append(ax.axhline(design.objective, color="0.5", lw=0.8, ls=(0, (1, 3)), label=reached))
    unit = (_variables.DIMENSIONS | _variables.FIELDS | design.units).get(design.minimised, "")
    ax.set(xlabel="iteration", ylabel=f"{design.minimised} [{unit}]" if unit else design.minimised)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.grid(alpha=0.3)
    ax.legend(handles=entries, loc="center left", bbox_to_anchor=(1.01, 0.5))
    return ax


def before_after(before: rj.Podium, design: Design, excitation: rj.AbstractExcitation) -> Figure:
    """Rotation of the structure before and after under one motion, each over its own α, and the motion."""
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
