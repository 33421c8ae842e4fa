"""What the loop is of: the plan, the scene, the state that is carried, and what may be kept of a step."""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple, TypeVar

from rockjax._excitations.base import AbstractExcitation, AbstractLookahead
from rockjax._types import Flag, Index, Value, Vector

from .coefficients import Coefficients
from .runge_kutta import Tableau

T = TypeVar("T")


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
    many_hops: bool  # hops may be followed in large numbers
    tableau: Tableau
    turns: bool = False  # what is known of the turning point of each step is kept as well


class Turn(NamedTuple):
    """A turning point |θ| = θ_m that a step has passed, inf where it has passed none."""

    margin: Value  # the overturning margin of that point alone
    slowing: Value  # its angular deceleration −σθ̈ [rad/s²]


class Scene(NamedTuple):
    """One podium under one excitation, with everything the loop needs computed once."""

    c: Coefficients
    excitation: AbstractExcitation
    lookahead: AbstractLookahead
    start: Value
    end: Value
    overturn_angle: Value  # overturn_ratio·α [rad]
    rest: Value  # rest velocity [rad/s]
    landing: Value  # part of a step within which it lands on an event
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
    deformation: Value | None  # None where not wanted
    shear: Value | None  # likewise
    margin: Value | None  # likewise
    turn: Turn | None  # of the last trial; None where not wanted
    uplifted: Flag
    uplift_time: Value
    overturn_time: Value
    impacts: Index
    look: Index | None  # so many impacts and many hops are looked for; None where they never are
    slowest: Value  # least impact speed so far …
    slowest_before_peak: Value  # … and up to the peak
    steps: Index
    rejected: Index


# What of it moves with the parameters and tells on a peak. Modes, times and lengths of steps are constants
# for derivatives, and nothing feeds on the times of events and the speeds of impacts that are kept.
MOVING = ("event_time", "x", "v", "peak", "deformation", "shear", "margin", "turn")


def moving(state: LoopState) -> dict[str, Any]:
    """The part of a state that carries the tangents of its peaks."""
    return {name: getattr(state, name) for name in MOVING}


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


def present(value: T | None) -> T:
    """What the plan says is there."""
    assert value is not None
    return value
