"""Searches with motions drawn anew in every step.

A start ends at the mean of the second half of its gradient steps (Polyak–Ruppert averaging). Small batches
bias this mean. An independent sample at the mean measures the bias: the bias and the scatter between two
samples are added to the margins aimed at, and a shorter search continues from the mean. A new independent
sample follows each search.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

import rockjax as rj

from ._answer import Effort, Found, Sampled
from ._descent import End, Evaluation
from ._evaluator import Estimate, Evaluator
from ._gradients import GradientSteps
from ._optimality import optimality
from ._quadratic import Vector
from ._results import AVERAGED, INFEASIBLE, INTERRUPTED, NOT_FINITE

if TYPE_CHECKING:
    import optax

MAX_ITERATIONS = 300
CORRECTIONS, PART = 3, 4  # further searches, each of this part of the steps
SAFE = 1.645 * np.sqrt(2)  # standard errors: 95 % of second samples agree
EXACT = 1e4  # penalty of violations in the computation of multipliers


class FreshSearch:
    """All starts of a design with fresh samples.

    - `transformation`: of Optax; `evaluate`: evaluates a point of every start
    - `points`: starting points (starts, n), in scaled variables
    - `tolerance`: first margin aimed at [–]; `max_iterations`: steps of the first search
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
        self.samples = 0
        self.estimates: list[dict[int, Estimate]] = [{} for _ in points]
        self.evaluations: list[Evaluation] = []
        self.stopped = False

    def run(self) -> bool:
        """Run the search and return whether it was interrupted.

        Starts of an interrupted search end at the mean of their last steps so far.
        """
        try:
            first = self.evaluate(self.x)
        except KeyboardInterrupt:
            raise rj.Interrupted("stopped before the first evaluation", None) from None
        self.steps = GradientSteps(self.transformation, self.evaluate, self.x, first, self.tolerance, [])
        try:
            self.walk(self.max_iterations, ~self.steps.dead)
            self.verify()
            for k in range(CORRECTIONS):
                again = self.corrected(first=k == 0)
                if not again.any():
                    break
                self.walk(max(self.max_iterations // PART, 2), again)
                self.verify()
        except KeyboardInterrupt:
            self.stopped = True
            self.settle()
            self.verify()
        return self.stopped

    def walk(self, steps: int, moving: np.ndarray) -> None:
        self.steps.walk(steps, moving)
        self.settle()

    def settle(self) -> None:
        """Move every start to the mean of its last steps."""
        pairs = zip(self.steps.x, self.steps.tails, strict=True)
        self.x = np.stack([np.mean([y for y, _ in tail], axis=0) if tail else x for x, tail in pairs])
        self.steps.x = self.x

    def verify(self) -> None:
        """Evaluate the means: accurately for fixed motions, by a new independent sample for fresh ones."""
        self.evaluate.accurate = True
        exact = self.evaluate(self.x)
        self.evaluate.accurate = False
        self.estimates = [self.evaluate.estimates(x, self.samples) for x in self.x]
        self.samples += 1
        pairs = zip(exact, self.estimates, strict=True)
        self.evaluations = [self._with(there, estimates) for there, estimates in pairs]

    @property
    def ends(self) -> np.ndarray:
        """Index after the last margin of each target, beginning with 0."""
        return np.cumsum([0, *self.evaluate.sizes])

    def _with(self, there: Evaluation, estimates: dict[int, Estimate]) -> Evaluation:
        c, ends = there.c.copy(), self.ends
        for place, found in estimates.items():
            c[ends[place] : ends[place + 1]] = found.margins
        return there._replace(c=c)

    def errors(self, k: int) -> Vector:
        """Return the standard errors of the margins of a start, from the sample and from its mean."""
        ends = self.ends
        found = np.zeros(ends[-1])
        for place, estimate in self.estimates[k].items():
            found[ends[place] : ends[place + 1]] = estimate.errors
        tail = self.steps.tails[k]
        seen = np.stack([there.c for _, there in tail]) if tail else np.zeros((1, ends[-1]))
        wandering = seen.std(axis=0) / np.sqrt(len(seen))
        return np.where(found > 0, np.hypot(found, wandering), 0.0)

    def corrected(self, first: bool) -> np.ndarray:
        """Shift the margins aimed at by the independent sample; return the starts that continue (s,)."""
        again, steps = np.zeros(len(self.x), bool), self.steps
        for k, there in enumerate(self.evaluations):
            if steps.dead[k] or not there.finite:
                continue
            inside = np.maximum(SAFE * self.errors(k), self.tolerance)
            active = steps.price[k] > 1e-3 * np.max(steps.price[k], initial=0.0)
            off = (there.c < 0) | (first & active & (there.c > 2 * inside))
            steps.aim[k] += np.where(off, inside - there.c, 0.0)
            again[k] = bool(off.any())
        return again

    @property
    def iterations(self) -> int:
        return len(self.steps.history)

    def end(self, k: int) -> End:
        """Return the end of a start, with multipliers from the mean slopes of its last steps."""
        there, steps, tail = self.evaluations[k], self.steps, self.steps.tails[k]
        count = sum(row.start == k for row in steps.history)
        if steps.dead[k] or not tail:
            code = INTERRUPTED if self.stopped and not steps.dead[k] else NOT_FINITE
            return End(self.x[k], np.full(len(there.c), np.nan), code, count, there)
        mean = Evaluation(
            *(np.mean(parts, axis=0) for parts in zip(*(seen for _, seen in tail), strict=True))
        )
        c = mean.c - steps.aim[k]
        here = Evaluation(mean.f / steps.scale, c, mean.f_slope / steps.scale, mean.c_slope)
        prices = optimality(self.x[k], here, [], 1.0, EXACT, self.tolerance).multipliers
        code = INTERRUPTED if self.stopped else AVERAGED if there.violation == 0 else INFEASIBLE
        return End(self.x[k], prices, code, count, there)

    def found(self, sizes: dict[str, int], effort: Effort) -> Found:
        ends = [self.end(k) for k in range(len(self.x))]
        return Found(ends, self.evaluations, sizes, self.steps.scale, self.steps.history, effort)

    def sampled(self, x: Vector) -> Sampled:
        """Return the standard errors of the last independent sample at the end of a start."""
        k = int(np.argmin(np.abs(self.x - x).max(axis=1)))
        return Sampled({}, {place: found.errors for place, found in self.estimates[k].items()})
