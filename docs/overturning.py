"""Draw the pictures of `overturning.md` and prints its numbers: `python docs/overturning.py`."""

from __future__ import annotations

import math
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

import optimise
import rockjax as rj
from rockjax import plots

IMAGES = Path(__file__).parent / "images"
ALPHA = math.atan(0.15)
RIGID = rj.Podium(ALPHA, 1.5, 10.0, rj.Rigid(100.0))
ELASTIC = rj.Podium(ALPHA, 1.5, 10.0, rj.Elastic(100.0, 0.5))
FRAME = rj.Podium(ALPHA, 1.5, 110.0)
UNIT = float(FRAME.g) * 0.15
COLUMN = optimise.Dimensions(
    width=0.45, height=3.0, column_mass=1.5e3, beam_mass=30e3, top_mass=300e3, period=0.5
)


def save(figure, name: str) -> None:
    figure.savefig(IMAGES / f"{name}.png", dpi=120)
    plt.close(figure)


def margins() -> None:
    """Draw the margin and the peak rotation on both sides of the boundary."""
    ratio = np.linspace(0.8, 6.0, 400)
    options = rj.Options(rtol=1e-10, atol=1e-12, outputs=("peak_rotation", "margin"))
    figure = plt.figure(figsize=(10, 3.8), layout="constrained")
    axes = figure.subplots(1, 2, sharex=True)
    cases = (("rigid", RIGID, 1.0), (r"$T_s = 0.5$ s", ELASTIC, 1.0), ("frame, bands of both", FRAME, 1.4187))
    for k, (label, podium, T_p) in enumerate(cases):
        peaks = rj.peak_responses(podium, rj.Ricker(ratio * UNIT, T_p), options=options)
        line_style = {
            "color": plots.COLOURS[k],
            "ls": plots.STYLES[k],
            "label": f"{label}, $T_p = {T_p:g}$ s",
        }
        axes[0].plot(ratio, peaks.peak_rotation, **line_style)
        axes[1].plot(ratio, peaks.margin, **line_style)
    axes[0].set(
        xlabel=plots.ACCELERATION_RATIO, ylabel=r"$\max|\theta|\,/\,\alpha$", xlim=(ratio[0], ratio[-1])
    )
    axes[1].set(
        xlabel=plots.ACCELERATION_RATIO,
        ylabel="overturning margin $M$",
        ylim=(-2.2, 1.05),
        xlim=(ratio[0], ratio[-1]),
    )
    for ax in axes:
        ax.axhline(0, color="0.7", lw=0.6, zorder=0)
        ax.grid(alpha=0.3)
    axes[0].legend(loc="lower right")
    save(figure, "margin")


def windows() -> None:
    """Draw the windows of survival and all boundaries of the frame near the fold of its lowest branch."""
    x = np.linspace(1.45, 2.1, 261)
    scanned = rj.overturning_spectrum(FRAME, rj.Ricker, x, max_acceleration_ratio=3.0)
    figure = plt.figure(figsize=(8, 4.6), layout="constrained")
    ax = plots.overturning_spectrum(
        scanned, figure.add_subplot(), color=plots.COLOURS[2], lw=1.6, label="minimum"
    )
    line_style = {"color": plots.COLOURS[0], "ls": "", "marker": ".", "ms": 2}
    for k, boundary in enumerate(scanned["boundaries"].values.T):
        ax.plot(x, boundary, **line_style, label="all boundaries" if k == 0 else None)
    ax.set(
        xlim=(x[0], x[-1]),
        ylim=(1.4, 2.7),
        title="windows of survival (shaded) above the minimum, frame of Section 4",
    )
    ax.grid(alpha=0.3)
    ax.legend(loc="upper left")
    save(figure, "survival-windows")


def charts() -> None:
    """Draw the slimmest safe column and the smallest safe γ against the period of the pulse."""
    figure = plt.figure(figsize=(10, 4), layout="constrained")
    axes = figure.subplots(1, 2)
    T_p = np.linspace(0.3, 2.0, 120)
    chart = optimise.design_chart(COLUMN, ("width", (0.1, 1.5)), rj.Ricker, [2.0, 3.0, 4.0], T_p)
    optimise.plot_chart(chart, axes[0])
    axes[0].set_title("3 m column, elastic building, $T_s = 0.5$ s", fontsize=10)
    frame = rj.Podium(ALPHA, 1.5)
    amplitudes = np.array([2.95, 3.1, 3.25]) * UNIT
    p = float(frame.p)
    short = np.linspace(2 * math.pi / (4.0 * p), 2 * math.pi / (2.6 * p), 81)
    chart = optimise.design_chart(frame, ("gamma", (0.0, 60.0)), rj.Ricker, np.round(amplitudes, 2), short)
    optimise.plot_chart(chart, axes[1])
    axes[1].set_title(r"rigid frame, $\tan\alpha = 0.15$, $R = 1.5$ m", fontsize=10)
    save(figure, "design-charts")


if __name__ == "__main__":
    margins()
    windows()
    charts()
