"""Work against error of podiums with devices, of several modes and under vertical motion: `python -m
benchmarks.work_precision_control [points] [methods]`.

Work is counted in trial steps and in operations of a trial, which are the same on every machine, and not in
run time. Errors are against a solution at 1e-13. Writes `benchmarks/results/work_precision_control.json` and
the picture `docs/images/work-precision-control.png`. With methods named, those rows are measured anew and the
others are kept; `draw` for the points draws what is kept.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np

import rockjax as rj
from tests.scenes import operations_of_trial

from .families import family
from .measure import IMAGES, keep, kept, options, podium, show

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
# Down to which tolerance: below it, methods of low order take steps by the thousand and say nothing.
METHODS = {"dopri8": 1e-12, "tsit5": 1e-10, "bosh3": 1e-6}
NAME = "work_precision_control"


def motion_of(name: str, a_p: Any, T_p: Any) -> rj.AbstractExcitation:
    pulse = rj.Ricker(a_p, T_p)
    return rj.GroundMotion(pulse, rj.Ricker(-0.5 * a_p, 0.4 * T_p)) if "vertical" in name else pulse


def measure(points: int, methods: tuple[str, ...], rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Those rows and new ones; kept after each podium."""
    pulses = family("rigid", points)
    for name, structure in PODIUMS.items():
        motion = motion_of(name, pulses.a_p, pulses.T_p)
        solve = lambda rtol, method, structure=structure, motion=motion: rj.peak_responses(
            structure, motion, options=options(rtol, method)
        )
        truth = solve(1e-13, "dopri8")
        for method in methods:
            operations = operations_of_trial(structure, motion_of(name, 3.0, 1.0), options(1e-8, method))
            for rtol in (rtol for rtol in TOLERANCES if rtol >= 0.99 * METHODS[method]):
                found = solve(rtol, method)
                same = np.asarray(found.overturned) == np.asarray(truth.overturned)
                error = np.abs(np.asarray(found.peak_rotation) - np.asarray(truth.peak_rotation))[same]
                trials = np.asarray(found.stats.steps + found.stats.rejected)
                rows.append(
                    {
                        "family": name,
                        "method": method,
                        "rtol": rtol,
                        "trials": float(trials.mean()),
                        "operations": operations,
                        "median": float(np.median(error[error > 0])),
                        "p99": float(np.quantile(error, 0.99)),
                        "max": float(error.max()),
                        "flips": int((~same).sum()),
                    }
                )
                print(rows[-1], flush=True)
        keep(NAME, rows)
    return sorted(
        rows, key=lambda row: (list(PODIUMS).index(row["family"]), list(METHODS).index(row["method"]))
    )


def draw(rows: list[dict[str, Any]]) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    from rockjax.plots import COLOURS, STYLES

    figure, axes = plt.subplots(2, 3, figsize=(12, 7), sharex=True, sharey=True, layout="constrained")
    for ax, name in zip(axes.ravel(), PODIUMS, strict=True):
        for k, method in enumerate(METHODS):
            chosen = [row for row in rows if row["family"] == name and row["method"] == method]
            error, trials = ([row[key] for row in chosen] for key in ("p99", "trials"))
            ax.loglog(
                error, trials, ms=4, marker="o", label=method, color=COLOURS[k], linestyle=STYLES[k % 3]
            )
        ax.set(title=name)
        ax.grid(alpha=0.3)
    axes[0, 0].invert_xaxis()
    axes[0, 0].legend(fontsize=9)
    for ax in axes[1]:
        ax.set_xlabel(r"99th percentile of the error of $\max|\theta|/\alpha$")
    for ax in axes[:, 0]:
        ax.set_ylabel("trial steps of a scene, mean")
    figure.savefig(IMAGES / "work-precision-control.png", dpi=130)


def main(points: str = "20", *methods: str) -> None:
    if points == "draw":
        rows = kept(NAME)
    else:
        others = [row for row in kept(NAME) if row["method"] not in methods] if methods else []
        rows = measure(int(points), methods or tuple(METHODS), others)
        keep(NAME, rows)
    draw(rows)
    forms = {"family": "", "method": "", "rtol": ".0e", "trials": ".0f", "operations": "d"}
    show(rows, forms | {"median": ".1e", "p99": ".1e", "max": ".1e", "flips": "d"})


if __name__ == "__main__":
    main(*sys.argv[1:])
