"""`design`: size a structure so that it satisfies targets and minimises an objective.

A search has one or more starting points (starts). The point at which the search from a start stops is called
its end. Scaled variables are 0 and 1 at their bounds. A target holds where its margins are ≥ 0.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

import rockjax as rj
from rockjax._progress import bar as bar_of
from rockjax._responses.arguments import warn_of_small_restitution
from rockjax.internal import format_value, require_instance, require_number, require_whole

from ._answer import Design, Effort, SampleEstimates, SearchResult, build_design
from ._descent import Descent, End, Evaluation, Iterate, Settings, objective_scale, rank, scale_evaluation
from ._evaluator import Evaluator, build_problem, fresh_samples_of, run_descents
from ._failure import FailureProbability
from ._gradients import MAX_ITERATIONS as GRADIENT_STEPS
from ._gradients import GradientSteps, transformation_of
from ._objectives import AbstractObjective, PodiumFunction
from ._results import INFEASIBLE, INTERRUPTED, NOT_FINITE
from ._sampling import SampledTargets
from ._sqp import MAX_ITERATIONS, descend
from ._stochastic import MAX_ITERATIONS as FRESH_ITERATIONS
from ._stochastic import FreshSearch
from ._targets import AbstractScaleTarget, AbstractTarget
from ._variables import Structure, Variables, make_variables

if TYPE_CHECKING:
    import optax

MAX_REFINEMENTS = 3  # largest number of rounds that correct small violations found in the verification
SAMPLED_TOLERANCE = 1e-4  # smallest tolerance with sampled probabilities, whose scatter is larger
MAX_CORRECTIONS = 3  # largest number of times that a search continues after independent samples contradict it
MAX_CHECKED_ENDS = 4  # largest number of ends at which independent samples are taken in one round
MAX_SAMPLE_VIOLATION = 0.2  # largest violation in an independent sample that is corrected [–]


def design(
    podium: Structure,
    vary: Mapping[str, tuple[float, float]],
    minimise: AbstractObjective | Callable[[rj.Podium], Any] | None = None,
    targets: AbstractTarget | Sequence[AbstractTarget] = (),
    *,
    method: str | optax.GradientTransformation = "sqp",
    starts: int = 1,
    seed: int = 0,
    options: rj.Options = rj.Options(),
    tolerance: float = 1e-6,
    max_iterations: int | None = None,
    progress: Any = False,
) -> Design:
    """Find the structure that satisfies all targets and minimises an objective; outside jit.

    - `podium`: the first starting point, a `rockjax.Podium`, or an `optimise.Dimensions` to vary masses too.
      A varied parameter outside its bounds starts at the nearer bound. Parameters that are not varied keep
      their values
    - `vary`: name of a parameter of the structure → (lowest, highest) in the unit of the parameter. A
      `Podium` has `alpha`, `tan_alpha`, `R`, `gamma`, `lam`, `g`, `restitution`, `eta`, `T_s`, `zeta`,
      `width`, `height` and others. If only one of `width` and `height` varies, the other keeps its value. In
      a search, variables are scaled to [0, 1] between their bounds, logarithmically if the range is positive
      and highest/lowest > 10. Values within the bounds that together define no valid structure, such as
      columns that overlap, are treated like a simulation that does not finish
    - `minimise`: an objective, or a function of the podium that returns a number or a vector. The largest
      entry of a vector is minimised. None finds the design that satisfies the targets and is nearest to
      `podium` in scaled variables
    - `targets`: targets to satisfy; targets on the same motions share their simulations
    - `method`: `"sqp"` for sequential quadratic programming, or an `optax.GradientTransformation`; `"adam"`
      is short for `optax.adam(0.02)`. A transformation takes `max_iterations` steps on an augmented
      Lagrangian in scaled variables. Then `"sqp"` continues from the best point of each start. Targets with
      `FreshSamples` need a transformation, and the search ends without `"sqp"`
    - `starts`: number of starting points, ≥ 1: `podium`, and a random Latin hypercube for the others
    - `seed`: seed of the random starting points, ≥ 0
    - `options`: options of the simulations; their `outputs` and `throw` are ignored
    - `tolerance`: from 1e-10 to 1e-2 [–]. The search ends when the optimality conditions, in scaled
      variables, hold to this tolerance. A target holds where its margins are ≥ 0; the search aims at margins
      of at least `tolerance`. With a `FailureProbability`, a tolerance below 1e-4 is raised to 1e-4
    - `max_iterations`: for every start, the largest number of iterations of `"sqp"`, or the number of steps
      of a gradient transformation, ≥ 1. None means 60 for `"sqp"`, 100 for a transformation, and 300 with
      `FreshSamples`. Two kinds of iterations are not counted: up to 60 iterations of `"sqp"` after a
      transformation, and iterations that correct a design after an independent sample or the verification
      (see `Design.satisfied`)
    - `progress`: `True` for a progress bar, or any object with a method `update(n)`, which is called with
      n = 1 after each evaluation of all starts

    If no design is found that satisfies the targets, the design whose most negative margin is closest to 0 is
    returned, with `satisfied = False`. Raises `ValueError` for invalid inputs.

    Ctrl-C raises [`rockjax.Interrupted`][]. The attribute `partial` of this error is the best design so far
    or, with `FreshSamples`, the mean of the designs of the latest steps. This design is evaluated with the
    tolerances of the verification, but not corrected. No new independent sample is taken for a
    `FailureProbability`; without an earlier one at this design, its margin is NaN. If Ctrl-C comes during the
    first evaluation, `partial` is None.
    """
    start_time = time.perf_counter()
    transformation = transformation_of(method)
    require_instance("design", "options", options, rj.Options, "rockjax.Options")
    targets = (targets,) if isinstance(targets, AbstractTarget) else targets
    if isinstance(targets, str) or not isinstance(targets, Iterable):
        raise ValueError(
            "design: targets must be one or more targets such as optimise.PeakRotation, got "
            f"{format_value(targets)}"
        )
    targets = tuple(targets)
    require_whole("design", "seed", seed, 0)
    _check_arguments(starts, tolerance, max_iterations, targets, minimise)
    variables = make_variables(podium, vary)
    objective = (
        minimise if isinstance(minimise, AbstractObjective) or minimise is None else PodiumFunction(minimise)
    )
    options = options.replace(throw=False)
    sampled_targets = SampledTargets(variables, targets)
    tolerance = max(tolerance, SAMPLED_TOLERANCE) if sampled_targets.targets else tolerance
    problem = build_problem(
        variables, objective, tuple(t for k, t in enumerate(targets) if k not in sampled_targets.targets)
    )
    has_fresh_samples = any(fresh_samples_of(target) is not None for target in targets)
    _check_fresh(transformation, targets, objective)
    if max_iterations is None:
        default = MAX_ITERATIONS if transformation is None else GRADIENT_STEPS
        max_iterations = FRESH_ITERATIONS if has_fresh_samples else default
    points = _starting_points(variables, starts, seed)
    # The bar counts the first evaluation, every iteration and the verification.
    with bar_of(max_iterations + 2, "evaluations", progress) as bar:
        evaluate = Evaluator(problem, sampled_targets, options, points, tolerance, bar)
        evaluate.check_structure(points[0])
        search: DescentSearch | FreshSearch
        if transformation is not None and has_fresh_samples:
            search = FreshSearch(transformation, evaluate, points, tolerance, max_iterations)
        else:
            search = DescentSearch(transformation, evaluate, points, tolerance, max_iterations)
        is_interrupted = search.run()
    effort = evaluate.effort(search.iterations, time.perf_counter() - start_time)
    margin_counts = _margin_counts(targets, evaluate.margin_counts)
    result = build_design(
        podium, variables, objective, search.search_result(margin_counts, effort), search.estimate_samples
    )
    if is_interrupted:
        raise rj.Interrupted(f"stopped after {effort.iterations} iterations", result)
    warn_of_small_restitution(result.podium, stacklevel=3)
    return result


class DescentSearch:
    """Search from all starts of a design: first evaluation, simultaneous descents, verification.

    - `transformation`: gradient transformation that takes steps before the descents; None for descents only
    - `evaluate`: evaluates one point of every start
    - `points`: starting points (starts, n), in scaled variables
    - `tolerance`: largest residual of the optimality conditions at convergence, and least margin that the
      descents aim at [–]
    - `max_iterations`: number of steps of the transformation; without a transformation, largest number of
      iterations of a descent
    """

    def __init__(
        self,
        transformation: optax.GradientTransformation | None,
        evaluate: Evaluator,
        points: np.ndarray,
        tolerance: float,
        max_iterations: int,
    ):
        self.transformation, self.evaluate, self.points = transformation, evaluate, points
        self.tolerance, self.max_iterations = tolerance, max_iterations
        self.history: list[Iterate] = []
        self.ends: dict[int, End] = {}
        self.scale = 1.0
        self.evaluations: list[Evaluation] = []

    def run(self) -> bool:
        """Run the search and return whether it was interrupted. If so, every start whose descent has not
        ended ends at its best point so far. Raises `rockjax.Interrupted` if the first evaluation is
        interrupted."""
        evaluate, starts = self.evaluate, range(len(self.points))
        try:
            first = evaluate(self.points)
        except KeyboardInterrupt:
            raise rj.Interrupted("stopped before the first evaluation", None) from None
        self.scale = objective_scale([e for e in first if e.is_finite])
        steps = 0 if self.transformation is None else self.max_iterations
        max_iterations = steps + MAX_ITERATIONS if steps else self.max_iterations
        settings = Settings(self.scale, self.tolerance, 0.25, self.tolerance, max_iterations)
        points = self.points
        try:
            if self.transformation is not None:
                arguments = evaluate, points, first, self.tolerance, self.history
                GradientSteps(self.transformation, *arguments).take_steps(
                    steps, np.array([e.is_finite for e in first])
                )
                points = np.stack([x for x, _ in evaluate.best])
                first = [evaluation for _, evaluation in evaluate.best]
            descents = {k: descend(points[k], settings, self.history, k, steps) for k in starts}
            run_descents(descents, evaluate, points, first, self.ends)
            self.correct(settings)
            evaluate.use_accurate()
            self.verify()
        except KeyboardInterrupt:
            evaluate.use_accurate()
            self.ends |= {k: self.end_so_far(k, settings) for k in starts if k not in self.ends}
            self.evaluations = evaluate(self.end_points)
            for k, evaluation in enumerate(self.evaluations):
                if _small_violation(self.ends[k], evaluation, np.inf):  # a violation remains uncorrected
                    self.ends[k] = self.ends[k]._replace(result=INTERRUPTED)
            return True
        return False

    def verify(self) -> None:
        """Evaluate the ends with the tolerances of the verification, and correct small violations by further
        descents."""
        tolerance = self.tolerance
        self.evaluations = self.evaluate_with_samples()
        settings = Settings(self.scale, tolerance, 1e-2, tolerance, 12)
        limit = MAX_SAMPLE_VIOLATION if self.evaluate.sampled_targets.targets else 1e3 * tolerance
        for _ in range(MAX_REFINEMENTS):
            violations = {k: _small_violation(self.ends[k], e, limit) for k, e in enumerate(self.evaluations)}
            # Aim at a margin that exceeds `tolerance` by twice the violation.
            descents = {
                k: _descend_further(self.ends[k], settings._replace(shift=tolerance + 2 * violation), k)
                for k, violation in violations.items()
                if violation
            }
            if not descents:
                break
            run_descents(descents, self.evaluate, self.end_points, self.evaluations, self.ends)
            self.evaluations = self.evaluate_with_samples()

    def evaluate_with_samples(self) -> list[Evaluation]:
        """Take an independent sample of each probability at the best end; return the evaluations at all ends.
        If another end is the best after these samples, this end is sampled as well. At most
        `MAX_CHECKED_ENDS` ends are sampled."""
        for _ in range(MAX_CHECKED_ENDS):
            evaluations = self.evaluate(self.end_points)
            if not self.evaluate.sampled_targets.targets:
                return evaluations
            is_new, _ = self.evaluate.sampled_targets.check(self.end_points[_best_index(evaluations)])
            if not is_new:
                return evaluations
        return self.evaluate(self.end_points)

    def correct(self, settings: Settings) -> None:
        """Continue the descents from their ends while an independent sample at the best end contradicts the
        estimate of the search, at most `MAX_CORRECTIONS` times."""
        for _ in range(MAX_CORRECTIONS if self.evaluate.sampled_targets.targets else 0):
            best = _best_index(self.evaluate(self.end_points))
            _, differs = self.evaluate.sampled_targets.check(self.end_points[best])
            if not differs:
                return
            end_points, first = self.end_points, self.evaluate(self.end_points)
            descents = {
                k: _descend_further(end, settings, k)
                for k, end in self.ends.items()
                if end.result != NOT_FINITE
            }
            run_descents(descents, self.evaluate, end_points, first, self.ends)

    def end_so_far(self, k: int, settings: Settings) -> End:
        """Return the best point that start k has reached as its end, with unknown multipliers (NaN)."""
        x, evaluation = self.evaluate.best[k]
        iterations = sum(row.start == k for row in self.history)
        return End(
            x,
            np.full(len(evaluation.c), np.nan),
            INTERRUPTED,
            iterations,
            scale_evaluation(evaluation, settings),
        )

    def estimate_samples(self, x: np.ndarray) -> SampleEstimates:
        """Return the estimates from independent samples at x (n,), the end of a start."""
        return self.evaluate.sampled_targets.probabilities(x)

    @property
    def end_points(self) -> np.ndarray:
        """Scaled variables at the ends of all starts (starts, n)."""
        return np.stack([self.ends[k].x for k in range(len(self.ends))])

    @property
    def iterations(self) -> int:
        return sum(end.iterations for end in self.ends.values())

    def search_result(self, margin_counts: dict[str, int], effort: Effort) -> SearchResult:
        ends = [self.ends[k] for k in range(len(self.points))]
        return SearchResult(ends, self.evaluations, margin_counts, self.scale, self.history, effort)


def _descend_further(end: End, settings: Settings, start: int) -> Descent:
    """Continue a descent from its end. The new end has the sum of the iterations of both parts."""
    further = yield from descend(end.x, settings, [], start)
    return further._replace(iterations=end.iterations + further.iterations)


def _check_fresh(
    transformation: optax.GradientTransformation | None, targets: tuple, objective: AbstractObjective | None
) -> None:
    """Raise `ValueError` for fresh samples that a target, the objective or the method does not accept."""
    distributional = [t for t in targets if isinstance(t, AbstractScaleTarget) and t.accepts_fresh_samples]
    others = [t for t in targets if not any(t is other for other in distributional)]
    for item in (*others, objective, getattr(objective, "risk", None)):
        if fresh_samples_of(item) is not None:
            of_objective = " of the objective" if item is getattr(objective, "risk", None) else ""
            raise ValueError(
                "design: only the targets optimise.AnnualFrequency and optimise.MedianCapacity can have "
                f"FreshSamples; give the {type(item).__name__}{of_objective} fixed motions"
            )
    if not any(fresh_samples_of(t) is not None for t in distributional):
        return
    if any(isinstance(target, FailureProbability) for target in targets):
        raise ValueError(
            "design: a FailureProbability and a target with FreshSamples cannot be combined; leave one of "
            "them out"
        )
    if transformation is None:
        raise ValueError(
            "design: FreshSamples need a gradient transformation such as method=optax.adam(0.02); 'sqp' "
            "compares values of different steps, which belong to different motions"
        )


def _check_arguments(starts, tolerance, max_iterations, targets: tuple, minimise) -> None:
    """Raise `ValueError` for invalid arguments of `design`."""
    require_whole("design", "starts", starts, 1)
    if max_iterations is not None:
        require_whole("design", "max_iterations", max_iterations, 1)
    require_number("design", "tolerance", tolerance, lambda v: 1e-10 <= v <= 1e-2, "in [1e-10, 1e-2]")
    for k, target in enumerate(targets):
        if not isinstance(target, AbstractTarget):
            raise ValueError(
                f"design: targets[{k}] must be a target such as optimise.PeakRotation, got {target!r}"
            )
    if minimise is not None and not isinstance(minimise, AbstractObjective) and not callable(minimise):
        raise ValueError(
            f"design: minimise must be an objective or a function of the podium, got {minimise!r}"
        )
    if minimise is None and not targets:
        raise ValueError("design: there is nothing to do; give minimise, targets or both")


def _starting_points(variables: Variables, starts: int, seed: int) -> np.ndarray:
    """Return the starting points (starts, n), in scaled variables: the user's structure and a random Latin
    hypercube."""
    rng = np.random.default_rng(seed)
    n = len(variables.names)
    strata = (
        np.stack([rng.permutation(starts - 1) for _ in range(n)], axis=1) if starts > 1 else np.zeros((0, n))
    )
    sample = (strata + rng.uniform(size=strata.shape)) / max(starts - 1, 1)
    return np.concatenate([np.asarray(variables.start())[None], sample])


def _best_index(evaluations: list[Evaluation]) -> int:
    """Return the index of the best evaluation: the least violation and, among equal violations, the least
    objective."""
    keys = [rank(e) if e.is_finite else (np.inf, np.inf) for e in evaluations]
    return min(range(len(keys)), key=keys.__getitem__)


def _margin_counts(targets: tuple[AbstractTarget, ...], counts: list[int]) -> dict[str, int]:
    """Return name of the target → number of its margins; repeated names are numbered."""
    names: dict[str, int] = {}
    for target, count in zip(targets, counts, strict=True):
        base_name = target.name or target.describe()
        name, k = base_name, 2
        while name in names:
            name, k = f"{base_name} ({k})", k + 1
        names[name] = count
    return names


def _small_violation(end: End, verified: Evaluation, limit: float) -> float:
    """Return the violation at an end in the verification if a further descent may correct it, otherwise 0: if
    the evaluation is finite, the violation is at most `limit`, and the result of the search is neither
    `infeasible` nor `not_finite`."""
    if end.result in (INFEASIBLE, NOT_FINITE) or not verified.is_finite:
        return 0.0
    return verified.violation if verified.violation <= limit else 0.0
