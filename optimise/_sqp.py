"""Sequential quadratic programming with an exact penalty, a trust region and cuts from the steps that failed.

One descent is a coroutine: it yields points and is sent what holds there, so that many descents can be evaluated as one
batch. Its merit is max_i f_i + ν·(largest violation). The penalty of the *largest* violation is exact for finite ν, and
where no point satisfies all margins it leads to the one that violates least.

Responses have kinks (a later peak overtakes an earlier one) and jumps (one impact more before a fall). A rejected trial
leaves its linear models as cuts: if the function is the worst of several branches, the cut is the branch that took over.
Cuts are lifted to where they do not contradict the present point and dropped once they are far from it. Every rejected
step shrinks the region, so at a jump the descent stalls and says so.
"""

from __future__ import annotations

from collections.abc import Generator
from typing import NamedTuple

import numpy as np

from ._quadratic import Model, Step, Vector, solve
from ._results import CONVERGED, INFEASIBLE, NOT_FINITE, OUT_OF_ITERATIONS, STALLED

ACCEPT, GOOD = 1e-3, 0.75  # parts of the predicted decrease
LARGEST_PENALTY = 1e6
CUTS = 12  # trials remembered
NEAR = 1e-3  # a cut from so close tells of a kink here
LOOKS, REACHES = 4, (0.02, 0.06, 0.2, 0.5)  # how often and how far a descent looks around at its end
NOISE = 1e-11  # of the merit: decreases below are rounding


class Evaluation(NamedTuple):
    """Values f (k,), margins c (m,) and their Jacobians (k, n), (m, n) in scaled variables."""

    f: Vector
    c: Vector
    f_slope: Vector
    c_slope: Vector

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


class Iterate(NamedTuple):
    """One iteration of one start.

    `x`: scaled variables before the step; `objective` and worst `margin` there; `residual`: of the optimality conditions;
    `radius` of the trust region; `penalty` ν; `step`: largest entry of the step tried; whether it was `accepted`.
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
    """Where a descent ended: the point, its multipliers (m,) in units of the scaled objective, a result code, what holds
    there."""

    x: Vector
    multipliers: Vector
    result: int
    iterations: int
    there: Evaluation


Descent = Generator[Vector, Evaluation, End]


def descend(x: Vector, rules: Rules, history: list[Iterate], start: int) -> Descent:
    """Minimise from x in [0, 1]ⁿ; yields points, is sent `Evaluation`s there.

    Responses have ripples, and what satisfies the targets may be in several pieces: a descent looks around at its end, and
    goes on from a better point if it sees one.
    """
    end = yield from _descend(x, rules, history, start, 0)
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


def prepared(raw: Evaluation, rules: Rules) -> Evaluation:
    """An evaluation as descents look at it: values scaled, margins over those aimed at."""
    return Evaluation(raw.f / rules.scale, raw.c - rules.shift, raw.f_slope / rules.scale, raw.c_slope)


def rank(there: Evaluation) -> tuple[float, float]:
    """Less violation is better; where there is none, lower values."""
    return (there.violation, float(np.max(there.f)))


def _look_around(end: End, rules: Rules) -> Generator[Vector, Evaluation, Vector | None]:
    """A better point some way off along an axis, None if there is none."""
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


def _descend(x: Vector, rules: Rules, history: list[Iterate], start: int, first: int) -> Descent:
    """One descent; iterations are numbered from `first`."""
    n = len(x)

    here = prepared((yield x), rules)
    multipliers = np.zeros(len(here.c))
    if not here.finite:
        return End(x, multipliers, NOT_FINITE, first, here)
    state = _State(np.eye(n), rules.radius, 10.0, 1.0)
    cuts: list[tuple[Vector, Evaluation]] = []
    fresh = True  # the curvature has not been measured yet
    feasible_enough = 0.5 * rules.shift

    def record(iteration: int, residual: float, step: float, accepted: bool) -> None:
        margin = float(np.min(here.c, initial=np.inf)) + rules.shift
        value = float(np.max(here.f)) * rules.scale
        history.append(Iterate(start, iteration, x, value, margin, residual, state.radius, state.penalty, step, accepted))

    for iteration in range(first, rules.max_iterations):
        cuts = [(y, there) for y, there in cuts[-CUTS:] if np.max(np.abs(y - x)) <= 10 * state.radius]
        model = _model(x, here, cuts)
        multipliers, residual, left = _stationarity(x, here, _model(x, here, []), state.weight, state.penalty)
        near = [(y, there) for y, there in cuts if np.max(np.abs(y - x)) <= NEAR]
        if residual > rules.tolerance and near:  # smooth it is not, but perhaps at a kink
            multipliers, residual, left = _stationarity(x, here, _model(x, here, near), state.weight, state.penalty)
        violated = here.violation > feasible_enough
        # Where margins are steep, a short step may still mend a violation.
        if residual <= rules.tolerance and (not violated or left > 0.5 * here.violation):
            if not violated:
                record(iteration, residual, 0.0, False)
                if state.weight == 0.0:  # came from infeasible ground, and the objective has a say again
                    state = state._replace(weight=1.0)
                    continue
                return End(x, multipliers, CONVERGED, iteration, here)
            if state.weight == 0.0:
                record(iteration, residual, 0.0, False)
                return End(x, multipliers, INFEASIBLE, iteration, here)
            # Stationary with a violation: the penalty is too small, or nothing nearby satisfies the targets.
            if state.penalty < LARGEST_PENALTY:
                state = state._replace(penalty=100 * state.penalty)
            else:
                state = state._replace(weight=0.0, penalty=1.0, radius=max(state.radius, 0.1))
            continue
        if state.weight == 0.0 and not violated:
            state = state._replace(weight=1.0, penalty=10.0)
        lower, upper = np.maximum(-x, -state.radius), np.minimum(1 - x, state.radius)
        step, penalty = _steered(model, here, state, lower, upper)
        state = state._replace(penalty=penalty)
        if step is None:
            if np.array_equal(state.curvature, np.eye(n)):
                return End(x, multipliers, STALLED, iteration, here)
            state = state._replace(curvature=np.eye(n))
            continue
        merit = here.merit(state.weight, state.penalty)
        d = step.d
        predicted = merit - (
            state.weight * model.value(d) + state.penalty * step.violation + 0.5 * float(d @ state.curvature @ d)
        )
        slack = NOISE * max(1.0, abs(merit))
        length = float(np.max(np.abs(d)))
        if (length <= 1e-2 * rules.tolerance and not violated) or predicted <= slack:
            record(iteration, residual, length, False)
            if len(near) < len(cuts):  # held back by what was seen far away, which need not reach here
                state = state._replace(radius=0.25 * state.radius)
                cuts = near
                continue
            return End(x, multipliers, _resting(here, residual, rules), iteration, here)
        trial = np.clip(x + d, 0.0, 1.0)
        there = prepared((yield trial), rules)
        ratio = _ratio(there, merit, predicted, slack, state)
        if there.finite and ratio < ACCEPT and there.violation > step.violation + feasible_enough:
            # Second-order correction: the margins bend away from their linear models by about what was found.
            bent = model._replace(c=model.c.copy())
            bent.c[: len(here.c)] = there.c - here.c_slope @ d
            corrected = solve(bent, state.curvature, state.weight, state.penalty, lower, upper)
            if corrected is not None and np.max(np.abs(corrected.d - d)) > 0.1 * rules.tolerance:
                cuts.append((trial, there))
                other = np.clip(x + corrected.d, 0.0, 1.0)
                found = prepared((yield other), rules)
                better = _ratio(found, merit, predicted, slack, state)
                if better >= ACCEPT:
                    trial, there, ratio, d = other, found, better, corrected.d
        accepted = ratio >= ACCEPT
        record(iteration, residual, length, accepted)
        if accepted:
            change = _lagrangian_slope(there, step, here) - _lagrangian_slope(here, step, here)
            curvature, fresh = _updated(state.curvature, trial - x, change, fresh)
            radius = state.radius
            if ratio > GOOD and length > 0.8 * radius:
                radius = min(2 * radius, 1.0)
            elif ratio < 0.25:
                radius = 0.5 * length
            if ratio < 0.25:
                cuts.append((x, here))
            state = state._replace(curvature=curvature, radius=radius)
            x, here = trial, there
        else:
            if there.finite:
                cuts.append((trial, there))
            state = state._replace(radius=(0.5 if ratio > -1 else 0.25) * length)
            if state.radius <= 0.1 * rules.tolerance:
                return End(x, multipliers, _resting(here, residual, rules), iteration + 1, here)
    return End(x, multipliers, OUT_OF_ITERATIONS, rules.max_iterations, here)


class _State(NamedTuple):
    curvature: np.ndarray
    radius: float
    penalty: float
    weight: float  # of the objective: 0 while only the violation counts


def _resting(here: Evaluation, residual: float, rules: Rules) -> int:
    if here.violation > rules.shift:
        return INFEASIBLE
    return CONVERGED if residual <= 100 * rules.tolerance else STALLED


def _ratio(there: Evaluation, merit: float, predicted: float, slack: float, state: _State) -> float:
    if not there.finite:
        return -np.inf
    return (merit - there.merit(state.weight, state.penalty) + slack) / (predicted + slack)


def _model(x: Vector, here: Evaluation, cuts: list[tuple[Vector, Evaluation]]) -> Model:
    """Linear models at x, and those of the cuts, lifted so that they do not contradict the values at x."""
    k, m = len(here.f), len(here.c)
    f, f_slope, c, c_slope = [here.f], [here.f_slope], [here.c], [here.c_slope]
    for y, there in cuts:
        f.append(np.minimum(there.f + there.f_slope @ (x - y), here.f))
        f_slope.append(there.f_slope)
        c.append(np.maximum(there.c + there.c_slope @ (x - y), here.c))
        c_slope.append(there.c_slope)
    copies = 1 + len(cuts)
    return Model(
        np.concatenate(f),
        np.concatenate(f_slope),
        np.concatenate(c),
        np.concatenate(c_slope),
        np.tile(np.arange(k), copies),
        np.tile(np.arange(m), copies),
    )


def _stationarity(x: Vector, here: Evaluation, model: Model, weight: float, penalty: float) -> tuple[Vector, float, float]:
    """Multipliers, the residual of the optimality conditions, and the violation it would leave. The residual is the step
    that unit curvature would take, as of a projected gradient: 0 just where the merit is stationary in its bounds."""
    step = solve(model, np.eye(len(x)), weight, penalty, -x, 1 - x)
    if step is None:
        return np.zeros(len(here.c)), np.inf, here.violation
    multipliers = np.bincount(model.margin_of, step.margin_multipliers, minlength=len(here.c))
    return multipliers, float(np.max(np.abs(step.d))), step.violation


def _steered(model: Model, here: Evaluation, state: _State, lower: Vector, upper: Vector) -> tuple[Step | None, float]:
    """A step, and a penalty large enough that it gets a fair share of what feasibility can be had inside the region."""
    penalty = state.penalty
    step = solve(model, state.curvature, state.weight, penalty, lower, upper)
    if step is None or state.weight == 0.0 or step.violation <= 1e-10:
        return step, penalty
    least = solve(model, 1e-8 * np.eye(len(lower)), 0.0, 1.0, lower, upper)
    if least is None:
        return step, penalty
    wanted = here.violation - 0.3 * (here.violation - least.violation)
    if least.violation <= 1e-10:
        wanted = 1e-10
    while step is not None and step.violation > wanted + 1e-10 and penalty < LARGEST_PENALTY:
        penalty *= 10
        step = solve(model, state.curvature, state.weight, penalty, lower, upper)
    return step, penalty


def _lagrangian_slope(at: Evaluation, step: Step, here: Evaluation) -> Vector:
    k, m = len(here.f), len(here.c)
    return step.value_multipliers[:k] @ at.f_slope - step.margin_multipliers[:m] @ at.c_slope


def _updated(B: np.ndarray, s: Vector, y: Vector, fresh: bool) -> tuple[np.ndarray, bool]:
    """Powell's damped BFGS update, which stays positive definite; kinks are kept from spoiling it by bounds."""
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
