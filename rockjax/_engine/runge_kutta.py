"""One explicit Runge–Kutta step for second-order systems, from the tableau of any explicit method.

For x' = v, v' = a(t, x, v) the stage velocities need not be stored. With the stage accelerations k_j, x_i = x
+ c_i h v + h² Σ (AA)_ij k_j and v_i = v + h Σ A_ij k_j. This is algebraically the same method, with half the
sums if the acceleration does not depend on the velocity.
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

    x: Vector
    v: Vector
    a: Vector  # accelerations at the end
    x_error: Vector
    v_error: Vector


def _combine(weights: np.ndarray, k: list[Vector], component: int) -> Values | float:
    total = 0.0
    for w, stage in zip(weights, k, strict=False):
        # Products of a tableau with itself leave rounding where the exact weight is zero.
        if abs(w) > 1e-14:
            total = total + float(w) * stage[component]
    return total


def step(
    tab: Tableau, acceleration: Acceleration, t: Value | float, h: Value, x: Vector, v: Vector, a: Vector
) -> Step:
    """Advance a second-order system by one step.

    - `tab`: tableau of the method
    - `acceleration`: (t, x, v) ↦ accelerations
    - `t`, `h`: time at the start and length of the step [s]
    - `x`, `v`, `a`: positions, velocities and known accelerations at the start
    """
    parts = range(len(x))
    h2 = h * h

    def at(c, weights_x, weights_v):
        xi = tuple(x[d] + (float(c) * h) * v[d] + h2 * _combine(weights_x, k, d) for d in parts)
        vi = tuple(v[d] + h * _combine(weights_v, k, d) for d in parts)
        # All accelerations need the whole state.
        return barrier((xi, vi)) if len(x) > 1 else (xi, vi)

    k = [a]
    for i in range(1, len(tab.c)):
        xi, vi = at(tab.c[i], tab.AA[i], tab.A[i])
        # Without the barrier each stage would be computed again inside every later one.
        k.append(barrier(acceleration(t + float(tab.c[i]) * h, xi, vi)))
    x1, v1 = at(1.0, tab.bA, tab.b)
    a1 = k[-1] if tab.fsal else acceleration(t + h, x1, v1)
    x_error = tuple(jnp.asarray(h2 * _combine(tab.errorA, k, d)) for d in parts)
    v_error = tuple(jnp.asarray(h * _combine(tab.error, k, d)) for d in parts)
    return Step(x1, v1, a1, x_error, v_error)
