"""The subproblem of a step: linear models of values and margins, a quadratic of the Lagrangian's curvature.

    minimise    w·max_i(f_i + ∇f_i·d) + ν v + ½ dᵀB d        over d, v
    subject to  c_j + ∇c_j·d ≥ −v,   v ≥ 0,   lower ≤ d ≤ upper

The maximum is exact: a further variable above all its entries (epigraph form). v, the largest violation,
makes the problem solvable everywhere.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import clarabel
import numpy as np
from scipy import sparse

Vector = np.ndarray
_clarabel: Any = clarabel  # a compiled module without stubs


class Model(NamedTuple):
    """Linear models: values f (k,) and margins c (m,) at d = 0, their Jacobians (k, n) and (m, n).

    An entry may have several rows: `value_of` and `margin_of` hold the entry of each row.
    """

    f: Vector
    f_slope: Vector
    c: Vector
    c_slope: Vector
    value_of: Vector
    margin_of: Vector

    def value(self, d: Vector) -> float:
        """Return the largest modelled value."""
        return float(np.max(self.f + self.f_slope @ d))

    def violation(self, d: Vector) -> float:
        """Return the largest modelled violation, 0 without any."""
        return float(max(0.0, np.max(-(self.c + self.c_slope @ d), initial=0.0)))


class Step(NamedTuple):
    """A solved subproblem: step d, modelled violation, multipliers of value rows (sum w) and margin rows."""

    d: Vector
    violation: float
    value_multipliers: Vector
    margin_multipliers: Vector


ON_BOUND = 1e-10
_SOLVED = ("Solved", "AlmostSolved")


def solve(
    model: Model, curvature: np.ndarray, weight: float, penalty: float, lower: Vector, upper: Vector
) -> Step | None:
    """Solve the subproblem; return None where the solver fails.

    - `model`: linear models of values and margins; `curvature`: B (n, n)
    - `weight`: w of the values; `penalty`: ν of the largest violation
    - `lower`, `upper`: bounds of the step d (n,)
    """
    n, k, m = len(lower), len(model.f), len(model.c)
    top = np.max(model.f)
    quadratic = sparse.block_diag([np.triu(curvature), sparse.csc_matrix((2, 2))], format="csc")
    linear = np.concatenate([np.zeros(n), [weight, penalty]])
    identity, zeros = np.eye(n), np.zeros
    rows = np.block(
        [
            [model.f_slope, -np.ones((k, 1)), zeros((k, 1))],
            [-model.c_slope, zeros((m, 1)), -np.ones((m, 1))],
            [zeros((1, n)), zeros((1, 1)), -np.ones((1, 1))],
            [identity, zeros((n, 2))],
            [-identity, zeros((n, 2))],
        ]
    )
    right = np.concatenate([top - model.f, model.c, [0.0], upper, -lower])
    settings = _clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-12
    solver = _clarabel.DefaultSolver(
        quadratic, linear, sparse.csc_matrix(rows), right, [_clarabel.NonnegativeConeT(len(right))], settings
    )
    answer = solver.solve()
    if str(answer.status) not in _SOLVED and not (
        str(answer.status) == "InsufficientProgress" and answer.r_prim < 1e-7
    ):
        return None
    d = np.asarray(answer.x[:n])
    # An interior-point solution is never exactly at a bound.
    d = np.where(d - lower < ON_BOUND, lower, np.where(upper - d < ON_BOUND, upper, d))
    multipliers = np.maximum(np.asarray(answer.z), 0.0)
    return Step(d, model.violation(d), multipliers[:k], multipliers[k : k + m])
