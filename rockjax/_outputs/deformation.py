"""The largest deformation of each mode of the superstructure in a scene (one podium under one excitation)."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax.numpy as jnp

from rockjax._engine.bounds import Bounds, all_true
from rockjax._outputs.maxima import END_ZONE_DEFORMATIONS, Maximum
from rockjax._structures import Podium
from rockjax._types import Flag, Values

from .base import MODES, AbstractOutput
from .views import Ended, Moment, Start, Step


@dataclasses.dataclass(frozen=True)
class PeakDeformation(AbstractOutput):
    """The peak deformation max|u_t − u_b| of the superstructure [m], with the displacement u_t of its top
    mass and the displacement u_b of the beam. For several modes, the answer is the peak deformation of each
    mode."""

    name = "peak_deformation"
    unit = "m"
    description = "peak deformation of the superstructure max|u_t − u_b|"
    symbol = "|u_t − u_b|"
    by_default = True
    axis = MODES

    elastic: bool = True  # whether the superstructure vibrates
    has_mode_axis: bool = False  # whether the answer has an axis of modes

    def applies(self, podium: Podium) -> bool:
        return podium.vibrates

    def of(self, podium: Podium) -> PeakDeformation:
        top = podium.superstructure
        return PeakDeformation(podium.vibrates, top is not None and top.has_mode_axis)

    def quantity(self, moment: Moment) -> Values:
        return moment.deformation

    def start(self, start: Start) -> tuple[Values, None]:
        modes = start.scene.c.vibration
        return jnp.zeros(() if modes is None else modes.omega2.shape, start.t.dtype), None

    def over_step(self, step: Step, accumulator: Values) -> Maximum:
        # Steps are shortened to end on maxima only if the order of the method exceeds the degree of the
        # polynomial that interpolates a step.
        return step.largest(
            step.deformations, accumulator, END_ZONE_DEFORMATIONS, shortens_step=step.ends_on_maxima
        )

    def is_final(self, bounds: Bounds, accumulator: Values) -> Flag:
        return all_true(bounds.deformations() < accumulator)

    def answer(self, ended: Ended, accumulator: Values, note: Any) -> dict[str, Any]:
        return {self.name: jnp.atleast_1d(accumulator) if self.has_mode_axis else accumulator}

    def absent(self, ended: Ended) -> dict[str, Any]:
        if not self.elastic:
            deformation = jnp.zeros_like(ended.t)
        else:
            deformation = jnp.broadcast_to(jnp.full_like(ended.t, jnp.nan), ended.x[1].shape)
        return {self.name: jnp.atleast_1d(deformation) if self.has_mode_axis else deformation}
