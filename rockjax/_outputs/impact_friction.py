"""Friction demand and lift-off of the joints at impacts."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from rockjax._engine.bounds import Bounds
from rockjax._outputs.joint_forces import impulses_of_columns
from rockjax._types import Flag, Values

from .base import AbstractEventOutput, Variable
from .joints import JOINTS, AbstractOfJoints, end_offsets, friction_of, halves, quarter_tangent
from .views import Bounces, Ended, Impact, Start, Step


@dataclasses.dataclass(frozen=True)
class ImpactFriction(AbstractOfJoints, AbstractEventOutput):
    """The largest friction demand max|J_T|/J_N of the impulses at the joints of the worst column, and the
    least share of J_N over its mean of all columns, (F12), (F14).

    Its record holds the angles of the impulses, then −share. With everything rigid all impacts have the same.
    """

    name = "impact_friction"
    estimated = False

    @property
    def variables(self) -> tuple[Variable, ...]:
        return (
            Variable(
                "peak_impact_friction",
                "1",
                "largest friction demand max|J_T|/J_N of the joints at impacts",
                "max |J_T|/J_N",
                JOINTS,
            ),
            Variable(
                "least_impulse_share",
                "1",
                "least axial impulse of a column over the mean of all columns",
                "min J_N/mean",
                JOINTS,
            ),
        )

    def start(self, start: Start) -> tuple[Values, None]:
        return jnp.concatenate([self.zeros(start), self.zeros(start) - 1.0]), None

    def over_step(self, step: Step, record: Values) -> None:
        del step, record

    def at_impact(self, impact: Impact) -> Values:
        c, speed = impact.c, impact.v[0]
        # The ratios do not depend on the speed.
        unit = jnp.where(speed == 0, 1.0, speed)
        before = c, impact.sigma, impact.x, unit / jnp.abs(jax.lax.stop_gradient(unit))
        across, axial = impulses_of_columns(*before, end_offsets(c))
        _, mean = impulses_of_columns(*before, None)  # of all columns, not of the two ends
        share = jnp.where(mean > 0, axial / jnp.where(mean > 0, mean, 1.0), 1.0)
        return jnp.concatenate([jnp.abs(quarter_tangent(across, axial)).ravel(), -share.ravel()])

    def over_bounces(self, bounces: Bounces, record: Values) -> bool:
        del bounces, record  # of rigid podiums: the bounces have the ratios of the impact before them
        return True

    def is_final(self, bounds: Bounds, record: Values) -> Flag:
        if bounds.c.vibration is not None:
            return jnp.asarray(bounds.rests)
        return bounds.rests | jnp.any(halves(record)[0] > 0)

    def answer(self, ended: Ended, record: Values, note: Any) -> dict[str, Any]:
        angles, lifted = (self.answered(ended, self.worst(y)) for y in halves(record))
        return {"peak_impact_friction": friction_of(angles), "least_impulse_share": -lifted}
