"""What the parts of a search tell each other: what holds at a point, iterates, ends.

A descent is a coroutine: it yields points and is sent what holds there, so that many descents are evaluated
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
    overturned scenes of each target and, last, of the objective, whose peaks are until overturning."""

    f: Vector
    c: Vector
    f_slope: Vector
    c_slope: Vector
    overturned: Vector = np.zeros(0)

    @property
    def finite(self) -> bool:
        return all(bool(np.isfinite(y).all()) for y in self)

    @property
    def violation(self) -> float:
        return float(max(0.0, np.max(-self.c, initial=0.0)))

    def merit(self, weight: float, penalty: float) -> float:
        return weight * float(np.max(self.f)) + penalty * self.violation


class Rules(NamedTuple):
    """`scale`: of the values; `shift`: margins aimed at; first `radius` of the trust region; when to stop."""

    scale: float
    shift: float
    radius: float
    tolerance: float
    max_iterations: int

    @property
    def feasible_enough(self) -> float:
        """A violation of the margins aimed at that counts as none: the target itself still holds."""
        return 0.5 * self.shift


class Iterate(NamedTuple):
    """One iteration of one start.

    `x`: scaled variables before the step; `objective` and worst `margin` there; `residual`: of the optimality
    conditions; `radius` of the trust region; `penalty` ν; `step`: largest entry of the step tried; whether it
    was `accepted`.
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
    """Where a descent ended: the point, its multipliers (m,) in units of the scaled objective, a result code,
    what holds there."""

    x: Vector
    multipliers: Vector
    result: int
    iterations: int
    there: Evaluation


Descent = Generator[Vector, Evaluation, End]


def prepared(raw: Evaluation, rules: Rules) -> Evaluation:
    """An evaluation as descents look at it: values scaled, margins over those aimed at."""
    return Evaluation(raw.f / rules.scale, raw.c - rules.shift, raw.f_slope / rules.scale, raw.c_slope)


def rank(there: Evaluation) -> tuple[float, float]:
    """Less violation is better; where there is none, lower values."""
    return (there.violation, float(np.max(there.f)))


def scale_of(first: list[Evaluation]) -> float:
    """So large are changes of the objective across the box, by its slopes at the starts."""
    slopes = [float(np.max(np.abs(e.f_slope))) for e in first]
    slopes = [slope for slope in slopes if slope > 0]
    if slopes:
        return float(np.median(slopes))
    return max([float(np.max(np.abs(e.f))) for e in first if np.any(e.f != 0)], default=1.0)


def at_rest(here: Evaluation, residual: float, rules: Rules) -> int:
    """The result of a descent that no step improves."""
    if here.violation > rules.shift:
        return INFEASIBLE
    return CONVERGED if residual <= 100 * rules.tolerance else STALLED
