"""What a step leaves in the records: the largest rotation, deformation and shear, and the least overturning
margin."""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp

from rockjax._once import once
from rockjax._types import Flag, Value, Values, Vector

from . import margin
from .attempt import Attempt, Largest, StepOutcome
from .coefficients import Coefficients, Vibration, present, summed, weighted
from .guard import Guard
from .hermite import Quintic, quintic
from .maxima import WELL_INSIDE, WELL_INSIDE_CUBIC, End, Maximum, cubic, largest, spring, summit
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
    """The largest |θ| of the step and its time, with their derivatives."""
    end = once(summit(guard.path, 1.0))
    at_stop = jnp.where(end == 1, guard.at_end.value(outcome.after), guard.path.value(end))
    end_angle = jnp.where(hit, 0.0, jnp.where(toppled, scene.overturn_angle, at_stop))
    peak = guard.path.value(guard.turn)
    peak, end_angle = once((peak, end_angle))
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


class Maxima(NamedTuple):
    """Of the superstructure over a step; None where they are not wanted."""

    deformation: Maximum | None = None  # of each mode
    shear: Maximum | None = None
    drifts: Maximum | None = None  # of each story
    floors: Maximum | None = None  # absolute accelerations

    @property
    def cut(self) -> Value | float:
        """How far to shorten the step to land on one of them."""
        cuts = [jnp.min(each.cut, axis=-1) if each.cut.ndim else each.cut for each in self if each]
        return functools.reduce(jnp.minimum, cuts) if cuts else math.inf

    @property
    def values(self) -> Largest:
        return Largest(*(None if each is None else each.value for each in self))


class _Course(NamedTuple):
    """A quantity over a step: its polynomial, and its value and rate at both ends."""

    path: Quintic
    first: tuple[Values, Values]
    last: tuple[Values, Values]

    def largest(self, h: Value, record: Values, past: tuple[Value, Value], inside=WELL_INSIDE) -> Maximum:
        """Its largest size; the step begins and ends `past` its time stamps."""
        return largest(self.path, h, record, (End(*self.first, past[0]), End(*self.last, past[1])), inside)


def _sum(weights: Values, course: _Course) -> _Course:
    """Of the modes of a quantity over one step."""
    return jax.tree.map(lambda values: weighted(weights, values), course)


def superstructure_maxima(
    scene: Scene, plan: Plan, state: LoopState, ground_at, trial: Attempt, before: Value, after: Value
) -> Maxima:
    """Largest of what is wanted of the superstructure over the step: deformations, shear, drifts, floor
    accelerations.

    The step begins `before` and ends `after` its time stamps.
    """
    modes = scene.c.vibration
    if modes is not None:
        return _elastic_maxima(scene, plan, modes, state, ground_at, trial, (before, after))
    if plan.shear:
        course = _by_slopes(shear, scene.c, state, ground_at, trial)
        record = present(state.shear)
        return Maxima(shear=course.largest(trial.h, record, (before, after), WELL_INSIDE_CUBIC))
    return Maxima()


def _by_slopes(quantity, c: Coefficients, state: LoopState, ground_at, trial: Attempt) -> _Course:
    """A quantity that depends on accelerations, whose rates in time are found by differentiation."""
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
    past: tuple[Value, Value],
) -> Maxima:
    h, found = trial.h, Maxima()
    if not (plan.deformation or plan.shear or plan.drifts or plan.floors):
        return found
    jets = _deformations(scene.c, state, trial)
    (d0, r0, s0), (d1, r1, s1) = jets
    moved = _Course(quintic(d0, r0, s0, d1, r1, s1, h), (d0, r0), (d1, r1))

    def landed(found: Maximum) -> Maximum:
        """Where the polynomial is as good as the step, the maximum need not be landed on."""
        return found if plan.refine else found._replace(cut=jnp.full_like(found.cut, jnp.inf))

    if plan.deformation:
        record = present(state.deformation)
        found = found._replace(deformation=landed(moved.largest(h, record, past)))
    if plan.drifts:
        drifts = jax.vmap(lambda weights: _sum(weights, moved))(drift_weights(_floors(modes)))
        found = found._replace(drifts=landed(drifts.largest(h, present(state.drifts), past)))
    if not (plan.shear or plan.floors):
        return found
    # These take a derivative of the polynomial: they are landed on whatever the order.
    springs = _spring(modes, moved, jets, h)
    return _forces(scene.c, plan, modes, state, ground_at, trial, past, springs, found)


def _forces(
    c: Coefficients,
    plan: Plan,
    modes: Vibration,
    state: LoopState,
    ground_at,
    trial: Attempt,
    past: tuple[Value, Value],
    springs: _Course,
    found: Maxima,
) -> Maxima:
    """With the largest shear and accelerations of floors: forces of springs, less what moves with the
    beam."""
    h, several, base, inside = trial.h, modes.several, None, WELL_INSIDE
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
        force = course.largest(h, present(state.shear) * c.g, past, inside)
        found = found._replace(shear=force._replace(value=force.value / c.g))
    if plan.floors:
        floors = jax.vmap(carried)(_floors(modes))
        found = found._replace(floors=floors.largest(h, present(state.floors), past, inside))
    return found


def _floors(modes: Vibration) -> Values:
    return present(present(modes.several).floors)


Jet = tuple[Values, Values, Values]  # a quantity with its first two derivatives in time


def _deformations(c: Coefficients, state: LoopState, trial: Attempt) -> tuple[Jet, Jet]:
    """The deformation of each mode at both ends of the step."""

    def jet(x: Vector, v: Vector, a: Vector) -> Jet:
        u_b, u_b_dot = beam(c, state.sigma, x[0], v[0])
        u_b_ddot = beam_acceleration(c, state.sigma, x[0], v[0], a[0])
        return x[1] - u_b, v[1] - u_b_dot, a[1] - u_b_ddot

    end = trial.end
    return once((jet(state.x, state.v, trial.a0), jet(end.x, end.v, end.a)))


def _spring(modes: Vibration, course: _Course, jets: tuple[Jet, Jet], h: Value) -> _Course:
    """Force of the spring and damper of each mode over its mass, Eq. (7)."""
    first, last = once(
        [(modes.omega2 * d + modes.damping * r, modes.omega2 * r + modes.damping * s) for d, r, s in jets]
    )
    return _Course(spring(course.path, modes.omega2, modes.damping, h), first, last)


def energetic_impacts(scene: Scene, before: Energetic | None, hit: Flag, speed: Value) -> Energetic | None:
    """With one more impact, where there is one, of the speed |θ̇⁻|."""
    if before is None:
        return None
    ratio = jax.lax.stop_gradient(speed / (scene.c.p * scene.c.alpha))
    # On along the tangent: of faster ones a difference of speeds tells as well.
    one = jnp.where(hit, jnp.minimum(ratio * ratio, 1.0) ** 4 + 8 * jnp.maximum(ratio - 1, 0.0), 0.0)
    return Energetic(before.total + one, jnp.where(hit, one, before.last))


def larger(new: Values, record: Values) -> Values:
    """The larger of two, with the derivative of one of them: `maximum` would take half of each where they
    tie."""
    return jnp.where(new > record, new, record)
