"""Searches by motions that are drawn anew in every step: a gradient transformation of Optax on an augmented
Lagrangian, without comparing values, which are of other motions each time.

The transformation is given the gradient of the batch of the step,

    ∇f − Σ_j max(0, μ_j − ρ_j c_j) ∇c_j,   with ρ_j = ρ over a running mean of |∇c_j|²,

and μ_j follows max(0, μ_j − ρ_j c_j) by a tenth a step. Steps shrink with 1/√t, and where a start has come to
is the mean of the second half of them (Polyak and Ruppert). That is off by the bias of small batches. An
independent sample at the mean says by how much: it is added to what margins aim at, with what two samples may
differ, and a shorter search goes on from there. A new sample follows each.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import optax

import rockjax as rj

from ._answer import Effort, Found, Sampled
from ._descent import End, Evaluation, Iterate, scale_of
from ._evaluator import Estimate, Evaluator, verified
from ._optimality import optimality
from ._quadratic import Vector
from ._results import AVERAGED, INFEASIBLE, INTERRUPTED, NOT_FINITE

MAX_ITERATIONS = 300
CORRECTIONS, PART = 3, 4  # further searches, each of this part of the steps
RHO, FOLLOW = 10.0, 0.1
STEADY = 8  # the steps shrink from this part of a search on
LONGEST = 0.25  # step in scaled variables
SAFE = 1.645 * np.sqrt(2)  # standard errors: 95 % of second samples agree
FLAT = 1e-2  # margins with slopes below are not made steeper
EXACT = 1e4  # penalty of violations when multipliers are told


class Search:
    """All starts of a design by fresh samples: all take their steps with the same motions.

    Arrays have the starts (s,) in front, margins (s, m), scaled variables (s, n).
    """

    def __init__(
        self,
        transformation: optax.GradientTransformation,
        evaluate: Evaluator,
        points: np.ndarray,
        tolerance: float,
        max_iterations: int,
    ):
        whole = optax.with_extra_args_support(transformation)
        self.init = jax.jit(jax.vmap(whole.init))
        self.update = jax.jit(jax.vmap(lambda g, state, x: whole.update(g, state, x)))
        self.evaluate, self.x = evaluate, np.array(points, float)
        self.tolerance, self.max_iterations = tolerance, max_iterations
        self.history: list[Iterate] = []
        self.scale, self.iteration, self.samples = 1.0, 0, 0
        self.tails: list[list[tuple[Vector, Evaluation]]] = [[] for _ in points]
        self.estimates: list[dict[int, Estimate]] = [{} for _ in points]
        self.evaluations: list[Evaluation] = []
        self.dead: np.ndarray = np.zeros(len(points), bool)
        self.stopped = False

    def run(self, options: rj.Options) -> bool:
        """Whether it was interrupted: then starts end at the mean of the last steps so far."""
        try:
            first = self.evaluate(self.x)
        except KeyboardInterrupt:
            raise rj.Interrupted("stopped before the first evaluation", None) from None
        self.dead = np.array([not there.finite for there in first])
        self.scale = scale_of([there for there in first if there.finite])
        margins = len(first[0].c)
        self.price, self.aim = np.zeros((len(first), margins)), np.full((len(first), margins), self.tolerance)
        self.steep = np.stack([np.sum(there.c_slope**2, axis=1) for there in first])
        try:
            self.walk(self.max_iterations, ~self.dead)
            self.verify(options)
            for k in range(CORRECTIONS):
                again = self.corrected(first=k == 0)
                if not again.any():
                    break
                self.walk(max(self.max_iterations // PART, 2), again)
                self.verify(options)
        except KeyboardInterrupt:
            self.stopped = True
            self.settle()
            self.verify(options)
        return self.stopped

    def walk(self, steps: int, moving: np.ndarray) -> None:
        """So many steps of some of the starts, and to the mean of the second half of them."""
        memory = self.init(jnp.asarray(self.x))
        for k in np.flatnonzero(moving):
            self.tails[k] = []
        for t in range(steps):
            found = self.evaluate(self.x, int(moving.sum()))
            gradient = np.stack([self.gradient(k, there) for k, there in enumerate(found)])
            fine = moving & np.isfinite(gradient).all(axis=1)
            update, memory = self.update(
                jnp.asarray(np.where(fine[:, None], gradient, 0.0)), memory, jnp.asarray(self.x)
            )
            shrunk = 1 / np.sqrt(max(1.0, STEADY * t / steps))
            step = np.clip(shrunk * np.asarray(update), -LONGEST, LONGEST) * fine[:, None]
            after = np.clip(self.x + step, 0.0, 1.0)
            for k in map(int, np.flatnonzero(fine)):
                self.record(k, found[k], shrunk, float(np.max(np.abs(after[k] - self.x[k]))))
                if t >= steps // 2:
                    self.tails[k].append((self.x[k].copy(), found[k]))
            self.x, self.iteration = after, self.iteration + 1
        self.settle()

    def gradient(self, k: int, there: Evaluation) -> Vector:
        """Of the augmented Lagrangian of a start; its multipliers move."""
        c = there.c - self.aim[k]
        if np.isfinite(there.c_slope).all():
            self.steep[k] += FOLLOW * (np.sum(there.c_slope**2, axis=1) - self.steep[k])
        rho = RHO / np.maximum(self.steep[k], FLAT**2)
        price = np.maximum(0.0, self.price[k] - rho * c)
        gradient = there.f_slope[np.argmax(there.f)] / self.scale - price @ there.c_slope
        if np.isfinite(gradient).all():
            self.price[k] += FOLLOW * (price - self.price[k])
        return gradient

    def record(self, k: int, there: Evaluation, factor: float, step: float) -> None:
        margin, value = float(np.min(there.c, initial=np.inf)), float(np.max(there.f))
        row = Iterate(k, self.iteration, self.x[k], value, margin, np.nan, factor, RHO, step, True)
        self.history.append(row)

    def settle(self) -> None:
        """To the mean of the last steps."""
        self.x = np.stack(
            [
                np.mean([x for x, _ in tail], axis=0) if tail else self.x[k]
                for k, tail in enumerate(self.tails)
            ]
        )

    def verify(self, options: rj.Options) -> None:
        """What holds at the means: by accurate simulations of motions that stay, by a new independent sample
        of the others."""
        exact = self.evaluate.accurately(self.x, verified(options))
        self.estimates = [self.evaluate.estimates(x, self.samples) for x in self.x]
        self.samples += 1
        pairs = zip(exact, self.estimates, strict=True)
        self.evaluations = [self._with(there, estimates) for there, estimates in pairs]

    @property
    def ends(self) -> np.ndarray:
        """Where the margins of each target end, beginning with 0."""
        return np.cumsum([0, *self.evaluate.sizes])

    def _with(self, there: Evaluation, estimates: dict[int, Estimate]) -> Evaluation:
        c, ends = there.c.copy(), self.ends
        for place, found in estimates.items():
            c[ends[place] : ends[place + 1]] = found.margins
        return there._replace(c=c)

    def errors(self, k: int) -> Vector:
        """Standard errors of the margins of a start: of the sample, and of where its mean is."""
        ends = self.ends
        found = np.zeros(ends[-1])
        for place, estimate in self.estimates[k].items():
            found[ends[place] : ends[place + 1]] = estimate.errors
        seen = np.stack([there.c for _, there in self.tails[k]]) if self.tails[k] else np.zeros((1, ends[-1]))
        wandering = seen.std(axis=0) / np.sqrt(len(seen))
        return np.where(found > 0, np.hypot(found, wandering), 0.0)

    def corrected(self, first: bool) -> np.ndarray:
        """Aim where an independent sample says that it holds: which starts have to go on for it, (s,)."""
        again = np.zeros(len(self.x), bool)
        for k, there in enumerate(self.evaluations):
            if self.dead[k] or not there.finite:
                continue
            inside = np.maximum(SAFE * self.errors(k), self.tolerance)
            active = self.price[k] > 1e-3 * np.max(self.price[k], initial=0.0)
            off = (there.c < 0) | (first & active & (there.c > 2 * inside))
            self.aim[k] += np.where(off, inside - there.c, 0.0)
            again[k] = bool(off.any())
        return again

    @property
    def iterations(self) -> int:
        return len(self.history)

    def end(self, k: int) -> End:
        """Where a start ended, with multipliers by the mean slopes of its last steps."""
        there, tail = self.evaluations[k], self.tails[k]
        count = sum(row.start == k for row in self.history)
        if self.dead[k] or not tail:
            code = INTERRUPTED if self.stopped and not self.dead[k] else NOT_FINITE
            return End(self.x[k], np.full(len(there.c), np.nan), code, count, there)
        mean = Evaluation(
            *(np.mean(parts, axis=0) for parts in zip(*(seen for _, seen in tail), strict=True))
        )
        here = Evaluation(mean.f / self.scale, mean.c - self.aim[k], mean.f_slope / self.scale, mean.c_slope)
        prices = optimality(self.x[k], here, [], 1.0, EXACT, self.tolerance).multipliers
        code = INTERRUPTED if self.stopped else AVERAGED if there.violation == 0 else INFEASIBLE
        return End(self.x[k], prices, code, count, there)

    def found(self, sizes: dict[str, int], effort: Effort) -> Found:
        ends = [self.end(k) for k in range(len(self.x))]
        return Found(ends, self.evaluations, sizes, self.scale, self.history, effort)

    def sampled(self, x: Vector) -> Sampled:
        """What the last independent sample says at the end of a start."""
        k = int(np.argmin(np.abs(self.x - x).max(axis=1)))
        return Sampled({}, {place: found.errors for place, found in self.estimates[k].items()})
