"""Run time of records against error, and time of three peaks and of analyses: `python -m benchmarks.records`.

The benchmark solves 20 synthetic records of 2000 samples (dt = 0.01 s), each at 50 scales from 0.5 to 12 g
tan α, for the podium of Fig. 6 at η/γ = 10. Errors of max|θ|/α are relative to rockjax at rtol = 1e-13,
which an independent Taylor integrator has confirmed for chattering columns. `--peer FILE` adds another
implementation: a Python file with a function `sweep(params, "record", scales, ones, rtol=, atol=, cert=,
track=, parallel=, record=(times, samples))` that solves the scales of one record on all cores.

Writes the tables to `benchmarks/results/records.json` and the picture to
`docs/images/records-precision.png`.

`python -m benchmarks.records --ensemble 10000` only solves an ensemble of 10 000 random elastic podiums under
records of 10 s, and writes `benchmarks/results/ensemble.json`.
"""

from __future__ import annotations

import argparse
import datetime
import functools
import importlib.util
import math
import os
import platform
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

import rockjax as rj

from .measure import (
    IMAGES,
    PERIODS,
    ROTATION,
    Family,
    G,
    difference_quantiles,
    options,
    podium,
    report,
    rotations_and_outcomes,
    shortest_time,
    show,
    store_rows,
)

RECORDS, SAMPLES, DT = 20, 2000, 0.01
LEVELS = np.linspace(0.5, 12.0, 50)  # PGA divided by g tan α
PEAKS = ("peak_rotation", "peak_deformation", "peak_shear")
TOLERANCES = [10.0**-k for k in range(3, 13)]
METHODS = ("dopri8", "tsit5")
REFERENCE = 1e-13
Answer = tuple[np.ndarray, np.ndarray]  # peaks and overturned, shape (records, levels)


class Suite:
    """The records, and the scales that bring each record to its levels."""

    def __init__(self):
        motions = rj.synthetic_motions(RECORDS, seed=1, dt=DT)
        self.samples = np.stack([np.asarray(motion.acceleration)[:SAMPLES] for motion in motions])
        uplift = G * math.tan(Family.alpha)
        self.scales = LEVELS * uplift / np.abs(self.samples).max(axis=1)[:, None]
        self.records = rj.Records.of([rj.Record(row, DT) for row in self.samples])
        self.scenes = self.records.pick(np.arange(RECORDS)[:, None]).scaled(self.scales)
        self.intensity = np.linspace(0.5, 12.0, 12) * uplift

    def solve(self, structure: rj.Podium, options: rj.Options) -> Answer:
        return rotations_and_outcomes(rj.peak_responses(structure, self.scenes, options=options))


def by_peer(peer: ModuleType, suite: Suite, scenes: Family, rtol: float) -> Answer:
    params = {"alpha": scenes.alpha, "R": scenes.R, "gamma": scenes.gamma, "eta": scenes.eta}
    params |= {"T_s": scenes.T_s, "zeta": scenes.zeta}
    rows = []
    for samples, scales in zip(suite.samples, suite.scales, strict=True):
        record = DT * np.arange(SAMPLES), samples
        settings = {"rtol": rtol, "atol": 0.01 * rtol, "cert": True, "track": False, "parallel": True}
        rows.append(peer.sweep(params, "record", scales, np.ones(scales.size), record=record, **settings))
    return np.stack([row["peak"] for row in rows]), np.stack([row["overturned"] for row in rows])


def precision(suite: Suite, peer: ModuleType | None) -> list[dict[str, Any]]:
    """Return the time per scene and the error for each method and tolerance."""
    rows = []
    for name, period in PERIODS.items():
        scenes = Family(period, np.zeros(0), np.zeros(0))
        structure = podium(scenes)
        truth = suite.solve(structure, options(REFERENCE))
        solvers: dict[str, Callable[[float], Answer]] = {
            f"rockjax, {method}": functools.partial(_ours, suite, structure, method) for method in METHODS
        }
        if peer is not None:
            solvers["numba loop, DOP853"] = functools.partial(by_peer, peer, suite, scenes)
        for rtol in TOLERANCES:
            for solver, solve in solvers.items():
                row = {"family": name, "by": solver, "rtol": rtol} | difference_quantiles(solve(rtol), truth)
                rows.append(
                    row | {"us": 1e6 * shortest_time(functools.partial(solve, rtol), 3) / truth[0].size}
                )
                print(rows[-1], flush=True)
    return rows


def _ours(suite: Suite, structure: rj.Podium, method: str, rtol: float) -> Answer:
    return suite.solve(structure, options(rtol, method))


def compare_times(suite: Suite, peer: ModuleType | None) -> list[dict[str, Any]]:
    """Return times for the rotation alone, three peaks, a complete analysis and the peer, at rtol = 1e-8."""
    rows = []
    for name, period in PERIODS.items():
        scenes = Family(period, np.zeros(0), np.zeros(0))
        structure = podium(scenes)
        analysis = functools.partial(rj.incremental_dynamic_analysis, structure, suite.records)
        times: dict[str, Callable[[], Any]] = {
            "rotation [ms]": functools.partial(suite.solve, structure, options(1e-8)),
            "three peaks [ms]": functools.partial(suite.solve, structure, options(1e-8, outputs=PEAKS)),
            "analysis [ms]": functools.partial(analysis, suite.intensity),
        }
        if peer is not None:
            times["numba [ms]"] = functools.partial(by_peer, peer, suite, scenes, 1e-8)
        # The cases alternate, so that other load of the machine affects all of them.
        shortest = dict.fromkeys(times, math.inf)
        for _ in range(3):
            for case, work in times.items():
                time = 1e3 * shortest_time(work, 1 if "analysis" in case else 4)
                shortest[case] = min(shortest[case], time)
        rows.append({"family": name} | shortest)
        print(rows[-1], flush=True)
    return rows


def ensemble(scenes: int) -> list[dict[str, Any]]:
    """Return the time of an ensemble of random podiums with T_s ≈ 0.5 s under 20 records of 10 s, at
    rtol = 1e-8, for the rotation alone and for all peaks with estimated errors."""
    from scipy import stats

    base = podium(Family(0.5, np.zeros(0), np.zeros(0))).replace(restitution=0.9)
    motions = rj.synthetic_motions(
        RECORDS, seed=1, dt=DT, duration=10.0, pga=2.0 * G * math.tan(Family.alpha)
    )
    spread = {
        "alpha": stats.truncnorm(-3.0, 3.0, Family.alpha, 0.05 * Family.alpha),
        "restitution": stats.uniform(0.85, 0.1),
        "T_s": stats.lognorm(0.1, scale=0.5),
        "zeta": stats.uniform(0.02, 0.06),
        "initial.theta": stats.norm(0.0, 0.001),
    }
    rows = []
    for outputs in (ROTATION, (*PEAKS, "errors")):
        solve = lambda outputs=outputs: rj.ensemble(
            base, motions, spread=spread, n=scenes, seed=1, options=options(1e-8, outputs=outputs)
        )
        seconds, found = shortest_time(solve, 3), solve()
        counts = found.counts | {"uplifted": int(np.sum(found.data["uplifted"]))}
        machine = {"cpu": _cpu(), "load": os.getloadavg()[0], "date": datetime.date.today().isoformat()}
        rows.append({"outputs": " ".join(outputs), "seconds": seconds} | counts | machine)
    return rows


def _cpu() -> str:
    """Return the name of the processor."""
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()


def draw(rows: list[dict[str, Any]]) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    from rockjax.plots import COLOURS

    figure, axes = plt.subplots(1, len(PERIODS), figsize=(14, 4.2), sharey=True, layout="constrained")
    for ax, name in zip(axes, PERIODS, strict=True):
        for k, solver in enumerate(dict.fromkeys(row["by"] for row in rows)):
            chosen = [row for row in rows if row["family"] == name and row["by"] == solver]
            x, y = ([row[key] for row in chosen] for key in ("p99", "us"))
            line = ":" if solver.startswith("numba") else "-"
            ax.loglog(x, y, ms=4, color=COLOURS[k], linestyle=line, marker="so"[line == "-"], label=solver)
        ax.set(title=name, xlabel=r"99th percentile of the error of $\max|\theta|/\alpha$")
        ax.invert_xaxis()
        ax.grid(alpha=0.3)
    axes[0].set_ylabel("time per scene, two cores [µs]")
    axes[0].legend(fontsize=8)
    figure.savefig(IMAGES / "records-precision.png", dpi=130)


def _module(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--peer", type=Path, help="a file with another implementation")
    parser.add_argument("--ensemble", type=int, metavar="SCENES", help="solve only an ensemble")
    arguments = parser.parse_args()
    if arguments.ensemble:
        report("ensemble", ensemble(arguments.ensemble))
        return
    peer = None if arguments.peer is None else _module(arguments.peer)
    suite = Suite()
    times = compare_times(suite, peer)
    rows = precision(suite, peer)
    store_rows("records", [*times, *rows])
    draw(rows)
    show(times)
    show(rows)


if __name__ == "__main__":
    main()
