"""Bounces that end at rest whatever happens on the way: they are not followed.

A rigid column that has hit the ground with little speed bounces on in ever shorter hops, each of which keeps
e of the speed, and rests after a time that is easily bounded. Where the ground cannot lift it before then,
nothing is left of the bounces but the state at rest, and that is the same from the first of them on.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from rockjax._excitations.base import Shaking
from rockjax._excitations.sampled import AbstractSampled
from rockjax._once import once
from rockjax._types import Flag, Index, Value

from .coefficients import Coefficients, present
from .model import acceleration, horizontal, shear
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
    under pulses: under these there are few before it is certain that nothing changes any more.
    """
    if replayed is not None:  # what rests has no speed, by whichever rule
        return Skipped(hit & (replayed.mode == 0), jnp.zeros_like(state.impacts), speed)
    sampled = isinstance(scene.excitation, AbstractSampled)
    if not (plan.skip_bounces and sampled and scene.c.restraint is None):
        return Skipped(jnp.zeros_like(hit), jnp.zeros_like(state.impacts), speed)
    left = scene.c.restitution * speed
    t, piece, ground = now
    to_rest = once(hit & _bounces_to_rest(scene, plan, state, t, piece, horizontal(ground), left))
    impacts = once(jnp.where(to_rest, _bounces_from(scene, left), 0))
    # The last of them leaves the rest velocity.
    last = scene.rest / jnp.maximum(scene.c.restitution, jnp.finfo(speed.dtype).tiny)
    return Skipped(to_rest, impacts, jnp.where(to_rest, jnp.minimum(speed, last), speed))


def _bounces_to_rest(
    scene: Scene, plan: Plan, state: LoopState, t: Value, piece: Index, ground: Value, speed: Value
) -> Flag:
    """Whether columns that leave θ = 0 with the speed |θ̇| at t rest before the ground can lift them.

    Hops begin with speeds w eᵏ. Where the ground takes no more than leaves a deceleration a, each of them is
    w²/(2a) high at most and lasts 2w eᵏ/a at most, all together 2w/(a(1 − e)).
    """
    scene, state, t, ground, speed = jax.lax.stop_gradient((scene, state, t, ground, speed))
    c, zero = scene.c, jnp.zeros_like(t)
    loss = 1 - jnp.clip(c.restitution, 0.0, 1.0)

    def deceleration(ground: Value, theta: Value) -> Value:
        """−θ̈ on the side to which the ground accelerates the columns."""
        return -acceleration(c, jnp.ones_like(t), -ground, (theta,), (zero,))[0]

    def duration(a: Value) -> Value:
        lost = jnp.maximum(a, 0.0) * loss
        return jnp.where(lost > 0, 2 * speed / jnp.where(lost > 0, lost, 1.0), jnp.inf)

    room = scene.excitation.breakpoint(piece) - t
    ahead = jnp.minimum(AHEAD * duration(deceleration(jnp.abs(ground), zero)), room)
    ahead = jnp.where(jnp.isfinite(ahead), ahead, 0.0)
    later = jnp.abs(scene.excitation.piece(piece)(t + ahead))
    most = jnp.maximum(jnp.abs(ground), later)  # between them it goes along a line
    least = deceleration(most, zero)
    height = speed**2 / jnp.where(least > 0, least, 1.0)  # if no less than half is left up there
    at_top = deceleration(most, height)
    rests = (least > 0) & (at_top > 0.5 * least) & (duration(at_top) < ahead)
    if plan.shear:
        rests &= _shear_at_most(c, most, height, speed) < present(state.shear)
    return rests


def _shear_at_most(c: Coefficients, ground: Value, height: Value, speed: Value) -> Value:
    """The most shear of hops so high at most: that of columns that just lift, under a ground acceleration of
    this size to either side, and what rotation and its rate add."""
    one, zero = jnp.ones_like(height), (jnp.zeros_like(height),)
    each = (shear(c, one, g, zero, zero, acceleration(c, one, g, zero, zero)) for g in (ground, -ground))
    # By the rotation ψ changes, and with it 2Rθ̈ cos ψ, by less than 2R(p² + |θ̈|) θ.
    fastest = c.gravity / c.inertia * (1 + ground / c.g)
    turned = c.two_R * 2 * fastest * height / c.g
    return jnp.maximum(*map(jnp.abs, each)) + turned + c.two_R * speed**2 / c.g


def _bounces_from(scene: Scene, speed: Value) -> Index:
    """How many impacts there are until restitution leaves no more than the rest velocity of a speed |θ̇|."""
    speed = jax.lax.stop_gradient(speed)
    count = jnp.ceil(jnp.log(jnp.maximum(speed / scene.rest, 1.0)) / scene.lost)
    return jnp.where(jnp.isfinite(count), count, 0.0).astype(jnp.int32)
