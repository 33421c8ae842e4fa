"""The step: one trial of one scene, which advances the automaton.

A trial Runge–Kutta step is taken. A quintic through both of its ends is the guard: σθ while rocking, the
demand q in full contact. If the guard breaks inside the step, the step is shortened to end there and tried
again. Once it ends on the event (up to a small part of its length, covered by Taylor expansion) the event is
applied. An event is therefore as accurate as the solver, and needs no memory from one trial to the next.

Times, step lengths and roots are constants for derivatives. An event is differentiated by moving the state to
it and back (`restart`), which is exact in forward and reverse mode.
"""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp

from rockjax import _results as results
from rockjax._outputs.views import Impact, Step, StepEnd
from rockjax._programs.barrier import barrier

from .attempt import (
    AT_ONCE,
    SHRINK,
    Attempt,
    GroundMotion,
    StepOutcome,
    attempt,
    next_length,
    state_past,
)
from .certificate import certificate
from .fast_forward.bounces import skipped_bounces
from .fast_forward.rest import advance_to_uplift
from .fast_forward.samples import may_pass, past_all
from .guard import Guard, watch
from .ratio import safe_ratio
from .state import Decision, LoopState, Plan, Scene, StepInfo
from .transitions import past_breakpoint, restart, transition

NEARLY = 0.95  # of the uplift demand


def step(
    scene: Scene, plan: Plan, state: LoopState, replayed: Decision | None = None
) -> tuple[LoopState, StepInfo]:
    """Advance one scene by one trial step; a rigid podium in full contact goes directly to its next uplift.

    - `scene`, `plan`: the prepared scene and its static choices
    - `state`: state at the start of the step
    - `replayed`: recorded decision of an accepted step, which is repeated; None for a free choice

    Returns the new state and the record of the step.
    """
    if plan.follows_contact:
        return trial(scene, plan, state, replayed)
    if replayed is None:
        # Under `vmap` both branches are computed anyway, and `cond` would copy the samples of records into
        # every lane in every step.
        ahead = past_all(scene, plan, state)
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
    """Try a step, evaluate the guard over it, and either advance or prepare a shorter trial.

    - `scene`, `plan`: the prepared scene and its static choices
    - `state`: state at the start of the step
    - `replayed`: recorded decision of an accepted step, which is repeated; None for a free choice

    Returns the new state and the record of the step.
    """
    ground_at = scene.excitation.piece(state.piece)
    tried = attempt(scene, plan, state, ground_at, replayed)
    guard = watch(scene, plan, state, ground_at, tried.h, tried.a0, tried.end, tried.fresh)
    view, outcome = _classify(scene, plan, state, ground_at, tried, guard, replayed)
    advanced, info = _advance(scene, plan, state, view, outcome, replayed)
    repeated = _repeat(plan, state, tried, outcome)
    return jax.tree.map(lambda yes, no: jnp.where(outcome.accepted, yes, no), advanced, repeated), info


def _classify(
    scene: Scene,
    plan: Plan,
    state: LoopState,
    ground_at: GroundMotion,
    trial: Attempt,
    guard: Guard,
    replayed: Decision | None,
) -> tuple[Step, StepOutcome]:
    """Return the step as outputs see it, and its outcome from its error, its guard and its maxima."""
    constant = jax.lax.stop_gradient
    c, h, tiny, rocking = scene.c, trial.h, trial.tiny, state.sigma != 0
    near = jnp.maximum(scene.landing_fraction * h, tiny)
    in_time = state.t + h + guard.time_past_end <= constant(trial.stop) + tiny
    left, slope = guard.ending.value(guard.time_past_end), guard.ending.slope(guard.time_past_end)
    is_near = jnp.abs(constant(safe_ratio(left, slope, guard.converges))) <= near
    lands = (
        guard.converges
        & (jnp.abs(guard.time_past_end) <= near)
        & is_near
        & ~guard.breaks_before_turn
        & in_time
    )
    # Events at the end of the scene or just before it are ignored, except overturning: answers there move
    # with the end, not with the event.
    over = (
        trial.ends
        & guard.converges
        & ~guard.breaks_before_turn
        & (state.t + h + guard.time_past_end > constant(trial.stop) - AT_ONCE * tiny)
    )
    over &= ~(rocking & guard.rises_on)
    lands &= ~over
    if replayed is not None:
        lands = replayed.lands
    # Events and breakpoints move with the parameters: how far past its stamps the step begins and ends.
    newton = safe_ratio(left, slope, lands)
    before = state.event_time - constant(state.event_time)
    after = jnp.where(
        lands, guard.time_past_end - newton, jnp.where(trial.reaches, trial.stop - constant(trial.stop), 0.0)
    )
    broken = (guard.breaks_before_turn | guard.breaks_after_turn) & ~lands & ~over
    false_uplift = trial.fresh & (constant(state.v[0]) == 0) & broken & (h < 1e-9 / constant(c.p))
    event = jnp.where(broken & ~false_uplift, jnp.maximum(guard.inside, 0.02), jnp.inf)

    # Maxima inside the step are landed on if the polynomial is not accurate enough for them.
    view = Step(scene, plan.refines, state, ground_at, trial, guard, before, after)
    found = tuple(
        output.over_step(view, record) for output, record in zip(plan.outputs, state.records, strict=True)
    )
    # If the demand turns just below the threshold, the step is shortened to end at that turning point.
    doubtful = ~rocking & guard.turned & ~guard.breaks_before_turn & (jnp.abs(guard.top) > NEARLY * c.uplift)
    turning = view.cut_at_turn(doubtful)
    for each in found:
        if each is not None:
            turning = jnp.minimum(turning, jnp.min(each.cut, axis=-1) if each.cut.ndim else each.cut)
    turning = jnp.where(h > tiny, turning, jnp.inf)
    largest = tuple(None if each is None else each.value for each in found)
    # (A second-order method is too inaccurate for this check just after an uplift, where θ ~ t³.)
    halve = jnp.where(guard.turns_twice & (h > tiny) & (plan.tableau.order > 2), 0.5, jnp.inf)

    cut = jnp.minimum(jnp.minimum(turning, event), halve)
    accepted = trial.accurate & ~(cut < 1)
    lands, false_uplift = lands & accepted, false_uplift & accepted
    if replayed is not None:
        accepted, lands, false_uplift = jnp.ones_like(accepted), replayed.lands, replayed.false_uplift
    return view, barrier(StepOutcome(accepted, cut, lands, after, false_uplift, largest))


def _advance(
    scene: Scene,
    plan: Plan,
    state: LoopState,
    view: Step,
    outcome: StepOutcome,
    replayed: Decision | None,
) -> tuple[LoopState, StepInfo]:
    """Return the state after an accepted step, with the automaton's transitions and the records."""
    constant = jax.lax.stop_gradient
    trial, guard = view.trial, view.guard
    t, h, sigma, rocking = state.t, trial.h, state.sigma, state.sigma != 0
    accepted, lands, false_uplift = outcome.accepted, outcome.lands, outcome.false_uplift
    hit, toppled, lifted = (
        lands & rocking & ~guard.rises_on,
        lands & rocking & guard.rises_on,
        lands & ~rocking,
    )

    # The state at the end of the step or at the event, whose time moves with the parameters.
    x, v = barrier(state_past(scene, state, trial, outcome.after))
    hit, toppled, lifted = barrier((hit, toppled, lifted))
    now = jnp.where(lands, t + h + outcome.after, jnp.where(trial.reaches, trial.stop, t + h))
    stamp = jnp.where(lands, jnp.minimum(constant(now), constant(trial.stop)), constant(now))
    delta = jnp.where(lands | trial.reaches, now - constant(now), 0.0)
    passed = stamp >= constant(scene.excitation.breakpoint(state.piece))
    piece = scene.excitation.past(state.piece, passed)
    piece, stamp, now, delta = barrier((piece, stamp, now, delta))
    ground = scene.excitation.piece(piece)(stamp)

    at_impact = x, v
    speed = jnp.abs(v[0])
    skipped = skipped_bounces(scene, plan, state, (stamp, piece, ground), hit, speed, replayed)
    x, v, mode = transition(
        scene, sigma, x, v, ground, hit, lifted, guard.last, false_uplift, skipped.to_rest
    )
    mode = constant(mode) if replayed is None else replayed.mode
    x, v, mode = barrier((x, v, mode))
    starts = accepted & ~rocking & (mode != 0)

    impact = Impact(scene.c, sigma, now, ground, *at_impact, v, mode)
    end = StepEnd(view, accepted, lands, hit, toppled, outcome.after, now, stamp, x, v, impact)
    followed = zip(plan.outputs, state.records, state.notes, outcome.largest, strict=True)
    updated = [output.update(end, record, note, largest) for output, record, note, largest in followed]
    records, notes = (tuple(each[k] for each in updated) for k in (0, 1))
    raises = records[0] > state.peak
    first = starts & ~state.uplifted
    advanced = state._replace(
        t=stamp,
        event_time=now,
        x=x,
        v=v,
        sigma=mode,
        piece=piece,
        h=next_length(scene, state, trial, stamp),
        cut=jnp.full_like(h, jnp.inf),
        records=records,
        notes=notes,
        uplifted=state.uplifted | starts,
        uplift_time=jnp.where(first, now, state.uplift_time),
        overturn_time=jnp.where(toppled, now, state.overturn_time),
        impacts=state.impacts + hit.astype(jnp.int32) + skipped.impacts,
        min_impact_speed=jnp.where(
            accepted & hit,
            jnp.minimum(state.min_impact_speed, skipped.min_impact_speed),
            state.min_impact_speed,
        ),
        min_impact_speed_before_peak=jnp.where(
            raises, state.min_impact_speed, state.min_impact_speed_before_peak
        ),
        steps=state.steps + 1,
    )
    code = jnp.where(stamp >= constant(scene.end), results.END_OF_TIME, results.RUNNING)
    if not plan.to_the_end:
        code = jnp.where(certificate(scene, plan, advanced, piece, ground), results.SETTLED, code)
    # Return to the stamp by the field after the event. An event on a breakpoint comes before it; the field
    # between them applies from one to the other if they move differently.
    stops = jnp.where(piece > state.piece, trial.stop - constant(trial.stop), delta)
    x, v = restart(scene, stamp, delta - stops, x, v, mode, state.piece)
    x, v = past_breakpoint(scene, stamp, stops, x, v, mode, (state.piece, piece))
    code = jnp.where(toppled, results.OVERTURNED, code)
    passing = None if state.passing is None else may_pass(scene, mode, stamp) & (code == results.RUNNING)
    advanced = advanced._replace(x=x, v=v, code=code, passing=passing)
    decision = Decision(h, trial.reaches, lands, false_uplift, mode)
    return advanced, StepInfo(accepted, jnp.where(accepted & hit, now, jnp.nan), decision)


def _repeat(plan: Plan, state: LoopState, trial: Attempt, outcome: StepOutcome) -> LoopState:
    """Return the state after a rejected step: unchanged, with a shorter step to try."""
    shrunk = trial.h * jnp.where(trial.finite, trial.growth, SHRINK)
    return state._replace(
        h=jnp.where(trial.accurate, state.h, shrunk),
        records=tuple(
            output.after_rejection(record) for output, record in zip(plan.outputs, state.records, strict=True)
        ),
        cut=jnp.where(trial.accurate, trial.h * outcome.cut, jnp.inf),
        passing=None if state.passing is None else jnp.zeros_like(trial.finite),
        code=jnp.where(~trial.finite & ~(trial.h > trial.tiny), results.NOT_FINITE, state.code),
        rejected=state.rejected + 1,
    )
