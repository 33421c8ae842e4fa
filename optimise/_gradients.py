"""Steps of an Optax gradient transformation on an augmented Lagrangian, all starts in a batch.

With the largest value f, margins c and multipliers μ, the transformation follows the gradient of

    f + Σ_j (max(0, μ_j − ρ_j c_j)² − μ_j²)/2ρ_j,   with ρ_j = ρ over a running mean of |∇c_j|²,

so that steep and flat margins have equal weight. In each step μ_j moves by a tenth of the way to
max(0, μ_j − ρ_j c_j). Steps shrink with 1/√t and are projected onto the bounds. Values of different steps are
never compared, because their motions may differ.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np

from ._descent import Evaluation, Iterate, scale_of
from ._quadratic import Vector

if TYPE_CHECKING:
    import optax

    from ._evaluator import Evaluator

MAX_ITERATIONS = 100
RHO, FOLLOW = 10.0, 0.1
STEADY = 8  # the steps shrink after 1/STEADY of a search
LONGEST = 0.25  # longest step in scaled variables
FLAT = 1e-2  # margins with smaller slopes are not scaled up further


def transformation_of(method: str | optax.GradientTransformation) -> optax.GradientTransformation | None:
    """Return the gradient transformation of a method, None for `"sqp"`.

    Raises `ValueError` for anything else, and for transformations that evaluate the objective, as line
    searches do.
    """
    if isinstance(method, str) and method == "sqp":
        return None
    import optax  # slow to import

    if isinstance(method, str) and method == "adam":
        return optax.adam(0.02)
    if not isinstance(method, optax.GradientTransformation):
        raise ValueError(
            "design: method must be 'sqp', 'adam' or a gradient transformation of Optax such as "
            f"optax.adam(0.02), got {method!r}"
        )
    whole, x, value = optax.with_extra_args_support(method), jnp.zeros(1), jnp.zeros(())
    try:
        jax.eval_shape(lambda: whole.update(x, whole.init(x), x, value=value, grad=x))
    except TypeError as error:
        if "value_fn" not in str(error):
            raise
        raise ValueError(
            "design: method has to evaluate the objective by itself (value_fn), as line searches do; give "
            "one that steps by gradients alone, such as optax.adam(0.02) or "
            f"optax.lbfgs(0.1, linesearch=None), got {method!r}"
        ) from None
    return method


class GradientSteps:
    """Gradient steps of all starts in a batch, with common motions.

    Arrays have the starts (s,) in front: margins (s, m), scaled variables (s, n). `aim` holds the margins
    aimed at, `tails` the evaluations of the second half of the steps.

    - `transformation`: of Optax; `evaluate`: evaluates a point of every start
    - `points`: starting points (s, n); `first`: their evaluations
    - `tolerance`: first margin aimed at [–]; `history`: receives the iterates
    """

    def __init__(
        self,
        transformation: optax.GradientTransformation,
        evaluate: Evaluator,
        points: np.ndarray,
        first: list[Evaluation],
        tolerance: float,
        history: list[Iterate],
    ):
        import optax

        whole = optax.with_extra_args_support(transformation)
        self.init = jax.jit(jax.vmap(whole.init))
        self.update = jax.jit(
            jax.vmap(lambda g, state, x, value: whole.update(g, state, x, value=value, grad=g))
        )
        self.evaluate, self.x, self.history, self.iteration = evaluate, np.array(points, float), history, 0
        self.dead = np.array([not there.finite for there in first])
        self.scale = scale_of([there for there in first if there.finite])
        self.aim = np.full((len(first), len(first[0].c)), tolerance)
        self.price = np.zeros_like(self.aim)
        self.steep = np.stack([np.sum(there.c_slope**2, axis=1) for there in first])
        self.tails: list[list[tuple[Vector, Evaluation]]] = [[] for _ in first]

    def walk(self, steps: int, moving: np.ndarray) -> None:
        """Take `steps` steps with the starts `moving` (s,); steps with non-finite answers are skipped."""
        memory = self.init(jnp.asarray(self.x))
        for k in np.flatnonzero(moving):
            self.tails[k] = []
        for t in range(steps):
            found = self.evaluate(self.x, int(moving.sum()))
            pairs = [self._lagrangian(k, there) for k, there in enumerate(found)]
            values, gradient = (np.stack(parts) for parts in zip(*pairs, strict=True))
            fine = moving & np.isfinite(gradient).all(axis=1)
            gradient = np.where(fine[:, None], gradient, 0.0)
            update, memory = self.update(jnp.asarray(gradient), memory, jnp.asarray(self.x), values)
            shrunk = 1 / np.sqrt(max(1.0, STEADY * t / steps))
            step = np.clip(shrunk * np.asarray(update), -LONGEST, LONGEST) * fine[:, None]
            after = np.clip(self.x + step, 0.0, 1.0)
            for k in map(int, np.flatnonzero(fine)):
                self._record(k, found[k], shrunk, float(np.max(np.abs(after[k] - self.x[k]))))
                if t >= steps // 2:
                    self.tails[k].append((self.x[k].copy(), found[k]))
            self.x, self.iteration = after, self.iteration + 1

    def _lagrangian(self, k: int, there: Evaluation) -> tuple[float, Vector]:
        """Return value and gradient (n,) of the augmented Lagrangian of a start, and move its multipliers."""
        c = there.c - self.aim[k]
        if np.isfinite(there.c_slope).all():
            self.steep[k] += FOLLOW * (np.sum(there.c_slope**2, axis=1) - self.steep[k])
        rho = RHO / np.maximum(self.steep[k], FLAT**2)
        price = np.maximum(0.0, self.price[k] - rho * c)
        value = np.max(there.f) / self.scale + np.sum((price**2 - self.price[k] ** 2) / (2 * rho))
        gradient = there.f_slope[np.argmax(there.f)] / self.scale - price @ there.c_slope
        if np.isfinite(gradient).all():
            self.price[k] += FOLLOW * (price - self.price[k])
        return float(value), gradient

    def _record(self, k: int, there: Evaluation, factor: float, step: float) -> None:
        margin, value = float(np.min(there.c, initial=np.inf)), float(np.max(there.f))
        row = Iterate(k, self.iteration, self.x[k], value, margin, np.nan, factor, RHO, step, True)
        self.history.append(row)
