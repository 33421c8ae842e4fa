"""Warnings about numbers that are possible but probably a mistake."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from rockjax._structures.column import DENSITIES

from .tables import Bare, Quantity, Text

if TYPE_CHECKING:
    from .evaluation import Evaluation

STRESSES = 0.01e6, 50e6  # usual range of the mean compressive stress of columns [Pa]
PERIODS = 0.05, 10.0  # usual range of the first period of a building [s]
LARGEST_DRIFT = 0.1  # largest usual limit of (drift / storey height) [–]
LARGEST_DAMPING = 0.3  # largest usual damping ratio of a building [–]
LEAST_U = 0.01  # least usual utilisation [–]
FEW_MOTIONS = 7  # usual minimum number of motions for a mean


def _range(ends: tuple[float, float], kind: str, ending: str) -> Text:
    """Return the text "a to b", followed by `ending`. `kind`: kind of quantity of the numbers a and b."""
    first, last = (Quantity(y, kind, is_input=True) for y in ends)
    return Bare(first), " to ", last, ending


def warnings_of(evaluation: Evaluation) -> Iterator[Text]:
    """Yield a warning for each number that is probably a mistake."""
    problem = evaluation.problem
    podium, mass, depth = problem.podium, problem.column_mass, problem.joints.contact_depth
    width, height = problem.column_size
    if mass is not None:
        depth = width if depth is None else depth  # square columns by default
        density = mass / (width * height * depth)
        if not DENSITIES[0] <= density <= DENSITIES[1]:
            yield (
                *("The columns have ", Quantity(density, "density"), "; "),
                *_range(DENSITIES, "density", " are usual. Is structure.column_mass in kilograms?"),
            )
        stress = float(np.asarray(podium.dead_load)[0]) * mass * float(podium.g) / (width * depth)
        if not STRESSES[0] <= stress <= STRESSES[1]:
            yield (
                *("The mean stress of the columns is ", Quantity(stress, "stress"), "; "),
                *_range(STRESSES, "stress", " are usual."),
            )
    oscillators = None if podium.superstructure is None else podium.superstructure.oscillators
    if oscillators is not None:
        period = float(np.max(np.asarray(oscillators.T_s)))
        if not PERIODS[0] <= period <= PERIODS[1]:
            yield (
                *("The first period of the building is ", Quantity(period, "time"), "; "),
                *_range(PERIODS, "time", " are usual."),
            )
        damping = float(np.max(np.asarray(oscillators.zeta)))
        if damping > LARGEST_DAMPING:
            usual = Quantity(LARGEST_DAMPING, "number", is_input=True)
            yield (
                *("The largest damping ratio of the building is ", Quantity(damping, "number"), "; at most "),
                *(usual, " is usual. Is it in percent?"),
            )
    heights = problem.story_heights
    for check in evaluation.checks:
        if (
            check.kind.name == "peak-drift"
            and heights is not None
            and check.limit > LARGEST_DRIFT * heights.min()
        ):
            yield f"The limit of {check.id} exceeds a tenth of a storey height; limits are in m by default."
        if check.kind.name == "peak-drift-ratio" and check.limit > LARGEST_DRIFT:
            yield f"The limit of {check.id} exceeds a tenth of the height; is its unit missing?"
        if math.isfinite(check.utilisation) and 0 < check.utilisation < LEAST_U:
            least = Quantity(LEAST_U, "number", is_input=True)
            yield f"The utilisation of {check.id} is below ", least, "; is the unit of its limit right?"
        if check.statistic == "mean" and check.motions:
            number = len(problem.motions[check.motions])
            noun = "motion" if number == 1 else "motions"
            count, usual = (Quantity(y, "count") for y in (number, FEW_MOTIONS))
            if number < FEW_MOTIONS:
                yield f"{check.id} is a mean over ", count, f" {noun}; at least ", usual, " are usual."
