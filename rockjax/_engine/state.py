"""Data types of the integration loop: the plan, the scene (one podium under one excitation), the loop state,
and the result of a trial.

A breakpoint is a time at which the ground motion has a jump or a kink, and a piece is the ground motion
between two breakpoints. A trial is a step that may still be rejected or shortened. An event is an uplift, an
impact or overturning. An accumulator holds the value that an output has so far, such as the largest rotation.

The time of an event or breakpoint depends on the parameters. The loop works with the value of this time, held
constant under differentiation and called the stamp. A separate variable, `LoopState.event_time`, carries the
derivatives of the time with respect to the parameters.
"""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

from rockjax._excitations.base import AbstractExcitation, AbstractLookahead
from rockjax._programs.derivatives import with_tangents
from rockjax._types import Flag, Index, Value, Vector

from .coefficients import Coefficients
from .tableaus import Tableau


@dataclasses.dataclass(frozen=True)
class Plan:
    """Settings that are fixed at compilation (static under `jax.jit`).

    - `elastic`: True if the superstructure vibrates
    - `outputs`: the outputs that are computed, the rotation first; each is an `AbstractOutput` of
      `rockjax._outputs`
    - `unrequested`: registered outputs that are not requested, or that the podium does not have; their
      answers are NaN, a default, or missing
    - `tableau`: tableau of the Runge–Kutta method
    - `to_the_end`: True if the scene goes on even when no output can change any more, as in a history (a
      scene whose steps are stored)
    - `fast_forwards`: names of the permitted fast-forwards; each skips a part of a scene without trial steps
      (see `fast_forward/`)
    """

    elastic: bool
    outputs: tuple[Any, ...]
    unrequested: tuple[Any, ...]
    tableau: Tableau
    to_the_end: bool
    fast_forwards: tuple[str, ...]

    @property
    def ends_on_maxima(self) -> bool:
        """True if steps end on peaks of the rotation and of deformations. They do so if the order of the
        method exceeds 5, because the quintic polynomial through both ends of a step is then less accurate
        than the step."""
        return self.tableau.order > 5

    @property
    def follows_contact(self) -> bool:
        """True if full contact is integrated step by step. Otherwise a podium in full contact goes directly
        to its next uplift."""
        return "rest" not in self.fast_forwards

    @property
    def follows_impacts(self) -> bool:
        """True if an output needs every impact, however slow."""
        return any(output.follows_impacts for output in self.outputs)

    @property
    def of_joints(self) -> bool:
        """True if joint forces are requested."""
        return any(output.of_joints for output in self.outputs)


class Scene(NamedTuple):
    """One podium under one excitation, with all constants of the loop."""

    c: Coefficients  # constants of the podium
    excitation: AbstractExcitation  # ground motion
    lookahead: AbstractLookahead  # bounds on the remaining excitation, and the time of the next uplift
    start: Value  # start of the scene [s]
    end: Value  # end of the scene [s]
    overturn_angle: Value  # overturn_ratio·α [rad]
    rest_speed: Value  # columns come to rest at an impact if |θ̇| after the impact is at most this [rad/s]
    log_restitution: Value  # −ln e ≥ 0, with the restitution factor e [–]
    min_impact_speed: Value  # |θ̇| before an impact that reduces |θ̇| to `rest_speed` [rad/s]
    # Factor < 1 by which error estimates of unusually low order are multiplied (see `_estimate_factor` in
    # scene.py); None if the order is usual.
    estimate_factor: Value | None
    skip_below: Value  # a sample is skipped only if error/tolerance of the step to it is at most this [–]
    # A step counts as ending on an event if the time between the event and the end of the step is at most
    # this fraction of the step.
    landing_fraction: Value
    split_fraction: Value  # length of the first of two steps to a breakpoint, divided by the distance to it
    # A proposed step longer than this multiple of the distance to a breakpoint covers this distance unsplit.
    unsplit_limit: Value
    rtol: Value  # relative tolerance
    atol: Value  # absolute tolerance in the units of `attempt.natural_units`, such as α for θ [–]
    max_step: Value  # longest step after the excitation [s]
    max_excited_step: Value  # longest step during the excitation [s]
    excitation_end: Value  # end of the excitation [s]


class LoopState(NamedTuple):
    """State of the integration loop between two trials. Contact modes, stamps and step lengths are held
    constant under differentiation; `DIFFERENTIATED` and `_REPORTED` list the fields that have tangents."""

    t: Value  # stamp of the present time [s]
    event_time: Value  # equal to t, with the derivatives of the event or breakpoint at t, if there is one [s]
    x: Vector  # positions: θ [rad] and, if the superstructure vibrates, u_t [m] (see model.py)
    v: Vector  # velocities: the rates of the positions
    sigma: Value  # contact mode: 0 in full contact, ±1 while rocking, with the sign of θ
    piece: Index  # piece of the excitation
    h: Value  # step length that the step-size control proposes [s]
    # Limit on the next trial if the last one was accurate but too long, else inf. In the flat engine
    # (`flat.py`) it is the largest length of the next trial, in the segments engine (`segments.py`) its
    # latest end [s].
    trial_limit: Value
    code: Index  # result code, or results.RUNNING
    # The accumulator of each output of the plan, with tangents. The first is the largest |θ| so far [rad].
    accumulators: tuple[Any, ...]
    notes: tuple[Any, ...]  # further data of each output, such as the time of a peak
    uplifted: Flag  # the columns have left full contact, or rocked from the start
    uplift_time: Value  # time of the first uplift [s]: the start if the columns rock then; NaN without uplift
    overturn_time: Value  # time of overturning [s]; NaN before
    impacts: Index  # number of impacts so far
    min_impact_speed: Value  # least |θ̇| just before an impact so far [rad/s]; inf without impacts
    # Least |θ̇| just before those impacts that precede the largest rotation so far [rad/s]; inf if there are
    # none.
    min_impact_speed_before_peak: Value
    steps: Index  # number of accepted steps
    rejected: Index  # number of rejected steps
    may_skip: Flag | None = None  # the next sample may need no trial step; None if samples are never skipped

    @property
    def peak(self) -> Value:
        """Largest |θ| so far [rad]."""
        return self.accumulators[0]


# Fields whose tangents later steps use.
DIFFERENTIATED = ("event_time", "x", "v", "accumulators")

# Other fields that have tangents. Only the answers use these tangents; batches do not compute them.
_REPORTED = ("notes", "uplift_time", "overturn_time", "min_impact_speed", "min_impact_speed_before_peak")


def ready_for_tangents(state: LoopState) -> LoopState:
    """Return the state with a tangent, possibly zero, for every field that may get a tangent in the loop. A
    state without any tangent stays as it is."""
    fields = {name: getattr(state, name) for name in (*DIFFERENTIATED, *_REPORTED)}
    return state._replace(**with_tangents(fields))


def differentiated_fields(state: LoopState) -> dict[str, Any]:
    """Return the fields of a state whose tangents later steps use."""
    return {name: getattr(state, name) for name in DIFFERENTIATED}


class Decision(NamedTuple):
    """All choices of an accepted step. With them, another program can repeat the step although that program
    rounds differently."""

    h: Value  # length of the step [s]
    reaches_stop: Flag  # the step ends at the next breakpoint or at the end of the scene
    lands: Flag  # the step ends on an event
    false_uplift: Flag  # the uplift before the step was a rounding error; the columns return to full contact
    mode: Value  # contact mode after the step


class StepInfo(NamedTuple):
    """Result of a trial. `impact_time` and `decision` are valid only if the trial is accepted."""

    accepted: Flag
    impact_time: Value  # time of the impact on which the step ended [s]; NaN without an impact
    decision: Decision
