"""What a tendon and a damper cost: `python -m benchmarks.restrained`.

Rocking spectra of 100 × 100 Ricker pulses, rotation only, without restrainers and with a tendon and a linear
damper; accelerations relative to those that lift the columns, so that both rock alike. All in turn, the
shortest of several runs, with the trial steps of a scene beside it.
"""

from __future__ import annotations

import math
import time

import numpy as np
import xarray

import rockjax as rj

from .measure import keep, show

RUNS = 7
RATIOS = np.linspace(1, 10, 100)
OPTIONS = rj.Options(outputs=("peak_rotation",))
ALPHA = math.atan(0.15)
STRUCTURES = {
    "solitary block": rj.Podium(ALPHA, 1.5),
    "rigid": rj.Podium(ALPHA, 1.5, 10.0, rj.Rigid(100.0)),
    "elastic": rj.Podium(ALPHA, 1.5, 10.0, rj.Elastic(100.0, 0.5)),
}
PRESTRESS, STIFFNESS, DAMPING = 0.18, 0.5, 1.4  # of a column's share of the weight
Case = tuple[rj.Podium, np.ndarray]


def cases() -> dict[tuple[str, bool], Case]:
    found: dict[tuple[str, bool], Case] = {}
    for name, podium in STRUCTURES.items():
        eta = 0.0 if podium.superstructure is None else podium.superstructure.eta
        weight = float(podium.gamma + eta) + 0.5
        devices = rj.Tendon(PRESTRESS * weight, STIFFNESS * weight), rj.Damper(DAMPING * weight)
        found[name, False] = podium, RATIOS
        found[name, True] = podium.replace(restrainers=devices), RATIOS * (1 + PRESTRESS)
    return found


def spectrum(case: Case) -> xarray.Dataset:
    return rj.rocking_spectrum(case[0], rj.Ricker, RATIOS, case[1], options=OPTIONS)


def seconds(case: Case) -> float:
    began = time.perf_counter()
    spectrum(case)
    return time.perf_counter() - began


def main() -> None:
    every = cases()
    trials = {key: float(spectrum(case).steps.mean()) for key, case in every.items()}
    runs = [{key: seconds(case) for key, case in every.items()} for _ in range(RUNS)]
    best = {key: min(run[key] for run in runs) for key in every}
    rows = [
        {
            "structure": name,
            "steps without": trials[name, False],
            "with": trials[name, True],
            "µs a scene without": 1e6 * best[name, False] / RATIOS.size**2,
            "restrained": 1e6 * best[name, True] / RATIOS.size**2,
            "ratio": best[name, True] / best[name, False],
        }
        for name in STRUCTURES
    ]
    keep("restrained", rows)
    show(rows, {"structure": "", **dict.fromkeys(list(rows[0])[1:], ".2f")})


if __name__ == "__main__":
    main()
