"""Detection of bounces that certainly end at rest, which need not be followed.

A rigid column that hits the ground slowly bounces on in ever shorter hops. Each hop keeps the fraction e of
the speed, so the time until rest is easily bounded. If the ground cannot lift the column before then, and no
hop exceeds the recorded peak, the bounces are skipped: the column is put to rest at the first of them.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from rockjax._engine.model import horizontal
from rockjax._engine.state import Decision, LoopState, Plan, Scene
from rockjax._excitations.base import Shaking
from rockjax._outputs.views import Bounces
from rockjax._programs.barrier import barrier
from rockjax._types import Flag, Index, Value

AHEAD = 2.0  # the ground motion is bounded over this many times the estimated duration of the bounces


class Skipped(NamedTuple):
    """Bounces after an impact that are not followed."""

    to_rest: Flag  # bounces are skipped, and the columns rest
    impacts: Index  # number of skipped impacts
    min_impact_speed: Value  # least |θ̇| of them and of the impact before them


def skipped_bounces(
    scene: Scene,
    plan: Plan,
    state: LoopState,
    now: tuple[Value, Index, Value | Shaking],
    hit: Flag,
    speed: Value,
    replayed: Decision | None,
) -> Skipped:
    """Return the bounces after an impact that can be skipped.

    - `scene`, `plan`: the prepared scene and its static choices
    - `state`: state before the step that ends with the impact
    - `now`: time [s], piece of the excitation and ground acceleration [m/s²] at the impact
    - `hit`: whether the step ends with an impact
    - `speed`: |θ̇| before the impact [rad/s]
    - `replayed`: recorded decision to follow, or None

    Bounces are followed if something is elastic, restrainers act, impacts are requested, or the ground motion
    has no bound over a time interval.
    """
    if replayed is not None:  # a column at rest has no speed, whichever rule put it to rest
        return Skipped(hit & (replayed.mode == 0), jnp.zeros_like(state.impacts), speed)
    to_rest = None
    if "bounces" in plan.fast_forwards and scene.c.restraint is None:
        to_rest = _bounces_to_rest(scene, plan, state, now, scene.c.restitution * speed)
    if to_rest is None:
        return Skipped(jnp.zeros_like(hit), jnp.zeros_like(state.impacts), speed)
    to_rest = barrier(hit & to_rest)
    impacts = barrier(jnp.where(to_rest, _bounces_from(scene, scene.c.restitution * speed), 0))
    return Skipped(to_rest, impacts, jnp.where(to_rest, jnp.minimum(speed, scene.min_impact_speed), speed))


def _bounces_to_rest(
    scene: Scene,
    plan: Plan,
    state: LoopState,
    now: tuple[Value, Index, Value | Shaking],
    speed: Value,
) -> Flag | None:
    """Return whether columns that leave θ = 0 with the speed |θ̇| rest before the ground can lift them, with
    all hops below the recorded peak; None if the ground motion has no bound.

    Hops begin with speeds w eᵏ. If the ground leaves a deceleration of at least a, hop k is at most w²/(2a)
    high and lasts at most 2w eᵏ/a; all of them last at most 2w/(a(1 − e)).
    """
    scene, state, now, speed = jax.lax.stop_gradient((scene, state, now, speed))
    c, (t, piece, shaking) = scene.c, now
    ground = jnp.abs(horizontal(shaking))

    def at_foot(ground: Value) -> Value:
        """Return −θ̈ times its inertia at θ = 0, Eq. (24), on the side to which the ground accelerates the
        columns."""
        return c.gravity * c.sin_alpha - c.ground * ground * c.cos_alpha

    # Duration of all hops, times the deceleration and the lost fraction 1 − e.
    lasts, taken = 2 * speed * c.inertia, 1 - c.restitution
    slows, room = at_foot(ground) * taken, scene.excitation.breakpoint(piece) - t
    ahead = jnp.minimum(AHEAD * lasts / jnp.where(slows > 0, slows, 1.0), room)
    ahead = jnp.where((slows > 0) & jnp.isfinite(ahead), ahead, 0.0)
    most = scene.excitation.at_most(piece, t, ahead, ground)
    if most is None:
        return None
    least = at_foot(most)
    height = speed**2 * c.inertia / jnp.where(least > 0, least, 1.0)  # if half is left there
    # The slope of the sine is at most 1, and that of the cosine at most sin α.
    at_top = least - height * (c.gravity + c.ground * most * c.sin_alpha)
    rests = (least > 0) & (at_top > 0.5 * least) & (lasts < ahead * at_top * taken)
    bounces = Bounces(c, scene.overturn_angle, most, height, speed)
    for output, record in zip(plan.outputs, state.records, strict=True):
        rests &= output.over_bounces(bounces, record)
    return rests


def _bounces_from(scene: Scene, speed: Value) -> Index:
    """Return the number of impacts after which restitution has reduced |θ̇| to the rest velocity."""
    speed = jax.lax.stop_gradient(speed)
    count = jnp.ceil(jnp.log(jnp.maximum(speed / scene.rest_speed, 1.0)) / scene.log_restitution)
    return jnp.where(jnp.isfinite(count), count, 0.0).astype(jnp.int32)
