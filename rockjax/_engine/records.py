"""What a step leaves in the records: the largest rotation, deformation and shear, and the least overturning
margin."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from rockjax._types import Flag, Value, Vector

from . import margin
from .attempt import Attempt, StepOutcome
from .guard import Guard
from .hermite import quintic
from .maxima import WELL_INSIDE_CUBIC, End, Maximum, cubic, largest, spring, summit
from .model import acceleration, beam, beam_acceleration, shear
from .ratio import safe_ratio
from .state import LoopState, Plan, Scene, Turn, present


def step_peak(
    scene: Scene,
    state: LoopState,
    trial: Attempt,
    guard: Guard,
    outcome: StepOutcome,
    hit: Flag,
    toppled: Flag,
    now: Value,
) -> tuple[Value, Value]:
    """The largest |θ| of the step and its time, with their derivatives."""
    end = summit(guard.path, 1.0)
    at_stop = jnp.where(end == 1, guard.at_end.value(outcome.after), guard.path.value(end))
    end_angle = jnp.where(hit, 0.0, jnp.where(toppled, scene.overturn_angle, at_stop))
    peak = guard.path.value(guard.turn)
    at_turn = outcome.peaks & (peak > end_angle)
    crest = jnp.where(at_turn, guard.turn, end)
    on_crest = at_turn | (~outcome.lands & (end != 1))
    off = safe_ratio(guard.path.slope(crest), guard.path.curvature(crest), on_crest)
    time = jnp.where(on_crest, state.t + trial.h * (crest - jnp.clip(off, -1.0, 1.0)), now)
    return jnp.where(at_turn, peak, end_angle), time


def turn_at_peak(
    scene: Scene, plan: Plan, state: LoopState, ground_at, trial: Attempt, guard: Guard, peaks: Flag
) -> Turn:
    """A maximum of |θ| at the guard's turning point."""
    h, sigma, path = trial.h, state.sigma, guard.path
    off = safe_ratio(path.slope(guard.turn), path.curvature(guard.turn), peaks)
    z = guard.turn - jnp.clip(off, -1.0, 1.0)  # moves with the parameters
    theta = path.value(z)
    x, v = (sigma * theta,), (jnp.zeros_like(h),)
    if plan.elastic:
        sway = quintic(state.x[1], state.v[1], trial.a0[1], trial.end.x[1], trial.end.v[1], trial.end.a[1], h)
        x, v = (*x, sway.value(z)), (*v, safe_ratio(sway.slope(z), h, h > 0))
    slowing = -sigma * acceleration(scene.c, sigma, ground_at(state.t + z * h), x, v)[0]
    here = margin.at_turn(scene.c, scene.overturn_angle, theta, slowing)
    return Turn(*(jnp.where(peaks, y, jnp.inf) for y in (here, slowing)))


def least_margin(
    scene: Scene, state: LoopState, outcome: StepOutcome, x: Vector, v: Vector, toppled: Flag, stamp: Value
) -> Value:
    """The overturning margin so far, after an accepted step to the state (x, v)."""
    before = present(state.margin)
    least = jnp.where(outcome.peaks & (outcome.turn.margin < before), outcome.turn.margin, before)
    # Out of time on the way up: what is left from there.
    rises = (stamp >= jax.lax.stop_gradient(scene.end)) & (x[0] * v[0] > 0)
    here = margin.at_rest(scene.c, scene.overturn_angle, jnp.abs(x[0]))
    least = jnp.where(rises & (here < least), here, least)
    return jnp.where(toppled, margin.at_fall(scene.c, scene.overturn_angle, v[0]), least)


def superstructure_maxima(
    scene: Scene, plan: Plan, state: LoopState, ground_at, trial: Attempt, before: Value, after: Value
) -> tuple[Maximum, Maximum]:
    """Largest deformation and shear of the superstructure over the step, where they are wanted.

    The step begins `before` and ends `after` its time stamps.
    """
    c, h, sigma, a0, end = scene.c, trial.h, state.sigma, trial.a0, trial.end
    none = Maximum(jnp.zeros_like(h), jnp.full_like(h, jnp.inf))
    if plan.elastic and (plan.deformation or plan.shear):
        jets: list[tuple[Value, Value, Value]] = []
        for x, v, a in ((state.x, state.v, a0), (end.x, end.v, end.a)):
            u_b, u_b_dot = beam(c, sigma, x[0], v[0])
            jets.append((x[1] - u_b, v[1] - u_b_dot, a[1] - beam_acceleration(c, sigma, x[0], v[0], a[0])))
        path = quintic(*jets[0], *jets[1], h)
        deformation = force = none
        if plan.deformation:
            ends = (End(jets[0][0], jets[0][1], before), End(jets[1][0], jets[1][1], after))
            deformation = largest(path, h, present(state.deformation), ends)
        if plan.shear:
            first, last = ((c.omega2 * d + c.damping * r, c.omega2 * r + c.damping * s) for d, r, s in jets)
            ends = (End(*first, before), End(*last, after))
            force = largest(spring(path, c.omega2, c.damping, h), h, present(state.shear) * c.g, ends)
            force = force._replace(value=force.value / c.g)
        # The shear takes a derivative of the polynomial: it is landed on whatever the order.
        return deformation if plan.refine else deformation._replace(cut=none.cut), force
    if not plan.elastic and plan.shear:

        def along(t, x, v):
            return shear(c, sigma, ground_at(t), x, v, acceleration(c, sigma, ground_at(t), x, v))

        one = jnp.ones_like(h)
        s0, rate0 = jax.jvp(along, (state.t, state.x, state.v), (one, state.v, a0))
        s1, rate1 = jax.jvp(along, (state.t + h, end.x, end.v), (one, end.v, end.a))
        ends = (End(s0, rate0, before), End(s1, rate1, after))
        return none, largest(cubic(s0, rate0, s1, rate1, h), h, present(state.shear), ends, WELL_INSIDE_CUBIC)
    return none, none


def larger(new: Value, record: Value) -> Value:
    """The larger of two, with the derivative of one of them: `maximum` would take half of each where they
    tie."""
    return jnp.where(new > record, new, record)
