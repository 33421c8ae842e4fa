"""The guard over a step: when and where a mode ends."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from rockjax._programs.barrier import barrier
from rockjax._types import Flag, Value, Vector

from .hermite import (
    Quintic,
    crossing,
    is_long,
    quintic,
    third_at_end,
    turning_point_or_dip,
    turns_more_than_once,
)
from .model import acceleration, demand_jet
from .ratio import safe_ratio
from .runge_kutta import Step
from .state import LoopState, Plan, Scene


class Guard(NamedTuple):
    """Guard of a mode: σθ while rocking, which may not reach 0 or the overturning angle; in full contact the
    demand q, within ±q_up.

    Over a step it is monotone on both sides of at most one turning point. Everything but the two paths and
    `ending` is a constant for derivatives.
    """

    path: Quintic  # over the step, z ∈ [0, 1]
    at_end: Quintic  # a cubic in the time past the end of the step
    rising: Flag  # at the start …
    rises_on: Flag  # … and at the end
    turned: Flag
    turn: Value  # the turning point, 1 where there is none
    top: Value  # the value there
    last: Value  # the value at the end
    breaks_before_turn: Flag  # broken before the turning point …
    breaks_after_turn: Flag  # … or after it
    inside: Value  # where it breaks
    ending: Quintic  # distance to breaking, in the time past the end of the step …
    time_past_end: Value  # … and its root …
    converges: Flag  # … if Newton converges to it
    turns_twice: Flag  # it turns more than once, and may break in between


def watch(
    scene: Scene, plan: Plan, state: LoopState, ground_at, h: Value, a0: Vector, end: Step, fresh: Flag
) -> Guard:
    """Return the guard over a trial step.

    - `scene`, `plan`: the prepared scene and its static choices
    - `state`: state at the start of the step
    - `ground_at`: t ↦ ground acceleration on the present piece of the excitation [m/s²]
    - `h`: length of the step [s]
    - `a0`: accelerations at its start
    - `end`: state and accelerations at its end
    - `fresh`: whether the step starts on θ = 0, after an impact or an uplift
    """
    constant = jax.lax.stop_gradient
    rocking = state.sigma != 0
    path, at_end = barrier(_paths(scene, plan, state, ground_at, h, a0, end))
    fixed: Quintic = constant(path)
    one = jnp.ones_like(h)
    rising = (fixed.c1 > 0) | ((fixed.c1 == 0) & (fixed.c2 > 0)) | fresh
    rises_on = constant(at_end.c1) > 0
    turned = rising != rises_on
    # Without the barrier every kernel that needs these would compute them again.
    rising, rises_on, turned = barrier((rising, rises_on, turned))
    turn, dips = turning_point_or_dip(fixed, turned, rising)
    turn = jnp.where(turned, turn, one)
    last = constant(at_end.c0)
    top = jnp.where(turned, fixed.value(turn), last)
    turn, top = barrier((turn, top))
    overturn_angle = constant(scene.overturn_angle)
    uplift = constant(scene.c.uplift)

    def broken(value):
        return jnp.where(rocking, (value < 0) | (value >= overturn_angle), jnp.abs(value) > uplift)

    breaks_before_turn = turned & broken(top)
    breaks_after_turn = broken(last) & ~breaks_before_turn
    breaks_before_turn, breaks_after_turn = barrier((breaks_before_turn, breaks_after_turn))
    edge = jnp.where(breaks_before_turn, top, last)
    margin = constant(_margin(scene, rocking, path, edge, edge < 0))
    inside = crossing(
        margin, jnp.where(breaks_after_turn & turned, turn, 0.0), jnp.where(breaks_before_turn, turn, one)
    )
    ending = _margin(scene, rocking, at_end, last, ~rises_on)
    rounding = 8 * jnp.finfo(h.dtype).eps * jnp.where(rocking, overturn_angle, uplift)
    time_past_end, converges = _newton_to(ending, 0.5 * h, rounding)
    busy = rocking | (sum(jnp.abs(k) for k in fixed) > uplift)  # else no lift is possible
    turns_twice = turns_more_than_once(fixed, rising, rises_on, dips & is_long(h, scene.max_step)) & busy
    ending, inside, time_past_end, converges, turns_twice = barrier(
        (ending, inside, time_past_end, converges, turns_twice)
    )
    return Guard(
        path,
        at_end,
        rising,
        rises_on,
        turned,
        turn,
        top,
        last,
        breaks_before_turn,
        breaks_after_turn,
        inside,
        ending,
        time_past_end,
        converges,
        turns_twice,
    )


def _paths(
    scene: Scene, plan: Plan, state: LoopState, ground_at, h: Value, a0: Vector, end: Step
) -> tuple[Quintic, Quintic]:
    """Return the guard over the step as a quintic, and past its end as a cubic in time.

    The guard is σθ while rocking and the demand q in full contact, whose derivatives follow from linearity.
    Over a very short step the slopes of the quintic are differences of nearly equal numbers, so the cubic at
    the end uses the slopes of the step itself.
    """
    c, sigma = scene.c, state.sigma
    angle = tuple(sigma * y for y in (state.x[0], state.v[0], a0[0], end.x[0], end.v[0], end.a[0]))
    if not plan.follows_contact:
        return _through(angle, h, scene.max_step)

    def jet(t, x, v, a):
        one = jnp.ones_like(t)
        rate = lambda s: jax.jvp(ground_at, (s,), (one,))[1]
        g0, (g1, g2) = ground_at(t), jax.jvp(rate, (t,), (one,))
        jerk = acceleration(
            c, jnp.zeros_like(t), g1, (jnp.zeros_like(t), *v[1:]), (jnp.zeros_like(t), *a[1:])
        )
        return demand_jet(c, (g0, g1, g2), ((x, v), (v, a), (a, jerk)))

    demand = (*jet(state.t, state.x, state.v, a0), *jet(state.t + h, end.x, end.v, end.a))
    return _through(
        (jnp.where(sigma != 0, y, q) for y, q in zip(angle, demand, strict=True)), h, scene.max_step
    )


def _through(ends: Iterable[Value], h: Value, max_step: Value) -> tuple[Quintic, Quintic]:
    """Return the quintic through (value, slope, curvature) at both ends of a step, and the cubic at
    its end."""
    x0, v0, a0, x1, v1, a1 = ends
    zero = jnp.zeros_like(x1)
    path = quintic(x0, v0, a0, x1, v1, a1, h)
    third = safe_ratio(third_at_end(path, a0, a1, h, max_step), h**3, h > 0)
    return path, Quintic(x1, v1, 0.5 * a1, third, zero, zero)


def _margin(scene: Scene, rocking: Flag, guard: Quintic, edge: Value, falling: Flag) -> Quintic:
    """Return the distance to breaking of the guard: to impact or overturning while rocking, to uplift in full
    contact."""
    sign = jnp.where(rocking, jnp.where(falling, 1.0, -1.0), -jnp.sign(edge))
    sign = barrier(sign)
    limit = jnp.where(rocking, jnp.where(falling, 0.0, scene.overturn_angle), scene.c.uplift)
    scaled = Quintic(*(sign * k for k in guard))
    return barrier(scaled._replace(c0=scaled.c0 + limit))


def _newton_to(margin: Quintic, most: Value, rounding: Value) -> tuple[Value, Flag]:
    """Return the root of the margin past the end of the step [s], limited to ±`most`, and whether the margin
    falls to zero there. Both are constants for derivatives."""
    margin = jax.lax.stop_gradient(margin)
    time_past_end = jnp.zeros_like(margin.c0)
    falls = margin.c1 < 0
    for _ in range(3):
        slope = margin.slope(time_past_end)
        time_past_end = time_past_end - safe_ratio(margin.value(time_past_end), slope, falls & (slope < 0))
        time_past_end = barrier(jnp.clip(time_past_end, -most, most))
    # Newton converges slowly to a margin that only touches zero.
    arrives = jnp.abs(margin.value(time_past_end)) <= 1e-3 * jnp.abs(margin.c0) + rounding
    return time_past_end, falls & arrives
