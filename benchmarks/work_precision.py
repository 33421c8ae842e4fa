"""Work against error for each method and family of scenes.

    python -m benchmarks.work_precision pulses|control [points]

`pulses` measures the run time of rockjax and of a scalar Numba loop for the families of Fig. 6. `control`
solves podiums with devices, with several modes and under vertical motion. It counts trial steps and
operations per trial step, which do not depend on the machine. Errors are relative to a solution at 1e-13.
Both store a table in `benchmarks/results/` and draw it in `docs/images/`; `control draw` only draws it.
"""

from __future__ import annotations

import functools
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np

import rockjax as rj
from tests.scenes import operations_of_trial

from .measure import (
    IMAGES,
    PERIODS,
    difference_quantiles,
    errors,
    family,
    options,
    podium,
    report,
    rockjax_peaks,
    rotations_and_outcomes,
    shortest_time,
    store_rows,
    stored_rows,
)

METHODS = ("dopri8", "tsit5", "dopri5", "bosh3")
NUMBA = "numba DOP853"
# Smallest tolerance of each method; below it, methods of low order take hours.
LIMITS = {"dopri5": 1e-11, "bosh3": 1e-7}


def pulses(points: int = 60) -> None:
    from .peers import numba_loop

    rows = []
    for name in PERIODS:
        scenes = family(name, points)
        for method in (*METHODS, NUMBA):
            solve = numba_loop.solve if method == NUMBA else functools.partial(rockjax_peaks, method=method)
            for rtol in (10.0**-k for k in range(3, 13)):
                if rtol < 0.99 * LIMITS.get(method, 0.0):
                    continue
                row = {"family": name, "method": method, "rtol": rtol}
                row["us"] = shortest_time(functools.partial(solve, scenes, rtol), 3) / len(scenes) * 1e6
                rows.append(row | errors(solve(scenes, rtol), scenes))
                print(rows[-1], flush=True)
    report("work_precision", rows)
    draw(rows, "us", (1, 4), (14, 4.2), "time per scene, two cores [µs]", "work-precision.png")


RIGID, ELASTIC = (podium(family(name, 1)) for name in ("rigid", "T_s = 0.5 s"))
KAPPA = 0.4 * float(RIGID.critical_stiffness)
PODIUMS = {
    "rigid, nothing added": RIGID,
    "rigid, tendon and linear damper": RIGID.replace(restrainers=(rj.Tendon(20.0, KAPPA), rj.Damper(150.0))),
    "rigid, damper of ν = ½": RIGID.replace(restrainers=(rj.Damper(30.0, 0.5),)),
    "rigid, vertical motion": RIGID,
    "elastic, nothing added": ELASTIC,
    "three modes": ELASTIC.replace(superstructure=rj.Modes((80.0, 14.0, 6.0), (0.5, 0.17, 0.1))),
}
TOLERANCES = tuple(10.0**-k for k in (4, 6, 8, 10, 12))
CONTROL_LIMITS = {"dopri8": 1e-12, "tsit5": 1e-10, "bosh3": 1e-6}


def motion_of(name: str, a_p: Any, T_p: Any) -> rj.AbstractExcitation:
    pulse = rj.Ricker(a_p, T_p)
    return rj.GroundMotion(pulse, rj.Ricker(-0.5 * a_p, 0.4 * T_p)) if "vertical" in name else pulse


def control(points: int = 20) -> None:
    rows: list[dict[str, Any]] = []
    scenes = family("rigid", points)
    for name, structure in PODIUMS.items():
        motion = motion_of(name, scenes.a_p, scenes.T_p)
        solve = functools.partial(rj.peak_responses, structure, motion)
        truth = rotations_and_outcomes(solve(options=options(1e-13)))
        for method, limit in CONTROL_LIMITS.items():
            operations = operations_of_trial(structure, motion_of(name, 3.0, 1.0), options(1e-8, method))
            for rtol in (rtol for rtol in TOLERANCES if rtol >= 0.99 * limit):
                peaks = solve(options=options(rtol, method))
                trials = float(np.mean(peaks.stats.steps + peaks.stats.rejected))
                row = {"family": name, "method": method, "rtol": rtol, "trials": trials}
                rotations, outcomes = rotations_and_outcomes(peaks)
                row |= {"operations": operations} | difference_quantiles((rotations, outcomes), truth)
                error = np.abs(rotations - truth[0])[outcomes == truth[1]]
                rows.append(row | {"median": float(np.median(error[~(error == 0)]))})
                print(rows[-1], flush=True)
        store_rows("work_precision_control", rows)
    report("work_precision_control", rows)
    draw_control()


def draw_control() -> None:
    size, name = (12, 7), "work-precision-control.png"
    draw(stored_rows("work_precision_control"), "trials", (2, 3), size, "trial steps of a scene, mean", name)


def draw(
    rows: list[dict[str, Any]], work: str, grid: tuple[int, int], size: Sequence[float], axis: str, name: str
) -> None:
    """Draw the work against the error: a panel for each family, a line for each method."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    from rockjax.plots import COLOURS, STYLES

    figure, axes = plt.subplots(*grid, figsize=size, sharex=grid[0] > 1, sharey=True, layout="constrained")
    methods = dict.fromkeys(row["method"] for row in rows)
    for ax, label in zip(axes.ravel(), dict.fromkeys(row["family"] for row in rows), strict=True):
        for k, method in enumerate(methods):
            chosen = [row for row in rows if (row["family"], row["method"]) == (label, method)]
            x, y = ([row[key] for row in chosen] for key in ("p99", work))
            style, marker = (":", "s") if method == NUMBA else (STYLES[k % 3], "o")
            ax.loglog(x, y, ms=4, label=method, color=COLOURS[k], linestyle=style, marker=marker)
        ax.set(title=label)
        ax.grid(alpha=0.3)
        if grid[0] == 1:
            ax.invert_xaxis()
    if grid[0] > 1:
        axes[0, 0].invert_xaxis()
    axes.ravel()[0].legend(fontsize=8)
    figure.supxlabel(r"99th percentile of the error of $\max|\theta|/\alpha$")
    figure.supylabel(axis)
    figure.savefig(IMAGES / name, dpi=130)


if __name__ == "__main__":
    command, *arguments = sys.argv[1:]
    if arguments == ["draw"]:
        draw_control()
    else:
        {"pulses": pulses, "control": control}[command](*map(int, arguments))
