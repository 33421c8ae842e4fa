"""Pictures of `device-design.md`, from the tables of `benchmarks.device_design`.

`python -m benchmarks.device_figures [names]`
"""

from __future__ import annotations

import sys
from collections.abc import Callable

import matplotlib

matplotlib.use("Agg")
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import rockjax as rj
from rockjax import plots
from rockjax._files import write_figure

from .device_design import (
    ABOVE,
    COLUMN,
    ELASTIC,
    LARGEST_INERTANCE,
    LIMIT,
    RIGID,
    SUITES,
    TIGHT,
    fresh_peaks,
    records,
    short_pulses,
)
from .measure import IMAGES, kept

WORST = r"largest $|\theta|\,/\,\alpha$ of all motions"
FORCE = r"$P_0\,/\,(m_c g)$"
NAMES = {"records": "ten records", "pulses": "eight pulses"}
ALL = TIGHT.replace(rtol=1e-8, atol=1e-10)  # the programs are those of the checks


def rotations(podiums: list[rj.Podium], motions) -> np.ndarray:
    """Peak rotations of every podium (rows) under every motion."""
    return np.stack([np.asarray(fresh_peaks(one, motions, ALL).peak_rotation) for one in podiums])


def mark_limit(ax) -> None:
    ax.axhline(LIMIT, color="0.5", lw=0.8, ls="-", zorder=0)


def force() -> plt.Figure:
    """Peak rotations over the prestress, and histories without and with the least one."""
    figure = plt.figure(figsize=(9.5, 3.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    design, above = (row for row in kept("device-force") if row["suite"] == "records")
    sizes = np.linspace(0, 250e3, 251)
    found = rotations(
        [rj.Podium.from_dimensions(**RIGID, tendon_force=jnp.asarray(P)) for P in sizes], records()
    )
    left.plot(sizes / 1e3, found, color="0.75", lw=0.7, ls="-")
    left.plot(sizes / 1e3, found.max(axis=1), color=plots.COLOURS[0], ls="-", label="largest of ten records")
    for k, row in enumerate((design, above)):
        label = ("least prestress", "from 190 kN on")[k]
        force, rotation = row["tendon_force"] / 1e3, row["fresh rotation"]
        left.plot(force, rotation, "os"[k], ls="", color=plots.COLOURS[k + 1], label=label, zorder=3)
    mark_limit(left)
    left.set(
        xlabel=r"prestress of a tendon $P_0$ [kN]",
        ylabel=r"peak $|\theta|\,/\,\alpha$",
        xlim=(0, 250),
        ylim=(0, 1.05),
    )
    left.legend(loc="lower left")
    worst = records()[design["fresh motion"]]
    times = np.linspace(0, 9, 901)
    grey, red, green = (
        {"color": colour, "ls": "-"} for colour in ("0.6", plots.COLOURS[1], plots.COLOURS[3])
    )
    cases = ((0.0, grey), (design["tendon_force"], red), (ABOVE, green))
    for P, look in cases:
        podium = rj.Podium.from_dimensions(**RIGID, tendon_force=jnp.asarray(P))
        history = rj.simulate(podium, worst, options=rj.Options(throw=False))(times)
        label = f"$P_0$ = {P / 1e3:.0f} kN"
        right.plot(times, np.asarray(history.theta) / float(podium.alpha), label=label, **look)
    for side in (-LIMIT, LIMIT):
        right.axhline(side, color="0.5", lw=0.8, ls="-", zorder=0)
    right.set(xlabel=r"$t$ [s]", ylabel=plots.ROTATION, ylim=(-1.2, 1.2), xlim=(0, 9))
    right.legend(loc="lower right")
    return figure


def stiffness() -> plt.Figure:
    """Least prestress and largest force over the stiffness beside it."""
    figure = plt.figure(figsize=(9.5, 3.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    for k, suite in enumerate(SUITES):
        rows = [row for row in kept("device-stiffness") if row["suite"] == suite]
        ladder = [row for row in rows if row["study"] == "prestress alone" or row["study"].startswith("κ")]
        look = {"color": plots.COLOURS[k + 1], "ls": plots.STYLES[k], "marker": "os"[k], "ms": 4}
        x = [row["stiffness"] for row in ladder]
        left.plot(x, [row["prestress"] for row in ladder], label=NAMES[suite], **look)
        right.plot(x, [row["largest force"] for row in ladder], label=NAMES[suite], **look)
        alone = next(row for row in rows if row["study"] == "stiffness alone")
        right.plot(alone["stiffness"], alone["largest force"], "D", color=look["color"], ms=7, mfc="none")
    right.plot([], [], "D", color="0.4", mfc="none", label="stiffness alone")
    left.set(xlabel=r"stiffness $\kappa\,/\,\kappa_{cr}$", ylabel="least prestress " + FORCE, ylim=(0, None))
    right.set(xlabel=r"stiffness $\kappa\,/\,\kappa_{cr}$", xscale="symlog", yscale="log")
    right.set_ylabel(r"largest force $P_\mathrm{max}\,/\,(m_c g)$")
    right.set_xlim(0, 50)
    right.set_xticks([0, 1, 10], ["0", "1", "10"])
    right.set_yticks([4, 10, 20, 50, 100], ["4", "10", "20", "50", "100"])
    right.minorticks_off()
    for ax in (left, right):
        ax.grid(alpha=0.3)
        ax.legend()
    return figure


def damper() -> plt.Figure:
    """Largest rotation and shear over coefficient and exponent of the dampers, with the designs."""
    figure = plt.figure(figsize=(6.2, 4.2), layout="constrained")
    ax = figure.subplots()
    sizes, powers = np.geomspace(2e6, 3e7, 10), np.linspace(0.6, 1.0, 5)
    found = [[fresh_peaks(_damped(C, power), short_pulses(), ALL) for C in sizes] for power in powers]
    worst = np.array([[float(np.max(one.peak_rotation)) for one in row] for row in found])
    shear = np.array([[float(np.max(one.peak_shear)) for one in row] for row in found])
    filled = ax.contourf(sizes / 1e6, powers, worst, levels=np.arange(0, 0.71, 0.05))
    figure.colorbar(filled, ax=ax, label=r"largest $|\theta|\,/\,\alpha$ of six pulses")
    rows = kept("device-damper")
    lines = ax.contour(
        sizes / 1e6, powers, shear, levels=[row["shear"] for row in rows], colors="k", linewidths=0.8
    )
    ax.clabel(lines, fmt="%.3f", fontsize=7)
    for row in rows:
        if row["satisfied"]:
            ax.plot(
                row["damper_coefficient"] / 1e6,
                row["damper_exponent"],
                "o",
                color=plots.COLOURS[1],
                mec="w",
                clip_on=False,
            )
    ax.set(xscale="log", xlabel=r"coefficient $C$ [MN(s/m)$^\nu$]", ylabel=r"exponent $\nu$")
    ax.set_xticks([2, 5, 10, 20, 30], ["2", "5", "10", "20", "30"])
    ax.minorticks_off()
    ax.set_title(r"lines: largest shear $V_s\,/\,(m_t g)$; points: least rotation under them")
    return figure


def _damped(C: float, power: float) -> rj.Podium:
    return rj.Podium.from_dimensions(
        **ELASTIC, damper_coefficient=jnp.asarray(C), damper_exponent=jnp.asarray(power)
    )


def inerter() -> plt.Figure:
    """Largest rotation over the inertance, by both laws of restitution, and the designs."""
    figure = plt.figure(figsize=(9.5, 3.8), layout="constrained")
    rows = kept("device-inerter")
    ratios = np.linspace(0, LARGEST_INERTANCE / COLUMN, 61)
    plain = float(rj.Podium.from_dimensions(**RIGID).restitution_factor)
    for ax, suite in zip(figure.subplots(1, 2, sharey=True), SUITES, strict=True):
        for k, (name, law) in enumerate({"Eq. C12": "paper", "given": plain}.items()):
            podiums = [
                rj.Podium.from_dimensions(**RIGID, inertance=jnp.asarray(COLUMN * mu), restitution=law)
                for mu in ratios
            ]
            look = {"color": plots.COLOURS[k + 1], "ls": plots.STYLES[k]}
            label = r"$e$ by (C12)" if law == "paper" else f"$e$ = {plain:.3f} given"
            ax.plot(ratios, rotations(podiums, SUITES[suite]()).max(axis=1), label=label, **look)
            for row in rows:
                if (row["suite"], row["law"]) == (suite, name) and row["satisfied"]:
                    shape = "o" if row["study"] == "least inertance" else "s"
                    ax.plot(
                        row["inertance"] / COLUMN,
                        row["fresh rotation"],
                        shape,
                        color=look["color"],
                        clip_on=False,
                    )
        mark_limit(ax)
        ax.set(
            xlabel=r"inertance $\mu = b\,/\,m_c$", title=NAMES[suite], xlim=(0, ratios[-1]), ylim=(0, 1.05)
        )
        ax.legend()
    figure.axes[0].set_ylabel(WORST)
    return figure


def vertical() -> plt.Figure:
    """Peak rotations with the vertical component over those without."""
    figure = plt.figure(figsize=(4.6, 4.2), layout="constrained")
    ax = figure.subplots()
    rows = kept("device-vertical")
    for k, ratio in enumerate(sorted({row["ratio"] for row in rows})):
        some = [row for row in rows if row["ratio"] == ratio]
        x, y = (np.array([row[name] for row in some]) for name in ("without", "with"))
        label = rf"PGA = {ratio:g} $g\tan\alpha$"
        ax.plot(x, y, "osD^"[k], color=plots.COLOURS[k + 1], ms=4, mfc="none", label=label, clip_on=False)
    ax.plot([1e-3, 1], [1e-3, 1], color="0.5", lw=0.8, ls="-", zorder=0)
    ax.set(xscale="log", yscale="log", xlim=(1e-3, 1.0), ylim=(1e-3, 1.0), aspect="equal")
    ax.set(
        xlabel=r"peak $|\theta|\,/\,\alpha$, horizontal component alone",
        ylabel=r"peak $|\theta|\,/\,\alpha$ with the vertical one",
    )
    ax.grid(alpha=0.3)
    ax.legend(loc="upper left")
    return figure


PICTURES: dict[str, Callable[[], plt.Figure]] = {
    "force": force,
    "stiffness": stiffness,
    "damper": damper,
    "inerter": inerter,
    "vertical": vertical,
}


def main() -> None:
    for name in sys.argv[1:] or PICTURES:
        with plt.style.context(plots.STYLE):
            write_figure(IMAGES / f"device-{name}.png", PICTURES[name]())


if __name__ == "__main__":
    main()
