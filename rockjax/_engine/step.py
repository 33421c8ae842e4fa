"""One trial step of one scene (one podium under one excitation).

A trial takes a Runge–Kutta step. An accepted trial advances the scene. After a rejected trial, a shorter one
follows.

A contact mode σ lasts as long as a quantity, the guard, stays within limits. While rocking (σ = ±1) the guard
is σθ with the rotation θ, and the limits are 0 and the overturning angle. In full contact (σ = 0) it is the
uplift demand q of Eq. (9) of docs/model.md, with the limits ±q_up. A quintic polynomial interpolates the
guard between both ends of the step. An event occurs where the guard leaves its limits (it breaks). If this
happens inside the step, the trial is rejected, and the next trial is shortened to end at the event. The event
is applied once a trial ends on it, or so close to it that a Taylor expansion covers the remaining time.
Events are therefore as accurate as the solver.

Times, step lengths and roots are held constant under differentiation (`stop_gradient`). The constant value of
a time is called its stamp; the derivatives of an event's time with respect to the parameters are carried
separately. The end of the step is a constant time. `state_past` moves the state from there to the event, and
the event changes the state. `restart` then moves the state to the stamp, which changes derivatives, but no
values. The resulting derivatives are exact in forward and reverse mode.
"""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp

from rockjax import _results as results
from rockjax._outputs.maxima import Maximum
from rockjax._outputs.views import Impact, Step, StepEnd
from rockjax._programs.barrier import barrier
from rockjax._types import Flag, Index, Value, Vector

from .attempt import (
    SHRINK,
    SIMULTANEOUS,
    Attempt,
    GroundAcceleration,
    StepOutcome,
    attempt,
    next_length,
    state_past,
)
from .certificate import certificate
from .fast_forward.bounces import skipped_bounces
from .fast_forward.rest import advance_to_uplift
from .fast_forward.samples import may_skip_after, skip_samples
from .guard import Guard, evaluate_guard
from .ratio import safe_ratio
from .state import Decision, LoopState, Plan, Scene, StepInfo
from .transitions import after_impact, jolt, past_breakpoint, restart, transition

# A step in full contact ends on a turning point of the demand q if |q| there exceeds this fraction of the
# uplift threshold.
NEAR_UPLIFT = 0.95
# The columns come to rest at an impact if they fell for less than this multiple of
# `Attempt.time_resolution`. The time of such an impact and its derivatives are rounding errors.
SHORTEST_FALL = 10


def step(
    scene: Scene, plan: Plan, state: LoopState, replayed: Decision | None = None
) -> tuple[LoopState, StepInfo]:
    """Advance one scene by one trial step.

    - `scene`: the prepared scene; `plan`: settings that are fixed at compilation, such as the outputs
    - `state`: state at the start of the step
    - `replayed`: recorded decision of an accepted step to repeat; None if the step is decided here

    If the plan integrates full contact (`plan.follows_contact`), every step is a trial. Otherwise a podium in
    full contact goes directly to its next uplift. While it rocks, the state first advances from sample to
    sample of the ground motion as long as no trial is needed (`skip_samples`). Replayed steps skip no
    samples.

    Returns the new state and the result of the trial.
    """
    if plan.follows_contact:
        return trial(scene, plan, state, replayed)
    if replayed is None:
        # Under `vmap`, JAX computes both branches in any case, and `cond` would copy the samples of the
        # ground motion for every scene of the batch in every step.
        ahead = skip_samples(scene, plan, state)
        branches = advance_to_uplift(scene, plan, state), trial(scene, plan, ahead)
        return jax.tree.map(lambda a, b: jnp.where(state.sigma == 0, a, b), *branches)
    return jax.lax.cond(
        state.sigma == 0,
        lambda state: advance_to_uplift(scene, plan, state),
        lambda state: trial(scene, plan, state, replayed),
        state,
    )


# Jitted on its own so that JAX traces it once for all programs and derivatives; the compiler inlines it.
@functools.partial(jax.jit, static_argnames="plan")
def trial(
    scene: Scene, plan: Plan, state: LoopState, replayed: Decision | None = None
) -> tuple[LoopState, StepInfo]:
    """Try one step, with arguments as for `step`.

    Returns the state after the step and the result of the trial. If the step is rejected, time and motion
    stay the same, and the state contains the length of the next, shorter trial.
    """
    ground_at = scene.excitation.piece(state.piece)
    attempted = attempt(scene, plan, state, ground_at, replayed)
    h, a0, end, starts_at_zero = attempted.h, attempted.a0, attempted.end, attempted.starts_at_zero
    guard = evaluate_guard(scene, plan, state, ground_at, h, a0, end, starts_at_zero)
    view, outcome = _classify(scene, plan, state, ground_at, attempted, guard, replayed)
    advanced, info = _advance(scene, plan, state, view, outcome, replayed)
    repeated = _repeat(plan, state, attempted, outcome)
    return jax.tree.map(lambda yes, no: jnp.where(outcome.accepted, yes, no), advanced, repeated), info


def _classify(
    scene: Scene,
    plan: Plan,
    state: LoopState,
    ground_at: GroundAcceleration,
    trial: Attempt,
    guard: Guard,
    replayed: Decision | None,
) -> tuple[Step, StepOutcome]:
    """Return the step in the form that outputs use, and its outcome: accepted, or to be shortened. The
    outcome follows from the error, the guard and the maxima of the outputs."""
    constant = jax.lax.stop_gradient
    lands, is_ignored, newton_correction = _landing(scene, state, trial, guard, replayed)
    # Times of events and breakpoints depend on the parameters. `before` is the time from the start of the
    # step to the event or breakpoint there; it is zero, but has derivatives. `after` is the time from the end
    # of the step to the event or breakpoint there, with derivatives; zero if there is none.
    before = state.event_time - constant(state.event_time)
    after = jnp.where(
        lands,
        guard.time_past_end - newton_correction,
        jnp.where(trial.reaches_stop, trial.stop - constant(trial.stop), 0.0),
    )
    breaks = (guard.breaks_before_turn | guard.breaks_after_turn) & ~lands & ~is_ignored
    # If the columns return to θ = 0 even in a very short first step after an uplift, the uplift is false.
    is_short = trial.h < 1e-9 / constant(scene.c.p)
    false_uplift = trial.starts_at_zero & (constant(state.v[0]) == 0) & breaks & is_short
    # The next trial ends where the guard leaves its limits, but is not shorter than 2 % of this step.
    event_fraction = jnp.where(breaks & ~false_uplift, jnp.maximum(guard.break_point, 0.02), jnp.inf)

    # Outputs take maxima from polynomials through both ends of the step. If a polynomial is too inaccurate
    # for a maximum, the next trial is shortened to end on this maximum.
    view = Step(scene, plan.ends_on_maxima, state, ground_at, trial, guard, before, after)
    maxima = tuple(
        output.over_step(view, accumulator)
        for output, accumulator in zip(plan.outputs, state.accumulators, strict=True)
    )
    largest = tuple(None if maximum is None else maximum.value for maximum in maxima)
    is_divisible = trial.h > trial.time_resolution
    maximum_fraction = jnp.where(is_divisible, _maximum_fraction(view, maxima), jnp.inf)
    # A step in which the guard turns twice is halved. Methods of order 2 or lower omit this check, because
    # they are too inaccurate just after an uplift, where θ ∝ t³.
    checks_turns = plan.tableau.order > 2
    halving = jnp.where(guard.turns_twice & is_divisible & checks_turns, 0.5, jnp.inf)

    retry_fraction = jnp.minimum(jnp.minimum(maximum_fraction, event_fraction), halving)
    accepted = trial.accurate & ~(retry_fraction < 1)
    lands, false_uplift = lands & accepted, false_uplift & accepted
    if replayed is not None:
        accepted, lands, false_uplift = jnp.ones_like(accepted), replayed.lands, replayed.false_uplift
    return view, barrier(StepOutcome(accepted, retry_fraction, lands, after, false_uplift, largest))


def _landing(
    scene: Scene, state: LoopState, trial: Attempt, guard: Guard, replayed: Decision | None
) -> tuple[Flag, Flag, Value]:
    """Return whether the step ends on an event (lands), whether an event at its end is ignored, and the last
    Newton correction of the event's time [s]. The correction is close to zero, but carries the derivatives of
    this time.

    - `scene`, `state`: the prepared scene, and its state at the start of the step
    - `trial`, `guard`: the trial step and its guard
    - `replayed`: recorded decision of an accepted step to repeat; None if the step is decided here
    """
    constant, h, time_resolution = jax.lax.stop_gradient, trial.h, trial.time_resolution
    # The step lands if the time between its end and the event is at most this [s].
    max_distance = jnp.maximum(scene.landing_fraction * h, time_resolution)
    is_before_stop = state.t + h + guard.time_past_end <= constant(trial.stop) + time_resolution
    clearance = guard.clearance_at_end.value(guard.time_past_end)
    slope = guard.clearance_at_end.slope(guard.time_past_end)
    has_small_residual = jnp.abs(constant(safe_ratio(clearance, slope, guard.converges))) <= max_distance
    lands = (
        guard.converges
        & (jnp.abs(guard.time_past_end) <= max_distance)
        & has_small_residual
        & ~guard.breaks_before_turn
        & is_before_stop
    )
    # Events at the end of the scene or just before it are ignored, except overturning. The final outputs are
    # thus differentiated at the end of the scene, not at the event.
    is_ignored = (
        trial.ends_scene
        & guard.converges
        & ~guard.breaks_before_turn
        & (state.t + h + guard.time_past_end > constant(trial.stop) - SIMULTANEOUS * time_resolution)
    )
    is_ignored &= ~((state.sigma != 0) & guard.rising_at_end)
    lands = lands & ~is_ignored if replayed is None else replayed.lands
    return lands, is_ignored, safe_ratio(clearance, slope, lands)


def _maximum_fraction(view: Step, maxima: tuple[Maximum | None, ...]) -> Value:
    """Return the fraction of this step after which the next trial must end, so that it ends on a maximum of
    the demand or of an output; inf if this is not necessary."""
    state, guard = view.state, view.guard
    # If |q| has a maximum just below the threshold, the next trial ends at this maximum.
    turns_in_contact = (state.sigma == 0) & guard.turned & ~guard.breaks_before_turn
    is_near_uplift = jnp.abs(guard.turn_value) > NEAR_UPLIFT * view.scene.c.uplift
    fraction = view.cut_at_turn(turns_in_contact & is_near_uplift)
    for maximum in maxima:
        if maximum is not None:
            fractions = maximum.retry_fraction
            fraction = jnp.minimum(fraction, jnp.min(fractions, axis=-1) if fractions.ndim else fractions)
    return fraction


def _advance(
    scene: Scene,
    plan: Plan,
    state: LoopState,
    view: Step,
    outcome: StepOutcome,
    replayed: Decision | None,
) -> tuple[LoopState, StepInfo]:
    """Return the state after an accepted step, including the transition at its end, and the `StepInfo`."""
    constant = jax.lax.stop_gradient
    trial, guard = view.trial, view.guard
    h, sigma, rocking = trial.h, state.sigma, state.sigma != 0
    accepted, lands, false_uplift = outcome.accepted, outcome.lands, outcome.false_uplift
    rises = guard.rising_at_end
    hit, toppled, lifted = lands & rocking & ~rises, lands & rocking & rises, lands & ~rocking
    # The state at the end of the step, or at the event on which the step ends.
    x, v = barrier(state_past(scene, state, trial, outcome.after))
    hit, toppled, lifted = barrier((hit, toppled, lifted))
    piece, stamp, now, shift = barrier(_times(scene, state, trial, outcome))
    ground = scene.excitation.piece(piece)(stamp)

    at_impact = x, v
    speed = jnp.abs(v[0])
    skipped = skipped_bounces(scene, plan, state, (stamp, piece, ground), hit, speed, replayed)
    shortest_fall = SHORTEST_FALL * trial.time_resolution
    to_rest = skipped.to_rest | (speed < shortest_fall * jnp.abs(trial.a0[0]))
    x, v, mode = transition(scene, sigma, x, v, ground, hit, lifted, guard.end_value, false_uplift, to_rest)
    ground_jump = _ground_jump(scene, state, (piece != state.piece) & ~toppled, mode, x, v, ground)
    if ground_jump is not None:
        v, mode = ground_jump.v, ground_jump.sigma
    mode = constant(mode) if replayed is None else replayed.mode
    x, v, mode = barrier((x, v, mode))
    uplifts = accepted & ~rocking & (mode != 0)

    # If bounces are skipped, θ̇ in `v` is already zero, but outputs need θ̇ just after this impact.
    theta_dot_after, _ = after_impact(scene, sigma, at_impact[1][0], guard.end_value)
    impact = Impact(scene.c, sigma, now, ground, *at_impact, (theta_dot_after, *v[1:]), mode)
    end = StepEnd(view, accepted, lands, hit, toppled, outcome.after, now, stamp, x, v, impact, ground_jump)
    rows = zip(plan.outputs, state.accumulators, state.notes, outcome.largest, strict=True)
    updated = [output.update(end, accumulator, note, largest) for output, accumulator, note, largest in rows]
    accumulators, notes = (tuple(pair[k] for pair in updated) for k in (0, 1))
    impacts = hit.astype(jnp.int32) + skipped.impacts + (0 if ground_jump is None else ground_jump.strikes)
    is_first_uplift = uplifts & ~state.uplifted
    least = jnp.minimum(state.min_impact_speed, skipped.min_impact_speed)
    advanced = state._replace(
        t=stamp,
        event_time=now,
        x=x,
        v=v,
        sigma=mode,
        piece=piece,
        h=next_length(scene, state, trial, stamp),
        trial_limit=jnp.full_like(h, jnp.inf),
        accumulators=accumulators,
        notes=notes,
        uplifted=state.uplifted | uplifts,
        uplift_time=jnp.where(is_first_uplift, now, state.uplift_time),
        overturn_time=jnp.where(toppled, now, state.overturn_time),
        impacts=state.impacts + impacts,
        min_impact_speed=jnp.where(accepted & hit, least, state.min_impact_speed),
        min_impact_speed_before_peak=jnp.where(
            accumulators[0] > state.peak, state.min_impact_speed, state.min_impact_speed_before_peak
        ),
        steps=state.steps + 1,
    )
    code = jnp.where(stamp >= constant(scene.end), results.END_OF_TIME, results.RUNNING)
    if not plan.to_the_end:
        code = jnp.where(certificate(scene, plan, advanced, piece, ground), results.SETTLED, code)
    # The state is moved from the event to the stamp with the equation of motion after the event. If the event
    # coincides with a breakpoint, the derivatives of their times may differ. The state is then moved to the
    # breakpoint with the old piece of the excitation, and from there to the stamp with the new piece.
    breakpoint_shift = jnp.where(piece > state.piece, trial.stop - constant(trial.stop), shift)
    x, v = restart(scene, stamp, shift - breakpoint_shift, x, v, mode, state.piece)
    x, v = past_breakpoint(scene, stamp, breakpoint_shift, x, v, mode, (state.piece, piece))
    code = jnp.where(toppled, results.OVERTURNED, code)
    may_skip = (
        None if state.may_skip is None else may_skip_after(scene, mode, stamp) & (code == results.RUNNING)
    )
    advanced = advanced._replace(x=x, v=v, code=code, may_skip=may_skip)
    decision = Decision(h, trial.reaches_stop, lands, false_uplift, mode)
    return advanced, StepInfo(accepted, jnp.where(accepted & hit, now, jnp.nan), decision)


def _times(
    scene: Scene, state: LoopState, trial: Attempt, outcome: StepOutcome
) -> tuple[Index, Value, Value, Value]:
    """Return four results: the piece after the step, the time of the step's end as a stamp [s], the same time
    with derivatives [s], and a shift that is zero, but has these derivatives [s]."""
    constant, t, h, lands = jax.lax.stop_gradient, state.t, trial.h, outcome.lands
    now = jnp.where(lands, t + h + outcome.after, jnp.where(trial.reaches_stop, trial.stop, t + h))
    stamp = jnp.where(lands, jnp.minimum(constant(now), constant(trial.stop)), constant(now))
    shift = jnp.where(lands | trial.reaches_stop, now - constant(now), 0.0)
    at_breakpoint = stamp >= constant(scene.excitation.breakpoint(state.piece))
    return scene.excitation.past(state.piece, at_breakpoint), stamp, now, shift


def _ground_jump(scene: Scene, state: LoopState, is_passed: Flag, mode: Value, x: Vector, v: Vector, ground):
    """Return the effect of a jump of the ground's velocity at the end of the piece; None if the ground's
    velocity never jumps. Unless `is_passed` (the step reaches the next piece, and the columns do not
    overturn), the jump is zero."""
    jump = scene.excitation.velocity_jump(state.piece)
    if jump is None:
        return None
    jump = jax.tree.map(lambda y: jnp.where(is_passed, y, 0.0), jump)
    return jolt(scene, mode, x, v, ground, jump)


def _repeat(plan: Plan, state: LoopState, trial: Attempt, outcome: StepOutcome) -> LoopState:
    """Return the state after a rejected step: time and motion stay the same, and the next trial is
    shorter."""
    shrunk = trial.h * jnp.where(trial.finite, trial.growth, SHRINK)
    return state._replace(
        h=jnp.where(trial.accurate, state.h, shrunk),
        accumulators=tuple(
            output.after_rejection(accumulator)
            for output, accumulator in zip(plan.outputs, state.accumulators, strict=True)
        ),
        trial_limit=jnp.where(trial.accurate, trial.h * outcome.retry_fraction, jnp.inf),
        may_skip=None if state.may_skip is None else jnp.zeros_like(trial.finite),
        code=jnp.where(~trial.finite & ~(trial.h > trial.time_resolution), results.NOT_FINITE, state.code),
        rejected=state.rejected + 1,
    )
