"""The largest absolute horizontal acceleration of each floor of a building in a scene (one podium under one
excitation). (L2) and (L3) are in docs/floors.md."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from rockjax._engine.bounds import Bounds, all_true
from rockjax._engine.coefficients import not_none
from rockjax._engine.model import floor_accelerations
from rockjax._outputs.maxima import END_ZONE_ACCELERATIONS, Maximum
from rockjax._types import Flag, Values

from .shear import PeakShear
from .stories import AbstractStoryOutput
from .views import Bounces, Ended, Moment, Rest, Sample, Start, Step, deck_acceleration


@dataclasses.dataclass(frozen=True)
class PeakFloorAcceleration(AbstractStoryOutput):
    """The peak absolute horizontal acceleration of each floor of a building [m/s²]. All floors of a rigid
    building move with the beam, so their peak is g times the answer of `PeakShear`.

    If the model of the building omits modes, the velocity of floor j jumps at an impact. The jump is the
    fraction 1 − Σ_i W_i of the velocity jump of the deck (the beam), with the weights W_i = Γ_iφ_ji of the
    included modes, (L2), (L3). The peak does not include the impulses of these jumps.
    """

    name = "peak_floor_acceleration"
    unit = "m s-2"
    description = "peak absolute horizontal acceleration of the floors"
    symbol = "|ü_j + ü_g|"
    by_default = True

    def quantity(self, moment: Moment) -> Values:
        if not self.elastic:
            return deck_acceleration(moment) / moment.c.g
        return floor_accelerations(moment.c, moment.sigma, moment.ground, moment.x, moment.v, moment.a)

    def start(self, start: Start) -> tuple[Values, None]:
        return jnp.zeros(self.stories if self.elastic else (), start.t.dtype), None

    def over_step(self, step: Step, accumulator: Values) -> Maximum:
        if not self.elastic:
            return _BEAM.over_step(step, accumulator)
        force = step.inertia_force()
        floors = jax.vmap(force)(not_none(not_none(step.c.modal).floors))
        return step.largest(floors, accumulator, END_ZONE_ACCELERATIONS)

    def over_rest(self, rest: Rest, accumulator: Values) -> Values:
        return _BEAM.over_rest(rest, accumulator)

    def over_sample(self, sample: Sample, accumulator: Values) -> Flag:
        return _BEAM.over_sample(sample, accumulator)

    def over_bounces(self, bounces: Bounces, accumulator: Values) -> Flag:
        return _BEAM.over_bounces(bounces, accumulator)

    def is_final(self, bounds: Bounds, accumulator: Values) -> Flag:
        if not self.elastic:
            return _BEAM.is_final(bounds, accumulator)
        return all_true(
            jax.vmap(bounds.floor_acceleration)(not_none(not_none(bounds.c.modal).floors)) < accumulator
        )

    def answer(self, ended: Ended, accumulator: Values, note: Any) -> dict[str, Any]:
        return (
            {self.name: accumulator} if self.elastic else self.in_all_stories(accumulator * ended.scene.c.g)
        )


_BEAM = PeakShear()  # the shear of a rigid building, equal to the acceleration of the beam divided by g
