"""Records of a step: the largest rotation, deformation and shear, and the least overturning margin."""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp

from rockjax._engine.once import once
from rockjax._types import Flag, Value, Values, Vector

from . import margin
from .attempt import Attempt, Largest, StepOutcome
from .coefficients import Coefficients, Vibration, present, summed, weighted
from .guard import Guard
from .hermite import Quintic, is_long, quintic
from .maxima import WELL_INSIDE_CUBIC, WELL_INSIDE_QUINTIC, End, Maximum, cubic, largest, spring
from .model import acceleration, beam, beam_absolute, beam_acceleration, drift_weights, shear
from .ratio import safe_ratio
from .state import Energetic, LoopState, Plan, Scene, Turn


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
    """Return the largest |θ| of the step [rad] and its time [s], with their derivatives.

    - `scene`, `state`: the prepared scene, and the state at the start of the step
    - `trial`, `guard`, `outcome`: the accepted step, its guard and its outcome
    - `hit`, `toppled`: whether it ends with an impact, or at the overturning angle
    - `now`: time of its end, which moves with the parameters [s]
    """
    at_stop = guard.at_end.value(outcome.after)
    end_angle = jnp.where(hit, 0.0, jnp.where(toppled, scene.overturn_angle, at_stop))
    peak = guard.path.value(guard.turn)
    peak, end_angle = once((peak, end_angle))
    at_turn = outcome.peaks & (peak >= end_angle)
    # A record at an end that is not an event is a turning point up to rounding.
    at_event = (outcome.lands | trial.ends) & ~at_turn
    crest = jnp.where(at_turn, guard.turn, 1.0)
    time = jnp.where(at_event, now, state.t + _time_to_turn(scene, state, trial, guard, crest))
    return jnp.where(at_turn, peak, end_angle), time


def _time_to_turn(scene: Scene, state: LoopState, trial: Attempt, guard: Guard, z: Value) -> Value:
    """Return the time from the start of a step to its turning point of θ near `z`, which moves with the
    parameters [s].

    Over a short step the slopes of the quintic are differences of nearly equal numbers; there the speeds and
    accelerations at both ends give the derivative of the time.
    """
    path, end = guard.path, trial.end
    speed = cubic(state.v[0], trial.a0[0], end.v[0], end.a[0], trial.h)
    off, of_ends = (
        jnp.clip(safe_ratio(value, slope, slope != 0), -1.0, 1.0) * trial.h
        for value, slope in ((path.slope(z), path.curvature(z)), (speed.value(z), speed.slope(z)))
    )
    of_ends -= jax.lax.stop_gradient(of_ends)
    return z * trial.h - jnp.where(is_long(trial.h, scene.longest), off, of_ends)


def turn_at_peak(
    scene: Scene, plan: Plan, state: LoopState, ground_at, trial: Attempt, guard: Guard, peaks: Flag
) -> Turn:
    """Return the maximum of |θ| at the guard's turning point, with its overturning margin and deceleration.

    - `scene`, `plan`: the prepared scene and its static choices
    - `state`: state at the start of the step
    - `ground_at`: t ↦ ground acceleration on the present piece of the excitation [m/s²]
    - `trial`, `guard`: the step and its guard
    - `peaks`: whether |θ| has a maximum; otherwise the result is inf
    """
    h, sigma = trial.h, state.sigma
    span = _time_to_turn(scene, state, trial, guard, guard.turn)
    z = safe_ratio(span, h, h > 0)
    theta = guard.path.value(z)
    x, v = (sigma * theta,), (jnp.zeros_like(h),)
    if plan.elastic:
        first, last = (state.x[1], state.v[1], trial.a0[1]), (trial.end.x[1], trial.end.v[1], trial.end.a[1])
        sway = quintic(*first, *last, h)
        rate = cubic(*first[1:], *last[1:], h).value(z)
        slope = safe_ratio(sway.slope(z), h, h > 0)
        x, v = (*x, sway.value(z)), (*v, jnp.where(is_long(h, scene.longest), slope, rate))
    slowing = -sigma * acceleration(scene.c, sigma, ground_at(state.t + span), x, v)[0]
    here = margin.at_turn(scene.c, scene.overturn_angle, theta, slowing)
    return Turn(*(jnp.where(peaks, y, jnp.inf) for y in (here, slowing)))


def least_margin(
    scene: Scene, state: LoopState, outcome: StepOutcome, x: Vector, v: Vector, toppled: Flag, stamp: Value
) -> Value:
    """Return the least overturning margin so far, after an accepted step.

    - `scene`: the prepared scene
    - `state`, `outcome`: state at the start of the step, and its outcome
    - `x`, `v`: positions and velocities after the step
    - `toppled`: whether the step ends at the overturning angle
    - `stamp`: time at its end [s]
    """
    before = present(state.margin)
    least = jnp.where(outcome.peaks & (outcome.turn.margin < before), outcome.turn.margin, before)
    # At the end of the scene a column on its way up has the margin of its present rotation.
    rises = (stamp >= jax.lax.stop_gradient(scene.end)) & (x[0] * v[0] > 0)
    here = margin.at_rest(scene.c, scene.overturn_angle, jnp.abs(x[0]))
    least = jnp.where(rises & (here < least), here, least)
    return jnp.where(toppled, margin.at_fall(scene.c, scene.overturn_angle, v[0]), least)


class Maxima(NamedTuple):
    """Maxima of the superstructure over a step; None for outputs that are not requested."""

    deformation: Maximum | None = None  # of each mode
    shear: Maximum | None = None
    drifts: Maximum | None = None  # of each story
    floors: Maximum | None = None  # absolute accelerations

    @property
    def cut(self) -> Value | float:
        """Fraction of the step at which the first maximum that must be landed on lies; inf if there
        is none."""
        cuts = [jnp.min(each.cut, axis=-1) if each.cut.ndim else each.cut for each in self if each]
        return functools.reduce(jnp.minimum, cuts) if cuts else math.inf

    @property
    def values(self) -> Largest:
        return Largest(*(None if each is None else each.value for each in self))


class _Span(NamedTuple):
    """The length of a step [s], whether it is long enough for its polynomials, and how far past its time
    stamps it begins and ends [s]."""

    h: Value
    long: Flag
    before: Value
    after: Value


class _Course(NamedTuple):
    """A quantity over a step: its polynomial, and its value and rate at both ends."""

    path: Quintic
    first: tuple[Values, Values]
    last: tuple[Values, Values]

    def largest(self, span: _Span, record: Values, inside=WELL_INSIDE_QUINTIC, lands=True) -> Maximum:
        """Return the largest absolute value over a step.

        - `span`: the step
        - `record`: largest absolute value so far
        - `inside`: fraction of the step at both ends within which a maximum need not be landed on
        - `lands`: whether maxima are landed on at all
        """
        ends = End(*self.first, span.before), End(*self.last, span.after)
        return largest(self.path, span.h, span.long, record, ends, inside, lands)


def _sum(weights: Values, course: _Course) -> _Course:
    """Return the weighted sum over the modes of a quantity."""
    return jax.tree.map(lambda values: weighted(weights, values), course)


def superstructure_maxima(
    scene: Scene, plan: Plan, state: LoopState, ground_at, trial: Attempt, before: Value, after: Value
) -> Maxima:
    """Return the requested maxima of the superstructure over the step: deformations, shear, drifts, floor
    accelerations.

    - `scene`, `plan`: the prepared scene and its static choices
    - `state`: state at the start of the step
    - `ground_at`: t ↦ ground acceleration on the present piece of the excitation [m/s²]
    - `trial`: the step
    - `before`, `after`: times after its time stamps at which the step begins and ends [s]
    """
    modes = scene.c.vibration
    span = _Span(trial.h, is_long(trial.h, scene.longest), before, after)
    if modes is not None:
        return _elastic_maxima(scene, plan, modes, state, ground_at, trial, span)
    if plan.shear:
        course = _by_slopes(shear, scene.c, state, ground_at, trial)
        return Maxima(shear=course.largest(span, present(state.shear), WELL_INSIDE_CUBIC))
    return Maxima()


def _by_slopes(quantity, c: Coefficients, state: LoopState, ground_at, trial: Attempt) -> _Course:
    """Return a quantity that depends on accelerations; automatic differentiation gives its rates in time."""
    h, end = trial.h, trial.end

    def along(t, x, v):
        return quantity(c, state.sigma, ground_at(t), x, v, acceleration(c, state.sigma, ground_at(t), x, v))

    one = jnp.ones_like(h)
    first = jax.jvp(along, (state.t, state.x, state.v), (one, state.v, trial.a0))
    last = jax.jvp(along, (state.t + h, end.x, end.v), (one, end.v, end.a))
    return _Course(cubic(first[0], first[1], last[0], last[1], h), first, last)


def _elastic_maxima(
    scene: Scene,
    plan: Plan,
    modes: Vibration,
    state: LoopState,
    ground_at,
    trial: Attempt,
    span: _Span,
) -> Maxima:
    h, found = trial.h, Maxima()
    if not (plan.deformation or plan.shear or plan.drifts or plan.floors):
        return found
    jets = _deformations(scene.c, state, trial)
    (d0, r0, s0), (d1, r1, s1) = jets
    moved = _Course(quintic(d0, r0, s0, d1, r1, s1, h), (d0, r0), (d1, r1))

    # A maximum need not be landed on if the polynomial is as accurate as the step.
    if plan.deformation:
        record = present(state.deformation)
        found = found._replace(deformation=moved.largest(span, record, lands=plan.refine))
    if plan.drifts:
        drifts = jax.vmap(lambda weights: _sum(weights, moved))(drift_weights(_floors(modes)))
        found = found._replace(drifts=drifts.largest(span, present(state.drifts), lands=plan.refine))
    if not (plan.shear or plan.floors):
        return found
    # These use a derivative of the polynomial, so they are landed on for methods of any order.
    springs = _spring(modes, moved, jets, h)
    return _forces(scene.c, plan, modes, state, ground_at, trial, span, springs, found)


def _forces(
    c: Coefficients,
    plan: Plan,
    modes: Vibration,
    state: LoopState,
    ground_at,
    trial: Attempt,
    span: _Span,
    springs: _Course,
    found: Maxima,
) -> Maxima:
    """Add the largest shear and floor accelerations to `found`: spring forces, and for the mass that moves
    with the beam its acceleration."""
    several, base, inside = modes.several, None, WELL_INSIDE_QUINTIC
    if several is not None and several.residual is not None:
        base, inside = _by_slopes(beam_absolute, c, state, ground_at, trial), WELL_INSIDE_CUBIC

    def carried(weights: Values) -> _Course:
        of_springs = _sum(weights, springs)
        if base is None:
            return of_springs
        rest = summed(weights) - 1.0
        return jax.tree.map(lambda of_spring, of_base: of_spring + rest * of_base, of_springs, base)

    if plan.shear:
        course = springs if several is None else carried(several.shares)
        force = course.largest(span, present(state.shear) * c.g, inside)
        found = found._replace(shear=force._replace(value=force.value / c.g))
    if plan.floors:
        floors = jax.vmap(carried)(_floors(modes))
        found = found._replace(floors=floors.largest(span, present(state.floors), inside))
    return found


def _floors(modes: Vibration) -> Values:
    return present(present(modes.several).floors)


Jet = tuple[Values, Values, Values]  # a quantity with its first two derivatives in time


def _deformations(c: Coefficients, state: LoopState, trial: Attempt) -> tuple[Jet, Jet]:
    """Return the deformation of each mode with two derivatives in time, at both ends of the step."""

    def jet(x: Vector, v: Vector, a: Vector) -> Jet:
        u_b, u_b_dot = beam(c, state.sigma, x[0], v[0])
        u_b_ddot = beam_acceleration(c, state.sigma, x[0], v[0], a[0])
        return x[1] - u_b, v[1] - u_b_dot, a[1] - u_b_ddot

    end = trial.end
    return once((jet(state.x, state.v, trial.a0), jet(end.x, end.v, end.a)))


def _spring(modes: Vibration, course: _Course, jets: tuple[Jet, Jet], h: Value) -> _Course:
    """Return the force of the spring and damper of each mode over its mass, Eq. (7)."""
    first, last = once(
        [(modes.omega2 * d + modes.damping * r, modes.omega2 * r + modes.damping * s) for d, r, s in jets]
    )
    return _Course(spring(course.path, modes.omega2, modes.damping, h), first, last)


def energetic_impacts(scene: Scene, before: Energetic | None, hit: Flag, speed: Value) -> Energetic | None:
    """Return the sum over impacts after a step.

    - `scene`: the prepared scene
    - `before`: the sum before the step; None without error estimates
    - `hit`: whether the step ends with an impact
    - `speed`: |θ̇⁻| before it [rad/s]
    """
    if before is None:
        return None
    ratio = jax.lax.stop_gradient(speed / (scene.c.p * scene.c.alpha))
    # Faster impacts continue along the tangent, so that differences of their speeds still count.
    one = jnp.where(hit, jnp.minimum(ratio * ratio, 1.0) ** 4 + 8 * jnp.maximum(ratio - 1, 0.0), 0.0)
    return Energetic(before.total + one, jnp.where(hit, one, before.last))


def larger(new: Values, record: Values) -> Values:
    """Return the larger of two values with the derivative of one of them. `maximum` would average both
    derivatives at ties."""
    return jnp.where(new > record, new, record)
