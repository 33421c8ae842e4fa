"""The largest drift of each story of a building in a scene (one podium under one excitation)."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from rockjax._engine.bounds import Bounds, all_true
from rockjax._engine.coefficients import Coefficients, not_none
from rockjax._outputs.maxima import END_ZONE_DEFORMATIONS, Maximum
from rockjax._structures import Podium
from rockjax._types import Flag, Values

from .stories import AbstractStoryOutput
from .views import Ended, Moment, Start, Step


@dataclasses.dataclass(frozen=True)
class PeakDrift(AbstractStoryOutput):
    """The peak drift of each story of a building, the displacement of the floor above the story relative to
    the floor below it [m]."""

    name = "peak_drift"
    unit = "m"
    description = "peak drift of the stories"
    symbol = "drift"
    by_default = True

    def applies(self, podium: Podium) -> bool:
        return podium.vibrates and super().applies(podium)

    def quantity(self, moment: Moment) -> Values:
        return jnp.sum(_weights(moment.c) * moment.deformation[None, :], axis=-1)

    def start(self, start: Start) -> tuple[Values, None]:
        return jnp.zeros(self.stories, start.t.dtype), None

    def over_step(self, step: Step, accumulator: Values) -> Maximum:
        drifts = jax.vmap(step.deformations.summed)(_weights(step.c))
        return step.largest(drifts, accumulator, END_ZONE_DEFORMATIONS, shortens_step=step.ends_on_maxima)

    def is_final(self, bounds: Bounds, accumulator: Values) -> Flag:
        frequencies = jnp.sqrt(not_none(bounds.c.vibration).omega2)
        bound = jax.vmap(lambda weights: bounds.modal_sum(weights / frequencies))(_weights(bounds.c))
        return all_true(bound < accumulator)

    def absent(self, ended: Ended) -> dict[str, Any]:
        return self.in_all_stories(jnp.full_like(ended.t, jnp.nan if self.elastic else 0.0))


def drift_weights(floors: Values) -> Values:
    """Return the weight Γ_i(φ_ji − φ_{j−1,i}) of each mode i in each story j, with φ_0i = 0, shape (stories,
    modes). The drift of story j is the sum of weight times deformation over the modes, (C11) of
    docs/modes.md.

    - `floors`: Γ_iφ_ji, where Γ_i is the participation factor and φ_ji the shape of mode i at floor j, shape
      (stories, modes)
    """
    return jnp.concatenate([floors[:1], floors[1:] - floors[:-1]])


def _weights(c: Coefficients) -> Values:
    return drift_weights(not_none(not_none(c.modal).floors))
