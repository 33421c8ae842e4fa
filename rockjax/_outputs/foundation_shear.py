"""The largest horizontal force on the foundation over a scene."""

from __future__ import annotations

import dataclasses
from typing import Any

from rockjax._outputs.joint_forces import mean_forces, total_weight
from rockjax._outputs.maxima import Maximum
from rockjax._types import Flag, Value

from .joint_bounds import JointBounds
from .joints import AbstractForceOutput
from .views import Ended, Moment, Step


@dataclasses.dataclass(frozen=True)
class PeakFoundationShear(AbstractForceOutput):
    """The peak shear on the foundation divided by the total weight, max|V|/W_0, (F5)."""

    name = "peak_foundation_shear"
    unit = "1"
    description = "peak shear on the foundation divided by the total weight max|V|/W_0"
    symbol = "max |V|/W_0"

    def quantity(self, moment: Moment) -> Value:
        c, sigma, _, ground, x, v, a = moment
        return mean_forces(c, sigma, ground, x, v, a).foundation[0] / total_weight(c)

    def over_step(self, step: Step, accumulator: Value) -> Maximum:
        maximum = step.largest_forces(step.courses(self.quantity), (accumulator,))
        return maximum._replace(value=maximum.value[0])

    def is_unchanged(self, bounds: JointBounds, accumulator: Value) -> Flag:
        return bounds.foundation_shear <= accumulator * total_weight(bounds.c)

    def answer(self, ended: Ended, accumulator: Value, note: Any) -> dict[str, Any]:
        return {self.name: self.nan_if_weightless(ended, accumulator)}
