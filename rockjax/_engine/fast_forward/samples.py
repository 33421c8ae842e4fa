"""Fast-forward from one sample of the ground motion to the next without a trial step.

A trial step is a step that may be rejected, or shortened to end on an event. Under sampled ground motions,
trial steps end on every sample and are far shorter than the tolerance requires. Between most samples the
columns of a rigid podium (with a rigid superstructure or none) rock on, and no event occurs. A Nyström step
without a search for events then replaces the trial step, under three conditions:

- the error of the step is small enough;
- the rotation is monotone, does not change its sign and stays below the overturning angle;
- no output can change between the samples.
"""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp

from rockjax._engine.attempt import scaled_error
from rockjax._engine.coefficients import divided_by_inertia, not_none
from rockjax._engine.model import acceleration
from rockjax._engine.runge_kutta import Step
from rockjax._engine.runge_kutta import step as runge_kutta
from rockjax._engine.state import LoopState, Plan, Scene
from rockjax._engine.tableaus import nystrom
from rockjax._excitations.sampled import AbstractSampled
from rockjax._outputs.views import Sample
from rockjax._programs.barrier import barrier
from rockjax._types import Flag, Value, Vector


def can_skip_samples(scene: Scene, plan: Plan) -> bool:
    """Return whether samples may be skipped: the plan allows it, the excitation is sampled, and there are no
    restrainers, so that accelerations depend only on time and rotation."""
    sampled = isinstance(scene.excitation, AbstractSampled)
    return "samples" in plan.fast_forwards and sampled and scene.c.restraint is None


def may_skip_after(scene: Scene, mode: Value, t: Value) -> Flag:
    """Return whether samples may be skipped after an accepted step: only while the columns rock, and only
    between the start of the scene and the end of the ground motion.

    - `mode`: contact mode at the end of the step, 0 in full contact and ±1 while rocking
    - `t`: time of the end of the step [s]
    """
    return (mode != 0) & (t >= jax.lax.stop_gradient(scene.start)) & (t < scene.excitation_end)


def skip_samples(scene: Scene, plan: Plan, state: LoopState) -> LoopState:
    """Return the state after the samples that can be skipped before the next trial step. Batches call
    `skip_sample` instead."""
    if state.may_skip is None:
        return state
    skip = functools.partial(skip_sample, scene, plan)
    return jax.lax.while_loop(lambda state: not_none(state.may_skip), skip, state)


def skip_sample(scene: Scene, plan: Plan, state: LoopState) -> LoopState:
    """Advance to the next sample if `may_skip` is set and no trial step is needed; otherwise clear
    `may_skip`."""
    constant = jax.lax.stop_gradient
    record: AbstractSampled = scene.excitation  # pyright: ignore[reportAssignmentType]
    c, sigma, piece = divided_by_inertia(scene.c), state.sigma, state.piece
    _, dt, count, scale = record.sampling

    @jax.jit  # JAX traces the function once for all stages of the step
    def field(ground: Value, x: Vector, v: Vector) -> Vector:
        return acceleration(c, sigma, ground, x, v)

    before, after = (jnp.clip(piece - 1 + k, 0, count - 1) for k in (0, 1))
    ground_before, ground_after = barrier(
        [scale * record.samples_at(record.table, k) for k in (before, after)]
    )
    slope = barrier((ground_after - ground_before) / dt)
    ground = barrier(ground_before + slope * (state.t - record.sample_time(before)))
    # `now` carries the derivatives with respect to the parameters start and dt of the record; `stamp` is the
    # same time without derivatives.
    now = record.sample_time(piece)
    stamp = constant(now)
    h = stamp - state.t
    a = barrier(field(ground, state.x, state.v))
    field_after = lambda s, x, v: field(ground + slope * s, x, v)
    end = barrier(runge_kutta(nystrom(), field_after, 0.0, h, state.x, state.v, a))
    # The last sample is not skipped, since the ground acceleration may jump to zero there.
    skips = not_none(state.may_skip) & (piece < count - 1) & (stamp < constant(scene.end))
    skips &= constant(scaled_error(scene, state.x, state.v, end)) <= scene.skip_below
    skips &= _rocks_on(scene, state, a, end, h)
    sample = Sample(scene.c, sigma, h, (ground, state.x, state.v, a), (ground_after, end.x, end.v, end.a))
    for output, accumulator in zip(plan.outputs, state.accumulators, strict=True):
        skips &= output.over_sample(sample, accumulator)
    skips = barrier(skips)
    # The accelerations are continuous at a sample, so the derivatives of the sample's time do not affect the
    # state.
    moved = state._replace(t=stamp, event_time=now, x=end.x, v=end.v, piece=piece + 1, steps=state.steps + 1)
    moved = jax.tree.map(lambda new, old: jnp.where(skips, new, old), moved, state)
    return moved._replace(may_skip=skips)


def _rocks_on(scene: Scene, state: LoopState, a: Vector, end: Step, h: Value) -> Flag:
    """Return whether the rotation is monotone up to the next sample, and no impact or overturning occurs.

    θ̇ must have the same sign at both ends. As θ̈ is nearly linear between two samples, θ̇ has this sign
    throughout if θ̈ does not change its sign, or is too small to stop the columns.
    """
    angle, theta_dots, theta_ddots = jax.lax.stop_gradient(
        (state.sigma * end.x[0], (state.v[0], end.v[0]), (a[0], end.a[0]))
    )
    min_speed = jnp.minimum(*map(jnp.abs, theta_dots))
    keeps_sign = theta_ddots[0] * theta_ddots[1] >= 0
    keeps_direction = keeps_sign | (min_speed > h * jnp.maximum(*map(jnp.abs, theta_ddots)))
    is_inside = (angle > 0) & (angle < jax.lax.stop_gradient(scene.overturn_angle))
    return is_inside & keeps_direction & (theta_dots[0] * theta_dots[1] > 0)
