"""Design studies from random starts: `python -m benchmarks.studies [sqp] [adam] [names] [--runs N]`.

The methods are sequential quadratic programming, Adam or both; `--cap N` limits the iterations of a start.
Studies: (a) the slimmest column, (b) the lightest beam, (c) the least shear, (d) a probability, (e) a fit.

`python -m benchmarks.studies scipy` compares designs by exact gradients with SciPy's optimisers, which use
finite differences or no derivatives. The table has the number of simulated scenes (a scene with exact
derivatives costs as much as two to four scenes without), and the numbers of runs whose design breaks a limit
or is more than 1 % worse than the best design of all runs.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import optax
from scipy import optimize

import optimise
import rockjax as rj
from optimise._results import OUT_OF_ITERATIONS

from .measure import report, show

OPTIONS = rj.Options(rtol=1e-8, atol=1e-10, throw=False)
G = 9.80665


def shaking(seed: int, peak: float = 3.0, n: int = 350, dt: float = 0.02) -> rj.Record:
    """Return a synthetic near-fault record of 7 s: noise with an envelope and a velocity pulse.

    `peak` is the PGA [m/s²].
    """
    rng = np.random.default_rng([7, seed])
    t = dt * np.arange(n)
    period, centre = rng.uniform(0.7, 1.4), rng.uniform(2.0, 3.0)
    pulse = np.exp(-(((t - centre) / (0.8 * period)) ** 2)) * np.sin(
        2 * np.pi * (t - centre) / period + rng.uniform(0, 6)
    )
    noise = np.convolve(rng.normal(size=n), np.hanning(9), mode="same")
    noise *= np.exp(-(((t - 2.8) / 1.6) ** 2)) / np.abs(noise).max()
    a = (pulse + 0.5 * noise) * np.minimum(1, np.minimum(t, t[::-1]) / 0.5)
    return rj.Record(peak * a / np.abs(a).max(), dt)


def _slenderness(podium: rj.Podium):
    return podium.alpha


def _beam(podium: rj.Podium):
    return podium.gamma


def _random(rng: np.random.Generator, vary: dict[str, tuple[float, float]]) -> dict[str, Any]:
    return {name: float(rng.uniform(low, high)) for name, (low, high) in vary.items()}


def pulses(count: int) -> Sequence[rj.AbstractExcitation]:
    """Return symmetric Ricker pulses and full sines alternately; longer pulses are weaker."""
    periods = np.linspace(0.6, 1.4, (count + 1) // 2)
    amplitudes = np.linspace(4.0, 2.5, len(periods))
    pairs = zip(amplitudes, periods, strict=True)
    return [kind(a, T) for a, T in pairs for kind in (rj.Ricker, rj.OneSine)][:count]


def slimmest(seed: int = 0, count: int = 6, starts: int = 1, **more) -> optimise.Design:
    """Solve problem (a): the slimmest 3 m column whose peak rotation stays below 0.4 α under all pulses."""
    vary = {"width": (0.2, 1.5)}
    start = optimise.Dimensions(
        height=3.0,
        column_mass=1.5e3,
        beam_mass=30e3,
        top_mass=300e3,
        period=0.5,
        **_random(np.random.default_rng(seed), vary),
    )
    target = optimise.PeakRotation(0.4, pulses(count))
    return optimise.design(
        start, vary, _slenderness, target, seed=seed, starts=starts, options=OPTIONS, **more
    )


def lightest(
    seed: int = 0, frequencies: int = 13, ratio: float = 3.2, starts: int = 1, **more
) -> optimise.Design:
    """Solve problem (b): the least γ of a rigid frame that symmetric Ricker pulses do not overturn.

    The pulses have 3.5 ≤ ω_p/p ≤ 5 and amplitudes up to `ratio` times g tan α. Ratio 3.5 has no solution.
    """
    vary = {"gamma": (0.0, 100.0)}
    frame = rj.Podium(alpha=math.atan(0.15), R=1.5, **_random(np.random.default_rng(seed), vary))
    T_p = 2 * math.pi / (float(frame.p) * np.linspace(3.5, 5.0, frequencies))
    target = optimise.OverturningAcceleration(ratio, rj.Ricker, T_p, ratio=True, max_acceleration_ratio=8.0)
    return optimise.design(frame, vary, _beam, target, seed=seed, starts=starts, options=OPTIONS, **more)


def infeasible(seed: int = 0, **more) -> optimise.Design:
    """Solve problem (b) with a ratio that has no solution."""
    return lightest(seed, ratio=3.5, **more)


def least_shear(seed: int = 0, records: int = 4, starts: int = 1, **more) -> optimise.Design:
    """Solve problem (c): the least peak shear under all records, by varying column width and beam mass.

    1.5 times each record must not overturn the podium.
    """
    motions = [shaking(k) for k in range(records)]
    vary = {"width": (0.3, 0.9), "beam_mass": (5e3, 100e3)}
    start = optimise.Dimensions(
        height=3.0,
        column_mass=1.5e3,
        top_mass=100e3,
        period=0.5,
        **_random(np.random.default_rng(seed), vary),
    )
    target = optimise.OverturningScale(1.5, motions, max_scale=3.0)
    return optimise.design(
        start, vary, optimise.WorstShear(motions), target, seed=seed, starts=starts, options=OPTIONS, **more
    )


def slimmest_for_suite(
    seed: int = 0, records: int = 50, starts: int = 1, **more
) -> tuple[optimise.Design, float, float]:
    """Solve problem (d): the slimmest column that at most 5 % of the records overturn.

    Also returns the smoothed and the counted probability of overturning.
    """
    target = optimise.OverturningProbability(
        0.05, [shaking(k) for k in range(records)], intensity=1.3, smoothing=0.05
    )
    vary = {"width": (0.25, 1.2)}
    start = optimise.Dimensions(
        height=3.0, column_mass=1.5e3, beam_mass=30e3, **_random(np.random.default_rng(seed), vary)
    )
    answer = optimise.design(
        start, vary, _slenderness, target, seed=seed, starts=starts, options=OPTIONS, **more
    )
    return answer, target.smoothed(answer.podium), target.exact(answer.podium)


def measured(seed: int = 0, noise: float = 0.01) -> tuple[rj.Podium, rj.Ricker, np.ndarray, np.ndarray]:
    """Return a podium, a motion, times, and the rotation with noise relative to its peak."""
    truth = rj.Podium(alpha=0.2, R=1.8, gamma=2.0, restitution=0.93)
    motion = rj.Ricker(4.5, 1.1)
    times = np.arange(-1.5, 7.0, 0.02)
    theta = np.asarray(rj.simulate(truth, motion)(times).theta)
    rng = np.random.default_rng([11, seed])
    return truth, motion, times, theta + noise * np.abs(theta).max() * rng.normal(size=len(times))


def measured_fit(seed: int = 0, noise: float = 0.01, starts: int = 4) -> optimise.Fit:
    """Solve problem (e): fit slenderness and restitution factor to a noisy rotation, from a random start."""
    truth, motion, times, theta = measured(seed, noise)
    vary = {"alpha": (0.12, 0.3), "restitution": (0.8, 1.0)}
    first = truth.replace(**_random(np.random.default_rng(seed), vary))
    return optimise.fit(first, vary, motion, times, theta, starts=starts, seed=seed)


METHODS = {"sqp": "sqp", "adam": optax.adam(0.02)}
STUDIES: dict[str, Callable] = {
    "slimmest": slimmest,
    "lightest": lightest,
    "unreachable": infeasible,
    "least_shear": least_shear,
    "rarely": slimmest_for_suite,
    "measured_fit": measured_fit,
}


def is_wrong_fit(answer: optimise.Fit) -> bool:
    """Return True if an estimate deviates from the true value by more than five standard errors."""
    truth = measured()[0]
    true_values = {"alpha": float(truth.alpha), "restitution": float(truth.restitution_factor)}
    return any(
        abs(answer.variables[key] - value) > 5 * answer.errors[key] for key, value in true_values.items()
    )


def one_run(name: str, seed: int, solver_options: dict) -> dict:
    """Solve a study from one random start; fits use least squares for every method."""
    start_time = time.process_time()
    answer = STUDIES[name](seed) if name == "measured_fit" else STUDIES[name](seed, **solver_options)
    seconds = time.process_time() - start_time
    if isinstance(answer, optimise.Fit):
        return {"failed": is_wrong_fit(answer), "answer": answer.rms, "cpu s": seconds}
    if isinstance(answer, tuple):
        answer, smoothed, counted = answer
        bias = f"bias {smoothed - counted:+.4f}"
        print(f"  {name} {seed}: smoothed {smoothed:.4f}, counted {counted:.4f}, {bias}")
    result = str(answer.result._value)
    return {
        "failed": not answer.satisfied if name != "unreachable" else result != "2",
        "cut short": result == str(OUT_OF_ITERATIONS),
        "evaluations": answer.stats.evaluations,
        "scenes": answer.stats.scenes,
        "violation": max(0.0, -min(answer.failing.values(), default=0.0)),
        "answer": answer.objective,
        "cpu s": seconds,
    }


def row_of(name: str, method: str, runs: list[dict]) -> dict:
    """Return the row of a study; its first run includes compilation or loading of programs."""
    mean = lambda key: float(np.mean([run.get(key, 0) for run in runs]))
    later = [run["cpu s"] for run in runs[1:]] or [runs[0]["cpu s"]]
    return {
        "study": name,
        "method": method,
        "runs": len(runs),
        "failures": sum(run["failed"] for run in runs),
        "cut short": sum(run.get("cut short", False) for run in runs),
        "evaluations": mean("evaluations"),
        "scenes": mean("scenes"),
        "violation": max(run.get("violation", 0.0) for run in runs),
        "cpu s first": runs[0]["cpu s"],
        "cpu s later": float(np.mean(later)),
        "answers": ", ".join(f"{run['answer']:.5g}" for run in runs),
    }


class ComparedProblem(NamedTuple):
    """The least slenderness α with max|θ|/α ≤ `limit` under all pulses."""

    vary: dict[str, tuple[float, float]]
    limit: float  # 1 for overturning

    def structure(self, values: np.ndarray) -> optimise.Dimensions:
        sizes: dict[str, Any] = {"width": 0.5, "height": 3.0}
        sizes |= dict(zip(self.vary, map(float, values), strict=True))
        return optimise.Dimensions(column_mass=1.5e3, beam_mass=30e3, top_mass=300e3, period=0.5, **sizes)

    def target(self) -> optimise.AbstractTarget:
        return (
            optimise.NoOverturning(MOTIONS) if self.limit == 1 else optimise.PeakRotation(self.limit, MOTIONS)
        )


MOTIONS = pulses(6)
ROTATION = OPTIONS.replace(outputs=("peak_rotation",))
PROBLEMS = {
    "rotation ≤ 0.4 α, width": ComparedProblem({"width": (0.2, 1.5)}, 0.4),
    "no overturning, width": ComparedProblem({"width": (0.2, 1.5)}, 1.0),
    "no overturning, width and height": ComparedProblem({"width": (0.2, 1.5), "height": (2.0, 6.0)}, 1.0),
}


class CountedRotations:
    """Peak rotations divided by α as functions for SciPy, which count their scenes."""

    def __init__(self, problem: ComparedProblem):
        self.problem, self.scenes = problem, 0
        self.last: tuple[bytes, np.ndarray] | None = None

    def rotations(self, values: np.ndarray) -> np.ndarray:
        key = np.asarray(values, float).tobytes()
        if self.last is None or self.last[0] != key:
            podium = self.problem.structure(values).podium()
            self.scenes += len(MOTIONS)
            peaks = [rj.peak_response(podium, motion, options=ROTATION).peak_rotation for motion in MOTIONS]
            self.last = key, np.array([float(y) for y in peaks])
        return self.last[1]

    def alpha(self, values: np.ndarray) -> float:
        return float(self.problem.structure(values).podium().alpha)


def slsqp(problem: ComparedProblem, start: np.ndarray) -> tuple[np.ndarray, int]:
    counted = CountedRotations(problem)
    # Overturning means a peak rotation of 1, so the limit is slightly smaller.
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


def evolution(problem: ComparedProblem, start: np.ndarray, seed: int) -> tuple[np.ndarray, int]:
    counted = CountedRotations(problem)
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


def ours(problem: ComparedProblem, start: np.ndarray, seed: int) -> tuple[np.ndarray, int]:
    answer = optimise.design(
        problem.structure(start),
        problem.vary,
        _slenderness,
        problem.target(),
        seed=seed,
        options=ROTATION,
    )
    return np.array(list(answer.variables.values())), answer.stats.scenes


def check_design_limit(problem: ComparedProblem, values: np.ndarray) -> tuple[bool, float]:
    """Return whether a design satisfies its limit in an accurate simulation, and its α."""
    accurate = ROTATION.replace(rtol=1e-11, atol=1e-13)
    podium = problem.structure(values).podium()
    peaks = [rj.peak_response(podium, motion, options=accurate) for motion in MOTIONS]
    is_satisfied = all(
        not bool(peak.overturned) and float(peak.peak_rotation) <= problem.limit * (1 + 1e-6)
        for peak in peaks
    )
    return is_satisfied, float(podium.alpha)


def compare_with_scipy(runs: int) -> None:
    methods: dict[str, Callable[[ComparedProblem, np.ndarray, int], tuple[np.ndarray, int]]] = {
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
                start_time = time.perf_counter()
                values, scenes = solve(problem, start, seed)
                answers[method].append(
                    (*check_design_limit(problem, values), scenes, time.perf_counter() - start_time)
                )
        best = min(
            (alpha for outcomes in answers.values() for is_satisfied, alpha, *_ in outcomes if is_satisfied),
            default=math.nan,
        )
        for method, outcomes in answers.items():
            row = {"problem": name, "method": method, "runs": len(outcomes)}
            row["limit broken"] = sum(not is_satisfied for is_satisfied, *_ in outcomes)
            row["over 1 % worse"] = sum(
                is_satisfied and alpha > 1.01 * best for is_satisfied, alpha, *_ in outcomes
            )
            row["scenes"], row["seconds"] = (float(np.median([run[k] for run in outcomes])) for k in (2, 3))
            rows.append(row | {"best alpha": best})
            print(rows[-1], flush=True)
    report("design", rows)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("words", nargs="*", help=", ".join(["scipy", *METHODS, *STUDIES]))
    parser.add_argument("--runs", type=int, default=10, help="random starts")
    parser.add_argument("--cap", type=int, help="iterations of a start")
    arguments = parser.parse_args()
    if arguments.words == ["scipy"]:
        compare_with_scipy(arguments.runs)
        return
    settings = {} if arguments.cap is None else {"max_iterations": arguments.cap}
    rows = []
    for name in [word for word in arguments.words if word in STUDIES] or STUDIES:
        for method in [word for word in arguments.words if word in METHODS] or ["sqp"]:
            solver_options = settings | {"method": METHODS[method]}
            runs = [one_run(name, seed, solver_options) for seed in range(arguments.runs)]
            rows.append(row_of(name, method, runs))
            print(rows[-1], flush=True)
    show(rows)


if __name__ == "__main__":
    main()
