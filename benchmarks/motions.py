"""What a scene costs under each kind of ground motion: `python -m benchmarks.motions`.

The grid of Fig. 6 with pulses of every shape in place of Ricker's, rigid and elastic podiums, rotation alone.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import numpy as np

import rockjax as rj

from .families import Family, family
from .measure import keep, options, podium, shortest, show

MOTIONS: dict[str, Callable[[Family], rj.AbstractExcitation]] = {
    **{
        name: lambda scenes, name=name: getattr(rj, name)(scenes.a_p, scenes.T_p)
        for name in ("Ricker", "AntisymmetricRicker", "OneSine", "OneCosine", "HalfSine")
    },
    "MavroeidisPapageorgiou": lambda scenes: rj.MavroeidisPapageorgiou(
        scenes.a_p * scenes.T_p / (2 * np.pi), 1 / scenes.T_p, 2.0, 0.3
    ),
    "Gabor": lambda scenes: rj.Gabor(scenes.a_p, scenes.T_p, 2.0, 0.3),
    "GroundMotion of two": lambda scenes: rj.GroundMotion(
        rj.OneSine(scenes.a_p, scenes.T_p), rj.OneSine(0.3 * scenes.a_p, 0.4 * scenes.T_p)
    ),
}


def main() -> None:
    points = int(sys.argv[1]) if sys.argv[1:] else 100
    rows: list[dict[str, Any]] = []
    for name in ("rigid", "T_s = 0.5 s"):
        for motion, make in MOTIONS.items():
            scenes = family(name, points)
            structure, motions, how = podium(scenes), make(scenes), options(1e-8)
            trials = float(np.mean(rj.peak_responses(structure, motions, options=how).stats.steps))
            each = shortest(lambda: rj.peak_responses(structure, motions, options=how)) / len(scenes)  # noqa: B023
            row = {"family": name, "motion": motion, "us": each * 1e6, "trials": trials}
            rows.append(row | {"ns a trial": each * 1e9 / trials})
            print(rows[-1], flush=True)
    keep("motions", rows)
    show(rows, {"family": "", "motion": "", "us": ".2f", "trials": ".1f", "ns a trial": ".0f"})


if __name__ == "__main__":
    main()
