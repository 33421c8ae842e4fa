"""First order beside what is counted: `python -m benchmarks.risk_first_order`.

Motions are linear in √S₀, so the design points of one density are those of all, nearer or farther.
"""

from __future__ import annotations

import math

from scipy.stats import norm

from rockjax._risk.reliability import find_design_points, first_order, starting
from rockjax.internal import limit_state

from .measure import keep, show
from .risk import CASES, motion_of

STARTS, SEED = 8, 0


def rows_of(kind: str) -> list[dict]:
    """The cases of one structure, from the design points of its P ≈ 1e-4."""
    name = f"{kind} 1e-4"
    case = CASES[name]
    limit = limit_state("benchmark", case.podium, motion_of(case), "overturning")
    found = find_design_points("benchmark", limit, starting(limit, STARTS, SEED))
    rows = []
    for other, of in CASES.items():
        if not other.startswith(kind):
            continue
        factor = math.sqrt(case.S_0 / of.S_0)
        there = found._replace(u=found.u * factor, beta=found.beta * factor)
        nearest = float(there.beta.min())
        rows.append(
            {
                "case": other,
                "S_0": of.S_0,
                "beta": nearest,
                "one": 2 * float(norm.sf(nearest)),
                "all": first_order(there),
                "points": len(there.beta),
                "scenes": limit.scenes,
            }
        )
    return rows


def main() -> None:
    rows = [row for kind in ("block", "elastic") for row in rows_of(kind)]
    keep("risk-first-order", rows)
    forms = {"S_0": ".4f", "beta": ".3f", "one": ".2e", "all": ".2e", "points": "d", "scenes": "d"}
    show(rows, {"case": "", **forms})


if __name__ == "__main__":
    main()
