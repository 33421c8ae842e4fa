"""Gradient-based design of rocking podiums: size the columns so that targets hold and an objective is
least."""

from rockjax import __version__ as __version__

from ._annual import AnnualFrequency
from ._answer import Design, table
from ._chart import design_chart, plot_chart
from ._design import design
from ._explore import Explorer, explore
from ._failure import FailureProbability
from ._fit import Fit, fit
from ._fresh import FreshSamples
from ._objectives import (
    AbstractObjective,
    ExpectedLoss,
    WorstDeformation,
    WorstDrift,
    WorstFloorAcceleration,
    WorstRotation,
    WorstShear,
)
from ._pictures import before_after, convergence
from ._problem import Problem, load
from ._results import RESULTS
from ._targets import (
    AbstractTarget,
    MedianCapacity,
    NoOverturning,
    OverturningAcceleration,
    OverturningProbability,
    OverturningScale,
    PeakDeformation,
    PeakDrift,
    PeakFloorAcceleration,
    PeakRotation,
    PeakShear,
)
from ._variables import Dimensions

__all__ = [
    "RESULTS",
    "AbstractObjective",
    "AbstractTarget",
    "AnnualFrequency",
    "Design",
    "Dimensions",
    "ExpectedLoss",
    "Explorer",
    "FailureProbability",
    "Fit",
    "FreshSamples",
    "MedianCapacity",
    "NoOverturning",
    "OverturningAcceleration",
    "OverturningProbability",
    "OverturningScale",
    "PeakDeformation",
    "PeakDrift",
    "PeakFloorAcceleration",
    "PeakRotation",
    "PeakShear",
    "Problem",
    "WorstDeformation",
    "WorstDrift",
    "WorstFloorAcceleration",
    "WorstRotation",
    "WorstShear",
    "before_after",
    "convergence",
    "design",
    "design_chart",
    "explore",
    "fit",
    "load",
    "plot_chart",
    "table",
]
