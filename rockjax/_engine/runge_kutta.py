"""One explicit Runge–Kutta step for second-order systems, from the tableau of any explicit Diffrax solver.

For x' = v, v' = a(t, x, v) the stage velocities need not be stored: with k_j the stage accelerations, x_i = x
+ c_i h v + h² Σ (AA)_ij k_j and v_i = v + h Σ A_ij k_j. Algebraically the same method, with half the sums
where the acceleration does not depend on the velocity.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import jax.numpy as jnp
import numpy as np

from rockjax._once import once
from rockjax._types import Value, Values, Vector

if TYPE_CHECKING:
    import diffrax

Acceleration = Callable[[Value, Vector, Vector], Vector]  # (t, x, v) ↦ v'


@dataclasses.dataclass(frozen=True, eq=False)
class Tableau:
    """A Butcher tableau, squared for positions; NumPy constants of the compiled step. There is one of each
    solver."""

    order: int
    c: np.ndarray
    A: np.ndarray
    AA: np.ndarray
    b: np.ndarray
    bA: np.ndarray
    error: np.ndarray  # weights of the embedded error estimate, over the stages
    errorA: np.ndarray
    fsal: bool  # the last stage is the acceleration at the end of the step


@functools.cache
def tableau(solver: diffrax.AbstractERK) -> Tableau:
    """The tableau of a Diffrax solver."""
    import diffrax

    source = solver.tableau
    assert isinstance(source, diffrax.ButcherTableau)
    stages = source.num_stages
    A = np.zeros((stages, stages))
    for i, row in enumerate(source.a_lower, start=1):
        A[i, :i] = row
    b = np.asarray(source.b_sol, float)
    error = np.asarray(source.b_error, float)
    c = np.concatenate([[0.0], np.asarray(source.c, float)])
    order = solver.order(None)
    assert order is not None
    return Tableau(int(order), c, A, A @ A, b, b @ A, error, error @ A, source.fsal)


@functools.cache
def nystrom() -> Tableau:
    """RKN8(6)9FM of Dormand, El-Mikkawy and Prince (IMA J. Numer. Anal. 7, 1987, 423–430): of order 8 with
    eight new accelerations a step, where these do not depend on the velocity.

    Weights for positions are its own, not products of those for velocities; stage velocities there are none.
    """
    rows = [
        (1 / 800,),
        (1 / 600, 1 / 300),
        (9 / 200, -9 / 100, 9 / 100),
        (-66701 / 197352, 28325 / 32892, -2665 / 5482, 2170 / 24669),
        (227015747 / 304251000, -54897451 / 30425100, 12942349 / 10141700, -9499 / 304251, 539 / 9250),
        (
            *(-1131891597 / 901789000, 41964921 / 12882700, -6663147 / 3220675),
            *(270954 / 644135, -108 / 5875, 114 / 1645),
        ),
        (
            *(13836959 / 3667458, -17731450 / 1833729, 1063919505 / 156478208),
            *(-33213845 / 39119552, 13335 / 28544, -705 / 14272, 1645 / 57088),
        ),
        (223 / 7938, 0, 1175 / 8064, 925 / 6048, 41 / 448, 925 / 14112, 1175 / 72576),
    ]
    c = np.array([0, 1 / 20, 1 / 10, 3 / 10, 1 / 2, 7 / 10, 9 / 10, 1, 1])
    stages = np.zeros((9, 9))
    for k, row in enumerate(rows, start=1):
        stages[k, : len(row)] = row
    positions = stages[-1]
    middle = 5875 / 36288, 4625 / 21168, 41 / 224, 4625 / 21168, 5875 / 36288
    velocities = np.array([223 / 7938, 0, *middle, 223 / 7938, 0])
    # Of order 6, by which the error is estimated.
    middle = 1610737 / 44674560, 10023263 / 33505920, -497221 / 12409600, 10023263 / 78180480
    sixth = np.array([7987313 / 109941300, 0, *middle, 1610737 / 402071040, 0, 0])
    middle = 1610737 / 40207104, 10023263 / 23454144, -497221 / 6204800, 10023263 / 23454144
    last = 1610737 / 40207104, -4251941 / 54970650, 3 / 20
    velocities_sixth = np.array([7987313 / 109941300, 0, *middle, *last])
    errors = velocities - velocities_sixth, positions - sixth
    return Tableau(8, c, np.zeros((9, 9)), stages, velocities, positions, *errors, fsal=True)


class Step(NamedTuple):
    """What one trial step found."""

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
    """One step of length h from (t, x, v), where the acceleration is already known to be `a`."""
    parts = range(len(x))
    h2 = h * h

    def at(c, weights_x, weights_v):
        xi = tuple(x[d] + (float(c) * h) * v[d] + h2 * _combine(weights_x, k, d) for d in parts)
        vi = tuple(v[d] + h * _combine(weights_v, k, d) for d in parts)
        # Each of several accelerations needs all of it.
        return once((xi, vi)) if len(x) > 1 else (xi, vi)

    k = [a]
    for i in range(1, len(tab.c)):
        xi, vi = at(tab.c[i], tab.AA[i], tab.A[i])
        # Or each stage would be worked out again inside every later one.
        k.append(once(acceleration(t + float(tab.c[i]) * h, xi, vi)))
    x1, v1 = at(1.0, tab.bA, tab.b)
    a1 = k[-1] if tab.fsal else acceleration(t + h, x1, v1)
    x_error = tuple(jnp.asarray(h2 * _combine(tab.errorA, k, d)) for d in parts)
    v_error = tuple(jnp.asarray(h * _combine(tab.error, k, d)) for d in parts)
    return Step(x1, v1, a1, x_error, v_error)
