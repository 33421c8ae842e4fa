"""The largest rotation in a scene (one podium under one excitation). This output is always computed, because
other outputs and fast-forwards (the skipping of parts of a scene) need it."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from rockjax._engine.bounds import Bounds
from rockjax._engine.energy import potential
from rockjax._outputs.maxima import NEAR_MAXIMUM, Maximum
from rockjax._programs.barrier import barrier
from rockjax._types import Flag, Value

from .base import AbstractEventOutput, Variable
from .views import Bounces, Ended, Moment, Start, Step, StepEnd


@dataclasses.dataclass(frozen=True)
class PeakRotation(AbstractEventOutput):
    """The peak rotation max|θ|/α and its time."""

    name = "peak_rotation"
    unit = "1"
    description = "peak rotation max|θ|/α"
    symbol = "θ/α"
    by_default = True

    requested: bool = True  # False if only fast-forwards and other outputs use the rotation

    @property
    def variables(self) -> tuple[Variable, ...]:
        time = Variable(
            "peak_rotation_time",
            "s",
            "time of the peak rotation",
            sensitive=False,
            estimated=False,
            until_overturning=False,
        )
        return *super().variables, time

    def quantity(self, moment: Moment) -> Value:
        return moment.x[0] / moment.c.alpha

    def start(self, start: Start) -> tuple[Value, Value]:
        return jnp.minimum(jnp.abs(start.initial.theta), start.scene.overturn_angle), start.t

    def over_step(self, step: Step, accumulator: Value) -> Maximum:
        top = step.guard.turn_value
        may_raise = step.ends_on_maxima & step.peak_exceeds_ends & (top > accumulator * (1 - NEAR_MAXIMUM))
        return Maximum(top, step.cut_at_turn(may_raise))

    def update(self, end: StepEnd, accumulator: Value, note: Value, largest: Any) -> tuple[Value, Value]:
        del largest
        highest, time = barrier(highest_angle(end))
        if not self.requested:  # then no derivatives of the rotation are needed
            highest, time = jax.lax.stop_gradient((highest, time))
        raises = barrier(end.accepted & (end.step.sigma != 0) & (highest > accumulator))
        return jnp.where(raises, highest, accumulator), jnp.where(raises, time, note)

    def over_bounces(self, bounces: Bounces, accumulator: Value) -> Flag:
        return bounces.height < accumulator

    def is_final(self, bounds: Bounds, accumulator: Value) -> Flag | bool:
        if not self.requested:
            return True
        at_peak = potential(bounds.c, jnp.ones_like(accumulator), jnp.minimum(accumulator, bounds.well))
        return bounds.rests | (bounds.energy < at_peak)

    def answer(self, ended: Ended, accumulator: Value, note: Value) -> dict[str, Any]:
        if not self.requested:
            return self.absent(ended)
        return {self.name: accumulator / ended.scene.c.alpha, "peak_rotation_time": note}

    def absent(self, ended: Ended) -> dict[str, Any]:
        nan = jnp.full_like(ended.t, jnp.nan)
        return {self.name: nan, "peak_rotation_time": nan}


def highest_angle(end: StepEnd) -> tuple[Value, Value]:
    """Return the largest |θ| inside a step or at its end [rad], and the time of this maximum [s]. Both can be
    differentiated."""
    step, guard = end.step, end.step.guard
    at_stop = guard.at_end.value(end.after)
    end_angle = jnp.where(end.hit, 0.0, jnp.where(end.toppled, step.scene.overturn_angle, at_stop))
    peak, end_angle = barrier((guard.path.value(guard.turn), end_angle))
    at_turn = step.has_peak & (peak >= end_angle)
    # If |θ| is largest at the end of a step that ends neither on an event nor at the end of the scene, this
    # end is a turning point up to rounding, or |θ| rises further in the next step. The time is then that of
    # the turning point near this end.
    at_event = end.lands | step.trial.ends_scene
    if end.jolt is not None:  # the ground's velocity may jump there and reverse the rotation
        at_event |= step.trial.reaches_stop
    at_event &= ~at_turn
    turn = jnp.where(at_turn, guard.turn, 1.0)
    time = jnp.where(at_event, end.now, step.state.t + step.time_to_turn(turn))
    return jnp.where(at_turn, peak, end_angle), time
