"""Data types of a search for a design: evaluations, settings, iterates and ends of descents.

A descent is the search from one starting point (start). Each descent is a coroutine that yields points and
receives their evaluations, so that the points of many descents can be evaluated in one batch. A target holds
where its margins are ≥ 0. n is the number of design variables.
"""

from __future__ import annotations

from collections.abc import Generator
from typing import NamedTuple

import numpy as np

from ._quadratic import Vector
from ._results import CONVERGED, INFEASIBLE, STALLED


class Evaluation(NamedTuple):
    """Evaluation of a design point, in scaled variables (0 and 1 are the bounds).

    - `f`: values (k,) of the objective; the largest is minimised; `f_slope`: their Jacobian (k, n)
    - `c`: margins (m,) of all targets [–]; `c_slope`: their Jacobian (m, n)
    - `overturned`: number of overturned scenes (simulations) of each target and, as the last entry, of the
      objective; empty if overturned scenes were not counted
    """

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
        """Largest violation of a margin [–]; 0 if no margin is negative."""
        return float(max(0.0, np.max(-self.c, initial=0.0)))

    def merit(self, weight: float, penalty: float) -> float:
        """Return the merit: weight · max(f) + penalty · violation. A descent decreases the merit."""
        return weight * float(np.max(self.f)) + penalty * self.violation


class Settings(NamedTuple):
    """Settings of a descent.

    - `scale`: number by which the descent divides the objective
    - `shift`: least margin that the descent aims at [–]
    - `radius`: initial radius of the trust region, in scaled variables
    - `tolerance`: largest residual of the optimality conditions at convergence
    - `max_iterations`: number of iterations after which the descent stops
    """

    scale: float
    shift: float
    radius: float
    tolerance: float
    max_iterations: int

    @property
    def accepted_violation(self) -> float:
        """Largest accepted shortfall of a margin from `shift` [–]; a margin with this shortfall is still
        positive."""
        return 0.5 * self.shift


class Iterate(NamedTuple):
    """One iteration of one start.

    - `start`: index of the start; `iteration`: index of the iteration
    - `x`: scaled variables (n,) before the step; `objective`: largest objective value at `x`; `margin`:
      least margin at `x` [–], inf without targets
    - `residual`: residual of the optimality conditions
    - `radius`: radius of the trust region, in scaled variables; `penalty`: penalty ν of the violation
    - `step`: largest absolute entry of the step, in scaled variables; `accepted`: whether the step was taken

    In gradient steps (`_gradients.py`), `residual` is NaN, `radius` is the factor on the step, and `penalty`
    is ρ of the augmented Lagrangian.
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
    """End of the search from one start.

    - `x`: scaled variables (n,); `multipliers`: multipliers (m,) of the margins, for the objective divided by
      `Settings.scale`
    - `result`: code of `RESULTS`; `iterations`: number of iterations
    - `evaluation`: evaluation at `x`, scaled by `scale_evaluation` except in a search with fresh samples
    """

    x: Vector
    multipliers: Vector
    result: int
    iterations: int
    evaluation: Evaluation


Descent = Generator[Vector, Evaluation, End]


def scale_evaluation(evaluation: Evaluation, settings: Settings) -> Evaluation:
    """Return an evaluation as a descent uses it: values divided by `scale`, margins minus `shift`, and no
    numbers of overturned scenes."""
    return Evaluation(
        evaluation.f / settings.scale,
        evaluation.c - settings.shift,
        evaluation.f_slope / settings.scale,
        evaluation.c_slope,
    )


def rank(evaluation: Evaluation) -> tuple[float, float]:
    """Return the sort key of an evaluation: first the violation, then the largest objective value."""
    return (evaluation.violation, float(np.max(evaluation.f)))


def objective_scale(evaluations: list[Evaluation]) -> float:
    """Return a typical change of the objective between the bounds of a variable: the median of the largest
    absolute slopes of the finite evaluations at the starting points, in scaled variables. Slopes of zero are
    left out. If all are zero, return the largest absolute objective value, or 1 if that is zero as well."""
    slopes = [float(np.max(np.abs(e.f_slope))) for e in evaluations]
    slopes = [slope for slope in slopes if slope > 0]
    if slopes:
        return float(np.median(slopes))
    return max([float(np.max(np.abs(e.f))) for e in evaluations if np.any(e.f != 0)], default=1.0)


def final_result(current: Evaluation, residual: float, settings: Settings) -> int:
    """Return the result code of a descent that ends at `current` with the residual of the optimality
    conditions `residual`, because no step decreases the merit further."""
    # The evaluation has margins minus `shift`, so a violation above `shift` means a negative true margin.
    if current.violation > settings.shift:
        return INFEASIBLE
    return CONVERGED if residual <= 100 * settings.tolerance else STALLED
