"""Bounces that end at rest whatever happens on the way: they are not followed.

A rigid column that has hit the ground with little speed bounces on in ever shorter hops, each of which keeps
e of the speed, and rests after a time that is easily bounded. Where the ground cannot lift it before then,
and no hop is as high as it was before, nothing is left of the bounces but the state at rest, and that is the
same from the first of them on.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from rockjax._engine.once import once
from rockjax._excitations.base import Shaking
from rockjax._types import Flag, Index, Value

from . import margin
from .coefficients import Coefficients, present
from .model import horizontal
from .state import Decision, LoopState, Plan, Scene

AHEAD = 2.0  # the ground motion is looked at for so much longer than bounces last as things are


class Skipped(NamedTuple):
    """Bounces after an impact that are not followed."""

    to_rest: Flag  # whether there are any, and the columns rest
    impacts: Index  # so many
    slowest: Value  # least |θ̇| of them and of the impact before them


def skipped_bounces(
    scene: Scene,
    plan: Plan,
    state: LoopState,
    now: tuple[Value, Index, Value | Shaking],
    hit: Flag,
    speed: Value,
    replayed: Decision | None,
) -> Skipped:
    """Where columns hit with the speed |θ̇|; `now` is the time, the piece and the ground acceleration then.

    They are followed where something is elastic, restrainers hold the columns or impacts are wanted, and
    under motions that do not say how strong they can get in a while.
    """
    if replayed is not None:  # what rests has no speed, by whichever rule
        return Skipped(hit & (replayed.mode == 0), jnp.zeros_like(state.impacts), speed)
    to_rest = None
    if plan.skip_bounces and scene.c.restraint is None:
        to_rest = _bounces_to_rest(scene, plan, state, now, scene.c.restitution * speed)
    if to_rest is None:
        return Skipped(jnp.zeros_like(hit), jnp.zeros_like(state.impacts), speed)
    to_rest = once(hit & to_rest)
    impacts = once(jnp.where(to_rest, _bounces_from(scene, scene.c.restitution * speed), 0))
    return Skipped(to_rest, impacts, jnp.where(to_rest, jnp.minimum(speed, scene.slowest), speed))


def _bounces_to_rest(
    scene: Scene,
    plan: Plan,
    state: LoopState,
    now: tuple[Value, Index, Value | Shaking],
    speed: Value,
) -> Flag | None:
    """Whether columns that leave θ = 0 with the speed |θ̇| rest before the ground can lift them, and before
    they are as high as they were; None where the ground motion does not say.

    Hops begin with speeds w eᵏ. Where the ground takes no more than leaves a deceleration a, each of them is
    w²/(2a) high at most and lasts 2w eᵏ/a at most, all together 2w/(a(1 − e)).
    """
    scene, state, now, speed = jax.lax.stop_gradient((scene, state, now, speed))
    c, (t, piece, shaking) = scene.c, now
    ground = jnp.abs(horizontal(shaking))

    def at_foot(ground: Value) -> Value:
        """−θ̈ times its inertia, Eq. (24), at θ = 0 on the side to which the ground accelerates the
        columns."""
        return c.gravity * c.sin_alpha - c.ground * ground * c.cos_alpha

    # How long all hops last, times what slows them down and what restitution takes.
    lasts, taken = 2 * speed * c.inertia, 1 - c.restitution
    slows, room = at_foot(ground) * taken, scene.excitation.breakpoint(piece) - t
    ahead = jnp.minimum(AHEAD * lasts / jnp.where(slows > 0, slows, 1.0), room)
    ahead = jnp.where((slows > 0) & jnp.isfinite(ahead), ahead, 0.0)
    most = scene.excitation.at_most(piece, t, ahead, ground)
    if most is None:
        return None
    least = at_foot(most)
    height = speed**2 * c.inertia / jnp.where(least > 0, least, 1.0)  # if no less than half is left up there
    # The sine is steeper than 1 nowhere, and the cosine not than sin α.
    at_top = least - height * (c.gravity + c.ground * most * c.sin_alpha)
    rests = (least > 0) & (at_top > 0.5 * least) & (lasts < ahead * at_top * taken) & (height < state.peak)
    if plan.margin:  # of a turning point, where nothing but gravity turns the columns back
        rests &= present(state.margin) <= margin.at_rest(c, scene.overturn_angle, height)
    if plan.shear:
        rests &= _beam_at_most(c, most, height, speed) < present(state.shear) * c.g
    return rests


def _beam_at_most(c: Coefficients, ground: Value, height: Value, speed: Value) -> Value:
    """The most absolute acceleration of the beam over hops so high at most: that of columns that just lift,
    Eqs. (14), (24), under a ground acceleration of this size to either side, and what rotation and its rate
    add."""
    per_moment = c.two_R / c.inertia
    lifting = per_moment * c.cos_alpha
    at_foot = lifting * c.gravity * c.sin_alpha + jnp.abs(1 - lifting * c.ground * c.cos_alpha) * ground
    # By the rotation ψ changes, and with it 2Rθ̈ cos ψ, by less than 2R(p² + |θ̈|) θ.
    turned = 2 * per_moment * (c.gravity + c.ground * ground) * height
    return at_foot + turned + c.two_R * speed**2


def _bounces_from(scene: Scene, speed: Value) -> Index:
    """How many impacts there are until restitution leaves no more than the rest velocity of a speed |θ̇|."""
    speed = jax.lax.stop_gradient(speed)
    count = jnp.ceil(jnp.log(jnp.maximum(speed / scene.rest, 1.0)) / scene.lost)
    return jnp.where(jnp.isfinite(count), count, 0.0).astype(jnp.int32)
