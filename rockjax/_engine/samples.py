"""Passing samples of a record without a trial.

Under a record steps end on every sample, and are far shorter than the tolerance requires. At most samples no
event occurs: rigid columns rock on from one sample to the next. Such samples are passed by steps of a Nyström
method of which only the error is checked. A rotation that is monotone and stays inside the well meets no
guard, and sets no record that the next trial would miss. All other samples get a trial.
"""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp

from rockjax._engine.once import once
from rockjax._excitations.sampled import AbstractSampled
from rockjax._types import Flag, Value, Vector

from .attempt import over_tolerance
from .coefficients import Coefficients, over_inertia, present
from .model import acceleration, shear
from .runge_kutta import Step
from .runge_kutta import step as runge_kutta
from .state import LoopState, Plan, Scene
from .tableaus import nystrom


def passes_samples(scene: Scene, plan: Plan) -> bool:
    """Return whether the excitation has samples to pass, and accelerations depend on time and
    rotation only."""
    sampled = isinstance(scene.excitation, AbstractSampled)
    return plan.pass_samples and sampled and scene.c.restraint is None


def may_pass(scene: Scene, mode: Value, t: Value) -> Flag:
    """Return whether samples may be passed after an accepted step."""
    return (mode != 0) & (t >= jax.lax.stop_gradient(scene.start)) & (t < scene.quiet)


def past_all(scene: Scene, plan: Plan, state: LoopState) -> LoopState:
    """Return the state at the first sample that needs a trial, for one scene alone."""
    if state.passing is None:
        return state
    onward = functools.partial(past_sample, scene, plan)
    return jax.lax.while_loop(lambda state: present(state.passing), onward, state)


def past_sample(scene: Scene, plan: Plan, state: LoopState) -> LoopState:
    """Advance to the next sample if `passing` is set and the step needs no trial; otherwise clear
    `passing`."""
    constant = jax.lax.stop_gradient
    record: AbstractSampled = scene.excitation  # pyright: ignore[reportAssignmentType]
    c, sigma, piece = over_inertia(scene.c), state.sigma, state.piece
    _, dt, count, scale = record.sampling

    @jax.jit  # traced once for all stages
    def field(ground: Value, x: Vector, v: Vector) -> Vector:
        return acceleration(c, sigma, ground, x, v)

    before, after = (jnp.clip(piece - 1 + k, 0, count - 1) for k in (0, 1))
    first, last = once([scale * record.among(record.table, place) for place in (before, after)])
    slope = once((last - first) / dt)
    ground = once(first + slope * (state.t - record.sample_time(before)))
    now = record.sample_time(piece)  # it moves with the parameters, its stamp does not
    stamp = constant(now)
    h = stamp - state.t
    a = once(field(ground, state.x, state.v))
    along = lambda s, x, v: field(ground + slope * s, x, v)
    end = once(runge_kutta(nystrom(), along, 0.0, h, state.x, state.v, a))
    # The last sample is not passed: the motion may jump to zero there.
    goes = present(state.passing) & (piece < count - 1) & (stamp < constant(scene.end))
    goes &= constant(over_tolerance(scene, state.x, state.v, end)) <= scene.pass_below
    goes &= _goes_on(scene, state, a, end, h)
    if plan.shear:
        goes &= _shear_stays_under(scene, state, (ground, last), a, end, h)
    goes = once(goes)
    # The field is continuous at a sample: if the sample moves, the state at the stamp does not.
    moved = state._replace(t=stamp, event_time=now, x=end.x, v=end.v, piece=piece + 1, steps=state.steps + 1)
    moved = jax.tree.map(lambda new, old: jnp.where(goes, new, old), moved, state)
    return moved._replace(passing=goes)


def _goes_on(scene: Scene, state: LoopState, a: Vector, end: Step, h: Value) -> Flag:
    """Return whether the rotation is monotone over the sample and stays inside the well.

    θ̈ is nearly linear from one sample to the next. If it keeps its sign, or is too small to stop the
    columns, θ̇ does not change its sign twice.
    """
    angle, speeds, changes = jax.lax.stop_gradient(
        (state.sigma * end.x[0], (state.v[0], end.v[0]), (a[0], end.a[0]))
    )
    slowest = jnp.minimum(*map(jnp.abs, speeds))
    steady = (changes[0] * changes[1] >= 0) | (slowest > h * jnp.maximum(*map(jnp.abs, changes)))
    inside = (angle > 0) & (angle < jax.lax.stop_gradient(scene.overturn_angle))
    return inside & steady & (speeds[0] * speeds[1] > 0)


def _shear_stays_under(
    scene: Scene, state: LoopState, ground: tuple[Value, Value], a: Vector, end: Step, h: Value
) -> Flag:
    """Return whether the shear stays below its record up to the next sample.

    If its second derivative is at most C, it lies at most C z(1 − z) h²/2 above the straight line between its
    ends.
    """
    c, sigma = scene.c, state.sigma
    ends = (ground[0], state.x, state.v, a), (ground[1], *end[:3])
    first, last = jax.lax.stop_gradient([jnp.abs(shear(c, sigma, *y)) for y in ends])
    record = jax.lax.stop_gradient(present(state.shear))
    over = jax.lax.stop_gradient(_bend(scene.c, ground, (state.v[0], end.v[0]), (a[0], end.a[0]), h)) / c.g
    # Either it falls from the first end on, or the most that it can rise stays below the record.
    falls = (first <= record) & (last + 0.5 * over <= first)
    return falls | (jnp.maximum(first, last) + 0.125 * over <= record)


def _bend(
    c: Coefficients,
    ground: tuple[Value, Value],
    speeds: tuple[Value, Value],
    changes: tuple[Value, Value],
    h: Value,
) -> Value:
    """Bound h² times the second derivative in time of the beam's absolute acceleration over a sample, Eq.
    (14).

    - `c`: constants of the podium
    - `ground`: ü_g at both ends [m/s²]; it is linear in between and does not contribute itself
    - `speeds`, `changes`: θ̇ [rad/s] and θ̈ [rad/s²] at both ends
    - `h`: length of the step [s]
    """
    speed, change = (jnp.maximum(*map(jnp.abs, pair)) for pair in (speeds, changes))
    w, wh = h * h * change, h * (speed + h * change)  # θ̈ h² and θ̇ h at most
    jerk = h * h * jnp.abs(changes[1] - changes[0])  # θ⃛ h³
    most = jnp.maximum(*map(jnp.abs, ground))
    # θ⁗ h⁴, Eq. (24): by the rotation itself, and by the change of ü_g while columns turn.
    by_angle = h * h * (c.gravity + c.ground * most) / c.inertia * (w + wh * wh)
    by_ground = 2 * h * h * c.ground / c.inertia * jnp.abs(ground[1] - ground[0]) * wh
    turns = c.sin_alpha * (4 * wh * jerk + 3 * w * w + wh**4) + 6 * wh * wh * w
    return c.two_R * (by_angle + by_ground + turns) / (h * h)
