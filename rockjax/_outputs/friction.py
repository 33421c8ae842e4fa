"""The friction that the joints demand: the largest |T|/N over a scene."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from rockjax._engine.bounds import Bounds, every
from rockjax._outputs.maxima import WELL_INSIDE_CUBIC, Maximum
from rockjax._types import Flag, Values

from .joints import AbstractOfJoints, JointBounds, end_forces, friction_of, halves, quarter_tangent
from .views import Bounces, Ended, Start, Step


@dataclasses.dataclass(frozen=True)
class PeakFriction(AbstractOfJoints):
    """The largest friction demand max|T|/N of the bottom and the top joint of the worst column, (F9), (F11).

    Its record is the angle of the force with the axis, as tan(φ/4), which passes N = 0 smoothly.
    """

    name = "peak_friction"
    unit = "1"
    description = "largest friction demand max|T|/N of the joints"
    symbol = "max |T|/N"

    def start(self, start: Start) -> tuple[Values, None]:
        return self.zeros(start), None

    def over_step(self, step: Step, record: Values) -> Maximum:
        angles = step.through(step.course(end_forces), lambda forces: quarter_tangent(*halves(forces)))
        found = step.largest(angles, record, WELL_INSIDE_CUBIC)
        return found._replace(value=jnp.minimum(found.value, 1.0))

    def over_bounces(self, bounces: Bounces, record: Values) -> Flag:
        return self._stands(JointBounds.over(bounces), record)

    def is_final(self, bounds: Bounds, record: Values) -> Flag:
        return self._stands(JointBounds.of(bounds), record)

    def _stands(self, bounds: JointBounds, record: Values) -> Flag:
        return every(bounds.friction <= friction_of(jax.lax.stop_gradient(self.worst(record))))

    def answer(self, ended: Ended, record: Values, note: Any) -> dict[str, Any]:
        return {self.name: self.answered(ended, friction_of(self.worst(record)))}
