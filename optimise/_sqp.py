"""Sequential quadratic programming with an exact penalty, a trust region and cuts.

A descent is the search from one starting point. The objective is the largest of several values f_i. Each c_j
is a margin of a target minus the least margin that the descent aims at. If c_j < 0, the margin is violated by
−c_j. The merit is max_i f_i + ν·(largest violation), with the penalty ν. If ν is large enough, a minimum of
the merit satisfies the targets (an exact penalty). If a violation remains although ν is large, the weight of
the objective becomes 0, and the descent minimises only the violation.

In each iteration, a quadratic program (`_quadratic.py`) gives a step within the trust region, a box around
the current point. Responses have kinks (a later peak overtakes an earlier one) and jumps (one more impact
before overturning). If a response is the maximum of several branches, a linear model describes only the
branch that governs where the model was built. Linear models are therefore stored as cuts if they were built
at a rejected trial point, or at the old point of a step that decreased the merit by much less than predicted.
If a cut of f_i lies above f_i at the current point, the cut is lowered until it equals f_i there. If a cut of
c_j lies below c_j there, the cut is raised until it equals c_j. Cuts far from the current point are dropped.
Every rejected step shrinks the trust region, so a descent that cannot pass a jump usually ends with the
result `stalled`.
"""

from __future__ import annotations

from collections.abc import Generator
from typing import NamedTuple

import numpy as np

from ._descent import Descent, End, Evaluation, Iterate, Settings, final_result, rank, scale_evaluation
from ._optimality import EvaluatedPoints, linear_models, optimality, points_near
from ._quadratic import Model, Step, Vector, solve
from ._results import CONVERGED, INFEASIBLE, NOT_FINITE, OUT_OF_ITERATIONS, STALLED

MAX_ITERATIONS = 60  # default limit of the number of iterations
# A step is accepted if the merit decreases by at least ACCEPT_RATIO times the predicted decrease. The trust
# region may be enlarged if the merit decreases by more than GOOD_RATIO times the predicted decrease.
ACCEPT_RATIO, GOOD_RATIO = 1e-3, 0.75
LARGEST_PENALTY = 1e6  # the penalty ν is raised only while it is below this value
MAX_CUTS = 12  # largest number of cut points in the models
MAX_AXIS_SEARCHES = 4  # largest number of searches along the axes, each from the end of a descent
# A search along the axes changes one variable at a time by these distances, in scaled variables.
AXIS_DISTANCES = (0.02, 0.06, 0.2, 0.5)
ROUNDING = 1e-11  # relative decreases of the merit below this are taken as rounding errors


def descend(x: Vector, settings: Settings, history: list[Iterate], start: int, first: int = 0) -> Descent:
    """Minimise the objective from a point x (n,) in scaled variables: a coroutine that yields points,
    receives their `Evaluation`s and returns the `End`. It appends iterates to `history`; `start` is their
    starting point, and `first` the index of the first one.

    Responses have ripples, and the set of points that satisfy the targets may be disconnected. At its end, a
    descent therefore changes one variable at a time. If this leads to a better point, the descent continues
    from there.
    """
    end = yield from _descend(x, settings, history, start, first)
    for _ in range(MAX_AXIS_SEARCHES):
        if end.result in (NOT_FINITE, OUT_OF_ITERATIONS):
            break
        better_point = yield from _search_axes(end, settings)
        if better_point is None:
            break
        continued = yield from _descend(better_point, settings, history, start, end.iterations)
        if rank(continued.evaluation) >= rank(end.evaluation):
            end = end._replace(iterations=continued.iterations)
            break
        end = continued
    return end


def _descend(x: Vector, settings: Settings, history: list[Iterate], start: int, first: int) -> Descent:
    current = scale_evaluation((yield x), settings)
    if not current.is_finite:
        return End(x, np.zeros(len(current.c)), NOT_FINITE, first, current)
    search = _DescentState(x, current, settings, history, start, first)
    while search.iteration < settings.max_iterations:
        search.linearise()
        if search.is_stationary:
            result = search.end_or_reweight()
        else:
            result = yield from search.advance()
        if result is not None:
            return search.end(result)
        search.iteration += 1
    return search.end(OUT_OF_ITERATIONS)


def _search_axes(end: End, settings: Settings) -> Generator[Vector, Evaluation, Vector | None]:
    """Change one variable at a time from an end, and return the best point that is better than the end, or
    None. Larger changes are tried only if no smaller one leads to a better point."""
    best_rank, best_point = rank(end.evaluation), None
    for distance in AXIS_DISTANCES:
        for k in range(len(end.x)):
            for shift in (-distance, distance):
                x = end.x.copy()
                x[k] += shift
                if not 0 <= x[k] <= 1:
                    continue
                evaluation = scale_evaluation((yield x), settings)
                if (
                    evaluation.is_finite
                    and rank(evaluation) < best_rank
                    and (best_rank[0] > 0 or evaluation.violation == 0)
                ):
                    best_rank, best_point = rank(evaluation), x
        if best_point is not None:
            break
    return best_point


class _Merit(NamedTuple):
    """Weights of the merit, and the data of its quadratic model.

    - `curvature`: approximate Hessian of the Lagrangian (n, n); `radius`: radius of the trust region
    - `penalty`: ν; `weight`: weight of the objective: 1, or 0 while only the violation is reduced
    """

    curvature: np.ndarray
    radius: float
    penalty: float
    weight: float


class _Trial(NamedTuple):
    """A trial point, its evaluation, and the actual decrease of the merit divided by the predicted one."""

    x: Vector
    evaluation: Evaluation
    ratio: float


class _DescentState:
    """State of one descent. Methods that may end the descent, such as `end_or_reweight` and `advance`, return
    its result code, or None if the descent continues."""

    def __init__(
        self,
        x: Vector,
        current: Evaluation,
        settings: Settings,
        history: list[Iterate],
        start: int,
        first: int,
    ):
        self.x, self.current, self.settings = x, current, settings
        self.history, self.start, self.iteration = history, start, first
        self.merit = _Merit(np.eye(len(x)), settings.radius, 10.0, 1.0)
        self.multipliers = np.zeros(len(current.c))
        self.cuts: EvaluatedPoints = []
        # True until the first update, and from a reset in `_update_bfgs` until the next update.
        self.is_initial = True

    def end(self, result: int) -> End:
        """Return the end of the descent at the current point."""
        return End(self.x, self.multipliers, result, self.iteration, self.current)

    def record(self, step: float, accepted: bool) -> None:
        """Append an iterate to the history; `step` is the largest absolute entry of the step."""
        margin = float(np.min(self.current.c, initial=np.inf)) + self.settings.shift
        value = float(np.max(self.current.f)) * self.settings.scale
        radius, penalty = self.merit.radius, self.merit.penalty
        self.history.append(
            Iterate(
                self.start,
                self.iteration,
                self.x,
                value,
                margin,
                self.residual,
                radius,
                penalty,
                step,
                accepted,
            )
        )

    def linearise(self) -> None:
        """Drop cuts far from x, build the models around x and evaluate the optimality conditions at x."""
        x, current, merit = self.x, self.current, self.merit
        self.cuts = [
            (point, evaluation)
            for point, evaluation in self.cuts[-MAX_CUTS:]
            if np.max(np.abs(point - x)) <= 10 * merit.radius
        ]
        self.model = linear_models(x, current, self.cuts)
        self.near_points = points_near(x, self.cuts)
        self.multipliers, self.residual, self.modelled_violation = optimality(
            x, current, self.near_points, merit.weight, merit.penalty, self.settings.tolerance
        )
        self.is_violated = current.violation > self.settings.accepted_violation

    @property
    def is_stationary(self) -> bool:
        """True if the residual is at most the tolerance, unless targets are violated and the test step of
        `optimality` would remove at least half of the violation."""
        # The residual is the largest entry of the test step. Where margins are steep, even a test step
        # shorter than the tolerance may remove a violation, so a small residual is not enough.
        is_correctable = self.is_violated and self.modelled_violation <= 0.5 * self.current.violation
        return self.residual <= self.settings.tolerance and not is_correctable

    def end_or_reweight(self) -> int | None:
        """At a stationary point, return the result of the descent, or change the weights of the merit and
        return None."""
        merit = self.merit
        if not self.is_violated:
            self.record(0.0, False)
            if merit.weight == 0.0:  # no target is violated: restore the weight of the objective
                self.merit = merit._replace(weight=1.0)
                return None
            return CONVERGED
        if merit.weight == 0.0:
            self.record(0.0, False)
            return INFEASIBLE
        # The point is stationary but violates a target. Either the penalty is too small, or no point nearby
        # satisfies the targets.
        if merit.penalty < LARGEST_PENALTY:
            self.merit = merit._replace(penalty=100 * merit.penalty)
        else:
            self.merit = merit._replace(weight=0.0, penalty=1.0, radius=max(merit.radius, 0.1))
        return None

    def advance(self) -> Generator[Vector, Evaluation, int | None]:
        """Try a step inside the trust region and accept or reject it."""
        if self.merit.weight == 0.0 and not self.is_violated:
            self.merit = self.merit._replace(weight=1.0, penalty=10.0)
        step, penalty = _step_and_penalty(self.model, self.current, self.merit, *self.region)
        self.merit = self.merit._replace(penalty=penalty)
        if step is None:
            return self.reset_curvature()
        predicted, rounding = self.predict_decrease(step)
        step_size = float(np.max(np.abs(step.d)))
        if (step_size <= 1e-2 * self.settings.tolerance and not self.is_violated) or predicted <= rounding:
            self.record(step_size, False)
            return self.drop_distant_cuts()
        trial = yield from self.try_step(step, predicted, rounding)
        accepted = trial.ratio >= ACCEPT_RATIO
        self.record(step_size, accepted)
        return self.accept(trial, step, step_size) if accepted else self.reject(trial, step_size)

    @property
    def region(self) -> tuple[Vector, Vector]:
        """Lower and upper bounds of a step, from the trust region and the box [0, 1]ⁿ."""
        return np.maximum(-self.x, -self.merit.radius), np.minimum(1 - self.x, self.merit.radius)

    def reset_curvature(self) -> int | None:
        """Reset the curvature to the identity, because the solver has failed. Return `STALLED` if it is the
        identity already."""
        if np.array_equal(self.merit.curvature, np.eye(len(self.x))):
            return STALLED
        self.merit = self.merit._replace(curvature=np.eye(len(self.x)))
        return None

    def drop_distant_cuts(self) -> int | None:
        """Drop the cuts that are not near (`points_near`) and shrink the trust region, because no step
        decreases the merit. Return the result of the descent if all cuts are near."""
        if len(self.near_points) < len(self.cuts):
            self.merit = self.merit._replace(radius=0.25 * self.merit.radius)
            self.cuts = self.near_points
            return None
        return final_result(self.current, self.residual, self.settings)

    def predict_decrease(self, step: Step) -> tuple[float, float]:
        """Return the decrease of the merit that the models predict for a step, and a bound on the rounding
        error of this decrease."""
        merit, d = self.merit, step.d
        current = self.current.merit(merit.weight, merit.penalty)
        quadratic_term = 0.5 * float(d @ merit.curvature @ d)
        modelled = merit.weight * self.model.value(d) + merit.penalty * step.violation + quadratic_term
        return current - modelled, ROUNDING * max(1.0, abs(current))

    def decrease_ratio(self, evaluation: Evaluation, predicted: float, rounding: float) -> float:
        """Return the actual decrease of the merit divided by the predicted one; −inf if the evaluation is not
        finite. `rounding`, as from `predict_decrease`, is added to both decreases, so that rounding errors do
        not reject a step."""
        if not evaluation.is_finite:
            return -np.inf
        weights = self.merit.weight, self.merit.penalty
        return (self.current.merit(*weights) - evaluation.merit(*weights) + rounding) / (predicted + rounding)

    def try_step(
        self, step: Step, predicted: float, rounding: float
    ) -> Generator[Vector, Evaluation, _Trial]:
        """Try a step. If the step is not acceptable and violates the margins by more than the models predict,
        try a second-order correction of the step."""
        d = step.d
        x = np.clip(self.x + d, 0.0, 1.0)
        evaluation = scale_evaluation((yield x), self.settings)
        trial = _Trial(x, evaluation, self.decrease_ratio(evaluation, predicted, rounding))
        exceeds_model = evaluation.violation > step.violation + self.settings.accepted_violation
        if not (evaluation.is_finite and trial.ratio < ACCEPT_RATIO and exceeds_model):
            return trial
        # Second-order correction: shift the linear models of the margins by the errors of these models at the
        # trial point.
        shifted = self.model._replace(c=self.model.c.copy())
        shifted.c[: len(evaluation.c)] = evaluation.c - self.current.c_slope @ d
        merit = self.merit
        corrected = solve(shifted, merit.curvature, merit.weight, merit.penalty, *self.region)
        if corrected is None or np.max(np.abs(corrected.d - d)) <= 0.1 * self.settings.tolerance:
            return trial
        self.cuts.append((x, evaluation))
        corrected_x = np.clip(self.x + corrected.d, 0.0, 1.0)
        corrected_evaluation = scale_evaluation((yield corrected_x), self.settings)
        corrected_ratio = self.decrease_ratio(corrected_evaluation, predicted, rounding)
        if corrected_ratio < ACCEPT_RATIO:
            return trial
        return _Trial(corrected_x, corrected_evaluation, corrected_ratio)

    def accept(self, trial: _Trial, step: Step, step_size: float) -> None:
        """Move to the trial point, and update curvature, radius and cuts. The old point becomes a cut if the
        decrease of the merit was poorly predicted."""
        merit, ratio = self.merit, trial.ratio
        change = _lagrangian_slope(trial.evaluation, step, self.current) - _lagrangian_slope(
            self.current, step, self.current
        )
        curvature, self.is_initial = _update_bfgs(merit.curvature, trial.x - self.x, change, self.is_initial)
        radius = merit.radius
        if ratio > GOOD_RATIO and step_size > 0.8 * radius:
            radius = min(2 * radius, 1.0)
        elif ratio < 0.25:
            radius = 0.5 * step_size
        if ratio < 0.25:
            self.cuts.append((self.x, self.current))
        self.merit = merit._replace(curvature=curvature, radius=radius)
        self.x, self.current = trial.x, trial.evaluation

    def reject(self, trial: _Trial, step_size: float) -> int | None:
        """Store the trial point as a cut if its evaluation is finite, and shrink the trust region. Return the
        result of the descent if the radius is then at most a tenth of the tolerance."""
        if trial.evaluation.is_finite:
            self.cuts.append((trial.x, trial.evaluation))
        self.merit = self.merit._replace(radius=(0.5 if trial.ratio > -1 else 0.25) * step_size)
        if self.merit.radius > 0.1 * self.settings.tolerance:
            return None
        self.iteration += 1  # counts this iteration; `_descend` counts only iterations that do not end it
        return final_result(self.current, self.residual, self.settings)


def _step_and_penalty(
    model: Model, current: Evaluation, merit: _Merit, lower: Vector, upper: Vector
) -> tuple[Step | None, float]:
    """Return a step and the penalty with which it was computed. The step is None if the solver fails; `lower`
    and `upper` are its bounds (n,).

    The penalty is multiplied by 10 until the step removes the whole violation, if any step within the bounds
    can do so, or otherwise 30 % of the part that a step can remove. A penalty of at least `LARGEST_PENALTY`
    is not raised further.
    """
    penalty = merit.penalty
    step = solve(model, merit.curvature, merit.weight, penalty, lower, upper)
    if step is None or merit.weight == 0.0 or step.violation <= 1e-10:
        return step, penalty
    most_feasible = solve(model, 1e-8 * np.eye(len(lower)), 0.0, 1.0, lower, upper)
    if most_feasible is None:
        return step, penalty
    target_violation = current.violation - 0.3 * (current.violation - most_feasible.violation)
    if most_feasible.violation <= 1e-10:
        target_violation = 1e-10
    while step is not None and step.violation > target_violation + 1e-10 and penalty < LARGEST_PENALTY:
        penalty *= 10
        step = solve(model, merit.curvature, merit.weight, penalty, lower, upper)
    return step, penalty


def _lagrangian_slope(trial: Evaluation, step: Step, current: Evaluation) -> Vector:
    """Return the gradient (n,) of the Lagrangian at the evaluation `trial`, with the multipliers of `step`:
    only those of the models built at the current point, one for each value and each margin of `current`, and
    not those of cuts, which follow them."""
    k, m = len(current.f), len(current.c)
    return step.value_multipliers[:k] @ trial.f_slope - step.margin_multipliers[:m] @ trial.c_slope


def _update_bfgs(B: np.ndarray, s: Vector, y: Vector, is_initial: bool) -> tuple[np.ndarray, bool]:
    """Return Powell's damped BFGS update of the curvature B (n, n), positive definite, and True if B was
    reset to the identity instead. `s` is the step (n,), `y` the change of the gradient of the Lagrangian
    (n,). Eigenvalues are limited to [1e-4, 1e4], because the gradient jumps at kinks.

    `is_initial` is True in the first update, and in the first after this function has reset B. Before such an
    update, B is replaced by a multiple of the identity if the curvature along `s` is positive.
    """
    if is_initial and s @ y > 0:
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
