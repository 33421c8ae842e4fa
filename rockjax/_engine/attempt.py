"""A trial step: its length, its error, its outcome and the length of the next step."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from rockjax._excitations.sampled import AbstractSampled
from rockjax._programs.barrier import barrier
from rockjax._types import Flag, Value, Vector

from .coefficients import Coefficients, over_inertia, summed
from .hermite import Quintic, crossing, is_long, quintic, third_at_end
from .model import acceleration, steady_for
from .ratio import safe_ratio
from .runge_kutta import Acceleration, Step
from .runge_kutta import step as runge_kutta
from .state import Decision, LoopState, Plan, Scene

# Times the resolution of time: the end of the scene and an event this close to it count as simultaneous.
AT_ONCE = 100
SAFETY, SHRINK, GROW = 0.85, 0.2, 5.0  # of the step-size control
MOST_BENT = 0.8  # limit of 8 θ̇ d³θ/dt³ / (3 θ̈²) over a hop; above 1 the columns would not return
GroundMotion = Callable[[Value], Value]  # t ↦ ü_g(t) on one piece


class Attempt(NamedTuple):
    """A trial step and its accuracy."""

    h: Value
    reaches: Flag  # the stop
    stop: Value  # the next breakpoint or the end of the scene; moves with the parameters
    ends: Flag  # the scene
    fresh: Flag  # on θ = 0, after an impact or an uplift
    a0: Vector
    end: Step
    error: Value  # over tolerance
    growth: Value  # factor on the step length that this error allows for the next step
    finite: Flag
    accurate: Flag
    tiny: Value  # the resolution of time


class StepOutcome(NamedTuple):
    """Outcome of a trial: accepted, shortened or rejected, and the events at its end."""

    accepted: Flag
    cut: Value  # fraction of the step to try instead; inf where no shorter step is needed
    lands: Flag  # ends on an event …
    after: Value  # … this long after its end; also carries the derivative of the time of a breakpoint
    false_uplift: Flag  # a lift that the next step does not confirm: back to full contact
    largest: tuple[Any, ...]  # value of each output over the step; None for those without


def attempt(scene: Scene, plan: Plan, state: LoopState, ground_at, replayed: Decision | None) -> Attempt:
    """Try one step from a state, without judging its events.

    - `scene`, `plan`: the prepared scene and its static choices
    - `state`: state at the start of the step
    - `ground_at`: t ↦ ground acceleration on the present piece of the excitation [m/s²]
    - `replayed`: recorded decision of an accepted step, whose length is used; None for a free choice

    Returns the `Attempt`. Its error is a constant for derivatives.
    """
    constant = jax.lax.stop_gradient
    c, t = over_inertia(scene.c), state.t

    @jax.jit  # traced once for all stages
    def field(t, x, v):
        return acceleration(c, state.sigma, ground_at(t), x, v)

    # A step reaches the next breakpoint at most, and covers a hop at once.
    tiny = 1e-13 * (jnp.abs(t) + 1 / constant(c.p))
    edge = scene.excitation.breakpoint(state.piece)
    # A breakpoint just before the end of the scene is ignored: the step ends with the scene, and moves with
    # its end.
    last = constant(scene.end) <= constant(edge) + AT_ONCE * tiny
    stop = jnp.where(last, scene.end, edge)
    a0 = field(t, state.x, state.v)
    fresh = (state.sigma != 0) & (state.x[0] == 0)
    jerk = (
        _jerk(state, field, a0)
        if plan.follows_impacts or isinstance(scene.excitation, AbstractSampled)
        else None
    )
    h, reaches = _length(scene, state, constant(a0[0]), jerk, fresh, constant(stop))
    if replayed is not None:
        h, reaches = replayed.h, replayed.reaches
    h, reaches, a0, stop, last = barrier((h, reaches, a0, stop, last))
    end = barrier(runge_kutta(plan.tableau, field, t, h, state.x, state.v, a0))
    error = constant(over_tolerance(scene, state.x, state.v, end))
    if scene.estimate_factor is not None:
        error = error * scene.estimate_factor
    finite = jnp.isfinite(error)
    return Attempt(
        h,
        reaches,
        stop,
        reaches & last,
        fresh,
        a0,
        end,
        error,
        barrier(factor(plan, error)),
        finite,
        finite & ((error <= 1) | (h < tiny)),
        tiny,
    )


def _length(
    scene: Scene, state: LoopState, angular: Value, jerk: Value | None, fresh: Flag, stop: Value
) -> tuple[Value, Flag]:
    """Return the length of the trial [s], and whether it reaches the stop."""
    room = stop - state.t
    takes_all = (state.h > 0.999 * room) & ((state.h < 1.001 * room) | (state.h > scene.unsplit_limit * room))
    h = jnp.where(takes_all, room, jnp.where(state.h > 0.5 * room, scene.split_fraction * room, state.h))
    # After an impact θ̈ is nearly constant over a short hop, which lasts 2|θ̇/θ̈| …
    speed = jax.lax.stop_gradient(state.v[0])
    returns = fresh & (speed * angular < 0)
    falls = jnp.where(returns, angular, 1.0)
    hop = jnp.where(returns, -2 * speed / falls, jnp.inf)
    if jerk is not None:  # … or follows a straight line: 2/(1 + √(1 − y)) times as long, as a series
        y = jnp.where(returns, jnp.clip(8 / 3 * jerk * speed / falls**2, -MOST_BENT, MOST_BENT), 0.0)
        hop = hop * (1 + y * (1 / 4 + y * (1 / 8 + y * 5 / 64)))
    h = jnp.minimum(h, jnp.minimum(state.cut, hop))
    if jerk is not None:
        h = jnp.where(jnp.isinf(state.cut), _to_impact(state, angular, jerk, h), h)
    restraint = scene.c.restraint
    if restraint is not None and restraint.steep:
        steady = jax.lax.stop_gradient(steady_for(scene.c, restraint, speed, angular))
        h = jnp.where(state.sigma == 0, h, jnp.minimum(h, steady))
    return h, h >= room


def _to_impact(state: LoopState, angular: Value, jerk: Value, h: Value) -> Value:
    """Shorten the step to the impact that a cubic of θ predicts. Between samples of a record the prediction
    is so close that most impacts are landed on at the first trial."""
    one, zero = jnp.ones_like(h), jnp.zeros_like(h)
    theta, speed = jax.lax.stop_gradient((state.x[0], state.v[0]))
    left, speed, angular, jerk = (state.sigma * y for y in (theta, speed, angular, jerk))
    ahead = barrier(Quintic(left, h * speed, h**2 * angular / 2, h**3 * jerk / 6, zero, zero))
    meets = (left > 0) & (ahead.value(one) < 0)
    return jnp.where(meets, h * crossing(ahead, zero, one), h)


def _jerk(state: LoopState, field: Acceleration, a0: Vector) -> Value:
    """Return d³θ/dt³ at the start of the step, which predicts the next impact. It is used under records, and
    under pulses where all impacts are requested: a bouncing column has many."""
    rates = jnp.ones_like(state.t), state.v, a0
    _, jerks = jax.jvp(field, (state.t, state.x, state.v), rates)
    return jax.lax.stop_gradient(jerks[0])


def over_tolerance(scene: Scene, x: Vector, v: Vector, trial: Step) -> Value:
    """Return the root mean square of a step's estimated error over tolerance, in natural units.

    - `scene`: the prepared scene, which holds the tolerances
    - `x`, `v`: positions and velocities at the start of the step
    - `trial`: the step with its error estimates

    A step is accurate where the result is at most 1.
    """
    x_unit, v_unit = units(scene.c)
    total = jnp.zeros_like(x[0])
    for old, new, error, of_each in (
        (x, trial.x, trial.x_error, x_unit),
        (v, trial.v, trial.v_error, v_unit),
    ):
        for y0, y1, e, unit in zip(old, new, error, of_each, strict=True):
            scale = scene.atol * unit + scene.rtol * jnp.maximum(jnp.abs(y0), jnp.abs(y1))
            total = total + summed((e / scale) ** 2)
    # Divided by the number of degrees of freedom, not of modes: many modes at rest would hide one that moves.
    return jnp.sqrt(total / (2 * len(x)))


def units(c: Coefficients) -> tuple[Vector, Vector]:
    """Return natural units of positions and velocities: α and pα for the rotation. The unit of the
    superstructure is its deformation at uplift, g tan α/ω², or the sway of the beam's corner if that is
    smaller."""
    x_unit, v_unit = (c.alpha,), (c.p * c.alpha,)
    if c.vibration is not None:
        omega2 = c.vibration.omega2
        sway = jnp.minimum(c.two_R * c.sin_alpha, c.g * c.sin_alpha / (c.cos_alpha * omega2))
        x_unit, v_unit = (*x_unit, sway), (*v_unit, sway * jnp.maximum(c.p, jnp.sqrt(omega2)))
    return x_unit, v_unit


def factor(plan: Plan, error: Value) -> Value:
    """Return the factor on the step length that this error allows."""
    root = jnp.exp(-jnp.log(jnp.clip(error, 1e-30, 1e30)) / plan.tableau.order)  # a power takes longer
    return jnp.clip(SAFETY * root, SHRINK, GROW)


def next_length(scene: Scene, state: LoopState, trial: Attempt, t: Value) -> Value:
    """Return the controller's next step length [s].

    - `scene`: the prepared scene
    - `state`, `trial`: state before the accepted step, and that step
    - `t`: time at its end [s]

    A step that an event or a breakpoint has shortened does not reduce the controller's length.
    """
    proposed = trial.h * trial.growth
    shortened = (trial.h < 0.99 * state.h) & (trial.error < 0.5)
    proposed = jnp.where(shortened, jnp.maximum(proposed, state.h), proposed)
    return jnp.minimum(proposed, jnp.where(t < scene.excitation_end, scene.max_excited_step, scene.max_step))


def state_past(scene: Scene, state: LoopState, trial: Attempt, after: Value) -> tuple[Vector, Vector]:
    """Return positions and velocities shortly after the end of a step, by Taylor expansion from the end.

    - `scene`: the prepared scene
    - `state`, `trial`: state before the step, and the step
    - `after`: time past the end of the step [s]

    Third to fifth derivatives are those of the quintic through both ends.
    """
    h = trial.h
    z = safe_ratio(after, h, h > 0)
    x, v = [], []
    for x0, v0, a0, x1, v1, a1 in zip(
        state.x, state.v, trial.a0, trial.end.x, trial.end.v, trial.end.a, strict=True
    ):
        path, long = quintic(x0, v0, a0, x1, v1, a1, h), is_long(h, scene.max_step)
        # Third to fifth derivative at the end, over 3!, 4!, 5!; the step itself gives the lower ones.
        d3 = third_at_end(path, a0, a1, h, scene.max_step)
        d4, d5 = jnp.where(long, path.c4 + 5 * path.c5, 0.0), jnp.where(long, path.c5, 0.0)
        x.append(x1 + after * (v1 + 0.5 * after * a1) + z**3 * (d3 + z * (d4 + z * d5)))
        v.append(v1 + after * a1 + safe_ratio(z**2 * (3 * d3 + z * (4 * d4 + z * 5 * d5)), h, h > 0))
    return tuple(x), tuple(v)
