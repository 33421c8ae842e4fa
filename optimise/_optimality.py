"""Optimality of a point and its multipliers, from linear models and the step of unit curvature."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ._descent import Evaluation
from ._quadratic import Model, Vector, solve

NEAR_DISTANCE = 1e-3  # distance within which models of other points describe a kink here
EvaluatedPoints = list[tuple[Vector, Evaluation]]


class Optimality(NamedTuple):
    """Multipliers of the margins and residual of the optimality conditions.

    - `multipliers`: of the margins (m,); `violation`: modelled violation after the step [–]
    - `residual`: length of the step of unit curvature, as for a projected gradient; 0 exactly where the merit
      is stationary within the bounds
    """

    multipliers: Vector
    residual: float
    violation: float


def linear_models(x: Vector, current: Evaluation, points: EvaluatedPoints) -> Model:
    """Return linear models at x and those of other points, lifted to be consistent with the values at x."""
    k, m = len(current.f), len(current.c)
    f, f_slope, c, c_slope = [current.f], [current.f_slope], [current.c], [current.c_slope]
    for y, evaluation in points:
        f.append(np.minimum(evaluation.f + evaluation.f_slope @ (x - y), current.f))
        f_slope.append(evaluation.f_slope)
        c.append(np.maximum(evaluation.c + evaluation.c_slope @ (x - y), current.c))
        c_slope.append(evaluation.c_slope)
    copies = 1 + len(points)
    return Model(
        np.concatenate(f),
        np.concatenate(f_slope),
        np.concatenate(c),
        np.concatenate(c_slope),
        np.tile(np.arange(k), copies),
        np.tile(np.arange(m), copies),
    )


def points_near(x: Vector, points: EvaluatedPoints) -> EvaluatedPoints:
    """Return the evaluated points within `NEAR_DISTANCE` of x, whose models describe kinks at x."""
    return [(y, evaluation) for y, evaluation in points if np.max(np.abs(y - x)) <= NEAR_DISTANCE]


def optimality(
    x: Vector,
    current: Evaluation,
    near_points: EvaluatedPoints,
    weight: float,
    penalty: float,
    tolerance: float,
) -> Optimality:
    """Return the optimality of the merit at x, first as if it were smooth, then with models of near points.

    - `x`: scaled variables (n,); `current`: evaluation there; `near_points`: evaluated points near x
    - `weight`: of the values; `penalty`: ν of the largest violation
    - `tolerance`: residual above which the near points are used
    """
    found = _solve_optimality(x, current, [], weight, penalty)
    if found.residual > tolerance and near_points:  # not stationary if smooth; perhaps at a kink
        found = _solve_optimality(x, current, near_points, weight, penalty)
    return found


def _solve_optimality(
    x: Vector, current: Evaluation, near_points: EvaluatedPoints, weight: float, penalty: float
) -> Optimality:
    model = linear_models(x, current, near_points)
    step = solve(model, np.eye(len(x)), weight, penalty, -x, 1 - x)
    if step is None:
        return Optimality(np.zeros(len(current.c)), np.inf, current.violation)
    multipliers = np.bincount(model.margin_of, step.margin_multipliers, minlength=len(current.c))
    return Optimality(multipliers, float(np.max(np.abs(step.d))), step.violation)
