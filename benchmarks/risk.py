"""Probabilities of failure of rocking structures: `python -m benchmarks.risk subset|sweep|first-order`.

`subset [minutes] [names of cases]` compares repeated subset simulations with counted failures and prints the
table. It continues from the stored results, for at most `minutes` of processor time. `sweep MOTIONS STORE`
counts failures in a sweep, with one scene for each motion and spectral density S₀. The same command continues
an interrupted sweep, and `subset` includes the counts in the table. `first-order` uses design points. Motions
are proportional to √S₀, so the distances β of the design points are proportional to 1/√S₀.
"""

from __future__ import annotations

import json
import math
import os
import resource
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy.stats import binomtest, norm

import rockjax as rj
from rockjax._risk.reliability import find_design_points, first_order_probability, starting_directions
from rockjax._risk.rocking import limit_state
from rockjax._risk.structure import OPTIONS

from .measure import RESULTS, report, stored_rows_if_any

BATCH = 20_000  # number of scenes in a batch; the time is checked after each batch
COV = 0.1
MAX_SCENES = 1_000_000  # largest number of scenes in a repetition


class Case(NamedTuple):
    """A structure under motions with a spectral density."""

    podium: rj.Podium
    S_0: float  # spectral density [m²/s³]
    scenes: int  # number of scenes in which failures are counted, in addition to those of `sweep`
    repetitions: int = 20  # number of repetitions of subset simulation
    cov: float = COV  # requested coefficient of variation of a repetition


BLOCK = rj.Podium(alpha=0.2, R=1.0)
ELASTIC = rj.Podium(alpha=0.2, R=1.5, gamma=2.0, superstructure=rj.Elastic(5.0, 0.4, 0.05))
CASES = {
    "block 1e-2": Case(BLOCK, 0.0200, 100_000),
    "block 1e-3": Case(BLOCK, 0.0143, 1_000_000),
    "block 1e-4": Case(BLOCK, 0.0114, 13_000_000),
    "block 1e-5": Case(BLOCK, 0.0092, 0, 10, 0.2),
    "block 1e-6": Case(BLOCK, 0.0077, 0, 10, 0.2),
    "elastic 1e-2": Case(ELASTIC, 0.0320, 100_000),
    "elastic 1e-3": Case(ELASTIC, 0.0215, 1_000_000),
    "elastic 1e-4": Case(ELASTIC, 0.0164, 18_000_000),
    "elastic 1e-5": Case(ELASTIC, 0.0133, 0, 10, 0.2),
    "elastic 1e-6": Case(ELASTIC, 0.0112, 0, 10, 0.2),
}


def motion_of(case: Case) -> rj.GaussianMotion:
    return rj.GaussianMotion(61, 0.06, case.S_0)


def count_batch(case: Case, results: dict[str, Any]) -> None:
    """Count the failures of one more batch; each batch has a different seed."""
    limit = limit_state("benchmark", case.podium, motion_of(case), "overturning")
    number = results.setdefault("batches", 0)
    u = np.random.default_rng([11, number]).standard_normal((BATCH, limit.dimension))
    results["failures"] = results.get("failures", 0) + int((limit.values(u) <= 0).sum())
    results["batches"] = number + 1


def repeat_estimate(case: Case, results: dict[str, Any]) -> None:
    """Add a repetition of subset simulation."""
    runs = results.setdefault("runs", [])
    estimate = rj.failure_probability(
        case.podium,
        motion_of(case),
        method="subset",
        cov=case.cov,
        seed=100 + len(runs),
        max_scenes=MAX_SCENES,
    )
    runs.append([estimate.probability, estimate.standard_error, *estimate.interval, estimate.scenes])


def _is_repeated(case: Case, results: dict[str, Any]) -> bool:
    return len(results.get("runs", [])) >= case.repetitions


def _is_counted(case: Case, results: dict[str, Any]) -> bool:
    return results.get("batches", 0) * BATCH >= case.scenes


def advance(minutes: float, names: list[str]) -> dict[str, dict[str, Any]]:
    """Continue the cases one after another until the time is used up, and return all results."""
    path, end = RESULTS / "risk-runs.json", time.process_time() + 60 * minutes
    results: dict[str, dict[str, Any]] = json.loads(path.read_text()) if path.exists() else {}
    for name in names:
        results_of_case = results.setdefault(name, {})
        for step, is_complete in ((count_batch, _is_counted), (repeat_estimate, _is_repeated)):
            while time.process_time() < end and not is_complete(CASES[name], results_of_case):
                step(CASES[name], results_of_case)
                path.write_text(json.dumps(results) + "\n")
    return results


def row(name: str, results: dict[str, Any]) -> dict[str, Any]:
    """Return the row of a case.

    `cov` and `reported cov` are the observed and the mean reported coefficient of variation. `coverage` is
    the share of repetitions whose interval contains the counted probability.
    """
    runs = np.array(results.get("runs", [])).reshape(-1, 5)
    scenes, failures = results.get("batches", 0) * BATCH, results.get("failures", 0)
    sweep_rows = [row for row in stored_rows_if_any("risk-sweep") if row["case"] == name]
    if sweep_rows:  # the sweep has other motions, so its counts can be added
        scenes, failures = scenes + sweep_rows[0]["motions"], failures + sweep_rows[0]["failures"]
    counted = failures / scenes if scenes else math.nan
    low, high = binomtest(failures, scenes).proportion_ci(0.95) if scenes else (math.nan, math.nan)
    p, error, lower, upper, cost = runs.T
    return {
        "case": name,
        "counted": counted,
        "from": float(low),
        "to": float(high),
        "of": scenes,
        "repetitions": len(runs),
        "mean": float(p.mean()),
        "cov": float(p.std(ddof=1) / p.mean()),
        "reported cov": float(np.mean(error / p)),
        "coverage": float(np.mean((lower <= counted) & (counted <= upper))),
        "scenes": float(cost.mean()),
    }


def subset(minutes: str = "0", *names: str) -> None:
    results = advance(float(minutes), list(names) or list(CASES))
    report(
        "risk",
        [
            row(name, results_of_case)
            for name, results_of_case in results.items()
            if len(results_of_case.get("runs", [])) > 1
        ],
    )


COUNTED_CASES = ("block 1e-4", "block 1e-5")
BLOCK_SIZE = 100_000  # number of motions drawn at once


def scenes(motions: int) -> rj.Record:
    """Return motions scaled to the densities of `COUNTED_CASES`, shape (motions, densities)."""
    first = motion_of(CASES[COUNTED_CASES[0]])
    samples = np.empty((motions, 1, first.n))
    for k, start in enumerate(range(0, motions, BLOCK_SIZE)):
        size = min(BLOCK_SIZE, motions - start)
        u = np.random.default_rng([13, k]).standard_normal((size, first.dimension))
        samples[start : start + size, 0] = first.acceleration(jnp.asarray(u))
    # Motions are proportional to √S₀.
    scale = np.sqrt([CASES[name].S_0 / CASES[COUNTED_CASES[0]].S_0 for name in COUNTED_CASES])
    return rj.Record(samples, first.dt, scale)


def sweep(count: str, folder: str) -> None:
    motions, store = int(float(count)), Path(folder)
    before = os.times()
    data = rj.sweep(
        BLOCK,
        scenes(motions),
        ["motion", "density"],
        store=store,
        options=OPTIONS,
        outputs=("margin",),
        progress=sys.stderr.isatty(),
    )
    after = os.times()
    assert not isinstance(data, rj.SweepPlan)
    result = data["result"].to_numpy()
    shared = {
        "scenes": result.size,
        "cpu s": after.user + after.system - before.user - before.system,
        "peak memory [MiB]": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10,
        "disk [MiB]": sum(file.stat().st_size for file in store.rglob("*") if file.is_file()) / 2**20,
        "chunks": int(np.prod([len(sizes) for sizes in data["margin"].chunks or ()])),
        "without an answer": int((result > 2).sum()),
    }
    rows = [
        {"case": name, "motions": motions, "failures": int((result[:, k] == 2).sum())} | shared
        for k, name in enumerate(COUNTED_CASES)
    ]
    report("risk-sweep", rows)


STARTS, SEED = 8, 0


def rows_of(structure: str) -> list[dict]:
    """Return first-order results for the cases of one structure, from the design points of P ≈ 1e-4."""
    name = f"{structure} 1e-4"
    case = CASES[name]
    limit = limit_state("benchmark", case.podium, motion_of(case), "overturning")
    points = find_design_points("benchmark", limit, starting_directions(limit, STARTS, SEED))
    rows = []
    for other_name, other in CASES.items():
        if not other_name.startswith(structure):
            continue
        factor = math.sqrt(case.S_0 / other.S_0)
        scaled_points = points._replace(u=points.u * factor, beta=points.beta * factor)
        nearest = float(scaled_points.beta.min())
        rows.append(
            {
                "case": other_name,
                "S_0": other.S_0,
                "beta": nearest,
                "one": 2 * float(norm.sf(nearest)),
                "all": first_order_probability(scaled_points),
                "points": len(scaled_points.beta),
                "scenes": limit.scenes,
            }
        )
    return rows


def first_orders() -> None:
    report("risk-first-order", [row for kind in ("block", "elastic") for row in rows_of(kind)])


if __name__ == "__main__":
    command, *arguments = sys.argv[1:]
    {"subset": subset, "sweep": sweep, "first-order": first_orders}[command](*arguments)
