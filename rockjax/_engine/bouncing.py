"""Bounces that end at rest whatever happens on the way: they are not followed.

A rigid column that has hit the ground with little speed bounces on in ever shorter hops, each of which keeps
e of the speed, and rests after a time that is easily bounded. Where the ground cannot lift it before then,
nothing is left of the bounces but the state at rest, and that is the same from the first of them on.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from rockjax._excitations.sampled import AbstractSampled
from rockjax._types import Flag, Index, Value

from .coefficients import Coefficients, present
from .model import acceleration, shear
from .state import LoopState, Plan, Scene

AHEAD = 2.0  # the ground motion is looked at for so much longer than bounces last as things are


def skips_bounces(scene: Scene, plan: Plan) -> bool:
    """Whether bounces need not be followed: nothing is elastic, nothing restrains the columns, nobody counts
    impacts. Under pulses there are few of them before it is certain that nothing changes any more."""
    sampled = isinstance(scene.excitation, AbstractSampled)
    return plan.skip_bounces and sampled and scene.c.restraint is None


def bounces_to_rest(
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


def bounces_from(scene: Scene, speed: Value) -> Index:
    """How many impacts there are until restitution leaves no more than the rest velocity of a speed |θ̇|."""
    speed = jax.lax.stop_gradient(speed)
    count = jnp.ceil(jnp.log(jnp.maximum(speed / scene.rest, 1.0)) / scene.lost)
    return jnp.where(jnp.isfinite(count), count, 0.0).astype(jnp.int32)


def slowest_of(scene: Scene, speed: Value, calm: Flag) -> Value:
    """The least speed |θ̇| of impacts: of bounces that are not followed that of the last of them, which leaves
    the rest velocity."""
    left = jnp.maximum(scene.c.restitution, jnp.finfo(speed.dtype).tiny)
    return jnp.where(calm, jnp.minimum(speed, scene.rest / left), speed)
