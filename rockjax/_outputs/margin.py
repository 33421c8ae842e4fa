"""The overturning margin of a scene (one podium under one excitation). It is positive if the columns survive,
zero on the boundary of overturning, and negative if they overturn."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp

from rockjax._engine.bounds import Bounds
from rockjax._engine.energy import potential
from rockjax._outputs.maxima import NEAR_MAXIMUM, Maximum
from rockjax._types import Flag, Value

from .base import AbstractEventOutput, AbstractInternalOutput
from .turning_points import margin_at_fall, margin_at_rest
from .views import Bounces, Start, Step, StepEnd, Turn


@dataclasses.dataclass(frozen=True)
class Margin(AbstractEventOutput):
    """The overturning margin [–]: the least margin of all turning points of the rotation. If the columns
    overturn, it is the negative margin at the overturning angle. `turning_points.py` defines these margins.
    The initial rotation counts as a turning point, and so does the rotation at the end of the scene if |θ|
    still rises there."""

    name = "margin"
    unit = "1"
    description = "overturning margin"
    symbol = "M"
    estimated = False
    until_overturning = False
    needs_flat = True

    def start(self, start: Start) -> tuple[Value, None]:
        scene = start.scene
        return margin_at_rest(scene.c, scene.overturn_angle, jnp.abs(start.initial.theta)), None

    def over_step(self, step: Step, accumulator: Value) -> Maximum:
        value = step.turn.margin
        is_near_least = jax.lax.stop_gradient(value) < accumulator + NEAR_MAXIMUM * (1 - accumulator)
        return Maximum(value, step.cut_at_turn(step.ends_on_maxima & step.peak_exceeds_ends & is_near_least))

    def update(
        self, end: StepEnd, accumulator: Value, note: None, largest: Value | None
    ) -> tuple[Value, None]:
        del largest
        step, (x, v) = end.step, (end.x, end.v)
        scene, turn = step.scene, step.turn
        least = jnp.where(step.has_peak & (turn.margin < accumulator), turn.margin, accumulator)
        # If |θ| still increases at the end of a scene, the rotation there counts as a turning point.
        rises = (end.stamp >= jax.lax.stop_gradient(scene.end)) & (x[0] * v[0] > 0)
        at_end = margin_at_rest(scene.c, scene.overturn_angle, jnp.abs(x[0]))
        least = jnp.where(rises & (at_end < least), at_end, least)
        if end.jolt is not None:
            # The rotation also turns where a jump of the ground's velocity reverses it.
            turns = (x[0] * (v[0] - end.jolt.change[0]) > 0) & (x[0] * v[0] <= 0)
            least = jnp.where(turns & (at_end < least), at_end, least)
        return jnp.where(end.toppled, margin_at_fall(scene.c, scene.overturn_angle, v[0]), least), note

    def over_bounces(self, bounces: Bounces, accumulator: Value) -> Flag:
        # The right side is G of `turning_points.py` for a bound on |θ| during the bounces. G decreases with
        # |θ|, and the margin of a turning point is at least G.
        return accumulator <= margin_at_rest(bounces.c, bounces.overturn_angle, bounces.height)

    def is_final(self, bounds: Bounds, accumulator: Value) -> Flag | bool:
        depth = potential(bounds.c, jnp.ones_like(accumulator), bounds.overturn_angle)
        return bounds.rests | (bounds.energy < (1 - accumulator) * depth)


@dataclasses.dataclass(frozen=True)
class TurningPoints(AbstractInternalOutput):
    """The `Turn` of the latest trial step (a step that may be rejected): margin and deceleration at the
    maximum of |θ| in the step. Both are inf if the step has no maximum or was rejected. From this turning
    point, batches estimate the distance to the overturning boundary."""

    name = "turning_points"

    def start(self, start: Start):
        inf = jnp.full_like(start.t, jnp.inf)
        return Turn(inf, inf), None

    def update(self, end: StepEnd, accumulator, note, largest):
        del accumulator, largest
        return end.step.turn, note

    def after_rejection(self, accumulator):
        return jax.tree.map(lambda y: jnp.full_like(y, jnp.inf), accumulator)

    def over_bounces(self, bounces: Bounces, accumulator):
        del bounces, accumulator
        return True

    def is_final(self, bounds: Bounds, accumulator):
        del bounds, accumulator
        return True
