"""The largest absolute horizontal acceleration of the deck in a scene (one podium under one excitation). (L1)
is in docs/floors.md, Eq. (24) in docs/model.md."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax.numpy as jnp

from rockjax._engine.bounds import Bounds
from rockjax._outputs.maxima import END_ZONE_ACCELERATIONS, Maximum
from rockjax._types import Flag, Value

from .base import AbstractOutput, larger
from .shear import beam_bound, stays_below
from .views import Bounces, Ended, Moment, Rest, Sample, Start, Step, deck_acceleration


@dataclasses.dataclass(frozen=True)
class PeakDeckAcceleration(AbstractOutput):
    """The peak absolute horizontal acceleration sup|a_b| of the deck (the beam), (L1) [m/s²]. The peak
    includes the values just before and just after events, but not the impulses of impacts. A rigid
    superstructure moves with the deck.

    `is_final` compares the peak with `Bounds.beam`, a bound on |ü_g| + 2R(|θ̈| + θ̇²|sin ψ|) ≥ |a_b| with
    ψ = σα − θ. The energy bounds θ̇² and the spring forces. By Eq. (24) these also bound θ̈.
    """

    name = "peak_deck_acceleration"
    unit = "m s-2"
    description = "peak absolute horizontal acceleration of the deck"
    symbol = "|a_b|"

    def quantity(self, moment: Moment) -> Value:
        return deck_acceleration(moment)

    def start(self, start: Start) -> tuple[Value, None]:
        return jnp.zeros((), start.t.dtype), None

    def over_step(self, step: Step, accumulator: Value) -> Maximum:
        return step.largest(step.course(deck_acceleration), accumulator, END_ZONE_ACCELERATIONS)

    def over_rest(self, rest: Rest, accumulator: Value) -> Value:
        # In full contact the deck moves with the ground.
        return larger(rest.largest_ground_acceleration, accumulator)

    def over_sample(self, sample: Sample, accumulator: Value) -> Flag:
        return stays_below(sample, accumulator / sample.c.g)

    def over_bounces(self, bounces: Bounces, accumulator: Value) -> Flag:
        return beam_bound(bounces) < accumulator

    def is_final(self, bounds: Bounds, accumulator: Value) -> Flag:
        return bounds.beam < accumulator

    def absent(self, ended: Ended) -> dict[str, Any]:
        del ended
        return {}
