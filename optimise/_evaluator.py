"""Evaluations of design points, one for each start (starting point of a search), in one batch.

An evaluation contains the values of the objective, the margins of the targets, and the derivatives of both
with respect to the scaled variables. A scene is one structure under one ground motion.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

import rockjax as rj
from rockjax._options import DEFAULT_OUTPUTS
from rockjax._outputs.base import AbstractOutput
from rockjax._programs.key import TracedFunction
from rockjax._programs.program import StoredProgram
from rockjax._responses.arguments import check_overturn_ratio
from rockjax.internal import Module, as_float

from ._answer import Effort
from ._descent import Descent, End, Evaluation, rank
from ._fresh import BOOTSTRAP_STREAM, FreshSamples
from ._objectives import AbstractObjective, PodiumFunction
from ._sampling import SampledTargets
from ._suite import Suite, is_same_suite
from ._targets import AbstractResponses, AbstractScaleTarget, AbstractTarget
from ._variables import Variables

VERIFICATION_TOLERANCES = {"rtol": 1e-11, "atol": 1e-13}
BOOTSTRAP_SAMPLES = 200  # resamples from which standard errors are estimated


class DesignProblem(Module):
    """Objective values and target margins as a differentiable function of the design variables.

    Targets and the objective are called items. All items that read peak responses share one combined suite of
    motions. The combined suite contains the motions of equal suites only once.

    - `variables`: the design variables; `targets`: the targets
    - `objective`: the objective; None to minimise the squared distance from the user's structure, in scaled
      variables
    - `suite`: the combined suite, None if no item reads responses
    - `slices`: for each target and then the objective, the ends (first, end) of a slice of `suite` that
      contains its motions; None for an item that reads no responses
    - `outputs`: requested outputs of the simulations; `scenes`: number of scenes of one evaluation
    """

    variables: Variables
    objective: AbstractObjective | None
    targets: tuple[AbstractTarget, ...]
    suite: Suite | None
    slices: tuple[tuple[int, int] | None, ...] = eqx.field(static=True)
    outputs: tuple[str | AbstractOutput, ...] = eqx.field(static=True)
    scenes: int = eqx.field(static=True)

    def __call__(
        self, x: Float[Array, " n"], options: rj.Options
    ) -> tuple[Float[Array, " k"], list[Float[Array, " m"]], Int[Array, " items"]]:
        """Evaluate a point x in scaled variables. Returns the objective values (k,), the margins (m,) of
        every target, and the number of overturned scenes of every item, which is 0 for items without
        `until_overturning`."""
        podium = self.variables.podium(x)
        peaks = None if self.suite is None else self.suite.responses(podium, options, self.outputs)
        overturned = jnp.zeros(len(self.slices), int)

        def evaluate_item(k: int, item, evaluate_alone: Callable):
            nonlocal overturned
            first_and_end = self.slices[k]
            if first_and_end is None:
                return evaluate_alone(podium, options)
            item_peaks = jax.tree.map(lambda y: y[slice(*first_and_end)], peaks)
            if item.until_overturning:
                overturned = overturned.at[k].set(jnp.sum(item_peaks.overturned))
            return item.read(item_peaks, options)

        margins = [jnp.atleast_1d(evaluate_item(k, t, t.margins)) for k, t in enumerate(self.targets)]
        if self.objective is None:
            values = jnp.sum((x - self.variables.start()) ** 2)[None]
        else:
            values = evaluate_item(len(self.targets), self.objective, self.objective.values)
        return values, margins, overturned


def build_problem(
    variables: Variables, objective: AbstractObjective | None, targets: tuple[AbstractTarget, ...]
) -> DesignProblem:
    """Return the problem of a design. Items with the same motions share their simulations."""
    suite: Suite | None = None
    merged_suites: list[tuple[Suite, tuple[int, int]]] = []
    slices: list[tuple[int, int] | None] = []
    outputs: set[str | AbstractOutput] = set()
    items: list[Any] = []
    scenes = 0
    for item in (*targets, _trace_functions(variables, objective)):
        span = None
        if isinstance(item, AbstractResponses):
            outputs |= set(item.outputs)
            span = next((span for other, span in merged_suites if is_same_suite(other, item.suite)), None)
            if span is None:
                first = 0 if suite is None else len(suite)
                span = first, first + len(item.suite)
                suite = item.suite if suite is None else suite.merged_with(item.suite)
                merged_suites.append((item.suite, span))
            item = eqx.tree_at(lambda i: i.suite, item, None)
        elif item is not None:
            scenes += item.scenes
        slices.append(span)
        items.append(_floats_to_arrays(item))
    variables = dataclasses.replace(variables, base=_floats_to_arrays(variables.base))
    *target_items, objective_item = items
    scenes += 0 if suite is None else len(suite)
    return DesignProblem(
        variables,
        objective_item,
        tuple(target_items),
        suite,
        tuple(slices),
        tuple(sorted(outputs, key=str)),
        scenes,
    )


def _floats_to_arrays(item: Any) -> Any:
    """Turn Python floats, which compiled programs contain as constants, into arrays, so that other values
    need no other compilation. Zeros stay floats, because a zero may mean that a component is absent."""
    return jax.tree.map(lambda y: as_float(y) if isinstance(y, float) and y else y, item)


def _trace_functions(variables: Variables, objective: AbstractObjective | None) -> AbstractObjective | None:
    """Replace the user's functions by instances of `TracedFunction`.

    The store of compiled programs identifies a `TracedFunction` by its lowered program. A new function that
    computes the same as an earlier one therefore uses the stored program of the earlier one.
    """

    def trace(leaf: Any) -> Any:
        if not isinstance(leaf, PodiumFunction) or isinstance(leaf.function, TracedFunction):
            return leaf
        podium_shape = jax.eval_shape(variables.podium, jax.ShapeDtypeStruct((len(variables.names),), float))
        try:
            return PodiumFunction(TracedFunction(leaf.function, podium_shape))
        except Exception:  # evaluating the function later reports the error
            return leaf

    return jax.tree.map(trace, objective, is_leaf=lambda leaf: isinstance(leaf, PodiumFunction))


@functools.partial(StoredProgram, arrays_only=True, description="the design with its derivatives")
def _evaluate_points(problem: DesignProblem, options: rj.Options, points: Float[Array, "starts n"]):
    """Return, for each point, the Jacobians of the objective values and of the margins of every target, and
    everything that `problem` returns."""

    def evaluate_point(x):
        def with_result(x):
            values, margins, overturned = problem(x, options)
            return (values, margins), (values, margins, overturned)

        return jax.jacfwd(with_result, has_aux=True)(x)

    return jax.vmap(evaluate_point)(points)


@functools.partial(StoredProgram, arrays_only=True)
def _least_scales(target: AbstractScaleTarget, options: rj.Options, podium: rj.Podium):
    """Return the overturning scales (k,) of the motions of a target."""
    return target.least_scales(podium, options)


@functools.partial(StoredProgram, arrays_only=True)
def _margins_of_samples(target: AbstractScaleTarget, scales: Float[Array, "samples k"]):
    """Return the margins (samples, margins) of a target for samples of overturning scales (samples, k)."""
    return jax.vmap(target.margins_of_scales)(scales)


class MarginEstimate(NamedTuple):
    """Margins (k,) of a target in an independent sample, and their standard errors (k,) [–]."""

    margins: np.ndarray
    errors: np.ndarray


def fresh_samples_of(item: Any) -> FreshSamples | None:
    """Return the fresh samples of a target or objective; None if its motions are not drawn anew."""
    suite = getattr(item, "suite", None)
    return suite.fresh_samples if isinstance(suite, Suite) else None


def _with_records(target: Any, records: rj.Records) -> Any:
    """Return a target with a batch of fresh samples as its suite."""
    return eqx.tree_at(lambda t: t.suite, target, target.suite.with_records(records))


def verification_options(options: rj.Options) -> rj.Options:
    """Return options with tolerances small enough to verify a design."""
    return options.replace(
        **{name: min(value, getattr(options, name)) for name, value in VERIFICATION_TOLERANCES.items()}
    )


def options_as_arrays(options: rj.Options) -> rj.Options:
    """Return options with arrays in place of numbers, so that other values need no other compilation."""
    return jax.tree.map(as_float, options)


class Evaluator:
    """Evaluate one point of every start in one batch, store the best point of each start and count the cost.

    Points are ranked first by the largest shortfall of a margin from half of `target_margin`, and then by the
    objective. Descents also accept margins of half of `target_margin` (`Settings.accepted_violation`).

    - `problem`: objective, and targets that JAX can trace; `sampled_targets`: targets on probabilities of
      failure, which JAX cannot trace
    - `options`: options of the simulations; `points`: starting points (starts, n), in scaled variables
    - `target_margin`: least margin that the search aims at [–]; `bar`: progress bar

    Attributes: `best` contains the best point of every start and its evaluation, `margin_counts` the number
    of margins of each target, and `evaluations` the number of evaluated points. `fresh_samples` maps the
    index of a target to its fresh samples.
    """

    def __init__(
        self,
        problem: DesignProblem,
        sampled_targets: SampledTargets,
        options: rj.Options,
        points: np.ndarray,
        target_margin: float,
        bar,
    ):
        self.sampled_targets, self.draw_count, self.verification_scenes = sampled_targets, 0, 0
        self.is_accurate = False  # whether evaluations use the tolerances of verification
        fresh_samples = {k: fresh_samples_of(target) for k, target in enumerate(problem.targets)}
        self.fresh_samples = {k: samples for k, samples in fresh_samples.items() if samples is not None}
        self.start_count, self.target_margin, self.bar = len(points), target_margin, bar
        self.options, self.full_problem = options, problem
        objective = problem.objective
        self.problem = dataclasses.replace(
            problem,
            objective=None if objective is None else objective.while_searching(),
            targets=tuple(target.while_searching() for target in problem.targets),
        )
        items = (*problem.targets, problem.objective)
        outputs = {output for item in items for output in getattr(item, "outputs", ())}
        self.checked_options = options.replace(outputs=tuple(outputs) or DEFAULT_OUTPUTS)
        self.evaluations, self.margin_counts = 0, []
        self.best: list[tuple[np.ndarray, Evaluation]] = []

    def __call__(self, points: np.ndarray, count: int | None = None) -> list[Evaluation]:
        """Return the evaluations at points (starts, n). Objective values are NaN where `check_structure`
        raises an error. `count` is the number of points to add to the attribute `evaluations`, without points
        of starts that have ended; None for all.

        If `is_accurate` is True, simulations use the tolerances of verification. The objective, and targets
        without fresh samples, then search for overturning with the `width` (resolution) that the user gave.
        Otherwise, and for targets with fresh samples, the `width` is coarser (`while_searching`).
        """
        options = verification_options(self.options) if self.is_accurate else self.options
        problem = self.full_problem if self.is_accurate else self.problem
        if self.fresh_samples:  # draw new motions
            targets = list(problem.targets)
            for k, samples in self.fresh_samples.items():
                targets[k] = _with_records(self.problem.targets[k], samples.draw(self.draw_count))
            problem = dataclasses.replace(problem, targets=tuple(targets))
            self.draw_count += 1
        jacobians, values = _evaluate_points(problem, options_as_arrays(options), as_float(points))
        (f, margins, overturned), (f_slope, slopes) = jax.tree.map(np.asarray, (values, jacobians))
        is_valid = np.array([self.is_valid(x) for x in points])
        f = np.where(is_valid[:, None], f, np.nan)
        f_slope = np.where(is_valid[:, None, None], f_slope, np.nan)
        margins, slopes = self._insert_sampled(points, is_valid, margins, slopes)
        for k in self.sampled_targets.targets:
            overturned = np.insert(overturned, k, 0, axis=1)
        self.margin_counts = [margin.shape[1] for margin in margins]
        self.evaluations += self.start_count if count is None else count
        # Empty arrays come first, so that a design without targets has margins of shape (starts, 0).
        empty = np.zeros((self.start_count, 0)), np.zeros((self.start_count, 0, points.shape[1]))
        c, c_slope = (
            np.concatenate([blank, *ys], axis=1) for blank, ys in zip(empty, (margins, slopes), strict=True)
        )
        evaluations = [Evaluation(*row) for row in zip(f, c, f_slope, c_slope, overturned, strict=True)]
        pairs = list(zip(np.array(points), evaluations, strict=True))
        self.best = [min(pair, key=self._rank_pair) for pair in zip(self.best or pairs, pairs, strict=True)]
        self.bar.update(1)
        return evaluations

    def check_structure(self, x: np.ndarray) -> None:
        """Raise `ValueError` if there is no valid structure at x (n,), or if its overturning margin is
        requested and not defined. Compiled programs cannot raise errors for invalid values, such as columns
        that overlap."""
        check_overturn_ratio("design", self.problem.variables.podium(x), self.checked_options)

    def is_valid(self, x: np.ndarray) -> bool:
        """Return whether `check_structure` accepts the structure at x (n,)."""
        try:
            self.check_structure(x)
        except ValueError:
            return False
        return True

    def estimates(self, x: np.ndarray, k: int) -> dict[int, MarginEstimate]:
        """Return, for all targets with fresh samples, index of the target → margins at x (n,) in the
        independent sample with the index k."""
        podium = self.full_problem.variables.podium(x)
        return {index: self._estimate(index, podium, k) for index in self.fresh_samples}

    def _estimate(self, index: int, podium: rj.Podium, k: int) -> MarginEstimate:
        """Return the margins of one target in the sample with the index k, with bootstrap standard errors."""
        target, samples = self.problem.targets[index], self.fresh_samples[index]
        assert isinstance(target, AbstractScaleTarget)
        batches = [
            _least_scales(_with_records(target, records), options_as_arrays(self.options), podium)
            for records in samples.sample(k)
        ]
        scales = np.concatenate([np.asarray(batch) for batch in batches])
        self.verification_scenes += scales.size
        rng = np.random.default_rng([samples.seed, BOOTSTRAP_STREAM, k])
        resamples = rng.integers(scales.size, size=(BOOTSTRAP_SAMPLES, scales.size))
        resamples[0] = np.arange(scales.size)  # the sample itself
        # Margins of given scales do not depend on the records, so any batch can be used here.
        margins = np.asarray(
            _margins_of_samples(_with_records(target, samples.draw(0)), as_float(scales[resamples]))
        )
        return MarginEstimate(margins[0], margins.std(axis=0))

    def _insert_sampled(
        self, points: np.ndarray, is_valid: np.ndarray, margins: list, slopes: list
    ) -> tuple[list, list]:
        """Insert the margins and slopes of sampled targets at the indices of these targets; NaN at invalid
        points."""
        unknown = np.nan, np.full(points.shape[1], np.nan)
        nothing = dict.fromkeys(self.sampled_targets.targets, unknown)
        rows = [self.sampled_targets.at(x) if ok else nothing for x, ok in zip(points, is_valid, strict=True)]
        margins, slopes = list(margins), list(slopes)
        for k in self.sampled_targets.targets:
            margins.insert(k, np.array([[row[k][0]] for row in rows]))
            slopes.insert(k, np.stack([row[k][1][None] for row in rows]))
        return margins, slopes

    def use_accurate(self) -> None:
        """Switch permanently to the accuracy of verification, also for the sampled targets."""
        self.is_accurate = True
        self.sampled_targets.use_accurate()

    def _rank_pair(self, pair: tuple[np.ndarray, Evaluation]) -> tuple[float, float]:
        """Return the sort key of a point and its evaluation."""
        _, evaluation = pair
        return (
            rank(evaluation._replace(c=evaluation.c - 0.5 * self.target_margin))
            if evaluation.is_finite
            else (np.inf, np.inf)
        )

    def effort(self, iterations: int, seconds: float) -> Effort:
        """Return the cost of all evaluations, with a number of iterations and a wall time [s]."""
        scenes = (
            self.evaluations * self.problem.scenes + self.sampled_targets.scenes + self.verification_scenes
        )
        return Effort(self.evaluations, scenes, iterations, seconds)


def run_descents(
    descents: dict[int, Descent],
    evaluate: Evaluator,
    points: np.ndarray,
    first: list[Evaluation],
    ends: dict[int, End],
) -> None:
    """Advance all descents, by start, until each has ended; their points (starts, n) are evaluated in
    batches. `first` are the evaluations of the first points. The end of each descent is stored in `ends`."""
    points = np.array(points)

    def advance(k: int, evaluation: Evaluation | None) -> bool:
        """Send an evaluation to a descent and store its next point; return False if it has ended."""
        try:
            points[k] = next(descents[k]) if evaluation is None else descents[k].send(evaluation)
        except StopIteration as stop:
            ends[k] = stop.value
            return False
        return True

    running = [k for k in descents if advance(k, None)]
    evaluations = first
    while running := [k for k in running if advance(k, evaluations[k])]:
        evaluations = evaluate(points, len(running))
