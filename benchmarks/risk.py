"""Probabilities of failure of rocking structures: subset simulation, repeated, beside counting.

`python -m benchmarks.risk [minutes] [names of cases]` goes on from what is kept, for so many minutes of
processor time at most, and prints the table. What `benchmarks.risk_sweep` has counted is in it.
"""

from __future__ import annotations

import json
import math
import sys
import time
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import binomtest

import rockjax as rj
from rockjax.internal import limit_state

from .measure import RESULTS, keep, kept_so_far, show

BATCH = 20_000  # scenes counted between two looks at the clock
COV = 0.1
MAX_SCENES = 1_000_000  # of a repetition


class Case(NamedTuple):
    """A structure, the density S₀ of its motions [m²/s³], the scenes that are counted here, and the
    repetitions of subset simulation with their coefficient of variation."""

    podium: rj.Podium
    S_0: float
    scenes: int
    repetitions: int = 20
    cov: float = COV


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


def counted(case: Case, known: dict[str, Any]) -> None:
    """Count a batch more; the next one has a seed of its own."""
    limit = limit_state("benchmark", case.podium, motion_of(case), "overturning")
    number = known.setdefault("batches", 0)
    u = np.random.default_rng([11, number]).standard_normal((BATCH, limit.dimension))
    known["failures"] = known.get("failures", 0) + int((limit.values(u) <= 0).sum())
    known["batches"] = number + 1


def repeated(case: Case, known: dict[str, Any]) -> None:
    """One repetition more."""
    runs = known.setdefault("runs", [])
    found = rj.failure_probability(
        case.podium,
        motion_of(case),
        method="subset",
        cov=case.cov,
        seed=100 + len(runs),
        max_scenes=MAX_SCENES,
    )
    runs.append([found.probability, found.standard_error, *found.interval, found.scenes])


def _all_repeated(case: Case, known: dict[str, Any]) -> bool:
    return len(known.get("runs", [])) >= case.repetitions


def _all_counted(case: Case, known: dict[str, Any]) -> bool:
    return known.get("batches", 0) * BATCH >= case.scenes


def advance(minutes: float, names: list[str]) -> dict[str, dict[str, Any]]:
    """Go on with all cases in turn, until the time is used up or nothing is left."""
    path, end = RESULTS / "risk-runs.json", time.process_time() + 60 * minutes
    known: dict[str, dict[str, Any]] = json.loads(path.read_text()) if path.exists() else {}
    for name in names:
        of = known.setdefault(name, {})
        for step, done in ((counted, _all_counted), (repeated, _all_repeated)):
            while time.process_time() < end and not done(CASES[name], of):
                step(CASES[name], of)
                path.write_text(json.dumps(known) + "\n")
    return known


def row(name: str, known: dict[str, Any]) -> dict[str, Any]:
    """What is known of a case. `held`: the share of the repetitions whose intervals hold what is counted."""
    runs = np.array(known.get("runs", [])).reshape(-1, 5)
    scenes, failures = known.get("batches", 0) * BATCH, known.get("failures", 0)
    of_sweep = [row for row in kept_so_far("risk-sweep") if row["case"] == name]
    if of_sweep:  # other motions
        scenes, failures = scenes + of_sweep[0]["motions"], failures + of_sweep[0]["failures"]
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
        "said": float(np.mean(error / p)),
        "held": float(np.mean((lower <= counted) & (counted <= upper))),
        "scenes": float(cost.mean()),
    }


def main(minutes: float = 0.0, *names: str) -> None:
    known = advance(minutes, list(names) or list(CASES))
    rows = [row(name, of) for name, of in known.items() if len(of.get("runs", [])) > 1]
    keep("risk", rows)
    forms = {"counted": ".3e", "from": ".3e", "to": ".3e", "of": "d", "repetitions": "d", "mean": ".3e"}
    show(rows, {"case": "", **forms, "cov": ".3f", "said": ".3f", "held": ".2f", "scenes": ".0f"})


if __name__ == "__main__":
    main(*(float(y) if k == 0 else y for k, y in enumerate(sys.argv[1:])))  # pyright: ignore[reportArgumentType]
