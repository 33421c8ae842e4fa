"""Run time against error, per method and family: `python -m benchmarks.work_precision [points]`.

Writes the table to `benchmarks/results/work_precision.json` and the picture to
`docs/images/work-precision.png`.
"""

from __future__ import annotations

import functools
import sys

from .families import PERIODS, family
from .measure import IMAGES, errors, keep, rockjax_peaks, shortest, show
from .peers import numba_loop

TOLERANCES = [10.0**-k for k in range(3, 13)]
METHODS = ("dopri8", "tsit5", "dopri5", "bosh3")


def measure(points: int) -> list[dict]:
    rows = []
    for name in PERIODS:
        scenes = family(name, points)
        for method in (*METHODS, "numba DOP853"):
            for rtol in TOLERANCES:
                # Methods of low order at tight tolerances would take hours and say nothing.
                if (method == "bosh3" and rtol < 1e-7) or (method == "dopri5" and rtol < 1e-11):
                    continue
                solve = (
                    numba_loop.solve
                    if method == "numba DOP853"
                    else lambda s, r, m=method: rockjax_peaks(s, r, m)
                )
                error = errors(solve(scenes, rtol), scenes)
                seconds = shortest(functools.partial(solve, scenes, rtol), 3)
                rows.append(
                    {"family": name, "method": method, "rtol": rtol, "us": seconds / len(scenes) * 1e6}
                    | error
                )
                print(rows[-1], flush=True)
    return rows


def draw(rows: list[dict]) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    from rockjax.plots import COLOURS, STYLES

    figure, axes = plt.subplots(1, len(PERIODS), figsize=(14, 4.2), sharey=True, layout="constrained")
    for ax, name in zip(axes, PERIODS, strict=True):
        for k, method in enumerate((*METHODS, "numba DOP853")):
            chosen = [row for row in rows if row["family"] == name and row["method"] == method]
            peer = method == "numba DOP853"
            look = {
                "color": COLOURS[k],
                "linestyle": ":" if peer else STYLES[k % 3],
                "marker": "s" if peer else "o",
            }
            label = "scalar numba loop, DOP853" if peer else f"rockjax, {method}"
            ax.loglog(
                [row["p99"] for row in chosen], [row["us"] for row in chosen], ms=4, label=label, **look
            )
        ax.set(title=name, xlabel=r"99th percentile of the error of $\max|\theta|/\alpha$")
        ax.invert_xaxis()
        ax.grid(alpha=0.3)
    axes[0].set_ylabel("time per scene, two cores [µs]")
    axes[0].legend(fontsize=8)
    figure.savefig(IMAGES / "work-precision.png", dpi=130)


def main(points: int = 60) -> None:
    rows = measure(points)
    keep("work_precision", rows)
    draw(rows)
    forms = {
        "family": "",
        "method": "",
        "rtol": ".0e",
        "us": ".2f",
        "median": ".1e",
        "p99": ".1e",
        "max": ".1e",
        "flips": "d",
    }
    show(rows, forms)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
