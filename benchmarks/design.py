"""Design by exact gradients beside what SciPy does with finite differences and without: `python -m
benchmarks.design`.

The same problems, motions and simulator; SciPy's optimisers see values only. Counted are the scenes they
simulate (ours: with their derivatives, which cost two to four values each) and the runs, from random starts,
that end in a design that breaks a limit, or that is more than 1 % worse than the best one known.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy import optimize

import optimise
import rockjax as rj

from .measure import keep
from .studies import pulses

OPTIONS = rj.Options(rtol=1e-8, atol=1e-10, outputs=("peak_rotation",), throw=False)
RUNS = 10


class Problem(NamedTuple):
    """Least slenderness α under a limit of the peak rotation over α, for a set of pulses."""

    vary: dict[str, tuple[float, float]]
    limit: float  # 1 is overturning itself

    def structure(self, values: np.ndarray) -> optimise.Dimensions:
        given = {"width": 0.5, "height": 3.0} | dict(zip(self.vary, map(float, values), strict=True))
        return optimise.Dimensions(column_mass=1.5e3, beam_mass=30e3, top_mass=300e3, period=0.5, **given)

    def target(self) -> optimise.AbstractTarget:
        return (
            optimise.NoOverturning(MOTIONS) if self.limit == 1 else optimise.PeakRotation(self.limit, MOTIONS)
        )


MOTIONS = pulses(6)
PROBLEMS = {
    "rotation ≤ 0.4 α, width": Problem({"width": (0.2, 1.5)}, 0.4),
    "no overturning, width": Problem({"width": (0.2, 1.5)}, 1.0),
    "no overturning, width and height": Problem({"width": (0.2, 1.5), "height": (2.0, 6.0)}, 1.0),
}


def slenderness(podium: rj.Podium):
    """One function for all runs: a new one would be compiled anew."""
    return podium.alpha


class Counted:
    """Peak rotations over α as a user of SciPy would write them, counted."""

    def __init__(self, problem: Problem):
        self.problem, self.scenes = problem, 0
        self.last: tuple[bytes, np.ndarray] | None = None

    def rotations(self, values: np.ndarray) -> np.ndarray:
        key = np.asarray(values, float).tobytes()
        if self.last is None or self.last[0] != key:
            podium = self.problem.structure(values).podium()
            self.scenes += len(MOTIONS)
            found = [rj.peak_response(podium, motion, options=OPTIONS).peak_rotation for motion in MOTIONS]
            self.last = key, np.array([float(y) for y in found])
        return self.last[1]

    def alpha(self, values: np.ndarray) -> float:
        return float(self.problem.structure(values).podium().alpha)


def slsqp(problem: Problem, start: np.ndarray) -> tuple[np.ndarray, int]:
    counted = Counted(problem)
    # Overturning is a peak rotation of exactly 1: stay a little below.
    limit = problem.limit if problem.limit < 1 else 0.999
    answer = optimize.minimize(
        counted.alpha,
        start,
        method="SLSQP",
        bounds=list(problem.vary.values()),
        constraints={"type": "ineq", "fun": lambda y: limit - counted.rotations(y)},
        options={"maxiter": 100},
    )
    return np.asarray(answer.x), counted.scenes


def evolution(problem: Problem, start: np.ndarray, seed: int) -> tuple[np.ndarray, int]:
    counted = Counted(problem)
    limit = problem.limit if problem.limit < 1 else 0.999
    answer = optimize.differential_evolution(
        counted.alpha,
        list(problem.vary.values()),
        constraints=optimize.NonlinearConstraint(counted.rotations, -np.inf, limit),
        x0=start,
        rng=seed,
        maxiter=30,
        popsize=10,
        polish=False,
    )
    return np.asarray(answer.x), counted.scenes


def ours(problem: Problem, start: np.ndarray, seed: int) -> tuple[np.ndarray, int]:
    answer = optimise.design(
        problem.structure(start), problem.vary, slenderness, problem.target(), seed=seed, options=OPTIONS
    )
    return np.array(list(answer.variables.values())), answer.stats.scenes


def verdict(problem: Problem, values: np.ndarray) -> tuple[bool, float]:
    """Whether a design keeps its limit in an accurate simulation, and its α."""
    fine = OPTIONS.replace(rtol=1e-11, atol=1e-13)
    podium = problem.structure(values).podium()
    peaks = [rj.peak_response(podium, motion, options=fine) for motion in MOTIONS]
    kept = all(
        not bool(peak.overturned) and float(peak.peak_rotation) <= problem.limit * (1 + 1e-6)
        for peak in peaks
    )
    return kept, float(podium.alpha)


def compare(runs: int = RUNS) -> list[dict]:
    methods: dict[str, Callable[[Problem, np.ndarray, int], tuple[np.ndarray, int]]] = {
        "exact gradients, SQP": ours,
        "SLSQP, finite differences": lambda problem, start, seed: slsqp(problem, start),
        "differential evolution": evolution,
    }
    rows = []
    for name, problem in PROBLEMS.items():
        lower, upper = np.array(list(problem.vary.values())).T
        starts = [np.random.default_rng([5, k]).uniform(lower, upper) for k in range(runs)]
        answers: dict[str, list[tuple[bool, float, int, float]]] = {}
        for method, solve in methods.items():
            count = runs if method != "differential evolution" else min(runs, 3)
            solve(problem, starts[0], 0)  # compiles
            answers[method] = []
            for seed, start in enumerate(starts[:count]):
                began = time.perf_counter()
                values, scenes = solve(problem, start, seed)
                answers[method].append((*verdict(problem, values), scenes, time.perf_counter() - began))
        best = min(
            (alpha for found in answers.values() for kept, alpha, *_ in found if kept), default=math.nan
        )
        for method, found in answers.items():
            broken = sum(not kept for kept, *_ in found)
            worse = sum(kept and alpha > 1.01 * best for kept, alpha, *_ in found)
            rows.append(
                {
                    "problem": name,
                    "method": method,
                    "runs": len(found),
                    "limit broken": broken,
                    "over 1 % worse": worse,
                    "scenes": float(np.median([scenes for *_, scenes, _ in found])),
                    "seconds": float(np.median([seconds for *_, seconds in found])),
                    "best alpha": best,
                }
            )
            print(rows[-1], flush=True)
    return rows


if __name__ == "__main__":
    keep("design", compare(int(sys.argv[1]) if len(sys.argv) > 1 else RUNS))
