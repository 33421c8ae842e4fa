"""First-order methods: an augmented Lagrangian around a gradient transformation of Optax.

With values f and margins c, multipliers λ (of the values, of sum 1) and μ (of the margins), the
transformation is given the gradient of

    max over w ≥ 0, Σ w = 1 of  w·f − |w − λ|²/2ρ   +   Σ_j (max(0, μ_j − ρ_j c_j)² − μ_j²)/2ρ_j,

which is smooth where f and c are: Σ w_i ∇f_i − Σ max(0, μ_j − ρ_j c_j) ∇c_j with w = λ + ρ f projected on the
simplex. ρ_j = ρ/|∇c_j|², so that steep margins count for no more than flat ones. Steps are projected on the
bounds. Once steps lead no further, λ and μ move to w and max(0, μ_j − ρ_j c_j), and ρ grows where that has
not halved what is missing. If it grows beyond all measure, only the largest violation is minimised, as a
minimax problem of its own.

The step size of the transformation is where the search for one begins. A step is taken if it leads below the
highest of the last few values of the Lagrangian; momentum needs that much freedom. Steps that are not taken
halve all later ones, a second one in a row starts the transformation's memory anew, and steps that lead
downhill three times in a row double the next. What was seen at steps not taken tells of kinks, as in the
quadratic programming: of all gradients near by the transformation is given the combination of least norm.
When a descent ends, and with what multipliers, is decided as for every method.
"""

from __future__ import annotations

from collections.abc import Generator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from ._descent import Descend, Descent, End, Evaluation, Iterate, Rules, at_rest, prepared, rank
from ._optimality import Seen, nearby, optimality, unit_step
from ._quadratic import Vector
from ._results import CONVERGED, INFEASIBLE, NOT_FINITE, OUT_OF_ITERATIONS

MAX_ITERATIONS = 1000
FIRST_RHO, LARGEST_RHO = 10.0, 1e6
EXACT = 1e4  # penalty of the largest violation from which optimality is judged
FLAT = 1e-2  # margins with slopes below are not made steeper
DECREASE = 1e-4  # part of the one that the slope promises
UPHILL = 0.8  # factor of the step size after a step that led uphill
RECENT = 6  # values of the Lagrangian of which a step has to fall below the highest
SEEN = 12  # points remembered
STREAK = 3  # steps downhill in a row that double the next
AGAIN = 64.0  # times as far as the last steps, when multipliers have moved because they led nowhere
IDLE = 12  # times that multipliers move before a step follows


def descend_by_gradients(transformation: optax.GradientTransformation) -> Descend:
    """Descents by a gradient transformation. Raises `ValueError` for one that has to evaluate by itself, as
    line searches do."""
    steps = _steps(transformation)

    def once(x: Vector, rules: Rules, history: list[Iterate], start: int, first: int) -> Descent:
        here = prepared((yield x), rules)
        if not here.finite:
            return End(x, np.zeros(len(here.c)), NOT_FINITE, first, here)
        search = _Search(steps, x, here, rules, history, start, first)
        while search.iteration < rules.max_iterations:
            result = search.assess()
            if result is None:
                result = yield from search.advance()
                search.iteration += 1
            if result is not None:
                return search.end(result)
        return search.best_seen()

    return once


class _Steps(NamedTuple):
    init: Any  # parameters → state
    update: Any  # gradient, state, parameters, value → update, state


def _steps(transformation: optax.GradientTransformation) -> _Steps:
    whole = optax.with_extra_args_support(transformation)

    def update(gradient, state, x, value):
        return whole.update(gradient, state, x, value=value, grad=gradient)

    steps = _Steps(jax.jit(whole.init), jax.jit(update))
    x = jnp.zeros(1)
    try:
        jax.eval_shape(lambda: update(x, whole.init(x), x, jnp.zeros(())))
    except TypeError as error:
        if "value_fn" not in str(error):
            raise
        raise ValueError(
            "design: method has to evaluate the objective by itself (value_fn), as line searches do; give "
            "one that steps "
            f"by gradients alone, such as optax.adam(0.02) or optax.lbfgs(0.1, linesearch=None); got "
            f"{transformation!r}"
        ) from None
    return steps


class _Weights(NamedTuple):
    """Multipliers of the values and of the margins, and the ρ of each. What has no say has no entries in
    `values`."""

    values: Vector
    margins: Vector
    rho: float
    rho_margins: Vector


class _Search:
    """Where one descent is, and what it remembers. Its parts return a result code where they end it, None
    otherwise."""

    def __init__(
        self,
        steps: _Steps,
        x: Vector,
        here: Evaluation,
        rules: Rules,
        history: list[Iterate],
        start: int,
        first: int,
    ):
        self.steps, self.x, self.here, self.rules = steps, x, here, rules
        self.history, self.start, self.iteration = history, start, first
        self.multipliers, self.residual = np.zeros(len(here.c)), np.inf
        self.best = x, here
        self.seen: Seen = []
        self.factor = 1.0
        self.restoring = False
        self.begin()

    def begin(self) -> None:
        """Multipliers of someone who knows nothing yet."""
        values, margins = len(self.terms(self.here).f), len(self.terms(self.here).c)
        self.weights = self.scaled(
            _Weights(np.full(values, 1 / values), np.zeros(margins), FIRST_RHO, np.ones(margins))
        )
        self.missing, self.wanted, self.idle = np.inf, 0.1, 0
        self.forget()

    def forget(self) -> None:
        self.memory = self.steps.init(jnp.asarray(self.x))
        self.recent: list[float] = []
        self.streak = 0

    def terms(self, at: Evaluation) -> Evaluation:
        """What is minimised and kept: while nothing but the violation counts, that is the objective."""
        n = len(self.x)
        return Evaluation(-at.c, np.zeros(0), -at.c_slope, np.zeros((0, n))) if self.restoring else at

    def scaled(self, weights: _Weights) -> _Weights:
        terms = self.terms(self.here)
        steep = np.maximum(np.sum(terms.c_slope**2, axis=1), FLAT**2)
        return weights._replace(rho_margins=weights.rho / steep)

    def moved(self, at: Evaluation) -> tuple[Vector, Vector]:
        """The multipliers that the Lagrangian has in effect at a point."""
        terms, weights = self.terms(at), self.weights
        return (
            on_simplex(weights.values + weights.rho * terms.f),
            np.maximum(0.0, weights.margins - weights.rho_margins * terms.c),
        )

    def lagrangian(self, at: Evaluation) -> Evaluation:
        """Value and gradient of the augmented Lagrangian, as of a problem without margins."""
        terms, weights = self.terms(at), self.weights
        w, mu = self.moved(at)
        value = w @ terms.f - np.sum((w - weights.values) ** 2) / (2 * weights.rho)
        value += np.sum((mu**2 - weights.margins**2) / (2 * weights.rho_margins))
        slope = w @ terms.f_slope - mu @ terms.c_slope
        return Evaluation(np.array([value]), np.zeros(0), slope[None], np.zeros((0, len(slope))))

    def end(self, result: int) -> End:
        return End(self.x, self.multipliers, result, self.iteration, self.here)

    def best_seen(self) -> End:
        self.x, self.here = self.best
        self.assess()
        return self.end(OUT_OF_ITERATIONS)

    @property
    def violated(self) -> bool:
        return self.here.violation > self.rules.feasible_enough

    def assess(self) -> int | None:
        """How far x is from optimal; the result, if it is there."""
        weight, penalty = (0.0, 1.0) if self.restoring else (1.0, EXACT)
        near = nearby(self.x, self.seen)
        tolerance = self.rules.tolerance
        self.multipliers, self.residual, left = optimality(
            self.x, self.here, near, weight, penalty, tolerance
        )
        if self.restoring and not self.violated:  # the objective has a say again
            self.restoring = False
            self.begin()
            return None
        if self.residual > tolerance:
            return None
        if not self.violated:
            return CONVERGED
        return INFEASIBLE if self.restoring and left > 0.5 * self.here.violation else None

    def advance(self) -> Generator[Vector, Evaluation, int | None]:
        """A step of the transformation, tried and judged; or the next multipliers."""
        here = self.lagrangian(self.here)
        near = [(y, self.lagrangian(there)) for y, there in nearby(self.x, self.seen)]
        downhill = unit_step(self.x, here, near)
        if np.max(np.abs(downhill)) <= self.wanted:
            return self.move_multipliers(rested=False)
        trial = self.trial(here, downhill)
        length = float(np.max(np.abs(trial - self.x)))
        if length <= 0.01 * self.rules.tolerance and self.streak == 0:
            return self.move_multipliers(rested=True)
        there = prepared((yield trial), self.rules)
        then = float(self.lagrangian(there).f[0]) if there.finite else np.inf
        now, promised = float(here.f[0]), float(np.abs(here.f_slope[0]) @ np.abs(trial - self.x))
        taken = then < max([*self.recent, now]) - DECREASE * promised
        self.record(length, taken)
        if taken:
            self.take(trial, there, then < now, now)
        else:
            self.leave(trial, there)
        return None

    def trial(self, here: Evaluation, downhill: Vector) -> Vector:
        value, x = jnp.asarray(here.f[0]), jnp.asarray(self.x)
        update, self.memory = self.steps.update(jnp.asarray(-downhill), self.memory, x, value)
        step = self.factor * np.asarray(update)
        step *= min(1.0, self.rules.radius / max(float(np.max(np.abs(step))), 1e-300))
        return np.clip(self.x + step, 0.0, 1.0)

    def take(self, trial: Vector, there: Evaluation, downhill: bool, now: float) -> None:
        self.recent = [*self.recent[1 - RECENT :], now]
        self.x, self.here, self.idle = trial, there, 0
        self.best = min(self.best, (trial, there), key=self.standing)
        self.streak = self.streak + 1 if downhill else 0
        if not downhill:
            self.factor *= UPHILL
        elif self.streak % STREAK == 0:
            self.factor *= 2

    def leave(self, trial: Vector, there: Evaluation) -> None:
        if there.finite:
            self.seen = [*self.seen[1 - SEEN :], (trial, there)]
        self.factor *= 0.5
        if self.streak == 0:
            self.forget()
        self.streak = 0

    def standing(self, seen: tuple[Vector, Evaluation]) -> tuple[float, float]:
        violation, value = rank(seen[1])
        return (violation if violation > self.rules.feasible_enough else 0.0, value)

    def record(self, step: float, accepted: bool) -> None:
        margin = float(np.min(self.here.c, initial=np.inf)) + self.rules.shift
        value = float(np.max(self.here.f)) * self.rules.scale
        state = self.factor, self.weights.rho
        self.history.append(
            Iterate(self.start, self.iteration, self.x, value, margin, self.residual, *state, step, accepted)
        )

    def move_multipliers(self, rested: bool) -> int | None:
        """The Lagrangian is as low as wanted, or `rested`: as low as steps get it."""
        terms, weights = self.terms(self.here), self.weights
        w, mu = self.moved(self.here)
        slack = np.minimum(terms.c, weights.margins / weights.rho_margins)
        missing = max(np.max(np.abs(slack), initial=0.0), np.max(np.abs(w - weights.values)) / weights.rho)
        self.idle += 3 if rested else 1
        if self.idle > IDLE:
            return self.rest()
        rho = weights.rho * (4 if missing > 0.5 * self.missing else 1)
        self.missing = float(missing)
        if rho > LARGEST_RHO:
            if self.violated and not self.restoring:
                self.restoring = True
                self.begin()
                return None
            rho = LARGEST_RHO
        self.weights = self.scaled(_Weights(w, mu, rho, weights.rho_margins))
        self.wanted = max(0.3 * self.wanted, 0.1 * self.rules.tolerance)
        if rested:
            self.factor *= AGAIN
        self.forget()
        return None

    def rest(self) -> int:
        """The result where no step leads on: of the best that was seen, should it be another point."""
        if self.standing(self.best) < self.standing((self.x, self.here)):
            self.x, self.here = self.best
            self.restoring = False
            self.assess()
        return at_rest(self.here, self.residual, self.rules)


def on_simplex(y: Vector) -> Vector:
    """The nearest point with entries ≥ 0 of sum 1."""
    order = np.sort(y)[::-1]
    excess = (np.cumsum(order) - 1) / np.arange(1, len(y) + 1)
    return np.maximum(y - excess[np.nonzero(order > excess)[0][-1]], 0.0)
