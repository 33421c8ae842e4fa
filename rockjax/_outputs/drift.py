"""The largest drift of each story of a building."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from rockjax._engine.bounds import Bounds, every
from rockjax._engine.coefficients import Coefficients, present
from rockjax._engine.maxima import WELL_INSIDE_QUINTIC, Maximum
from rockjax._engine.model import beam, drift_weights
from rockjax._structures import Podium, ShearBuilding
from rockjax._types import Flag, Values

from .base import STORIES, AbstractOutput
from .views import Ended, Moment, Start, Step


def stories_of(podium: Podium) -> int:
    """Return the number of stories of a building, 0 for other superstructures."""
    top = podium.superstructure
    return top.stories if isinstance(top, ShearBuilding) else 0


@dataclasses.dataclass(frozen=True)
class PeakDrift(AbstractOutput):
    """The peak drift of each story of a building [m]."""

    name = "peak_drift"
    unit = "m"
    description = "peak drift of the stories"
    symbol = "drift"
    by_default = True
    axis = STORIES

    stories: int = 0
    elastic: bool = True

    def applies(self, podium: Podium) -> bool:
        return podium.vibrates and stories_of(podium) > 0

    def of(self, podium: Podium) -> PeakDrift:
        return PeakDrift(stories_of(podium), podium.vibrates)

    def quantity(self, moment: Moment) -> Values:
        deformation = moment.x[1] - beam(moment.c, moment.sigma, moment.x[0], moment.v[0])[0]
        return jnp.sum(_weights(moment.c) * deformation[None, :], axis=-1)

    def start(self, start: Start) -> tuple[Values, None]:
        return jnp.zeros(self.stories, start.t.dtype), None

    def over_step(self, step: Step, record: Values) -> Maximum:
        moved = step.deformations
        drifts = jax.vmap(moved.summed)(_weights(step.c))
        return step.largest(drifts, record, WELL_INSIDE_QUINTIC, lands=step.refines)

    def is_final(self, bounds: Bounds, record: Values) -> Flag:
        stiffness = jnp.sqrt(present(bounds.c.vibration).omega2)
        bound = jax.vmap(lambda weights: bounds.of_sum(weights / stiffness))(_weights(bounds.c))
        return every(bound < record)

    def absent(self, ended: Ended) -> dict[str, Any]:
        if not self.stories:
            return {}
        absent = jnp.nan if self.elastic else 0.0
        return {self.name: jnp.broadcast_to(jnp.full_like(ended.t, absent), (self.stories,))}


def _weights(c: Coefficients) -> Values:
    return drift_weights(present(present(c.several).floors))
