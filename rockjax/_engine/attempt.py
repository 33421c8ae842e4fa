"""A trial step: its length, its error, the state at an event close to its end, and the length of the next
step.

A trial step is a step that may still be rejected, or shortened to end on an event. It ends at the next
breakpoint of the excitation (a time at which the ground motion has a jump or a kink) at the latest.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from rockjax._excitations.sampled import AbstractSampled
from rockjax._programs.barrier import barrier
from rockjax._types import Flag, Value, Vector

from .coefficients import Coefficients, divided_by_inertia, summed
from .hermite import Quintic, crossing, is_long, quintic, third_at_end
from .model import acceleration, steady_step
from .ratio import safe_ratio
from .runge_kutta import Acceleration, Step
from .runge_kutta import step as runge_kutta
from .state import Decision, LoopState, Plan, Scene

# An event or breakpoint counts as simultaneous with the end of the scene if it precedes the end by less than
# this multiple of `Attempt.time_resolution`.
SIMULTANEOUS = 100
# Step-size control: safety factor, and the limits of the factor from one step length to the next.
SAFETY, SHRINK, GROW = 0.85, 0.2, 5.0
# Largest |y| in the power series of `_length` for the time from θ = 0 to the next impact. For y > 1 the
# estimated θ never returns to 0.
MAX_SERIES_ARGUMENT = 0.8
GroundAcceleration = Callable[[Value], Value]  # t [s] ↦ ground acceleration on one piece [m/s²]


class Attempt(NamedTuple):
    """A trial step and its accuracy."""

    h: Value  # length of the step [s]
    reaches_stop: Flag  # the step ends at `stop`
    stop: Value  # latest end of the step: the next breakpoint or the end of the scene, with derivatives [s]
    ends_scene: Flag  # the step ends at the end of the scene
    starts_at_zero: Flag  # the step starts rocking from θ = 0, after an impact or an uplift
    a0: Vector  # accelerations at the start
    end: Step  # state, accelerations and error estimates at the end
    error: Value  # estimated error divided by the tolerance
    growth: Value  # factor from the length of this trial to that of the next, according to the error
    finite: Flag  # the error is neither inf nor NaN
    # The error is finite, and it is within the tolerance or the step cannot be shortened any further.
    accurate: Flag
    time_resolution: Value  # shorter times are rounding errors [s]


class StepOutcome(NamedTuple):
    """Outcome of a trial: whether the step is accepted or must be shortened, and the event at its end."""

    accepted: Flag
    retry_fraction: Value  # length of the next trial divided by that of this one; inf if none is needed
    lands: Flag  # the step ends on an event, or so close to it that a Taylor expansion covers the rest
    after: Value  # time from the end of the step to the event or breakpoint there, with derivatives [s]
    false_uplift: Flag  # the uplift before the step was a rounding error; the columns return to full contact
    largest: tuple[Any, ...]  # largest value of each output in the step; None for outputs without a maximum


def attempt(scene: Scene, plan: Plan, state: LoopState, ground_at, replayed: Decision | None) -> Attempt:
    """Take one step from a state, without a search for events.

    - `scene`: the prepared scene; `plan`: settings that are fixed at compilation, such as the tableau
    - `state`: state at the start of the step
    - `ground_at`: t ↦ ground acceleration on the present piece of the excitation [m/s²]
    - `replayed`: recorded decision of an accepted step, which fixes the length; None if the length is free

    Returns the `Attempt`. Its error is held constant under differentiation.
    """
    constant = jax.lax.stop_gradient
    c, t = divided_by_inertia(scene.c), state.t

    @jax.jit  # JAX traces the function once for all stages of the step
    def field(t, x, v):
        return acceleration(c, state.sigma, ground_at(t), x, v)

    time_resolution = 1e-13 * (jnp.abs(t) + 1 / constant(c.p))
    next_breakpoint = scene.excitation.breakpoint(state.piece)
    # A step ends at the next breakpoint at the latest. A breakpoint just before the end of the scene is
    # ignored, so that the end time of the last step is differentiated as the end of the scene and not as the
    # breakpoint.
    is_last = constant(scene.end) <= constant(next_breakpoint) + SIMULTANEOUS * time_resolution
    stop = jnp.where(is_last, scene.end, next_breakpoint)
    a0 = field(t, state.x, state.v)
    starts_at_zero = (state.sigma != 0) & (state.x[0] == 0)
    jerk = (
        _jerk(state, field, a0)
        if plan.follows_impacts or isinstance(scene.excitation, AbstractSampled)
        else None
    )
    h, reaches_stop = _length(scene, state, constant(a0[0]), jerk, starts_at_zero, constant(stop))
    if replayed is not None:
        h, reaches_stop = replayed.h, replayed.reaches_stop
    h, reaches_stop, a0, stop, is_last = barrier((h, reaches_stop, a0, stop, is_last))
    end = barrier(runge_kutta(plan.tableau, field, t, h, state.x, state.v, a0))
    error = constant(scaled_error(scene, state.x, state.v, end))
    if scene.estimate_factor is not None:
        error = error * scene.estimate_factor
    finite = jnp.isfinite(error)
    return Attempt(
        h,
        reaches_stop,
        stop,
        reaches_stop & is_last,
        starts_at_zero,
        a0,
        end,
        error,
        barrier(step_factor(plan, error)),
        finite,
        finite & ((error <= 1) | (h < time_resolution)),
        time_resolution,
    )


def _length(
    scene: Scene, state: LoopState, theta_ddot: Value, jerk: Value | None, starts_at_zero: Flag, stop: Value
) -> tuple[Value, Flag]:
    """Return the length of the trial [s], and whether the trial ends at the time `stop`.

    - `scene`, `state`: the prepared scene, and the state at the start of the step
    - `theta_ddot`, `jerk`: θ̈ [rad/s²] and d³θ/dt³ [rad/s³] at the start; `jerk` may be None
    - `starts_at_zero`: True if the step starts rocking from θ = 0
    - `stop`: time of the next breakpoint or of the end of the scene [s]
    """
    remaining = stop - state.t
    # The comment above `SPLIT` in scene.py explains how steps divide the remaining time.
    covers_remaining = (state.h > 0.999 * remaining) & (
        (state.h < 1.001 * remaining) | (state.h > scene.unsplit_limit * remaining)
    )
    split = jnp.where(state.h > 0.5 * remaining, scene.split_fraction * remaining, state.h)
    h = jnp.where(covers_remaining, remaining, split)
    # A step that starts at θ = 0 covers at most one hop, the motion up to the next impact. A hop with
    # constant θ̈ lasts 2|θ̇/θ̈|.
    theta_dot = jax.lax.stop_gradient(state.v[0])
    returns = starts_at_zero & (theta_dot * theta_ddot < 0)
    safe_theta_ddot = jnp.where(returns, theta_ddot, 1.0)
    hop = jnp.where(returns, -2 * theta_dot / safe_theta_ddot, jnp.inf)
    # If θ̈ is linear in time, the hop lasts 2/(1 + √(1 − y)) times as long, with
    # y = 8 θ̇ d³θ/dt³ / (3 θ̈²). The factor is computed from its power series in y.
    if jerk is not None:
        y = 8 / 3 * jerk * theta_dot / safe_theta_ddot**2
        y = jnp.where(returns, jnp.clip(y, -MAX_SERIES_ARGUMENT, MAX_SERIES_ARGUMENT), 0.0)
        hop = hop * (1 + y * (1 / 4 + y * (1 / 8 + y * 5 / 64)))
    h = jnp.minimum(h, jnp.minimum(state.trial_limit, hop))
    if jerk is not None:
        h = jnp.where(jnp.isinf(state.trial_limit), _to_impact(state, theta_ddot, jerk, h), h)
    restraint = scene.c.restraint
    if restraint is not None and restraint.steep:
        steady = jax.lax.stop_gradient(steady_step(scene.c, restraint, theta_dot, theta_ddot))
        h = jnp.where(state.sigma == 0, h, jnp.minimum(h, steady))
    return h, h >= remaining


def _to_impact(state: LoopState, theta_ddot: Value, jerk: Value, h: Value) -> Value:
    """Return the step length, shortened to the next impact if the cubic Taylor polynomial of θ in time
    predicts an impact in the step.

    Under sampled ground motions the prediction is so accurate that most trials land on the impact at once.
    """
    one, zero = jnp.ones_like(h), jnp.zeros_like(h)
    theta, theta_dot = jax.lax.stop_gradient((state.x[0], state.v[0]))
    angle, rate, curvature, jerk = (state.sigma * y for y in (theta, theta_dot, theta_ddot, jerk))
    path = barrier(Quintic(angle, h * rate, h**2 * curvature / 2, h**3 * jerk / 6, zero, zero))
    hits = (angle > 0) & (path.value(one) < 0)
    # `earliest` is a lower bound on the time to the impact, divided by h. Without this bound, a search that
    # has not converged could propose steps of almost zero length again and again.
    earliest = safe_ratio(angle, sum((jnp.abs(c) for c in path[1:]), zero), hits)
    return jnp.where(hits, h * crossing(path, earliest, one), h)


def _jerk(state: LoopState, field: Acceleration, a0: Vector) -> Value:
    """Return the jerk d³θ/dt³ at the start of the step [rad/s³], for the prediction of the next impact.

    The jerk is used only under sampled ground motions, or if an output needs every impact.
    """
    rates = jnp.ones_like(state.t), state.v, a0
    _, jerks = jax.jvp(field, (state.t, state.x, state.v), rates)
    return jax.lax.stop_gradient(jerks[0])


def scaled_error(scene: Scene, x: Vector, v: Vector, trial: Step) -> Value:
    """Return the estimated error of a step divided by the tolerance, as a root mean square over positions and
    velocities.

    - `scene`: the prepared scene, which holds the tolerances
    - `x`, `v`: positions and velocities at the start of the step
    - `trial`: the step with its error estimates

    The step is accurate enough if the result is at most 1.
    """
    x_units, v_units = natural_units(scene.c)
    total = jnp.zeros_like(x[0])
    for old, new, errors, units in (
        (x, trial.x, trial.x_error, x_units),
        (v, trial.v, trial.v_error, v_units),
    ):
        for y0, y1, error, unit in zip(old, new, errors, units, strict=True):
            tolerance = scene.atol * unit + scene.rtol * jnp.maximum(jnp.abs(y0), jnp.abs(y1))
            total = total + summed((error / tolerance) ** 2)
    # All vibration modes together count as one position and one velocity, so that modes at rest do not hide
    # the error of a moving one.
    return jnp.sqrt(total / (2 * len(x)))


def natural_units(c: Coefficients) -> tuple[Vector, Vector]:
    """Return the natural units of positions and velocities, in which tolerances are measured.

    The units of the rotation are α and pα. For a mode with the circular frequency ω, the unit of the
    displacement is u = g tan α/ω², a typical deformation at uplift, but at most 2R sin α, the displacement of
    the beam at |θ| = α. The unit of the velocity of the mode is u·max(p, ω).
    """
    x_unit, v_unit = (c.alpha,), (c.p * c.alpha,)
    if c.vibration is not None:
        omega2 = c.vibration.omega2
        u = jnp.minimum(c.two_R * c.sin_alpha, c.g * c.sin_alpha / (c.cos_alpha * omega2))
        x_unit, v_unit = (*x_unit, u), (*v_unit, u * jnp.maximum(c.p, jnp.sqrt(omega2)))
    return x_unit, v_unit


def step_factor(plan: Plan, error: Value) -> Value:
    """Return the length of the next step divided by that of the present step. `error` is the estimated error
    of the present step divided by the tolerance."""
    root = jnp.exp(-jnp.log(jnp.clip(error, 1e-30, 1e30)) / plan.tableau.order)  # cheaper than a power
    return jnp.clip(SAFETY * root, SHRINK, GROW)


def next_length(scene: Scene, state: LoopState, trial: Attempt, t: Value) -> Value:
    """Return the length that the step-size control proposes for the next step [s].

    - `scene`: the prepared scene
    - `state`, `trial`: the state before the accepted step, and the step
    - `t`: time at the end of the step [s]

    If the step was shorter than `state.h` although its error is below half the tolerance, an event, a
    breakpoint or a maximum has shortened it. The proposed length is then at least `state.h`. The proposed
    length never exceeds the longest step of the scene.
    """
    proposed = trial.h * trial.growth
    shortened = (trial.h < 0.99 * state.h) & (trial.error < 0.5)
    proposed = jnp.where(shortened, jnp.maximum(proposed, state.h), proposed)
    return jnp.minimum(proposed, jnp.where(t < scene.excitation_end, scene.max_excited_step, scene.max_step))


def state_past(scene: Scene, state: LoopState, trial: Attempt, after: Value) -> tuple[Vector, Vector]:
    """Return positions and velocities shortly before or after the end of a step, by Taylor expansion from the
    end.

    - `scene`: the prepared scene
    - `state`, `trial`: the state before the step, and the step
    - `after`: time past the end of the step, negative before the end [s]

    The quintic through both ends of the step gives the third to fifth derivatives. If the step is very short,
    the third derivative is its mean over the step, and the fourth and fifth are zero.
    """
    h = trial.h
    z = safe_ratio(after, h, h > 0)
    x, v = [], []
    for x0, v0, a0, x1, v1, a1 in zip(
        state.x, state.v, trial.a0, trial.end.x, trial.end.v, trial.end.a, strict=True
    ):
        path, long = quintic(x0, v0, a0, x1, v1, a1, h), is_long(h, scene.max_step)
        # d3, d4, d5: third to fifth derivative at the end with respect to z, divided by 3!, 4!, 5!.
        d3 = third_at_end(path, a0, a1, h, scene.max_step)
        d4, d5 = jnp.where(long, path.c4 + 5 * path.c5, 0.0), jnp.where(long, path.c5, 0.0)
        x.append(x1 + after * (v1 + 0.5 * after * a1) + z**3 * (d3 + z * (d4 + z * d5)))
        v.append(v1 + after * a1 + safe_ratio(z**2 * (3 * d3 + z * (4 * d4 + z * 5 * d5)), h, h > 0))
    return tuple(x), tuple(v)
