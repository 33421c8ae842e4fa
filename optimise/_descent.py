"""Data that the parts of a search exchange: evaluations, iterates and ends.

A descent is a coroutine: it yields points and receives their evaluations, so that many descents are evaluated
as one batch.
"""

from __future__ import annotations

from collections.abc import Generator
from typing import NamedTuple

import numpy as np

from ._quadratic import Vector
from ._results import CONVERGED, INFEASIBLE, STALLED


class Evaluation(NamedTuple):
    """Values f (k,), margins c (m,) and their Jacobians (k, n), (m, n) in scaled variables; the number of
    overturned scenes of each target and, last, of the objective."""

    f: Vector
    c: Vector
    f_slope: Vector
    c_slope: Vector
    overturned: Vector = np.zeros(0)

    @property
    def is_finite(self) -> bool:
        return all(bool(np.isfinite(y).all()) for y in self)

    @property
    def violation(self) -> float:
        return float(max(0.0, np.max(-self.c, initial=0.0)))

    def merit(self, weight: float, penalty: float) -> float:
        return weight * float(np.max(self.f)) + penalty * self.violation


class Rules(NamedTuple):
    """Settings of a descent.

    - `scale`: unit of the values; `shift`: margin aimed at [–]
    - `radius`: first radius of the trust region, in scaled variables
    - `tolerance`, `max_iterations`: stopping criteria
    """

    scale: float
    shift: float
    radius: float
    tolerance: float
    max_iterations: int

    @property
    def accepted_violation(self) -> float:
        """Accepted violation of the margins aimed at, with which the targets still hold [–]."""
        return 0.5 * self.shift


class Iterate(NamedTuple):
    """One iteration of one start.

    - `x`: scaled variables before the step; `objective` and worst `margin` there
    - `residual`: of the optimality conditions; `radius`: of the trust region; `penalty`: ν
    - `step`: largest entry of the step tried; `accepted`: whether it was accepted
    """

    start: int
    iteration: int
    x: Vector
    objective: float
    margin: float
    residual: float
    radius: float
    penalty: float
    step: float
    accepted: bool


class End(NamedTuple):
    """End of a descent.

    - `x`: scaled variables (n,); `multipliers`: of the margins (m,), in units of the scaled objective
    - `result`: code of `RESULTS`; `iterations`: their number; `evaluation`: that at `x`
    """

    x: Vector
    multipliers: Vector
    result: int
    iterations: int
    evaluation: Evaluation


Descent = Generator[Vector, Evaluation, End]


def scale_evaluation(evaluation: Evaluation, rules: Rules) -> Evaluation:
    """Return an evaluation for descents: values scaled, margins relative to those aimed at."""
    return Evaluation(
        evaluation.f / rules.scale,
        evaluation.c - rules.shift,
        evaluation.f_slope / rules.scale,
        evaluation.c_slope,
    )


def rank(evaluation: Evaluation) -> tuple[float, float]:
    """Sort key of evaluations: by violation, then by value."""
    return (evaluation.violation, float(np.max(evaluation.f)))


def objective_scale(first: list[Evaluation]) -> float:
    """Return the typical change of the objective across the box, from its slopes at the starts."""
    slopes = [float(np.max(np.abs(e.f_slope))) for e in first]
    slopes = [slope for slope in slopes if slope > 0]
    if slopes:
        return float(np.median(slopes))
    return max([float(np.max(np.abs(e.f))) for e in first if np.any(e.f != 0)], default=1.0)


def result_at_rest(current: Evaluation, residual: float, rules: Rules) -> int:
    """Return the result code of a descent that no step improves."""
    if current.violation > rules.shift:
        return INFEASIBLE
    return CONVERGED if residual <= 100 * rules.tolerance else STALLED
