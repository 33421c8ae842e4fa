"""Sequential quadratic programming with an exact penalty, a trust region and cuts from the steps that failed.

The merit is max_i f_i + ν·(largest violation). The penalty of the *largest* violation is exact for finite ν,
and where no point satisfies all margins it leads to the one with the least violation.

Responses have kinks (a later peak overtakes an earlier one) and jumps (one more impact before overturning). A
rejected trial adds its linear models as cuts: if the function is the maximum of several branches, the cut is
the branch that took over. Cuts are lifted to be consistent with the present point, and dropped once they are
far from it. Every rejected step shrinks the region, so at a jump the descent ends with the result `stalled`.
"""

from __future__ import annotations

from collections.abc import Generator
from typing import NamedTuple

import numpy as np

from ._descent import Descent, End, Evaluation, Iterate, Rules, rank, result_at_rest, scale_evaluation
from ._optimality import EvaluatedPoints, linear_models, optimality, points_near
from ._quadratic import Model, Step, Vector, solve
from ._results import CONVERGED, INFEASIBLE, NOT_FINITE, OUT_OF_ITERATIONS, STALLED

MAX_ITERATIONS = 60
ACCEPT_RATIO, GOOD_RATIO = 1e-3, 0.75  # parts of the predicted decrease
LARGEST_PENALTY = 1e6
CUTS = 12  # trials remembered
AXIS_SEARCHES, AXIS_DISTANCES = (
    4,
    (0.02, 0.06, 0.2, 0.5),
)  # number and distances of the searches along the axes at an end
NOISE = 1e-11  # relative decreases of the merit below this are rounding


def descend(x: Vector, rules: Rules, history: list[Iterate], start: int, first: int = 0) -> Descent:
    """Minimise from x in [0, 1]ⁿ: a coroutine that yields points and receives their `Evaluation`s.

    - `x`: first point (n,), in scaled variables; `rules`: scale, margins aimed at, stopping criteria
    - `history`: receives the iterates; `start`: their start; `first`: number of the first one

    Returns the `End`. Responses have ripples and the feasible set may be disconnected: a descent therefore
    searches along the axes at its end, and continues from a better point if it finds one.
    """
    end = yield from _descend(x, rules, history, start, first)
    for _ in range(AXIS_SEARCHES):
        if end.result in (NOT_FINITE, OUT_OF_ITERATIONS):
            break
        other = yield from _search_axes(end, rules)
        if other is None:
            break
        continued = yield from _descend(other, rules, history, start, end.iterations)
        if rank(continued.evaluation) >= rank(end.evaluation):
            end = end._replace(iterations=continued.iterations)
            break
        end = continued
    return end


def _descend(x: Vector, rules: Rules, history: list[Iterate], start: int, first: int) -> Descent:
    current = scale_evaluation((yield x), rules)
    if not current.is_finite:
        return End(x, np.zeros(len(current.c)), NOT_FINITE, first, current)
    search = _DescentState(x, current, rules, history, start, first)
    while search.iteration < rules.max_iterations:
        search.linearise()
        if search.is_stationary:
            result = search.raise_penalty()
        else:
            result = yield from search.advance()
        if result is not None:
            return search.end(result)
        search.iteration += 1
    return search.end(OUT_OF_ITERATIONS)


def _search_axes(end: End, rules: Rules) -> Generator[Vector, Evaluation, Vector | None]:
    """Search along the axes for a better point; return None if there is none."""
    best, found = rank(end.evaluation), None
    for distance in AXIS_DISTANCES:
        for k in range(len(end.x)):
            for side in (-distance, distance):
                x = end.x.copy()
                x[k] += side
                if not 0 <= x[k] <= 1:
                    continue
                evaluation = scale_evaluation((yield x), rules)
                if (
                    evaluation.is_finite
                    and rank(evaluation) < best
                    and (best[0] > 0 or evaluation.violation == 0)
                ):
                    best, found = rank(evaluation), x
        if found is not None:
            break
    return found


class _Merit(NamedTuple):
    """Weights of the merit, with `curvature` of the Lagrangian and `radius` of the trust region."""

    curvature: np.ndarray
    radius: float
    penalty: float
    weight: float  # of the objective: 0 while only the violation counts


class _Trial(NamedTuple):
    """A trial point, its evaluation, and actual over predicted decrease of the merit."""

    x: Vector
    evaluation: Evaluation
    ratio: float


class _DescentState:
    """State of one descent. Its methods return a result code if they end it, None otherwise."""

    def __init__(
        self, x: Vector, current: Evaluation, rules: Rules, history: list[Iterate], start: int, first: int
    ):
        self.x, self.current, self.rules = x, current, rules
        self.history, self.start, self.iteration = history, start, first
        self.merit = _Merit(np.eye(len(x)), rules.radius, 10.0, 1.0)
        self.multipliers = np.zeros(len(current.c))
        self.cuts: EvaluatedPoints = []
        self.is_fresh = True  # the curvature has not been measured yet

    def end(self, result: int) -> End:
        return End(self.x, self.multipliers, result, self.iteration, self.current)

    def record(self, step: float, accepted: bool) -> None:
        margin = float(np.min(self.current.c, initial=np.inf)) + self.rules.shift
        value = float(np.max(self.current.f)) * self.rules.scale
        state = self.merit.radius, self.merit.penalty
        self.history.append(
            Iterate(self.start, self.iteration, self.x, value, margin, self.residual, *state, step, accepted)
        )

    def linearise(self) -> None:
        """Build the models around x and evaluate its optimality."""
        x, current, merit = self.x, self.current, self.merit
        self.cuts = [
            (y, evaluation)
            for y, evaluation in self.cuts[-CUTS:]
            if np.max(np.abs(y - x)) <= 10 * merit.radius
        ]
        self.model = linear_models(x, current, self.cuts)
        self.near_points = points_near(x, self.cuts)
        found = optimality(x, current, self.near_points, merit.weight, merit.penalty, self.rules.tolerance)
        self.multipliers, self.residual, self.modelled_violation = found
        self.is_violated = current.violation > self.rules.accepted_violation

    @property
    def is_stationary(self) -> bool:
        # Where margins are steep, a short step may still remove a violation.
        corrects = self.is_violated and self.modelled_violation <= 0.5 * self.current.violation
        return self.residual <= self.rules.tolerance and not corrects

    def raise_penalty(self) -> int | None:
        """Return the result of a stationary point, or change the merit and return None."""
        merit = self.merit
        if not self.is_violated:
            self.record(0.0, False)
            if merit.weight == 0.0:  # feasible again: restore the weight of the objective
                self.merit = merit._replace(weight=1.0)
                return None
            return CONVERGED
        if merit.weight == 0.0:
            self.record(0.0, False)
            return INFEASIBLE
        # Stationary with a violation: the penalty is too small, or nothing nearby satisfies the targets.
        if merit.penalty < LARGEST_PENALTY:
            self.merit = merit._replace(penalty=100 * merit.penalty)
        else:
            self.merit = merit._replace(weight=0.0, penalty=1.0, radius=max(merit.radius, 0.1))
        return None

    def advance(self) -> Generator[Vector, Evaluation, int | None]:
        """Try a step inside the region and accept or reject it."""
        if self.merit.weight == 0.0 and not self.is_violated:
            self.merit = self.merit._replace(weight=1.0, penalty=10.0)
        step, penalty = _step_and_penalty(self.model, self.current, self.merit, *self.region)
        self.merit = self.merit._replace(penalty=penalty)
        if step is None:
            return self.without_a_step()
        predicted, slack = self.prediction(step)
        length = float(np.max(np.abs(step.d)))
        if (length <= 1e-2 * self.rules.tolerance and not self.is_violated) or predicted <= slack:
            self.record(length, False)
            return self.without_a_decrease()
        trial = yield from self.try_step(step, predicted, slack)
        accepted = trial.ratio >= ACCEPT_RATIO
        self.record(length, accepted)
        return self.accept(trial, step, length) if accepted else self.reject(trial, length)

    @property
    def region(self) -> tuple[Vector, Vector]:
        return np.maximum(-self.x, -self.merit.radius), np.minimum(1 - self.x, self.merit.radius)

    def without_a_step(self) -> int | None:
        if np.array_equal(self.merit.curvature, np.eye(len(self.x))):
            return STALLED
        self.merit = self.merit._replace(curvature=np.eye(len(self.x)))
        return None

    def without_a_decrease(self) -> int | None:
        if len(self.near_points) < len(
            self.cuts
        ):  # held back by cuts from far away, which need not apply here
            self.merit = self.merit._replace(radius=0.25 * self.merit.radius)
            self.cuts = self.near_points
            return None
        return result_at_rest(self.current, self.residual, self.rules)

    def prediction(self, step: Step) -> tuple[float, float]:
        """Return the predicted decrease of the merit and its rounding."""
        merit, d = self.merit, step.d
        present = self.current.merit(merit.weight, merit.penalty)
        quadratic_term = 0.5 * float(d @ merit.curvature @ d)
        predicted = merit.weight * self.model.value(d) + merit.penalty * step.violation + quadratic_term
        return present - predicted, NOISE * max(1.0, abs(present))

    def ratio(self, evaluation: Evaluation, predicted: float, slack: float) -> float:
        if not evaluation.is_finite:
            return -np.inf
        weights = self.merit.weight, self.merit.penalty
        return (self.current.merit(*weights) - evaluation.merit(*weights) + slack) / (predicted + slack)

    def try_step(self, step: Step, predicted: float, slack: float) -> Generator[Vector, Evaluation, _Trial]:
        """Try a step; if it violates the margins by more than modelled, try a second-order correction."""
        d = step.d
        x = np.clip(self.x + d, 0.0, 1.0)
        evaluation = scale_evaluation((yield x), self.rules)
        trial = _Trial(x, evaluation, self.ratio(evaluation, predicted, slack))
        too_far = evaluation.violation > step.violation + self.rules.accepted_violation
        if not (evaluation.is_finite and trial.ratio < ACCEPT_RATIO and too_far):
            return trial
        # Second-order correction: the models are shifted by the error found at the trial point.
        shifted = self.model._replace(c=self.model.c.copy())
        shifted.c[: len(evaluation.c)] = evaluation.c - self.current.c_slope @ d
        merit = self.merit
        corrected = solve(shifted, merit.curvature, merit.weight, merit.penalty, *self.region)
        if corrected is None or np.max(np.abs(corrected.d - d)) <= 0.1 * self.rules.tolerance:
            return trial
        self.cuts.append((x, evaluation))
        other = np.clip(self.x + corrected.d, 0.0, 1.0)
        found = scale_evaluation((yield other), self.rules)
        better = self.ratio(found, predicted, slack)
        return _Trial(other, found, better) if better >= ACCEPT_RATIO else trial

    def accept(self, trial: _Trial, step: Step, length: float) -> None:
        merit, ratio = self.merit, trial.ratio
        change = _lagrangian_slope(trial.evaluation, step, self.current) - _lagrangian_slope(
            self.current, step, self.current
        )
        curvature, self.is_fresh = _update_bfgs(merit.curvature, trial.x - self.x, change, self.is_fresh)
        radius = merit.radius
        if ratio > GOOD_RATIO and length > 0.8 * radius:
            radius = min(2 * radius, 1.0)
        elif ratio < 0.25:
            radius = 0.5 * length
        if ratio < 0.25:
            self.cuts.append((self.x, self.current))
        self.merit = merit._replace(curvature=curvature, radius=radius)
        self.x, self.current = trial.x, trial.evaluation

    def reject(self, trial: _Trial, length: float) -> int | None:
        if trial.evaluation.is_finite:
            self.cuts.append((trial.x, trial.evaluation))
        self.merit = self.merit._replace(radius=(0.5 if trial.ratio > -1 else 0.25) * length)
        if self.merit.radius > 0.1 * self.rules.tolerance:
            return None
        self.iteration += 1
        return result_at_rest(self.current, self.residual, self.rules)


def _step_and_penalty(
    model: Model, current: Evaluation, merit: _Merit, lower: Vector, upper: Vector
) -> tuple[Step | None, float]:
    """Return a step and a penalty, raised until the step attains a fair share of the possible feasibility."""
    penalty = merit.penalty
    step = solve(model, merit.curvature, merit.weight, penalty, lower, upper)
    if step is None or merit.weight == 0.0 or step.violation <= 1e-10:
        return step, penalty
    most_feasible = solve(model, 1e-8 * np.eye(len(lower)), 0.0, 1.0, lower, upper)
    if most_feasible is None:
        return step, penalty
    target = current.violation - 0.3 * (current.violation - most_feasible.violation)
    if most_feasible.violation <= 1e-10:
        target = 1e-10
    while step is not None and step.violation > target + 1e-10 and penalty < LARGEST_PENALTY:
        penalty *= 10
        step = solve(model, merit.curvature, merit.weight, penalty, lower, upper)
    return step, penalty


def _lagrangian_slope(trial: Evaluation, step: Step, current: Evaluation) -> Vector:
    k, m = len(current.f), len(current.c)
    return step.value_multipliers[:k] @ trial.f_slope - step.margin_multipliers[:m] @ trial.c_slope


def _update_bfgs(B: np.ndarray, s: Vector, y: Vector, is_fresh: bool) -> tuple[np.ndarray, bool]:
    """Return Powell's damped BFGS update, positive definite, with bounded eigenvalues against kinks."""
    if is_fresh and s @ y > 0:
        B = np.clip(s @ y / (s @ s), 1e-2, 1e2) * np.eye(len(s))
    Bs = B @ s
    step_curvature = s @ Bs
    if step_curvature <= 0 or not np.isfinite(y).all():
        return np.eye(len(s)), True
    if s @ y < 0.2 * step_curvature:
        t = 0.8 * step_curvature / (step_curvature - s @ y)
        y = t * y + (1 - t) * Bs
    B = B + np.outer(y, y) / (s @ y) - np.outer(Bs, Bs) / step_curvature
    values, vectors = np.linalg.eigh(0.5 * (B + B.T))
    return (vectors * np.clip(values, 1e-4, 1e4)) @ vectors.T, False
