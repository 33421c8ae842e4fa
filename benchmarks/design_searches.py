"""Searches for design points beside each other: `python -m benchmarks.design_searches [names]`.

The search along rays of rockjax; the improved Hasofer–Lind–Rackwitz–Fiessler iteration with a line search on
the merit function of Zhang & Der Kiureghian; SciPy's SLSQP; and SciPy's L-BFGS-B on an exact penalty. All
begin where the rays of the same eight directions first fail, and all answers are measured alike: by the least
distance at which the ray through the answer fails.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.optimize import minimize

import rockjax as rj
from rockjax._risk.limit_state import AbstractLimitState
from rockjax._risk.reliability import starting
from rockjax._risk.search import BEYOND, design_points, distances
from rockjax.internal import limit_state

from .measure import keep, kept_so_far, show
from .risk import BLOCK

STARTS, SEED, STEPS = 8, 0, 60
ALIGNED = 1e-6  # 1 − cos of the angle between answer and normal
CASES = {
    "block, 61": (BLOCK, rj.GaussianMotion(61, 0.06, 0.0114)),
    "block, 601": (BLOCK, rj.GaussianMotion(601, 0.01, 0.0114)),
    "block, 4001": (BLOCK, rj.GaussianMotion(4001, 0.0025, 0.0114)),
}


def one(limit: AbstractLimitState, u: np.ndarray) -> tuple[float, np.ndarray]:
    value, slope = limit.gradients(u[None])
    return float(value[0]), slope[0]


def along_rays(limit: AbstractLimitState, u: np.ndarray) -> np.ndarray:
    return design_points(limit, u, 1e3).u


def hlrf(limit: AbstractLimitState, u: np.ndarray) -> np.ndarray:
    """With merit |u|²/2 + c|G|, c > |u|/|∇G|, and Armijo's rule."""
    for _ in range(STEPS):
        value, slope = one(limit, u)
        steep = float(slope @ slope)
        if steep == 0 or not np.isfinite(steep):
            break
        size = np.sqrt(steep)
        cosine = -(slope @ u) / (size * np.linalg.norm(u))
        if 1 - cosine < ALIGNED and abs(value) < 1e-6:
            break
        way = (slope @ u - value) / steep * slope - u
        c = 2 * np.linalg.norm(u) / size
        merit = 0.5 * float(u @ u) + c * abs(value)
        fall = float((u + c * np.sign(value) * slope) @ way)
        lengths = 0.5 ** np.arange(12)
        tried = u + lengths[:, None] * way
        merits = 0.5 * np.sum(tried**2, axis=1) + c * np.abs(limit.values(tried))
        good = np.flatnonzero(merits <= merit + 1e-4 * lengths * min(fall, 0.0))
        if good.size == 0:
            break
        u = tried[good[0]]
    return u


def slsqp(limit: AbstractLimitState, u: np.ndarray) -> np.ndarray:
    known: dict[bytes, tuple[float, np.ndarray]] = {}

    def at(x: np.ndarray) -> tuple[float, np.ndarray]:
        if x.tobytes() not in known:
            known.clear()
            known[x.tobytes()] = one(limit, x)
        return known[x.tobytes()]

    constraint = {"type": "ineq", "fun": lambda x: -at(x)[0], "jac": lambda x: -at(x)[1]}
    found = minimize(
        lambda x: 0.5 * float(x @ x), u, jac=lambda x: x, constraints=constraint, method="SLSQP",
        options={"maxiter": STEPS},
    )  # fmt: skip
    return found.x


def penalty(limit: AbstractLimitState, u: np.ndarray) -> np.ndarray:
    """|u|²/2 + c max(G, 0), c twice what makes it exact at the start."""
    _, slope = one(limit, u)
    c = 2 * np.linalg.norm(u) / max(float(np.linalg.norm(slope)), 1e-6)

    def function(x: np.ndarray) -> tuple[float, np.ndarray]:
        value, slope = one(limit, x)
        return 0.5 * float(x @ x) + c * max(value, 0.0), x + c * slope if value > 0 else x

    return minimize(function, u, jac=True, method="L-BFGS-B", options={"maxiter": 2 * STEPS}).x


def each(search: Callable[[AbstractLimitState, np.ndarray], np.ndarray]):
    """A search from one start, from all of them."""
    return lambda limit, u: np.array([search(limit, start) for start in u])


SEARCHES: dict[str, Any] = {
    "along rays": along_rays,
    "iHLRF": each(hlrf),
    "SLSQP": each(slsqp),
    "L-BFGS, penalty": each(penalty),
}


def row(case: str, name: str) -> dict[str, Any]:
    podium, motion = CASES[case]
    limit = limit_state("benchmark", podium, motion, "overturning")
    e = starting(limit, STARTS, SEED)[: STARTS // 2]  # the others are mirror images
    u = e * distances(limit, e, BEYOND * np.sqrt(limit.dimension))[:, None]
    one(limit, u[0])  # compiled
    scenes, slopes, began = limit.scenes, limit.gradients_taken, time.process_time()
    found = SEARCHES[name](limit, u)
    took = time.process_time() - began
    scenes, slopes = limit.scenes - scenes, limit.gradients_taken - slopes
    length = np.linalg.norm(found, axis=1)
    usable = np.isfinite(length) & (length > 0)
    beta = np.full(len(found), np.inf)
    beta[usable] = distances(limit, found[usable] / length[usable, None], 40.0)
    beta.sort()
    return {
        "case": case, "search": name, "nearest": float(beta[0]),
        "betas": [float(y) if np.isfinite(y) else None for y in beta], "scenes": scenes,
        "gradients": slopes, "cpu s": took,
    }  # fmt: skip


def main(*names: str) -> None:
    rows = [r for r in kept_so_far("design-searches") if r["case"] not in (names or CASES)]
    for case in names or CASES:
        for name in SEARCHES:
            if name == "SLSQP" and CASES[case][1].dimension > 100:  # its matrices are dense
                continue
            rows.append(row(case, name))
            print(rows[-1], flush=True)
    keep("design-searches", rows)
    forms = {"nearest": ".3f", "scenes": "d", "gradients": "d", "cpu s": ".1f"}
    show(rows, {"case": "", "search": "", **forms})


if __name__ == "__main__":
    main(*sys.argv[1:])
