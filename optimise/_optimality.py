"""Optimality of a point and its multipliers, from linear models and the step of unit curvature."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ._descent import Evaluation
from ._quadratic import Model, Vector, solve

NEAR = 1e-3  # distance within which models of other points describe a kink here
Seen = list[tuple[Vector, Evaluation]]


class Optimality(NamedTuple):
    """Multipliers of the margins and residual of the optimality conditions.

    - `multipliers`: of the margins (m,); `violation`: modelled violation after the step [–]
    - `residual`: length of the step of unit curvature, as for a projected gradient; 0 exactly where the merit
      is stationary within the bounds
    """

    multipliers: Vector
    residual: float
    violation: float


def linear_models(x: Vector, here: Evaluation, seen: Seen) -> Model:
    """Return linear models at x and those of other points, lifted to be consistent with the values at x."""
    k, m = len(here.f), len(here.c)
    f, f_slope, c, c_slope = [here.f], [here.f_slope], [here.c], [here.c_slope]
    for y, there in seen:
        f.append(np.minimum(there.f + there.f_slope @ (x - y), here.f))
        f_slope.append(there.f_slope)
        c.append(np.maximum(there.c + there.c_slope @ (x - y), here.c))
        c_slope.append(there.c_slope)
    copies = 1 + len(seen)
    return Model(
        np.concatenate(f),
        np.concatenate(f_slope),
        np.concatenate(c),
        np.concatenate(c_slope),
        np.tile(np.arange(k), copies),
        np.tile(np.arange(m), copies),
    )


def nearby(x: Vector, seen: Seen) -> Seen:
    """Return the evaluated points within `NEAR` of x, whose models describe kinks at x."""
    return [(y, there) for y, there in seen if np.max(np.abs(y - x)) <= NEAR]


def optimality(
    x: Vector, here: Evaluation, near: Seen, weight: float, penalty: float, tolerance: float
) -> Optimality:
    """Return the optimality of the merit at x, first as if it were smooth, then with models of near points.

    - `x`: scaled variables (n,); `here`: evaluation there; `near`: evaluated points near x
    - `weight`: of the values; `penalty`: ν of the largest violation
    - `tolerance`: residual above which the near points are used
    """
    found = _optimality(x, here, [], weight, penalty)
    if found.residual > tolerance and near:  # not stationary if smooth; perhaps at a kink
        found = _optimality(x, here, near, weight, penalty)
    return found


def _optimality(x: Vector, here: Evaluation, near: Seen, weight: float, penalty: float) -> Optimality:
    model = linear_models(x, here, near)
    step = solve(model, np.eye(len(x)), weight, penalty, -x, 1 - x)
    if step is None:
        return Optimality(np.zeros(len(here.c)), np.inf, here.violation)
    multipliers = np.bincount(model.margin_of, step.margin_multipliers, minlength=len(here.c))
    return Optimality(multipliers, float(np.max(np.abs(step.d))), step.violation)
