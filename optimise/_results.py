"""Results of a design."""

from __future__ import annotations

import equinox as eqx


class RESULTS(eqx.Enumeration):
    """Named results of a design."""

    converged = "The optimality conditions hold, and all targets are satisfied."
    stalled = (
        "The targets are satisfied, but the optimality conditions do not hold. The search found no further "
        "improvement, often because a response has a kink or a jump; raise starts to try other designs."
    )
    infeasible = (
        "No design within the bounds was found that satisfies the targets; the closest one is returned. "
        "Widen the bounds, relax the targets or raise starts."
    )
    out_of_iterations = (
        "The search did not converge within max_iterations; raise max_iterations or tolerance."
    )
    not_finite = (
        "A response is not finite, a simulation did not finish or the structure is invalid, for the starting "
        "design or in the verification; start from another design, or raise max_steps or history of options."
    )
    interrupted = "The search was stopped; the best design so far is returned. Start from it to continue."
    averaged = "The design is the mean of the last steps; the targets hold in an independent sample."
    unverified = (
        "A probability of failure has no independent sample at this design that has converged, so its target "
        "may be violated; raise the target's cov, or sample the design with the target's method probability."
    )


NAMES = (
    *("converged", "stalled", "infeasible", "out_of_iterations", "not_finite", "interrupted"),
    *("averaged", "unverified"),
)
CONVERGED, STALLED, INFEASIBLE, OUT_OF_ITERATIONS, NOT_FINITE, INTERRUPTED, AVERAGED, UNVERIFIED = range(8)


def result_of_code(code: int) -> RESULTS:
    """Return the result for a code, which is an index of `NAMES`."""
    return getattr(RESULTS, NAMES[code])


def result_name(result: RESULTS) -> str:
    """Return the name of a result."""
    return NAMES[int(result._value)]
