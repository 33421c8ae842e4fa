"""Optimality conditions of the merit at a point: residual and multipliers.

The merit (`Evaluation.merit`) is the weighted objective plus a penalty on the largest violation of a margin.
Points are in scaled variables, which are 0 and 1 at their bounds.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ._descent import Evaluation
from ._quadratic import Model, Vector, solve

# Linear models at points within this distance of x, in scaled variables, describe kinks at x.
NEAR_DISTANCE = 1e-3
EvaluatedPoints = list[tuple[Vector, Evaluation]]


class Optimality(NamedTuple):
    """Multipliers of the margins and residual of the optimality conditions.

    Both come from a test step, which minimises the merit that linear models predict plus half the squared
    length of the step. If the solver finds no test step, the multipliers are 0 and the residual is inf.

    - `multipliers`: multipliers (m,) of the margins
    - `residual`: largest absolute entry of the test step, comparable to the norm of a projected gradient. The
      residual is 0 if and only if no step within the bounds decreases the merit of the models
    - `violation`: violation after the test step according to the linear models [–]; without a test step, the
      present violation
    """

    multipliers: Vector
    residual: float
    violation: float


def linear_models(x: Vector, current: Evaluation, points: EvaluatedPoints) -> Model:
    """Return the linear models for steps from x (n,): one built at x, and one built at each of `points`,
    called cuts. If a cut predicts a larger objective value at x than that of `current`, it is lowered to that
    value. If it predicts a smaller margin, it is raised to that margin."""
    f, f_slope, c, c_slope = [current.f], [current.f_slope], [current.c], [current.c_slope]
    for point, evaluation in points:
        f.append(np.minimum(evaluation.f + evaluation.f_slope @ (x - point), current.f))
        f_slope.append(evaluation.f_slope)
        c.append(np.maximum(evaluation.c + evaluation.c_slope @ (x - point), current.c))
        c_slope.append(evaluation.c_slope)
    margin_index = np.tile(np.arange(len(current.c)), len(c))
    join = np.concatenate
    return Model(join(f), join(f_slope), join(c), join(c_slope), margin_index)


def points_near(x: Vector, points: EvaluatedPoints) -> EvaluatedPoints:
    """Return those of `points` that lie within `NEAR_DISTANCE` of x. Their models describe kinks at x."""
    return [(y, evaluation) for y, evaluation in points if np.max(np.abs(y - x)) <= NEAR_DISTANCE]


def optimality(
    x: Vector,
    current: Evaluation,
    near_points: EvaluatedPoints,
    weight: float,
    penalty: float,
    tolerance: float,
) -> Optimality:
    """Return multipliers and residual of the merit at x (n,). At first only the models built at x are used,
    as if the merit were smooth at x. If the residual exceeds `tolerance`, x may be at a kink, and the models
    of near points are added. `weight` is that of the objective, `penalty` that of the largest violation,
    ν."""
    result = _solve_optimality(x, current, [], weight, penalty)
    if result.residual > tolerance and near_points:
        result = _solve_optimality(x, current, near_points, weight, penalty)
    return result


def _solve_optimality(
    x: Vector, current: Evaluation, near_points: EvaluatedPoints, weight: float, penalty: float
) -> Optimality:
    model = linear_models(x, current, near_points)
    step = solve(model, np.eye(len(x)), weight, penalty, -x, 1 - x)
    if step is None:
        return Optimality(np.zeros(len(current.c)), np.inf, current.violation)
    multipliers = np.bincount(model.margin_index, step.margin_multipliers, minlength=len(current.c))
    return Optimality(multipliers, float(np.max(np.abs(step.d))), step.violation)
