"""What the loop is of: the plan, the scene, the state that is carried, and what may be kept of a step."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero

from rockjax._excitations.base import AbstractExcitation, AbstractLookahead
from rockjax._types import Flag, Index, Value, Values, Vector

from .coefficients import Coefficients
from .tableaus import Tableau


@dataclasses.dataclass(frozen=True)
class Plan:
    """What is decided before tracing."""

    elastic: bool
    superstructure: bool
    rotation: bool
    deformation: bool
    shear: bool
    impacts: bool
    margin: bool
    errors: bool
    to_the_end: bool  # a history goes on until t_end, or rest for good
    refine: bool  # the method is of higher order than the Hermite polynomial: land on the peaks
    skip_bounces: bool  # that end at rest whatever happens on the way
    pass_samples: bool  # of a record, without a trial, where nothing happens
    tableau: Tableau
    several: bool  # displacements and deformations have an axis of modes
    stories: int
    drifts: bool  # of the stories …
    floors: bool  # … and accelerations of the floors
    turns: bool = False  # what is known of the turning point of each step is kept as well


class Turn(NamedTuple):
    """A turning point |θ| = θ_m that a step has passed, inf where it has passed none."""

    margin: Value  # the overturning margin of that point alone
    slowing: Value  # its angular deceleration −σθ̈ [rad/s²]


class Energetic(NamedTuple):
    """Impacts by their speed: each counts as y⁸, y = |θ̇⁻|/(pα), so that those count from which columns can
    overturn, and faster ones as 1 + 8(y − 1)."""

    total: Value  # of all so far …
    last: Value  # … and of the last one


class Scene(NamedTuple):
    """One podium under one excitation, with everything the loop needs computed once."""

    c: Coefficients
    excitation: AbstractExcitation
    lookahead: AbstractLookahead
    start: Value
    end: Value
    overturn_angle: Value  # overturn_ratio·α [rad]
    rest: Value  # rest velocity [rad/s]
    lost: Value  # −ln e
    slowest: Value  # impact, which leaves the rest velocity [rad/s]
    estimated: Value | None  # what the estimate of a lower order than usual counts; None: all of it
    pass_below: Value  # error over tolerance up to which samples are passed
    landing: Value  # part of a step within which it lands on an event
    split: Value  # part of what is left up to a breakpoint that is the first of two steps …
    whole: Value  # … where the controller's step is no longer than this times it
    rtol: Value
    atol: Value
    longest: Value  # longest step [s] …
    longest_excited: Value  # … and while the ground moves
    quiet: Value  # end of the excitation


class LoopState(NamedTuple):
    """The automaton's state. Times and steps are constants for derivatives; states at them carry the
    tangents."""

    t: Value
    event_time: Value  # t with its derivative: the moving time of the event or breakpoint that t stands on
    x: Vector
    v: Vector
    sigma: Value  # mode: 0 full contact, ±1 rocking
    piece: Index
    h: Value  # the controller's step
    cut: Value  # a shorter one to land on an event, inf where there is none
    code: Index  # results.RUNNING, or how the scene ended
    peak: Value  # max|θ| so far
    peak_time: Value
    deformation: Values | None  # of each mode; None where not wanted
    shear: Value | None  # likewise
    margin: Value | None  # likewise
    turn: Turn | None  # of the last trial; None where not wanted
    uplifted: Flag
    uplift_time: Value
    overturn_time: Value
    impacts: Index
    slowest: Value  # least impact speed so far …
    slowest_before_peak: Value  # … and up to the peak
    steps: Index
    rejected: Index
    drifts: Values | None = None  # of each story, None where not wanted
    floors: Values | None = None  # likewise: absolute accelerations of the floors
    energetic: Energetic | None = None  # None without error estimates
    passing: Flag | None = None  # samples may be passed from here; None where they never are


# What of it moves with the parameters and tells on a peak. Modes, times and lengths of steps are constants
# for derivatives, and nothing feeds on the times of events and the speeds of impacts that are kept.
MOVING = ("event_time", "x", "v", "peak", "deformation", "shear", "margin", "drifts", "floors", "turn")


MOVING_TURNS = ("event_time", "x", "v", "turn")  # what tells on the turning points

# What has a tangent besides, once a step has been taken.
_REPORTED = ("peak_time", "uplift_time", "overturn_time", "slowest", "slowest_before_peak")


@jax.custom_jvp
def _given(numbers):
    return numbers


def _given_jvp(primals, tangents):
    """Where some have tangents all have them, and rows of them where those are rows."""
    absent = lambda y: isinstance(y, SymbolicZero)
    one = next(y for y in jax.tree.leaves(tangents[0], is_leaf=absent) if not absent(y))
    zero = jax.lax.select(False, one, jnp.zeros_like(one))[(0,) * one.ndim]

    def full(tangent):
        shape = tangent.aval.shape
        return jnp.broadcast_to(zero, shape) if shape else zero

    return primals[0], jax.tree.map(lambda y: full(y) if absent(y) else y, tangents[0], is_leaf=absent)


_given.defjvp(_given_jvp, symbolic_zeros=True)


def ready_for_tangents(state: LoopState) -> LoopState:
    """The same; where part of it has tangents, so has all that will have them in the loop.

    JAX differentiates the body of a loop again whenever it finds another number that moves, and batches it
    again: three times instead of once.
    """
    return state._replace(**_given({name: getattr(state, name) for name in (*MOVING, *_REPORTED)}))


def moving(state: LoopState, names: Iterable[str] = MOVING) -> dict[str, Any]:
    """The part of a state that carries the tangents of its peaks, or of so much of it."""
    return {name: getattr(state, name) for name in names}


class Decision(NamedTuple):
    """All that is discrete about an accepted step. With these, a step can be repeated whatever its
    rounding."""

    h: Value
    reaches: Flag  # the stop
    lands: Flag  # on an event
    false_uplift: Flag
    mode: Value  # afterwards


class StepInfo(NamedTuple):
    """What may be kept of a trial: whether it was accepted, the time of the impact it ended on (else NaN),
    and how."""

    accepted: Flag
    impact_time: Value
    decision: Decision
