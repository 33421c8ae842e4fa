"""Limit states with known probabilities, compared with OpenTURNS: `python -m benchmarks.reliability [names]`.

The limit states come from the tests and from otbenchmark (RP…), with the probabilities published there. They
are functions of standard normal variables, and both programs call the same functions. OpenTURNS finds the
design point by COBYLA, without derivatives. An evaluation by rockjax may include the derivative.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.stats import norm

import rockjax as rj

from .measure import report, show

ROOT2, COV, SEEDS = math.sqrt(2.0), 0.1, 3
OURS = ("importance", "line", "subset")


class Problem(NamedTuple):
    G: Callable[[Any], Any]  # limit state function; failure is G ≤ 0
    dimension: int
    probability: float  # P(G ≤ 0)


def _four_branches(x):
    curve, diagonal, across = 3 + 0.1 * (x[0] - x[1]) ** 2, (x[0] + x[1]) / ROOT2, x[0] - x[1]
    return jnp.min(jnp.stack([curve - diagonal, curve + diagonal, across + 7 / ROOT2, 7 / ROOT2 - across]))


def _rp35(x):
    first = 2 - x[1] + jnp.exp(-0.1 * x[0] ** 2) + (0.2 * x[0]) ** 4
    return jnp.minimum(first, 4.5 - x[0] * x[1])


def _rp53(u):
    x, y = 1.5 + u[0], 2.5 + u[1]
    return jnp.sin(2.5 * x) + 2 - (x * x + 4) * (y - 1) / 20


def _rp57(x):
    first = jnp.maximum(-(x[0] ** 2) + x[1] ** 3 + 3, 2 - x[0] - 8 * x[1])
    return jnp.minimum(first, (x[0] + 3) ** 2 + (x[1] + 3) ** 2 - 4)


def _rp110(x):
    first = jnp.where(x[0] <= 3.5, 0.85 - 0.1 * x[0], 4 - x[0])
    return jnp.minimum(first, jnp.where(x[1] <= 2.0, 2.3 - x[1], 0.5 - 0.1 * x[1]))


PROBLEMS = {
    "R − S": Problem(lambda u: 100 + 10 * u[0] - 20 * u[1], 2, 3.872108215522042e-6),
    "four branches": Problem(_four_branches, 2, 2.222795066194432e-3),
    "RP22": Problem(
        lambda x: 2.5 - (x[0] + x[1]) / ROOT2 + 0.1 * (x[0] - x[1]) ** 2, 2, 4.207305511299618e-3
    ),
    "RP24": Problem(
        lambda u: 2.5 - 0.2357 * 3 * (u[0] - u[1]) + 0.00463 * (3 * (u[0] + u[1])) ** 4, 2, 2.86e-3
    ),
    "RP25": Problem(
        lambda x: jnp.maximum(x[0] ** 2 - 8 * x[1] + 16, -16 * x[0] + x[1] + 32), 2, 4.148566293759747e-5
    ),
    "RP28": Problem(
        lambda u: (78064 + 11710 * u[0]) * (0.0104 + 0.00156 * u[1]) / 146.14 - 1, 2, 1.4532945550025393e-7
    ),
    "RP31": Problem(lambda x: 2 - x[1] + 256 * x[0] ** 4, 2, 3.226681209587691e-3),
    "RP33": Problem(lambda x: jnp.minimum(3 * math.sqrt(3) - jnp.sum(x), 3 - x[2]), 3, 2.57e-3),
    "RP35": Problem(_rp35, 2, 3.47894632e-3),
    "RP53": Problem(_rp53, 2, 3.13e-2),
    "RP54": Problem(lambda u: jnp.sum(-norm.logsf(u)) - 8.951, 20, 9.98e-4),
    "RP57": Problem(_rp57, 2, 2.84e-2),
    "RP63": Problem(lambda x: 0.1 * jnp.sum(x[1:] ** 2) - 4.5 - x[0], 100, 3.79e-4),
    "RP75": Problem(lambda x: 3 - x[0] * x[1], 2, 9.81929872154689e-3),
    "RP89": Problem(lambda x: jnp.minimum(8 - x[0] ** 2 - x[1], 6 - x[0] / 5 - x[1]), 2, 5.43e-3),
    "RP107": Problem(lambda x: 5 * math.sqrt(10) - jnp.sum(x), 10, 2.92e-7),
    "RP110": Problem(_rp110, 2, 3.19e-5),
    "RP111": Problem(lambda x: 12.5 - jnp.abs(x[0] * x[1]), 2, 7.65e-7),
}


class Run(NamedTuple):
    """Result of a method: probability and number of evaluations of G; NaN if the method fails."""

    probability: float
    evaluations: float


def ours(problem: Problem, method: str, seed: int) -> Run:
    try:
        estimate = rj.reliability(
            problem.G, problem.dimension, method=method, cov=COV, seed=seed, max_scenes=300_000
        )
    except ValueError:
        return Run(math.nan, math.nan)
    return Run(estimate.probability, estimate.scenes)


def openturns(problem: Problem, method: str, seed: int) -> Run:
    import openturns as ot  # pyright: ignore[reportMissingImports]

    ot.RandomGenerator.SetSeed(seed)
    batched, calls = jax.jit(jax.vmap(problem.G)), [0]

    def sample(x):
        u = np.asarray(x)
        calls[0] += len(u)
        size = 1 << (len(u) - 1).bit_length()  # powers of two, so that few programs are compiled
        padded = np.concatenate([u, np.repeat(u[-1:], size - len(u), axis=0)])
        return np.asarray(batched(padded))[: len(u), None]

    dimension = problem.dimension
    function = ot.PythonFunction(dimension, 1, func_sample=sample)
    vector = ot.CompositeRandomVector(function, ot.RandomVector(ot.Normal(dimension)))
    event = ot.ThresholdEvent(vector, ot.LessOrEqual(), 0.0)
    try:
        if method == "subset":
            algorithm = ot.SubsetSampling(event)
            algorithm.setMaximumOuterSampling(100)  # 10⁴ evaluations per level, as by default
            algorithm.setBlockSize(100)
            algorithm.setMaximumCoefficientOfVariation(COV)
        else:
            solver = ot.Cobyla()
            solver.setStartingPoint(np.zeros(dimension))
            form = ot.FORM(solver, event)
            form.run()
            if method == "FORM":
                return Run(form.getResult().getEventProbability(), calls[0])
            algorithm = ot.PostAnalyticalImportanceSampling(form.getResult())
            algorithm.setMaximumCoefficientOfVariation(COV)
            algorithm.setMaximumOuterSampling(3000)
            algorithm.setBlockSize(100)
        algorithm.run()
        return Run(algorithm.getResult().getProbabilityEstimate(), calls[0])
    except (TypeError, RuntimeError):
        return Run(math.nan, math.nan)


def main(names: list[str]) -> None:
    rows = []
    for name in names or list(PROBLEMS):
        problem = PROBLEMS[name]
        methods = [("rockjax", m, ours) for m in OURS]
        methods += [("OpenTURNS", m, openturns) for m in ("FORM", "importance", "subset")]
        for solver_name, method, solve in methods:
            runs = np.array(
                [solve(problem, method, seed) for seed in range(1 if method == "FORM" else SEEDS)]
            )
            error = np.abs(runs[:, 0] / problem.probability - 1)
            row = {"problem": name, "d": problem.dimension, "P": problem.probability, "by": solver_name}
            row |= {"method": method, "evaluations": float(runs[:, 1].mean()), "error": float(error.mean())}
            rows.append(row)
            print(row, flush=True)
    report("reliability", rows) if not names else show(rows)


if __name__ == "__main__":
    main(sys.argv[1:])
