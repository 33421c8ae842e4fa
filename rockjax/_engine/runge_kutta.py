"""One explicit Runge–Kutta step for second-order systems.

For x' = v, v' = a(t, x, v), a step needs only the accelerations k_j of its stages:

    x_i = x + c_i h v + h² Σ_j (AA)_ij k_j
    v_i = v + h Σ_j A_ij k_j

Here x and v are the state at the start of the step, and x_i and v_i the state at stage i. The step has the
length h, and stage i is at the time c_i h after its start. A contains the weights of the method, and AA is
the matrix product A·A. The formulas are algebraically the same as the method for the first-order system. In
the tableau of a Nyström method, AA contains independent weights, and A is zero. If the acceleration does not
depend on the velocity, the compiler removes the velocities of the stages.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from rockjax._programs.barrier import barrier
from rockjax._types import Value, Values, Vector

from .tableaus import Tableau

Acceleration = Callable[[Value, Vector, Vector], Vector]  # (t, x, v) ↦ v'


class Step(NamedTuple):
    """State, accelerations and error estimates at the end of a trial step."""

    x: Vector  # positions
    v: Vector  # velocities
    a: Vector  # accelerations
    x_error: Vector  # error estimates of the positions
    v_error: Vector  # error estimates of the velocities


def _weighted_sum(weights: np.ndarray, k: list[Vector], component: int) -> Values | float:
    """Return the element `component` of Σ_j w_j k_j, with the weights w_j and the accelerations k_j of the
    stages computed so far. Weights of later stages are ignored."""
    total = 0.0
    for weight, stage in zip(weights, k, strict=False):
        # Elements of the matrix product AA that should be zero contain rounding errors.
        if abs(weight) > 1e-14:
            total = total + float(weight) * stage[component]
    return total


def step(
    tab: Tableau, acceleration: Acceleration, t: Value | float, h: Value, x: Vector, v: Vector, a: Vector
) -> Step:
    """Advance a second-order system by one step.

    - `tab`: tableau of the method
    - `acceleration`: (t, x, v) ↦ accelerations
    - `t`, `h`: time at the start and length of the step [s]
    - `x`, `v`, `a`: positions, velocities and accelerations at the start
    """
    components = range(len(x))
    h2 = h * h

    def stage_state(c, weights_x, weights_v):
        xi = tuple(x[d] + (float(c) * h) * v[d] + h2 * _weighted_sum(weights_x, k, d) for d in components)
        vi = tuple(v[d] + h * _weighted_sum(weights_v, k, d) for d in components)
        # With the barrier, XLA computes the state once, and not again for each component of the acceleration.
        return barrier((xi, vi)) if len(x) > 1 else (xi, vi)

    k = [a]
    for i in range(1, len(tab.c)):
        xi, vi = stage_state(tab.c[i], tab.AA[i], tab.A[i])
        # With the barrier, XLA computes this stage once, and not again for each later stage.
        k.append(barrier(acceleration(t + float(tab.c[i]) * h, xi, vi)))
    x1, v1 = stage_state(1.0, tab.bA, tab.b)
    a1 = k[-1] if tab.fsal else acceleration(t + h, x1, v1)
    x_error = tuple(jnp.asarray(h2 * _weighted_sum(tab.errorA, k, d)) for d in components)
    v_error = tuple(jnp.asarray(h * _weighted_sum(tab.error, k, d)) for d in components)
    return Step(x1, v1, a1, x_error, v_error)
