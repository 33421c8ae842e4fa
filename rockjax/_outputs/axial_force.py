"""The least and the largest axial force in the joints over a scene."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from rockjax._engine.coefficients import present
from rockjax._outputs.maxima import Maximum
from rockjax._types import Flag

from .base import Variable
from .joint_bounds import JointBounds, Pair
from .joints import JOINTS, AbstractJointOutput, all_of, end_forces, halves
from .views import Ended, Start, Step

Pairs = tuple[Pair, ...]


@dataclasses.dataclass(frozen=True)
class AxialForce(AbstractJointOutput):
    """The least and the largest axial force N/(m_c g) at the bottom and the top joint of the worst column,
    (F8). If the least force is negative, a joint would open, and the model no longer holds.

    The accumulator contains the largest −N/(m_c g) and the largest N/(m_c g).
    """

    name = "axial_force"

    @property
    def variables(self) -> tuple[Variable, ...]:
        return (
            Variable("least_axial_force", "1", "least axial force min N/(m_c g)", "min N/(m_c g)", JOINTS),
            Variable("peak_axial_force", "1", "largest axial force max N/(m_c g)", "max N/(m_c g)", JOINTS),
        )

    def start(self, start: Start) -> tuple[Pairs, None]:
        return tuple((y, y) for y in self.filled(start, -jnp.inf)), None

    def over_step(self, step: Step, accumulator: Pairs) -> Maximum:
        _, axial = halves(step.courses(end_forces))
        axial = [jax.tree.map(lambda y: y / step.c.g, course) for course in axial]
        return step.largest_forces(axial, accumulator, sizes="both")

    def is_unchanged(self, bounds: JointBounds, accumulator: Pairs) -> Flag:
        g, (tension, compression) = bounds.c.g, jax.lax.stop_gradient(self._worst_of_both(accumulator))
        least, most = bounds.least_axial, bounds.most_axial
        return all_of(
            (least[k] >= -tension[k] * g) & (most[k] <= compression[k] * g) for k in range(self.joints)
        )

    def _worst_of_both(self, accumulator: Pairs) -> tuple[Pair, Pair]:
        """Return the largest −N/(m_c g) and the largest N/(m_c g) at each joint."""
        tension, compression = map(self.worst, zip(*accumulator, strict=True))
        return tension, compression

    def answer(self, ended: Ended, accumulator: Pairs, note: Any) -> dict[str, Any]:
        tension, compression = (self.nan_if_weightless(ended, y) for y in self._worst_of_both(accumulator))
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

    def answer(self, ended: Ended, accumulator: Pairs, note: Any) -> dict[str, Any]:
        least = super().answer(ended, accumulator, note)["least_axial_force"]
        load = present(ended.scene.c.joints).dead_load
        return {self.name: jnp.where(load > 0, 1 - least / jnp.where(load > 0, load, 1.0), 0.0)}
