"""Results of a design."""

from __future__ import annotations

import equinox as eqx


class RESULTS(eqx.Enumeration):
    """Named results of a design."""

    converged = "The optimality conditions hold, and all targets are satisfied."
    stalled = (
        "The targets are satisfied; the design stopped at a kink or a jump of a response, where no step "
        "improves it."
    )
    infeasible = (
        "No design within the bounds was found that satisfies the targets; the closest one is returned. "
        "Widen the bounds, relax the targets or raise starts."
    )
    out_of_iterations = "The design needed more than max_iterations; raise it, or loosen the tolerance."
    not_finite = (
        "A response of the starting design is not finite, or its scene did not finish; start from another "
        "design."
    )
    interrupted = "The design was stopped; the best design so far is returned. Start from it to continue."
    averaged = "The mean design of a search by fresh samples; an independent sample satisfies the targets."
    unverified = (
        "The independent sample of a probability of failure has not converged, so its target may be "
        "violated; raise the target's cov."
    )


NAMES = (
    "converged",
    "stalled",
    "infeasible",
    "out_of_iterations",
    "not_finite",
    "interrupted",
    "averaged",
    "unverified",
)
CONVERGED, STALLED, INFEASIBLE, OUT_OF_ITERATIONS, NOT_FINITE, INTERRUPTED, AVERAGED, UNVERIFIED = range(8)


def result_of_code(code: int) -> RESULTS:
    """Return the result with a code."""
    return getattr(RESULTS, NAMES[code])


def result_name(result: RESULTS) -> str:
    """Return the name of a result."""
    return NAMES[int(result._value)]
