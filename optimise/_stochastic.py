"""Searches for a design with motions that are drawn anew in every step (fresh samples).

The search from a starting point (start) ends at the mean of the points of the second half of its gradient
steps (Polyak–Ruppert averaging). Small batches of motions bias this mean. An independent sample of motions
shows the bias. If a target is violated in this sample, the margin that the search aims at is increased by the
violation and by an allowance for the scatter between two samples. If, after the first search, a margin that
limits the design is larger than needed, the margin that the search aims at is reduced. In both cases a
shorter search continues from the mean, and a new independent sample is taken.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

import rockjax as rj

from ._answer import Effort, SampleEstimates, SearchResult
from ._descent import End, Evaluation
from ._evaluator import Evaluator, MarginEstimate
from ._gradients import GradientSteps
from ._optimality import optimality
from ._quadratic import Vector
from ._results import AVERAGED, INFEASIBLE, INTERRUPTED, NOT_FINITE

if TYPE_CHECKING:
    import optax

MAX_ITERATIONS = 300  # default number of steps of the first search
MAX_CORRECTIONS = 3  # largest number of further searches after the first
STEPS_DIVISOR = 4  # a further search has max_iterations/STEPS_DIVISOR steps
# Allowance in standard errors: 95 % of further samples have a margin that is lower by less than this.
SAFETY_FACTOR = 1.645 * np.sqrt(2)
EXACT_PENALTY = 1e4  # penalty of violations when multipliers are computed


class FreshSearch:
    """Search from all starts of a design with fresh samples.

    - `transformation`: an Optax gradient transformation; `evaluate`: evaluates one point of every start
    - `points`: starting points (starts, n), in scaled variables
    - `tolerance`: least margin that the first search aims at [–]; `max_iterations`: number of steps of the
      first search
    """

    def __init__(
        self,
        transformation: optax.GradientTransformation,
        evaluate: Evaluator,
        points: np.ndarray,
        tolerance: float,
        max_iterations: int,
    ):
        self.transformation, self.evaluate, self.x = transformation, evaluate, points
        self.tolerance, self.max_iterations = tolerance, max_iterations
        self.sample_count = 0
        self.estimates: list[dict[int, MarginEstimate]] = [{} for _ in points]
        self.evaluations: list[Evaluation] = []
        self.is_interrupted = False

    def run(self) -> bool:
        """Run the search and return whether it was interrupted.

        If the search is interrupted, every start ends at the mean of those points that it has reached in the
        second half of its latest series of steps. A start that has not reached this half ends at its present
        point. Raises `rockjax.Interrupted` if the first evaluation is interrupted.
        """
        try:
            first = self.evaluate(self.x)
        except KeyboardInterrupt:
            raise rj.Interrupted("stopped before the first evaluation", None) from None
        self.gradient_steps = GradientSteps(
            self.transformation, self.evaluate, self.x, first, self.tolerance, []
        )
        try:
            self.take_steps(self.max_iterations, ~self.gradient_steps.is_excluded)
            self.verify()
            for k in range(MAX_CORRECTIONS):
                continuing = self.shift_margins(is_first=k == 0)
                if not continuing.any():
                    break
                self.take_steps(max(self.max_iterations // STEPS_DIVISOR, 2), continuing)
                self.verify()
        except KeyboardInterrupt:
            self.is_interrupted = True
            self.move_to_means()
            self.verify()
        return self.is_interrupted

    def take_steps(self, steps: int, active: np.ndarray) -> None:
        """Take `steps` gradient steps from the starts for which `active` (s,) is True; then move every start
        to its mean."""
        self.gradient_steps.take_steps(steps, active)
        self.move_to_means()

    def move_to_means(self) -> None:
        """Move every start to the mean of the points in `GradientSteps.last_steps`, if there are any."""
        pairs = zip(self.gradient_steps.x, self.gradient_steps.last_steps, strict=True)
        self.x = np.stack(
            [np.mean([y for y, _ in last_steps], axis=0) if last_steps else x for x, last_steps in pairs]
        )
        self.gradient_steps.x = self.x

    def verify(self) -> None:
        """Evaluate the mean points of all starts. Targets on fixed motions are evaluated with the tolerances
        of the verification, and targets with fresh samples with a new independent sample."""
        self.evaluate.is_accurate = True
        exact = self.evaluate(self.x)
        self.evaluate.is_accurate = False
        self.estimates = [
            self.evaluate.estimates(x, self.sample_count) if self.evaluate.is_valid(x) else {} for x in self.x
        ]
        self.sample_count += 1
        pairs = zip(exact, self.estimates, strict=True)
        self.evaluations = [self._with_estimates(evaluation, estimates) for evaluation, estimates in pairs]

    @property
    def margin_offsets(self) -> np.ndarray:
        """Index of the first margin of each target and, as the last entry, the number of all margins."""
        return np.cumsum([0, *self.evaluate.margin_counts])

    def _with_estimates(self, evaluation: Evaluation, estimates: dict[int, MarginEstimate]) -> Evaluation:
        """Return an evaluation in which `estimates` replace the margins of targets with fresh samples."""
        c, offsets = evaluation.c.copy(), self.margin_offsets
        for index, estimate in estimates.items():
            c[offsets[index] : offsets[index + 1]] = estimate.margins
        return evaluation._replace(c=c)

    def errors(self, k: int) -> Vector:
        """Return the standard errors (m,) of the margins at start k, from the scatter of the independent
        sample and of the last steps; 0 for targets with fixed motions."""
        offsets = self.margin_offsets
        standard_errors = np.zeros(offsets[-1])
        for index, estimate in self.estimates[k].items():
            standard_errors[offsets[index] : offsets[index + 1]] = estimate.errors
        last_steps = self.gradient_steps.last_steps[k]
        margins = (
            np.stack([evaluation.c for _, evaluation in last_steps])
            if last_steps
            else np.zeros((1, offsets[-1]))
        )
        mean_error = margins.std(axis=0) / np.sqrt(len(margins))
        return np.where(standard_errors > 0, np.hypot(standard_errors, mean_error), 0.0)

    def shift_margins(self, is_first: bool) -> np.ndarray:
        """Correct the margins that the search aims at, using the independent sample. Return a mask (s,) of
        the starts that continue.

        After the correction, the margin in the independent sample should equal the allowance for scatter. The
        allowance is `SAFETY_FACTOR` standard errors, but at least the tolerance. Violated margins are
        corrected. After the first search (`is_first`), margins that limit the design (those with multipliers)
        are also corrected if they exceed twice the allowance.
        """
        continuing, steps = np.zeros(len(self.x), bool), self.gradient_steps
        for k, evaluation in enumerate(self.evaluations):
            if steps.is_excluded[k] or not evaluation.is_finite:
                continue
            allowance = np.maximum(SAFETY_FACTOR * self.errors(k), self.tolerance)
            is_active = steps.multipliers[k] > 1e-3 * np.max(steps.multipliers[k], initial=0.0)
            is_corrected = (evaluation.c < 0) | (is_first & is_active & (evaluation.c > 2 * allowance))
            steps.target_margins[k] += np.where(is_corrected, allowance - evaluation.c, 0.0)
            continuing[k] = bool(is_corrected.any())
        return continuing

    @property
    def iterations(self) -> int:
        return len(self.gradient_steps.history)

    def end(self, k: int) -> End:
        """Return the end of start k. Its multipliers come from the mean slopes in its last steps."""
        evaluation, steps = self.evaluations[k], self.gradient_steps
        last_steps = steps.last_steps[k]
        count = sum(row.start == k for row in steps.history)
        if steps.is_excluded[k] or not last_steps:
            code = INTERRUPTED if self.is_interrupted and not steps.is_excluded[k] else NOT_FINITE
            return End(self.x[k], np.full(len(evaluation.c), np.nan), code, count, evaluation)
        fields = zip(*(evaluation for _, evaluation in last_steps), strict=True)
        mean = Evaluation(*(np.mean(values, axis=0) for values in fields))
        c = mean.c - steps.target_margins[k]
        current = Evaluation(mean.f / steps.scale, c, mean.f_slope / steps.scale, mean.c_slope)
        multipliers = optimality(self.x[k], current, [], 1.0, EXACT_PENALTY, self.tolerance).multipliers
        code = INTERRUPTED if self.is_interrupted else AVERAGED if evaluation.violation == 0 else INFEASIBLE
        return End(self.x[k], multipliers, code, count, evaluation)

    def search_result(self, margin_counts: dict[str, int], effort: Effort) -> SearchResult:
        ends = [self.end(k) for k in range(len(self.x))]
        return SearchResult(
            ends,
            self.evaluations,
            margin_counts,
            self.gradient_steps.scale,
            self.gradient_steps.history,
            effort,
        )

    def estimate_samples(self, x: Vector) -> SampleEstimates:
        """Return the standard errors of the margins in the last independent sample at x (n,), the end of a
        start."""
        k = int(np.argmin(np.abs(self.x - x).max(axis=1)))
        return SampleEstimates({}, {index: estimate.errors for index, estimate in self.estimates[k].items()})
