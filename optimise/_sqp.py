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

from ._descent import Descent, End, Evaluation, Iterate, Rules, at_rest, prepared, rank
from ._optimality import Seen, linear_models, nearby, optimality
from ._quadratic import Model, Step, Vector, solve
from ._results import CONVERGED, INFEASIBLE, NOT_FINITE, OUT_OF_ITERATIONS, STALLED

MAX_ITERATIONS = 60
ACCEPT, GOOD = 1e-3, 0.75  # parts of the predicted decrease
LARGEST_PENALTY = 1e6
CUTS = 12  # trials remembered
LOOKS, REACHES = 4, (0.02, 0.06, 0.2, 0.5)  # number and distances of the searches along the axes at an end
NOISE = 1e-11  # relative decreases of the merit below this are rounding


def descend(x: Vector, rules: Rules, history: list[Iterate], start: int, first: int = 0) -> Descent:
    """Minimise from x in [0, 1]ⁿ: a coroutine that yields points and receives their `Evaluation`s.

    - `x`: first point (n,), in scaled variables; `rules`: scale, margins aimed at, stopping criteria
    - `history`: receives the iterates; `start`: their start; `first`: number of the first one

    Returns the `End`. Responses have ripples and the feasible set may be disconnected: a descent therefore
    searches along the axes at its end, and continues from a better point if it finds one.
    """
    end = yield from _descend(x, rules, history, start, first)
    for _ in range(LOOKS):
        if end.result in (NOT_FINITE, OUT_OF_ITERATIONS):
            break
        other = yield from _look_around(end, rules)
        if other is None:
            break
        again = yield from _descend(other, rules, history, start, end.iterations)
        if rank(again.there) >= rank(end.there):
            end = end._replace(iterations=again.iterations)
            break
        end = again
    return end


def _descend(x: Vector, rules: Rules, history: list[Iterate], start: int, first: int) -> Descent:
    here = prepared((yield x), rules)
    if not here.finite:
        return End(x, np.zeros(len(here.c)), NOT_FINITE, first, here)
    search = _Search(x, here, rules, history, start, first)
    while search.iteration < rules.max_iterations:
        search.linearise()
        if search.stationary:
            result = search.raise_penalty()
        else:
            result = yield from search.advance()
        if result is not None:
            return search.end(result)
        search.iteration += 1
    return search.end(OUT_OF_ITERATIONS)


def _look_around(end: End, rules: Rules) -> Generator[Vector, Evaluation, Vector | None]:
    """Search along the axes for a better point; return None if there is none."""
    best, found = rank(end.there), None
    for reach in REACHES:
        for k in range(len(end.x)):
            for side in (-reach, reach):
                x = end.x.copy()
                x[k] += side
                if not 0 <= x[k] <= 1:
                    continue
                there = prepared((yield x), rules)
                if there.finite and rank(there) < best and (best[0] > 0 or there.violation == 0):
                    best, found = rank(there), x
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
    there: Evaluation
    ratio: float


class _Search:
    """State of one descent. Its methods return a result code if they end it, None otherwise."""

    def __init__(
        self, x: Vector, here: Evaluation, rules: Rules, history: list[Iterate], start: int, first: int
    ):
        self.x, self.here, self.rules = x, here, rules
        self.history, self.start, self.iteration = history, start, first
        self.merit = _Merit(np.eye(len(x)), rules.radius, 10.0, 1.0)
        self.multipliers = np.zeros(len(here.c))
        self.cuts: Seen = []
        self.fresh = True  # the curvature has not been measured yet

    def end(self, result: int) -> End:
        return End(self.x, self.multipliers, result, self.iteration, self.here)

    def record(self, step: float, accepted: bool) -> None:
        margin = float(np.min(self.here.c, initial=np.inf)) + self.rules.shift
        value = float(np.max(self.here.f)) * self.rules.scale
        state = self.merit.radius, self.merit.penalty
        self.history.append(
            Iterate(self.start, self.iteration, self.x, value, margin, self.residual, *state, step, accepted)
        )

    def linearise(self) -> None:
        """Build the models around x and evaluate its optimality."""
        x, here, merit = self.x, self.here, self.merit
        self.cuts = [
            (y, there) for y, there in self.cuts[-CUTS:] if np.max(np.abs(y - x)) <= 10 * merit.radius
        ]
        self.model = linear_models(x, here, self.cuts)
        self.near = nearby(x, self.cuts)
        found = optimality(x, here, self.near, merit.weight, merit.penalty, self.rules.tolerance)
        self.multipliers, self.residual, self.left = found
        self.violated = here.violation > self.rules.feasible_enough

    @property
    def stationary(self) -> bool:
        # Where margins are steep, a short step may still remove a violation.
        corrects = self.violated and self.left <= 0.5 * self.here.violation
        return self.residual <= self.rules.tolerance and not corrects

    def raise_penalty(self) -> int | None:
        """Return the result of a stationary point, or change the merit and return None."""
        merit = self.merit
        if not self.violated:
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
        if self.merit.weight == 0.0 and not self.violated:
            self.merit = self.merit._replace(weight=1.0, penalty=10.0)
        step, penalty = _steered(self.model, self.here, self.merit, *self.region)
        self.merit = self.merit._replace(penalty=penalty)
        if step is None:
            return self.without_a_step()
        predicted, slack = self.prediction(step)
        length = float(np.max(np.abs(step.d)))
        if (length <= 1e-2 * self.rules.tolerance and not self.violated) or predicted <= slack:
            self.record(length, False)
            return self.without_a_decrease()
        trial = yield from self.tried(step, predicted, slack)
        accepted = trial.ratio >= ACCEPT
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
        if len(self.near) < len(self.cuts):  # held back by cuts from far away, which need not apply here
            self.merit = self.merit._replace(radius=0.25 * self.merit.radius)
            self.cuts = self.near
            return None
        return at_rest(self.here, self.residual, self.rules)

    def prediction(self, step: Step) -> tuple[float, float]:
        """Return the predicted decrease of the merit and its rounding."""
        merit, d = self.merit, step.d
        now = self.here.merit(merit.weight, merit.penalty)
        bend = 0.5 * float(d @ merit.curvature @ d)
        then = merit.weight * self.model.value(d) + merit.penalty * step.violation + bend
        return now - then, NOISE * max(1.0, abs(now))

    def ratio(self, there: Evaluation, predicted: float, slack: float) -> float:
        if not there.finite:
            return -np.inf
        weights = self.merit.weight, self.merit.penalty
        return (self.here.merit(*weights) - there.merit(*weights) + slack) / (predicted + slack)

    def tried(self, step: Step, predicted: float, slack: float) -> Generator[Vector, Evaluation, _Trial]:
        """Try a step; if it violates the margins by more than modelled, try a second-order correction."""
        d = step.d
        x = np.clip(self.x + d, 0.0, 1.0)
        there = prepared((yield x), self.rules)
        trial = _Trial(x, there, self.ratio(there, predicted, slack))
        too_far = there.violation > step.violation + self.rules.feasible_enough
        if not (there.finite and trial.ratio < ACCEPT and too_far):
            return trial
        # Second-order correction: the models are shifted by the error found at the trial point.
        bent = self.model._replace(c=self.model.c.copy())
        bent.c[: len(there.c)] = there.c - self.here.c_slope @ d
        merit = self.merit
        corrected = solve(bent, merit.curvature, merit.weight, merit.penalty, *self.region)
        if corrected is None or np.max(np.abs(corrected.d - d)) <= 0.1 * self.rules.tolerance:
            return trial
        self.cuts.append((x, there))
        other = np.clip(self.x + corrected.d, 0.0, 1.0)
        found = prepared((yield other), self.rules)
        better = self.ratio(found, predicted, slack)
        return _Trial(other, found, better) if better >= ACCEPT else trial

    def accept(self, trial: _Trial, step: Step, length: float) -> None:
        merit, ratio = self.merit, trial.ratio
        change = _lagrangian_slope(trial.there, step, self.here) - _lagrangian_slope(
            self.here, step, self.here
        )
        curvature, self.fresh = _updated(merit.curvature, trial.x - self.x, change, self.fresh)
        radius = merit.radius
        if ratio > GOOD and length > 0.8 * radius:
            radius = min(2 * radius, 1.0)
        elif ratio < 0.25:
            radius = 0.5 * length
        if ratio < 0.25:
            self.cuts.append((self.x, self.here))
        self.merit = merit._replace(curvature=curvature, radius=radius)
        self.x, self.here = trial.x, trial.there

    def reject(self, trial: _Trial, length: float) -> int | None:
        if trial.there.finite:
            self.cuts.append((trial.x, trial.there))
        self.merit = self.merit._replace(radius=(0.5 if trial.ratio > -1 else 0.25) * length)
        if self.merit.radius > 0.1 * self.rules.tolerance:
            return None
        self.iteration += 1
        return at_rest(self.here, self.residual, self.rules)


def _steered(
    model: Model, here: Evaluation, merit: _Merit, lower: Vector, upper: Vector
) -> tuple[Step | None, float]:
    """Return a step and a penalty, raised until the step attains a fair share of the possible feasibility."""
    penalty = merit.penalty
    step = solve(model, merit.curvature, merit.weight, penalty, lower, upper)
    if step is None or merit.weight == 0.0 or step.violation <= 1e-10:
        return step, penalty
    least = solve(model, 1e-8 * np.eye(len(lower)), 0.0, 1.0, lower, upper)
    if least is None:
        return step, penalty
    wanted = here.violation - 0.3 * (here.violation - least.violation)
    if least.violation <= 1e-10:
        wanted = 1e-10
    while step is not None and step.violation > wanted + 1e-10 and penalty < LARGEST_PENALTY:
        penalty *= 10
        step = solve(model, merit.curvature, merit.weight, penalty, lower, upper)
    return step, penalty


def _lagrangian_slope(at: Evaluation, step: Step, here: Evaluation) -> Vector:
    k, m = len(here.f), len(here.c)
    return step.value_multipliers[:k] @ at.f_slope - step.margin_multipliers[:m] @ at.c_slope


def _updated(B: np.ndarray, s: Vector, y: Vector, fresh: bool) -> tuple[np.ndarray, bool]:
    """Return Powell's damped BFGS update, positive definite, with bounded eigenvalues against kinks."""
    if fresh and s @ y > 0:
        B = np.clip(s @ y / (s @ s), 1e-2, 1e2) * np.eye(len(s))
    Bs = B @ s
    bend = s @ Bs
    if bend <= 0 or not np.isfinite(y).all():
        return np.eye(len(s)), True
    if s @ y < 0.2 * bend:
        t = 0.8 * bend / (bend - s @ y)
        y = t * y + (1 - t) * Bs
    B = B + np.outer(y, y) / (s @ y) - np.outer(Bs, Bs) / bend
    values, vectors = np.linalg.eigh(0.5 * (B + B.T))
    return (vectors * np.clip(values, 1e-4, 1e4)) @ vectors.T, False
