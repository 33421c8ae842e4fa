"""Estimators of a probability of failure, one module each; `ESTIMATORS` contains them by name."""

from ._base import AbstractEstimator, ProbabilityEstimate, ProbabilitySlopes
from ._importance import Importance
from ._line import Line
from ._monte_carlo import MonteCarlo
from ._subset import Subset

ESTIMATORS: dict[str, type[AbstractEstimator]] = {
    "importance": Importance,
    "line": Line,
    "subset": Subset,
    "monte-carlo": MonteCarlo,
}

__all__ = ["ESTIMATORS", "AbstractEstimator", "ProbabilityEstimate", "ProbabilitySlopes"]
