"""The least and the largest axial force in the joints over a scene."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from rockjax._engine.bounds import all_true
from rockjax._engine.coefficients import present
from rockjax._outputs.maxima import END_ZONE_CUBIC, Maximum
from rockjax._types import Flag, Values

from .base import Variable
from .joints import JOINTS, AbstractJointOutput, JointBounds, end_forces, halves
from .views import Ended, Start, Step


@dataclasses.dataclass(frozen=True)
class AxialForce(AbstractJointOutput):
    """The least and the largest axial force N/(m_c g) at the bottom and the top joint of the worst column,
    (F8). If the least force is negative, a joint would open, and the model no longer holds.

    The record contains the largest −N/(m_c g), then the largest N/(m_c g).
    """

    name = "axial_force"

    @property
    def variables(self) -> tuple[Variable, ...]:
        return (
            Variable("least_axial_force", "1", "least axial force min N/(m_c g)", "min N/(m_c g)", JOINTS),
            Variable("peak_axial_force", "1", "largest axial force max N/(m_c g)", "max N/(m_c g)", JOINTS),
        )

    def start(self, start: Start) -> tuple[Values, None]:
        return self.zeros(start, 2) - jnp.inf, None

    def over_step(self, step: Step, record: Values) -> Maximum:
        axial = jax.tree.map(lambda forces: halves(forces)[1] / step.c.g, step.course(end_forces))
        return step.largest(axial, record, END_ZONE_CUBIC, sizes="both")

    def is_unchanged(self, bounds: JointBounds, record: Values) -> Flag:
        tension, compression = map(self.worst, halves(jax.lax.stop_gradient(record)))
        g = bounds.c.g
        return all_true((bounds.least_axial >= -tension * g) & (bounds.most_axial <= compression * g))

    def answer(self, ended: Ended, record: Values, note: Any) -> dict[str, Any]:
        tension, compression = (self.nan_if_weightless(ended, self.worst(y)) for y in halves(record))
        return {"least_axial_force": 0.0 - tension, "peak_axial_force": compression}


@dataclasses.dataclass(frozen=True)
class Unloading(AxialForce):
    """The largest loss of axial force 1 − N/N_0 at the bottom and the top joint of the worst column [–], for
    targets and limit states. N_0 is the dead load of the mean column. If the loss exceeds 1, a joint would
    open. The answer is 0 at a joint without dead load.
    """

    name = "unloading"

    @property
    def variables(self) -> tuple[Variable, ...]:
        return (Variable(self.name, "1", "largest loss of axial force 1 − N/N_0", "max 1 − N/N_0", JOINTS),)

    def answer(self, ended: Ended, record: Values, note: Any) -> dict[str, Any]:
        least = super().answer(ended, record, note)["least_axial_force"]
        load = present(ended.scene.c.joints).dead_load
        return {self.name: jnp.where(load > 0, 1 - least / jnp.where(load > 0, load, 1.0), 0.0)}
