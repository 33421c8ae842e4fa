"""Whether a point is optimal, and at which shadow prices: linear models there, and the step that unit
curvature would take."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ._descent import Evaluation
from ._quadratic import Model, Vector, solve

NEAR = 1e-3  # models from so close tell of a kink here
Seen = list[tuple[Vector, Evaluation]]


class Optimality(NamedTuple):
    """`multipliers` of the margins (m,); `residual` of the optimality conditions; the `violation` it would
    leave.

    The residual is the step that unit curvature would take, as of a projected gradient: 0 just where the
    merit is stationary in its bounds.
    """

    multipliers: Vector
    residual: float
    violation: float


def linear_models(x: Vector, here: Evaluation, seen: Seen) -> Model:
    """Linear models at x, and those of points seen elsewhere, lifted so that they do not contradict the
    values at x."""
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
    """What was seen so close to x that a kink between belongs to x."""
    return [(y, there) for y, there in seen if np.max(np.abs(y - x)) <= NEAR]


def optimality(
    x: Vector, here: Evaluation, near: Seen, weight: float, penalty: float, tolerance: float
) -> Optimality:
    """Of the merit with these weights: as if it were smooth at x; where it is not, with what was seen near
    by."""
    found = _optimality(x, here, [], weight, penalty)
    if found.residual > tolerance and near:  # smooth it is not, but perhaps at a kink
        found = _optimality(x, here, near, weight, penalty)
    return found


def unit_step(x: Vector, here: Evaluation, near: Seen) -> Vector:
    """The step (n,) that unit curvature would take inside the bounds; minus a projected gradient where all is
    smooth."""
    step = solve(linear_models(x, here, near), np.eye(len(x)), 1.0, 1.0, -x, 1 - x)
    return np.clip(x - here.f_slope[0], 0.0, 1.0) - x if step is None else step.d


def _optimality(x: Vector, here: Evaluation, near: Seen, weight: float, penalty: float) -> Optimality:
    model = linear_models(x, here, near)
    step = solve(model, np.eye(len(x)), weight, penalty, -x, 1 - x)
    if step is None:
        return Optimality(np.zeros(len(here.c)), np.inf, here.violation)
    multipliers = np.bincount(model.margin_of, step.margin_multipliers, minlength=len(here.c))
    return Optimality(multipliers, float(np.max(np.abs(step.d))), step.violation)
