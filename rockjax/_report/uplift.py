"""The output `uplift_ratio`. Its inverse is the least factor on a motion that lifts the columns.

Before uplift the structure is linear, so one solution without uplift determines this factor.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import jax.numpy as jnp

from rockjax._engine.coefficients import not_none
from rockjax._engine.model import horizontal_demand
from rockjax._excitations.base import Shaking
from rockjax._outputs.base import AbstractOutput
from rockjax._outputs.maxima import END_ZONE_ACCELERATIONS, Maximum
from rockjax._outputs.views import Ended, Moment, Start, Step
from rockjax._types import Values


@dataclasses.dataclass(frozen=True)
class UpliftRatio(AbstractOutput):
    """Largest uplift demand over time, divided by its threshold [–].

    The ratio is the maximum of ±q/q_up − r over both signs and over time. Here q is the uplift demand of Eq.
    (9) in docs/model.md and q_up its threshold. Vertical motion changes the threshold by the fraction r, so
    columns lift at |q| = q_up (1 + r). As long as the columns do not lift, q and r are proportional to the
    motion. The least factor on the motion that lifts the columns is therefore 1/ratio.
    """

    name = "uplift_ratio"
    description = "largest uplift demand divided by its threshold"
    symbol = "|q|/q_up"

    def quantity(self, moment: Moment) -> Values:
        c, ground = moment.c, moment.ground
        demand = horizontal_demand(c, ground, moment.x, moment.v) / c.uplift
        threshold_change = (
            not_none(c.uplift_slope) * ground.vertical / c.uplift if isinstance(ground, Shaking) else 0.0
        )
        return jnp.stack([demand - threshold_change, -demand - threshold_change])

    def start(self, start: Start) -> tuple[Values, None]:
        return jnp.zeros(2, start.t.dtype), None

    def over_step(self, step: Step, accumulator: Values) -> Maximum:
        # `course` interpolates the quantity over the step by a cubic.
        return step.largest(step.course(self.quantity), accumulator, END_ZONE_ACCELERATIONS, sizes="signed")

    def answer(self, ended: Ended, accumulator: Any, note: Any) -> dict[str, Any]:
        del ended, note
        return {self.name: jnp.max(accumulator)}
