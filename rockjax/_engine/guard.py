"""The guard of a contact mode over a step, and the time at which it leaves its limits.

A contact mode (full contact, or rocking to one side) lasts as long as a quantity, its guard, stays within
limits. The guard breaks when it leaves these limits. Then an event occurs: an impact, overturning or an
uplift. A turning point is a maximum or minimum of the guard in time.
"""

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
    """The guard over a trial step.

    While rocking the guard is σθ, with the limits 0 and the overturning angle. In full contact it is the
    uplift demand q, with the limits ±q_up, Eq. (9) of docs/model.md.

    The fields are valid if there is at most one turning point. If there may be more, `turns_twice` is True,
    and the step is halved. All fields but `path`, `at_end` and `clearance_at_end` are held constant under
    differentiation. z is the time since the start of the step, divided by its length.
    """

    path: Quintic  # the guard over the step, as a function of z ∈ [0, 1]
    at_end: Quintic  # the guard as a cubic in the time past the end of the step [s]
    rising: Flag  # the guard increases at the start
    rising_at_end: Flag  # the guard increases at the end
    turned: Flag  # the guard has a turning point: its slopes at start and end have opposite signs
    turn: Value  # z of the turning point; 1 if there is none
    turn_value: Value  # value at the turning point; `end_value` if there is none
    end_value: Value  # value at the end of the step
    breaks_before_turn: Flag  # the guard is outside its limits at the turning point
    breaks_after_turn: Flag  # the guard is outside its limits at the end, but not at the turning point
    break_point: Value  # z at which the guard breaks; valid if it breaks in the step
    # Signed distance of the guard to the limit that it approaches at the end, positive inside the limits, as
    # a cubic in the time past the end of the step [s].
    clearance_at_end: Quintic
    # Time from the end of the step to the event, the root of `clearance_at_end` [s]; valid if `converges`.
    time_past_end: Value
    converges: Flag  # Newton's method converges to this root
    turns_twice: Flag  # the guard turns more than once, and may break between the turning points


def evaluate_guard(
    scene: Scene,
    plan: Plan,
    state: LoopState,
    ground_at,
    h: Value,
    a0: Vector,
    end: Step,
    starts_at_zero: Flag,
) -> Guard:
    """Return the guard over a trial step.

    - `scene`: the prepared scene; `plan`: settings that are fixed at compilation, such as the outputs
    - `state`: state at the start of the step
    - `ground_at`: t ↦ ground acceleration on the present piece of the excitation [m/s²]
    - `h`: length of the step [s]
    - `a0`: accelerations at the start of the step
    - `end`: state and accelerations at the end of the step
    - `starts_at_zero`: True if the step starts rocking from θ = 0, after an impact or an uplift
    """
    constant = jax.lax.stop_gradient
    rocking = state.sigma != 0
    path, at_end = barrier(_paths(scene, plan, state, ground_at, h, a0, end))
    fixed: Quintic = constant(path)
    one = jnp.ones_like(h)
    rising = (fixed.c1 > 0) | ((fixed.c1 == 0) & (fixed.c2 > 0)) | starts_at_zero
    rising_at_end = constant(at_end.c1) > 0
    turned = rising != rising_at_end
    # With the barrier, XLA computes these flags only once.
    rising, rising_at_end, turned = barrier((rising, rising_at_end, turned))
    turn, dips = turning_point_or_dip(fixed, turned, rising)
    turn = jnp.where(turned, turn, one)
    end_value = constant(at_end.c0)
    turn_value = jnp.where(turned, fixed.value(turn), end_value)
    turn, turn_value = barrier((turn, turn_value))
    overturn_angle = constant(scene.overturn_angle)
    uplift = constant(scene.c.uplift)

    def is_broken(value):
        return jnp.where(rocking, (value < 0) | (value >= overturn_angle), jnp.abs(value) > uplift)

    breaks_before_turn = turned & is_broken(turn_value)
    breaks_after_turn = is_broken(end_value) & ~breaks_before_turn
    breaks_before_turn, breaks_after_turn = barrier((breaks_before_turn, breaks_after_turn))
    broken_value = jnp.where(breaks_before_turn, turn_value, end_value)
    clearance = constant(_clearance(scene, rocking, path, broken_value, broken_value < 0))
    break_point = crossing(
        clearance, jnp.where(breaks_after_turn & turned, turn, 0.0), jnp.where(breaks_before_turn, turn, one)
    )
    clearance_at_end = _clearance(scene, rocking, at_end, end_value, ~rising_at_end)
    rounding = 8 * jnp.finfo(h.dtype).eps * jnp.where(rocking, overturn_angle, uplift)
    time_past_end, converges = _newton_root(clearance_at_end, 0.5 * h, rounding)
    # On z ∈ [0, 1] |q| cannot exceed the sum of the absolute values of the coefficients of q. In full contact
    # the guard can therefore break only if this sum exceeds the threshold.
    may_break = rocking | (sum(jnp.abs(k) for k in fixed) > uplift)
    dips &= is_long(h, scene.max_step)
    turns_twice = turns_more_than_once(fixed, rising, rising_at_end, dips) & may_break
    clearance_at_end, break_point, time_past_end, converges, turns_twice = barrier(
        (clearance_at_end, break_point, time_past_end, converges, turns_twice)
    )
    return Guard(
        path,
        at_end,
        rising,
        rising_at_end,
        turned,
        turn,
        turn_value,
        end_value,
        breaks_before_turn,
        breaks_after_turn,
        break_point,
        clearance_at_end,
        time_past_end,
        converges,
        turns_twice,
    )


def _paths(
    scene: Scene, plan: Plan, state: LoopState, ground_at, h: Value, a0: Vector, end: Step
) -> tuple[Quintic, Quintic]:
    """Return the guard over the step as a quintic in z, and near the end of the step as a cubic in the time
    past the end.

    In full contact `demand_jet` computes the derivatives of the guard in time. The cubic matches value, slope
    and curvature of the guard at the end of the step exactly. Over a very short step, the slopes and
    curvatures of the quintic are inaccurate, because they are differences of nearly equal numbers.
    """
    c, sigma = scene.c, state.sigma
    angle = tuple(sigma * y for y in (state.x[0], state.v[0], a0[0], end.x[0], end.v[0], end.a[0]))
    if not plan.follows_contact:  # then trial steps are used only while rocking
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
    """Return the quintic over a step, and the cubic in the time past its end. `ends` contains value, slope
    and curvature at the start, then at the end."""
    x0, v0, a0, x1, v1, a1 = ends
    zero = jnp.zeros_like(x1)
    path = quintic(x0, v0, a0, x1, v1, a1, h)
    third = safe_ratio(third_at_end(path, a0, a1, h, max_step), h**3, h > 0)
    return path, Quintic(x1, v1, 0.5 * a1, third, zero, zero)


def _clearance(scene: Scene, rocking: Flag, guard: Quintic, value: Value, falling: Flag) -> Quintic:
    """Return the signed distance of the guard to one of its limits, positive inside the limits.

    - `scene`, `rocking`: the prepared scene, and whether the columns rock
    - `guard`: the guard as a polynomial
    - `value`: in full contact, a value of the guard, whose sign selects the threshold +q_up or −q_up
    - `falling`: while rocking, True selects the limit 0 (impact), False the overturning angle
    """
    sign = jnp.where(rocking, jnp.where(falling, 1.0, -1.0), -jnp.sign(value))
    sign = barrier(sign)
    limit = jnp.where(rocking, jnp.where(falling, 0.0, scene.overturn_angle), scene.c.uplift)
    scaled = Quintic(*(sign * k for k in guard))
    return barrier(scaled._replace(c0=scaled.c0 + limit))


def _newton_root(clearance: Quintic, max_shift: Value, rounding: Value) -> tuple[Value, Flag]:
    """Find the root of the clearance near the end of the step by Newton's method.

    - `clearance`: polynomial in the time past the end of the step [s]
    - `max_shift`: largest time between the root and the end of the step [s]
    - `rounding`: clearances up to this size count as zero

    Returns the time of the root past the end [s], and whether Newton's method has converged to a root at
    which the clearance decreases. Both are held constant under differentiation.
    """
    clearance = jax.lax.stop_gradient(clearance)
    time_past_end = jnp.zeros_like(clearance.c0)
    decreases = clearance.c1 < 0
    for _ in range(3):
        slope = clearance.slope(time_past_end)
        time_past_end -= safe_ratio(clearance.value(time_past_end), slope, decreases & (slope < 0))
        time_past_end = barrier(jnp.clip(time_past_end, -max_shift, max_shift))
    # If the clearance only touches zero, Newton's method converges too slowly to pass this test.
    is_root = jnp.abs(clearance.value(time_past_end)) <= 1e-3 * jnp.abs(clearance.c0) + rounding
    return time_past_end, decreases & is_root
