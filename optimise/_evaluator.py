"""Evaluations of design points: objective and margins with their derivatives, a point of every start at
once."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import rockjax as rj
from rockjax._programs.program import KeptProgram

from ._answer import Effort
from ._descent import Descent, End, Evaluation, rank
from ._objectives import AbstractObjective
from ._suite import Suite, same
from ._targets import AbstractResponses, AbstractTarget
from ._variables import Variables


class DesignProblem(eqx.Module):
    """What is differentiated. Suites are held once; `uses` says which one an item reads, −1 for those with
    none."""

    variables: Variables
    objective: AbstractObjective | None
    targets: tuple[AbstractTarget, ...]
    suites: tuple[Suite, ...]
    uses: tuple[int, ...] = eqx.field(static=True)  # of the targets, then the objective
    outputs: tuple[tuple[str, ...], ...] = eqx.field(static=True)  # of the suites
    scenes: int = eqx.field(static=True)

    def __call__(
        self, x: Float[Array, " n"], options: rj.Options
    ) -> tuple[Float[Array, " k"], list[Float[Array, " m"]]]:
        """Values of the objective and margins of every target."""
        podium = self.variables.podium(x)
        peaks = [s.responses(podium, options, o) for s, o in zip(self.suites, self.outputs, strict=True)]

        def of(item, use: int, alone: Callable):
            return item.read(peaks[use], options) if use >= 0 else alone(podium, options)

        margins = [
            jnp.atleast_1d(of(t, use, t.margins)) for t, use in zip(self.targets, self.uses, strict=False)
        ]
        if self.objective is None:
            return jnp.sum((x - self.variables.start()) ** 2)[None], margins
        return of(self.objective, self.uses[-1], self.objective.values), margins


def problem_of(
    varied: Variables, objective: AbstractObjective | None, targets: tuple[AbstractTarget, ...]
) -> DesignProblem:
    suites: list[Suite] = []
    outputs: list[set[str]] = []
    uses: list[int] = []
    stripped: list[Any] = []
    scenes = 0
    for item in (*targets, objective):
        if isinstance(item, AbstractResponses):
            place = next((k for k, suite in enumerate(suites) if same(suite, item.suite)), len(suites))
            if place == len(suites):
                suites.append(item.suite)
                outputs.append(set())
                scenes += len(item.suite)
            outputs[place] |= set(item.outputs)
            uses.append(place)
            item = eqx.tree_at(lambda i: i.suite, item, None)
        else:
            uses.append(-1)
            scenes += 0 if item is None else item.scenes
        # Python numbers would each be compiled in.
        stripped.append(jax.tree.map(lambda y: jnp.asarray(y, float) if isinstance(y, float) else y, item))
    wanted = tuple(tuple(sorted(names)) for names in outputs)
    return DesignProblem(
        varied, stripped[-1], tuple(stripped[:-1]), tuple(suites), tuple(uses), wanted, scenes
    )


@functools.partial(KeptProgram, arrays_only=True)
def _evaluated(problem: DesignProblem, options: rj.Options, points: Float[Array, "starts n"]):
    """(values, margins of every target), their Jacobians, and the values again, of all points."""

    def at(x):
        def twice(x):
            answer = problem(x, options)
            return answer, answer

        return jax.jacfwd(twice, has_aux=True)(x)

    return jax.vmap(at)(points)


def traced(options: rj.Options) -> rj.Options:
    """Options whose numbers are not compiled in."""
    return jax.tree.map(lambda y: jnp.asarray(y, float), options)


class Evaluator:
    """Evaluates a point of every start at once, so that one compilation serves; remembers the best, counts
    what it does.

    Better is what violates margins less, so far `inside`, and of two that satisfy them what has the lower
    objective.
    """

    def __init__(self, problem: DesignProblem, options: rj.Options, points: np.ndarray, inside: float, bar):
        self.width, self.inside, self.bar = len(points), inside, bar
        self.options, self.certain = traced(options), problem
        self.problem = dataclasses.replace(
            problem, targets=tuple(target.while_searching() for target in problem.targets)
        )
        self.evaluations, self.sizes = 0, []
        self.best: list[tuple[np.ndarray, Evaluation]] = []

    def __call__(self, points: np.ndarray, count: int | None = None) -> list[Evaluation]:
        """Evaluations at points (width, n), of which `count` are asked for."""
        slopes, values = _evaluated(self.problem, self.options, jnp.asarray(points))
        (f, margins), (f_slope, slopes) = jax.tree.map(np.asarray, (values, slopes))
        self.sizes = [margin.shape[1] for margin in margins]
        self.evaluations += self.width if count is None else count
        none = np.zeros((self.width, 0)), np.zeros((self.width, 0, points.shape[1]))
        c, c_slope = (
            np.concatenate([blank, *ys], axis=1) for blank, ys in zip(none, (margins, slopes), strict=True)
        )
        found = [Evaluation(*parts) for parts in zip(f, c, f_slope, c_slope, strict=True)]
        seen = list(zip(np.array(points), found, strict=True))
        self.best = [min(pair, key=self._standing) for pair in zip(self.best or seen, seen, strict=True)]
        self.bar.update(1)
        return found

    def verifies(self, options: rj.Options) -> None:
        """From now on with these options, and with targets as certain as they are meant."""
        self.options, self.problem = traced(options), self.certain

    def _standing(self, seen: tuple[np.ndarray, Evaluation]) -> tuple[float, float]:
        _, there = seen
        return rank(there._replace(c=there.c - self.inside)) if there.finite else (np.inf, np.inf)

    def effort(self, iterations: int, seconds: float) -> Effort:
        return Effort(self.evaluations, self.evaluations * self.problem.scenes, iterations, seconds)


def side_by_side(
    descents: dict[int, Descent],
    evaluate: Evaluator,
    points: np.ndarray,
    first: list[Evaluation],
    ends: dict[int, End],
) -> None:
    """Drive descents side by side, whose first points are evaluated already; an end is put down as soon as it
    is there."""
    points = np.array(points)

    def goes_on(k: int, evaluation: Evaluation | None) -> bool:
        try:
            points[k] = next(descents[k]) if evaluation is None else descents[k].send(evaluation)
        except StopIteration as stop:
            ends[k] = stop.value
            return False
        return True

    running = [k for k in descents if goes_on(k, None)]
    evaluations = first
    while running := [k for k in running if goes_on(k, evaluations[k])]:
        evaluations = evaluate(points, len(running))
