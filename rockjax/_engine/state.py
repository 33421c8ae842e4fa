"""Data types of the integration loop: the plan, the scene, the carried state, and the record of a step."""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero

from rockjax._excitations.base import AbstractExcitation, AbstractLookahead
from rockjax._types import Flag, Index, Value, Vector

from .coefficients import Coefficients
from .tableaus import Tableau


@dataclasses.dataclass(frozen=True)
class Plan:
    """Choices that are made before tracing.

    - `elastic`: the superstructure vibrates
    - `outputs`: the outputs that are followed, the rotation first; each an `AbstractOutput` of
      `rockjax._outputs`, which this folder knows only by its methods
    - `absent`: outputs that are not requested
    - `tableau`: the Runge–Kutta method
    - `to_the_end`: a history goes on until t_end or final rest
    - `fast_forwards`: names of the fast-forwards that may be used
    """

    elastic: bool
    outputs: tuple[Any, ...]
    absent: tuple[Any, ...]
    tableau: Tableau
    to_the_end: bool
    fast_forwards: tuple[str, ...]

    @property
    def refines(self) -> bool:
        """True if the method is of higher order than the Hermite polynomial, so that peaks are landed on."""
        return self.tableau.order > 5

    @property
    def follows_contact(self) -> bool:
        """True if full contact is followed step by step; a rigid podium goes to its next uplift otherwise."""
        return "rest" not in self.fast_forwards

    @property
    def follows_impacts(self) -> bool:
        """True if every impact counts, however slow."""
        return any(output.follows_impacts for output in self.outputs)

    @property
    def of_joints(self) -> bool:
        """True if forces in the joints are requested."""
        return any(output.of_joints for output in self.outputs)


class Scene(NamedTuple):
    """One podium under one excitation, with everything the loop needs computed once."""

    c: Coefficients
    excitation: AbstractExcitation
    lookahead: AbstractLookahead
    start: Value
    end: Value
    overturn_angle: Value  # overturn_ratio·α [rad]
    rest_speed: Value  # rest velocity [rad/s]
    log_restitution: Value  # −ln e
    min_impact_speed: Value  # impact speed that restitution reduces to the rest velocity [rad/s]
    estimate_factor: Value | None  # factor on error estimates of lower order than usual; None for none
    pass_below: Value  # error over tolerance up to which samples are passed
    landing_fraction: Value  # part of a step within which it lands on an event
    split_fraction: Value  # first of two steps up to a breakpoint, as a part of the distance to it …
    unsplit_limit: Value  # … if the controller's step is at most this times the distance
    rtol: Value
    atol: Value
    max_step: Value  # longest step [s] …
    max_excited_step: Value  # … and while the ground moves
    excitation_end: Value  # end of the excitation


class LoopState(NamedTuple):
    """State of the automaton. Times and steps are constants for derivatives; states at them carry the
    tangents."""

    t: Value
    event_time: Value  # t with its derivative: the varying time of the event or breakpoint at t
    x: Vector
    v: Vector
    sigma: Value  # mode: 0 full contact, ±1 rocking
    piece: Index
    h: Value  # the controller's step
    cut: Value  # a shorter step to land on an event, inf if none is needed
    code: Index  # results.RUNNING, or how the scene ended
    records: tuple[Any, ...]  # of the outputs of the plan; they carry tangents. The first is max|θ|
    notes: tuple[Any, ...]  # beside them; batches do not follow their tangents
    uplifted: Flag
    uplift_time: Value
    overturn_time: Value
    impacts: Index
    min_impact_speed: Value  # least impact speed so far …
    min_impact_speed_before_peak: Value  # … and up to the largest rotation
    steps: Index
    rejected: Index
    passing: Flag | None = None  # samples may be passed from here; None where they never are

    @property
    def peak(self) -> Value:
        """Largest |θ| so far [rad]."""
        return self.records[0]


# Fields that carry tangents from step to step. Modes, times and step lengths are constants for derivatives,
# and recorded event times and impact speeds affect nothing else.
DIFFERENTIATED = ("event_time", "x", "v", "records")

# Other fields that have a tangent after the first step.
_REPORTED = ("notes", "uplift_time", "overturn_time", "min_impact_speed", "min_impact_speed_before_peak")


@jax.custom_jvp
def _given(numbers):
    return numbers


def _given_jvp(primals, tangents):
    """Give every number a tangent, of the same rows as the tangents that exist."""
    absent = lambda y: isinstance(y, SymbolicZero)
    one = next(y for y in jax.tree.leaves(tangents[0], is_leaf=absent) if not absent(y))
    zero = jax.lax.select(False, one, jnp.zeros_like(one))[(0,) * one.ndim]

    def full(tangent):
        shape = tangent.aval.shape
        return jnp.broadcast_to(zero, shape) if shape else zero

    return primals[0], jax.tree.map(lambda y: full(y) if absent(y) else y, tangents[0], is_leaf=absent)


_given.defjvp(_given_jvp, symbolic_zeros=True)


def ready_for_tangents(state: LoopState) -> LoopState:
    """Return the state, with tangents for all fields that get them in the loop if any field has one.

    JAX differentiates and batches the body of a loop again whenever it finds another field with a tangent.
    With all tangents from the start it does so only once.
    """
    return state._replace(**_given({name: getattr(state, name) for name in (*DIFFERENTIATED, *_REPORTED)}))


def differentiated_fields(state: LoopState) -> dict[str, Any]:
    """Return the fields of a state that carry tangents from step to step."""
    return {name: getattr(state, name) for name in DIFFERENTIATED}


class Decision(NamedTuple):
    """All discrete choices of an accepted step. With them a step can be repeated whatever its rounding."""

    h: Value
    reaches: Flag  # the stop
    lands: Flag  # on an event
    false_uplift: Flag
    mode: Value  # afterwards


class StepInfo(NamedTuple):
    """Record of a trial: whether it was accepted, the time of the impact it ended on (else NaN), and its
    decision."""

    accepted: Flag
    impact_time: Value
    decision: Decision
