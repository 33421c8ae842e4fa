"""The number of impacts before the largest rotation of a scene (one podium under one excitation)."""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from rockjax._engine.bounds import Bounds
from rockjax._types import Flag, Value

from .base import AbstractEventOutput
from .rotation import PeakRotation, highest_angle
from .views import Ended, Start, StepEnd


class _Counts(NamedTuple):
    """Numbers of impacts up to the present time."""

    all: Value
    before_peak: Value  # impacts before the largest rotation


@dataclasses.dataclass(frozen=True)
class ImpactsBeforePeak(AbstractEventOutput):
    """The number of impacts before the peak rotation. Derivatives of the peak rotation are valid as long as
    this number stays the same."""

    name = "impacts_before_peak"
    description = "number of impacts before the peak rotation"
    sensitive = False
    estimated = False
    until_overturning = False
    needs_flat = True
    follows_impacts = True

    def start(self, start: Start) -> tuple[Value, _Counts]:
        zero = jnp.zeros_like(start.t)
        return PeakRotation().start(start)[0], _Counts(zero, zero)

    def over_step(self, step: Any, accumulator: Value) -> None:
        del step, accumulator

    def update(self, end: StepEnd, accumulator: Value, note: _Counts, largest: Any) -> tuple[Value, _Counts]:
        del largest
        highest = jax.lax.stop_gradient(highest_angle(end)[0])
        raises = (end.step.sigma != 0) & (highest > accumulator)
        counts = _Counts(note.all + end.hit, jnp.where(raises, note.all, note.before_peak))
        return jnp.where(raises, highest, accumulator), counts

    def is_final(self, bounds: Bounds, accumulator: Value) -> Flag | bool:
        return PeakRotation().is_final(bounds, accumulator)

    def answer(self, ended: Ended, accumulator: Value, note: _Counts) -> dict[str, Any]:
        del ended, accumulator
        return {self.name: note.before_peak}
