"""Work against error of podiums with devices, of several modes and under vertical motion: `python -m
benchmarks.work_precision_control [points] [methods]`.

Work is counted in trial steps and in operations of a trial, which are the same on every machine, and not in
run time. Errors are against a solution at 1e-13. Writes `benchmarks/results/work_precision_control.json`.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np

import rockjax as rj
from tests.scenes import operations_of_trial

from .families import family
from .measure import keep, options, podium, show

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
METHODS = ("dopri8", "tsit5")
TOLERANCES = tuple(10.0**-k for k in (4, 6, 8, 10, 12))


def motion_of(name: str, a_p: Any, T_p: Any) -> rj.AbstractExcitation:
    pulse = rj.Ricker(a_p, T_p)
    return rj.GroundMotion(pulse, rj.Ricker(-0.5 * a_p, 0.4 * T_p)) if "vertical" in name else pulse


def measure(points: int, methods: tuple[str, ...]) -> list[dict[str, Any]]:
    pulses, rows = family("rigid", points), []
    for name, structure in PODIUMS.items():
        motion = motion_of(name, pulses.a_p, pulses.T_p)
        solve = lambda rtol, method, structure=structure, motion=motion: rj.peak_responses(
            structure, motion, options=options(rtol, method)
        )
        truth = solve(1e-13, "dopri8")
        for method in methods:
            operations = operations_of_trial(structure, motion_of(name, 3.0, 1.0), options(1e-8, method))
            for rtol in TOLERANCES:
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
    return rows


def main(points: str = "20", *methods: str) -> None:
    rows = measure(int(points), methods or METHODS)
    keep("work_precision_control", rows)
    forms = {"family": "", "method": "", "rtol": ".0e", "trials": ".0f", "operations": "d"}
    show(rows, forms | {"median": ".1e", "p99": ".1e", "max": ".1e", "flips": "d"})


if __name__ == "__main__":
    main(*sys.argv[1:])
