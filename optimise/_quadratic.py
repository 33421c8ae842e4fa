"""Quadratic program for a step d from a design point.

The program has linear models of objective values and margins, and a matrix B of the curvature:

    minimise    w·max_i(f_i + ∇f_i·d) + ν v + ½ dᵀB d        over d, v
    subject to  c_j + ∇c_j·d ≥ −v,   v ≥ 0,   lower ≤ d ≤ upper

f_i are the objective values; the largest is minimised. c_j are the margins, which should be ≥ 0. v is the
largest violation of a margin, and ν is the penalty per unit of v. Any violation is allowed at this penalty,
so a solution always exists. w is the weight of the objective. In the solver, the maximum over i is a further
variable with the lower bounds f_i + ∇f_i·d (epigraph form).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import clarabel
import numpy as np
from scipy import sparse

Vector = np.ndarray
_clarabel: Any = clarabel  # a compiled module without stubs


class Model(NamedTuple):
    """Linear models of objective values and margins. Several models may belong to the same value or margin.

    - `f`: modelled values (k,) at d = 0; `f_slope`: their Jacobian (k, n)
    - `c`: modelled margins (m,) at d = 0; `c_slope`: their Jacobian (m, n)
    - `margin_index` (m,): index of the margin that each entry of `c` models
    """

    f: Vector
    f_slope: Vector
    c: Vector
    c_slope: Vector
    margin_index: Vector

    def value(self, d: Vector) -> float:
        """Return the largest modelled value after a step d (n,)."""
        return float(np.max(self.f + self.f_slope @ d))

    def violation(self, d: Vector) -> float:
        """Return the largest modelled violation after a step d (n,), 0 if no margin is violated."""
        return float(max(0.0, np.max(-(self.c + self.c_slope @ d), initial=0.0)))


class Step(NamedTuple):
    """Solution of the quadratic program.

    - `d`: the step (n,); `violation`: largest violation v of a modelled margin after the step [–]
    - `value_multipliers` (k,): multipliers of the modelled values, which sum to the weight w
    - `margin_multipliers` (m,): multipliers of the modelled margins
    """

    d: Vector
    violation: float
    value_multipliers: Vector
    margin_multipliers: Vector


BOUND_DISTANCE = 1e-10  # if an entry of a step is closer than this to its bound, it is moved onto the bound
_SUCCESSES = ("Solved", "AlmostSolved")


def solve(
    model: Model, curvature: np.ndarray, weight: float, penalty: float, lower: Vector, upper: Vector
) -> Step | None:
    """Solve the quadratic program for the step d (n,) between `lower` and `upper`; return None if the solver
    fails. `curvature` is B (n, n), `weight` that of the objective, w, and `penalty` that of the largest
    violation, ν."""
    # The unknowns of the solver are d, the largest value after the step minus `largest_value`, and v.
    n, k, m = len(lower), len(model.f), len(model.c)
    largest_value = np.max(model.f)
    quadratic = sparse.block_diag([np.triu(curvature), sparse.csc_matrix((2, 2))], format="csc")
    linear = np.concatenate([np.zeros(n), [weight, penalty]])
    identity, zeros = np.eye(n), np.zeros
    constraints = np.block(
        [
            [model.f_slope, -np.ones((k, 1)), zeros((k, 1))],
            [-model.c_slope, zeros((m, 1)), -np.ones((m, 1))],
            [zeros((1, n)), zeros((1, 1)), -np.ones((1, 1))],
            [identity, zeros((n, 2))],
            [-identity, zeros((n, 2))],
        ]
    )
    right_side = np.concatenate([largest_value - model.f, model.c, [0.0], upper, -lower])
    settings = _clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-12
    solver = _clarabel.DefaultSolver(
        quadratic,
        linear,
        sparse.csc_matrix(constraints),
        right_side,
        [_clarabel.NonnegativeConeT(len(right_side))],
        settings,
    )
    solution = solver.solve()
    # A solution that satisfies the constraints is used even if the solver could not prove its optimality.
    if str(solution.status) not in _SUCCESSES and not (
        str(solution.status) == "InsufficientProgress" and solution.r_prim < 1e-7
    ):
        return None
    d = np.asarray(solution.x[:n])
    # The solver's interior-point method stays slightly inside the bounds.
    d = np.where(d - lower < BOUND_DISTANCE, lower, np.where(upper - d < BOUND_DISTANCE, upper, d))
    multipliers = np.maximum(np.asarray(solution.z), 0.0)
    return Step(d, model.violation(d), multipliers[:k], multipliers[k : k + m])
