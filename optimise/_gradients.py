"""Steps of an Optax gradient transformation on an augmented Lagrangian, for all starts in one batch.

The transformation follows the gradient of

    f + Σ_j (max(0, μ_j − ρ_j c_j)² − μ_j²)/(2ρ_j),

where f is the largest objective value divided by a typical change of the objective, c_j is a margin minus the
least margin that the search aims at, and μ_j is the multiplier of this margin. The sum contains all margins
of all targets. ρ_j is ρ divided by a running mean of |∇c_j|², so that steep and flat margins have equal
weight. In each step, μ_j moves a tenth of the way to max(0, μ_j − ρ_j c_j). After the first eighth of the
steps, step t of the transformation is multiplied by a factor that decreases as 1/√t. Points are projected
onto the bounds. This module never compares values of different steps, because the motions may differ from
step to step.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np

from ._descent import Evaluation, Iterate, objective_scale
from ._quadratic import Vector

if TYPE_CHECKING:
    import optax

    from ._evaluator import Evaluator

MAX_ITERATIONS = 100  # default number of steps
RHO = 10.0  # ρ of the augmented Lagrangian
SMOOTHING = 0.1  # weight of a new value in the running means of multipliers and squared slopes
STEP_DECAY = 8  # steps shrink after the first 1/STEP_DECAY of a search
MAX_STEP = 0.25  # largest absolute entry of a step, in scaled variables
MIN_SLOPE = 1e-2  # lower limit of the root-mean-square slope |∇c_j| in ρ_j


def transformation_of(method: str | optax.GradientTransformation) -> optax.GradientTransformation | None:
    """Return the gradient transformation of a method, None for `"sqp"`. Raises `ValueError` for other
    strings, and for transformations that evaluate the objective themselves, such as line searches."""
    if isinstance(method, str) and method == "sqp":
        return None
    import optax  # slow to import

    if isinstance(method, str) and method == "adam":
        return optax.adam(0.02)
    if not isinstance(method, optax.GradientTransformation):
        raise ValueError(
            "design: method must be 'sqp', 'adam' or an Optax gradient transformation such as "
            f"optax.adam(0.02), got {method!r}"
        )
    extended, x, value = optax.with_extra_args_support(method), jnp.zeros(1), jnp.zeros(())
    try:
        jax.eval_shape(lambda: extended.update(x, extended.init(x), x, value=value, grad=x))
    except TypeError as error:
        if "value_fn" not in str(error):
            raise
        raise ValueError(
            "design: method must not need value_fn, a function that evaluates the objective, as line "
            "searches do; give a method that needs only gradients, such as optax.adam(0.02) or "
            f"optax.lbfgs(0.1, linesearch=None); got {method!r}"
        ) from None
    return method


class GradientSteps:
    """Gradient steps from all starts (starting points) in one batch. In a step, all starts have the same
    motions.

    The first axis of arrays is that of the s starts: margins have shape (s, m), scaled variables (s, n).
    Attributes: `target_margins` contains the least margins that the search aims at, and `squared_slopes` the
    running means of |∇c_j|². `last_steps` contains, for each start, the points and evaluations of the second
    half of its latest series of steps. `is_excluded` is True for starts whose first evaluation is not finite.

    - `transformation`: an Optax gradient transformation; `evaluate`: evaluates one point of every start
    - `points`: starting points (s, n); `evaluations`: the evaluations of these points
    - `tolerance`: initial value of `target_margins` [–]; `history`: list to which iterates are appended
    """

    def __init__(
        self,
        transformation: optax.GradientTransformation,
        evaluate: Evaluator,
        points: np.ndarray,
        evaluations: list[Evaluation],
        tolerance: float,
        history: list[Iterate],
    ):
        import optax

        extended = optax.with_extra_args_support(transformation)
        self.init = jax.jit(jax.vmap(extended.init))
        self.update = jax.jit(
            jax.vmap(lambda g, state, x, value: extended.update(g, state, x, value=value, grad=g))
        )
        self.evaluate, self.x, self.history, self.iteration = evaluate, np.array(points, float), history, 0
        self.is_excluded = np.array([not evaluation.is_finite for evaluation in evaluations])
        self.scale = objective_scale([evaluation for evaluation in evaluations if evaluation.is_finite])
        self.target_margins = np.full((len(evaluations), len(evaluations[0].c)), tolerance)
        self.multipliers = np.zeros_like(self.target_margins)
        self.squared_slopes = np.stack([np.sum(evaluation.c_slope**2, axis=1) for evaluation in evaluations])
        self.last_steps: list[list[tuple[Vector, Evaluation]]] = [[] for _ in evaluations]

    def take_steps(self, steps: int, active: np.ndarray) -> None:
        """Take `steps` steps from the present points of the starts for which `active` (s,) is True. A start
        does not move in a step in which its gradient is not finite."""
        optimiser_state = self.init(jnp.asarray(self.x))
        for k in np.flatnonzero(active):
            self.last_steps[k] = []
        for t in range(steps):
            evaluations = self.evaluate(self.x, int(active.sum()))
            pairs = [self._lagrangian(k, evaluation) for k, evaluation in enumerate(evaluations)]
            values, gradient = (np.stack(column) for column in zip(*pairs, strict=True))
            is_usable = active & np.isfinite(gradient).all(axis=1)
            gradient = np.where(is_usable[:, None], gradient, 0.0)
            update, optimiser_state = self.update(
                jnp.asarray(gradient), optimiser_state, jnp.asarray(self.x), values
            )
            step_factor = 1 / np.sqrt(max(1.0, STEP_DECAY * t / steps))
            step = np.clip(step_factor * np.asarray(update), -MAX_STEP, MAX_STEP) * is_usable[:, None]
            new_x = np.clip(self.x + step, 0.0, 1.0)
            for k in map(int, np.flatnonzero(is_usable)):
                self._record(k, evaluations[k], step_factor, float(np.max(np.abs(new_x[k] - self.x[k]))))
                if t >= steps // 2:
                    self.last_steps[k].append((self.x[k].copy(), evaluations[k]))
            self.x, self.iteration = new_x, self.iteration + 1

    def _lagrangian(self, k: int, evaluation: Evaluation) -> tuple[float, Vector]:
        """Update the multipliers of start k; return its augmented Lagrangian and the gradient (n,)."""
        c = evaluation.c - self.target_margins[k]
        if np.isfinite(evaluation.c_slope).all():
            self.squared_slopes[k] += SMOOTHING * (
                np.sum(evaluation.c_slope**2, axis=1) - self.squared_slopes[k]
            )
        rho = RHO / np.maximum(self.squared_slopes[k], MIN_SLOPE**2)
        multipliers = np.maximum(0.0, self.multipliers[k] - rho * c)
        value = np.max(evaluation.f) / self.scale + np.sum(
            (multipliers**2 - self.multipliers[k] ** 2) / (2 * rho)
        )
        gradient = evaluation.f_slope[np.argmax(evaluation.f)] / self.scale - multipliers @ evaluation.c_slope
        if np.isfinite(gradient).all():
            self.multipliers[k] += SMOOTHING * (multipliers - self.multipliers[k])
        return float(value), gradient

    def _record(self, k: int, evaluation: Evaluation, factor: float, step: float) -> None:
        """Append an iterate of the start k to the history: the evaluation before the step, the factor by
        which the step of the transformation was multiplied, and the largest absolute entry of the step, in
        scaled variables."""
        margin, value = float(np.min(evaluation.c, initial=np.inf)), float(np.max(evaluation.f))
        row = Iterate(k, self.iteration, self.x[k], value, margin, np.nan, factor, RHO, step, True)
        self.history.append(row)
