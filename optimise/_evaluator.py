"""Evaluations of design points: objective and margins with their derivatives, a point of every start at
once."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import rockjax as rj
from rockjax.internal import KeptProgram, TracedFunction

from ._answer import Effort
from ._descent import Descent, End, Evaluation, rank
from ._objectives import AbstractObjective, OfPodium
from ._sampling import SampledTargets
from ._suite import Suite, same
from ._targets import AbstractResponses, AbstractTarget
from ._variables import Variables


class Part(NamedTuple):
    """Motions of a suite: so many of them from one on."""

    suite: int
    first: int
    size: int


class DesignProblem(eqx.Module):
    """What is differentiated. Suites are held once, and those that want the same are one; `uses` says which
    one an item reads, and which part of it."""

    variables: Variables
    objective: AbstractObjective | None
    targets: tuple[AbstractTarget, ...]
    suites: tuple[Suite, ...]
    uses: tuple[Part | None, ...] = eqx.field(static=True)  # of the targets, then the objective
    outputs: tuple[tuple[str, ...], ...] = eqx.field(static=True)  # of the suites
    scenes: int = eqx.field(static=True)

    def __call__(
        self, x: Float[Array, " n"], options: rj.Options
    ) -> tuple[Float[Array, " k"], list[Float[Array, " m"]]]:
        """Values of the objective and margins of every target."""
        podium = self.variables.podium(x)
        peaks = [s.responses(podium, options, o) for s, o in zip(self.suites, self.outputs, strict=True)]

        def of(item, use: Part | None, alone: Callable):
            if use is None:
                return alone(podium, options)
            part = slice(use.first, use.first + use.size)
            return item.read(jax.tree.map(lambda y: y[part], peaks[use.suite]), options)

        margins = [
            jnp.atleast_1d(of(t, use, t.margins)) for t, use in zip(self.targets, self.uses, strict=False)
        ]
        if self.objective is None:
            return jnp.sum((x - self.variables.start()) ** 2)[None], margins
        return of(self.objective, self.uses[-1], self.objective.values), margins


def problem_of(
    varied: Variables, objective: AbstractObjective | None, targets: tuple[AbstractTarget, ...]
) -> DesignProblem:
    simulated = _Simulated()
    uses: list[Part | None] = []
    stripped: list[Any] = []
    scenes = 0
    for item in (*targets, _named(varied, objective)):
        if isinstance(item, AbstractResponses):
            uses.append(simulated.add(item.suite, item.outputs))
            item = eqx.tree_at(lambda i: i.suite, item, None)
        else:
            uses.append(None)
            scenes += 0 if item is None else item.scenes
        stripped.append(_passed(item))
    scenes += sum(map(len, simulated.suites))
    varied = dataclasses.replace(varied, base=_passed(varied.base))
    return DesignProblem(
        varied,
        stripped[-1],
        tuple(stripped[:-1]),
        tuple(simulated.suites),
        tuple(uses),
        tuple(tuple(sorted(names)) for names in simulated.outputs),
        scenes,
    )


class _Simulated:
    """The suites that have to be simulated: a suite that several items share once, and suites of which one
    wants all that the other does side by side, in one loop."""

    def __init__(self):
        self.suites: list[Suite] = []
        self.outputs: list[set[str]] = []
        self._known: list[tuple[Suite, Part]] = []

    def add(self, suite: Suite, outputs: tuple[str, ...]) -> Part:
        wanted = set(outputs)
        part = next((part for known, part in self._known if same(known, suite)), None)
        if part is None:
            like = [k for k, names in enumerate(self.outputs) if names <= wanted or wanted <= names]
            place = like[0] if like else len(self.suites)
            if not like:
                self.suites.append(suite)
                self.outputs.append(set())
            first = len(self.suites[place]) if like else 0
            part = Part(place, first, len(suite))
            self._known.append((suite, part))
            if like:
                self.suites[place] = self.suites[place].and_also(suite)
        self.outputs[part.suite] |= wanted
        return part


def _passed(item: Any) -> Any:
    """With numbers as arrays: those of Python would each be compiled in. What is 0 may not be there at
    all."""
    return jax.tree.map(lambda y: jnp.asarray(y, float) if isinstance(y, float) and y else y, item)


def _named(varied: Variables, objective: AbstractObjective | None) -> AbstractObjective | None:
    """A function of the user's own is traced by itself: what it makes of a podium tells later processes
    which one it is."""

    def named(part: Any) -> Any:
        if not isinstance(part, OfPodium) or isinstance(part.function, TracedFunction):
            return part
        like = jax.eval_shape(varied.podium, jax.ShapeDtypeStruct((len(varied.names),), float))
        try:
            return OfPodium(TracedFunction(part.function, like))
        except Exception:  # whatever is wrong with it is said where it is evaluated
            return part

    return jax.tree.map(named, objective, is_leaf=lambda part: isinstance(part, OfPodium))


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

    def __init__(
        self,
        problem: DesignProblem,
        sampled: SampledTargets,
        options: rj.Options,
        points: np.ndarray,
        inside: float,
        bar,
    ):
        self.sampled = sampled
        self.width, self.inside, self.bar = len(points), inside, bar
        self.options, self.certain = traced(options), problem
        objective = problem.objective
        self.problem = dataclasses.replace(
            problem,
            objective=None if objective is None else objective.while_searching(),
            targets=tuple(target.while_searching() for target in problem.targets),
        )
        self.evaluations, self.sizes = 0, []
        self.best: list[tuple[np.ndarray, Evaluation]] = []

    def __call__(self, points: np.ndarray, count: int | None = None) -> list[Evaluation]:
        """Evaluations at points (width, n), of which `count` are asked for."""
        slopes, values = _evaluated(self.problem, self.options, jnp.asarray(points))
        (f, margins), (f_slope, slopes) = jax.tree.map(np.asarray, (values, slopes))
        margins, slopes = self._with_sampled(points, margins, slopes)
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

    def _with_sampled(self, points: np.ndarray, margins: list, slopes: list) -> tuple[list, list]:
        """Margins and slopes of all targets in their order, from those of the traced ones."""
        rows = [self.sampled.at(x) for x in points]
        margins, slopes = list(margins), list(slopes)
        for k in self.sampled.targets:
            margins.insert(k, np.array([[row[k].margin] for row in rows]))
            slopes.insert(k, np.stack([row[k].slope[None] for row in rows]))
        return margins, slopes

    def verifies(self, options: rj.Options) -> None:
        """From now on with these options, and with targets as certain as they are meant."""
        self.options, self.problem = traced(options), self.certain
        self.sampled.verifies()

    def _standing(self, seen: tuple[np.ndarray, Evaluation]) -> tuple[float, float]:
        _, there = seen
        return rank(there._replace(c=there.c - self.inside)) if there.finite else (np.inf, np.inf)

    def effort(self, iterations: int, seconds: float) -> Effort:
        scenes = self.evaluations * self.problem.scenes + self.sampled.scenes
        return Effort(self.evaluations, scenes, iterations, seconds)


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
