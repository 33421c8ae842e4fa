"""What a step leaves in the records: the largest rotation, deformation and shear, and the least overturning
margin."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp

from rockjax._types import Flag, Value, Vector

from . import margin
from .attempt import Attempt, Largest, StepOutcome
from .coefficients import Coefficients, Mode
from .guard import Guard
from .hermite import Quintic, quintic
from .maxima import WELL_INSIDE, WELL_INSIDE_CUBIC, End, Maximum, cubic, largest, spring, summit
from .model import (
    acceleration,
    beam,
    beam_absolute,
    beam_acceleration,
    shear,
    story_weights,
    weighted,
)
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
    for k in range(1, len(state.x)):
        sway = quintic(state.x[k], state.v[k], trial.a0[k], trial.end.x[k], trial.end.v[k], trial.end.a[k], h)
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
    """Of the superstructure over a step; empty where they are not wanted."""

    deformation: tuple[Maximum, ...]  # of each mode
    shear: Maximum
    drifts: tuple[Maximum, ...] = ()  # of each story
    floors: tuple[Maximum, ...] = ()  # absolute accelerations

    @property
    def cut(self) -> Value:
        """How far to shorten the step to land on one of them."""
        cuts = [each.cut for each in (*self.deformation, self.shear, *self.drifts, *self.floors)]
        return functools.reduce(jnp.minimum, cuts)

    @property
    def values(self) -> Largest:
        of_each = lambda maxima: tuple(maximum.value for maximum in maxima)
        return Largest(
            of_each(self.deformation), self.shear.value, of_each(self.drifts), of_each(self.floors)
        )


class _Course(NamedTuple):
    """A quantity over a step: its polynomial, and its value and rate at both ends."""

    path: Quintic
    first: tuple[Value, Value]
    last: tuple[Value, Value]

    def largest(self, h: Value, record: Value, past: tuple[Value, Value], inside=WELL_INSIDE) -> Maximum:
        """Its largest size; the step begins and ends `past` its time stamps."""
        return largest(self.path, h, record, (End(*self.first, past[0]), End(*self.last, past[1])), inside)


def _sum(weights: Sequence[Value | float], courses: Sequence[_Course]) -> _Course:
    """Of quantities over one step."""
    leaves = zip(*(jax.tree.leaves(course) for course in courses), strict=True)
    return jax.tree.unflatten(
        jax.tree.structure(courses[0]), [weighted(weights, values) for values in leaves]
    )


def superstructure_maxima(
    scene: Scene, plan: Plan, state: LoopState, ground_at, trial: Attempt, before: Value, after: Value
) -> Maxima:
    """Largest of what is wanted of the superstructure over the step: deformations, shear, drifts, floor
    accelerations.

    The step begins `before` and ends `after` its time stamps.
    """
    none = Maximum(jnp.zeros_like(trial.h), jnp.full_like(trial.h, jnp.inf))
    if plan.elastic and (plan.deformation or plan.shear or plan.drifts or plan.floors):
        return _elastic_maxima(scene, plan, state, ground_at, trial, (before, after), none)
    if not plan.elastic and plan.shear:
        course = _by_slopes(shear, scene.c, state, ground_at, trial)
        return Maxima((), course.largest(trial.h, present(state.shear), (before, after), WELL_INSIDE_CUBIC))
    return Maxima((), none)


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
    state: LoopState,
    ground_at,
    trial: Attempt,
    past: tuple[Value, Value],
    none: Maximum,
) -> Maxima:
    c, h = scene.c, trial.h
    jets = _deformations(c, state, trial)
    moved = [
        _Course(quintic(d0, r0, s0, d1, r1, s1, h), (d0, r0), (d1, r1)) for (d0, r0, s0), (d1, r1, s1) in jets
    ]

    def landed(found: Maximum) -> Maximum:
        """Where the polynomial is as good as the step, the maximum need not be landed on."""
        return found if plan.refine else found._replace(cut=none.cut)

    deformation, drifts, floors, force = (), (), (), none
    if plan.deformation:
        pairs = zip(moved, present(state.deformation), strict=True)
        deformation = tuple(landed(course.largest(h, record, past)) for course, record in pairs)
    if plan.drifts:
        pairs = zip(story_weights(c), present(state.drifts), strict=True)
        drifts = tuple(landed(_sum(weights, moved).largest(h, record, past)) for weights, record in pairs)
    if not (plan.shear or plan.floors):
        return Maxima(deformation, force, drifts)
    # These take a derivative of the polynomial: they are landed on whatever the order.
    springs = [_spring(mode, course, jet, h) for mode, course, jet in zip(c.modes, moved, jets, strict=True)]
    base, inside = None, WELL_INSIDE
    if c.residual is not None:
        base, inside = _by_slopes(beam_absolute, c, state, ground_at, trial), WELL_INSIDE_CUBIC

    def carried(weights: Vector) -> _Course:
        """Forces of springs, less what moves with the beam."""
        of_springs = _sum(weights, springs)
        return of_springs if base is None else _sum((1.0, sum(weights) - 1.0), (of_springs, base))

    if plan.shear:
        course = springs[0] if c.shares is None else carried(c.shares)
        force = course.largest(h, present(state.shear) * c.g, past, inside)
        force = force._replace(value=force.value / c.g)
    if plan.floors:
        pairs = zip(present(c.floors), present(state.floors), strict=True)
        floors = tuple(carried(weights).largest(h, record, past, inside) for weights, record in pairs)
    return Maxima(deformation, force, drifts, floors)


Jet = tuple[Value, Value, Value]  # a quantity with its first two derivatives in time


def _deformations(c: Coefficients, state: LoopState, trial: Attempt) -> list[tuple[Jet, Jet]]:
    """The deformation of each mode at both ends of the step."""
    of_ends = []
    for x, v, a in ((state.x, state.v, trial.a0), (trial.end.x, trial.end.v, trial.end.a)):
        u_b, u_b_dot = beam(c, state.sigma, x[0], v[0])
        u_b_ddot = beam_acceleration(c, state.sigma, x[0], v[0], a[0])
        modes = zip(x[1:], v[1:], a[1:], strict=True)
        of_ends.append([(u - u_b, u_dot - u_b_dot, u_ddot - u_b_ddot) for u, u_dot, u_ddot in modes])
    return list(zip(*of_ends, strict=True))


def _spring(mode: Mode, course: _Course, jets: tuple[Jet, Jet], h: Value) -> _Course:
    """Force of the spring and damper of a mode over its mass, Eq. (7)."""
    first, last = (
        (mode.omega2 * d + mode.damping * r, mode.omega2 * r + mode.damping * s) for d, r, s in jets
    )
    return _Course(spring(course.path, mode.omega2, mode.damping, h), first, last)


def larger(new: Value, record: Value) -> Value:
    """The larger of two, with the derivative of one of them: `maximum` would take half of each where they
    tie."""
    return jnp.where(new > record, new, record)
