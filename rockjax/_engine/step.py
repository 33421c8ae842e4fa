"""The step: one scene, one trial, read as the automaton it advances.

A trial Runge–Kutta step is taken; a quintic through both of its ends is the guard: σθ while rocking, the demand q in
full contact. If the guard is broken inside the step, the step is shortened to end there and tried again; once it ends
on the event (to a small part of its length, the rest by Taylor) the event is applied. So an event costs the
solver's own accuracy, and nothing about it needs remembering from one trial to the next.

Times, step lengths and roots are constants for derivatives. An event is differentiated by moving the state to it and
back (`restart`), which is exact in forward and reverse mode.
"""

from __future__ import annotations

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp

from rockjax import _results as results
from rockjax._types import Flag, Value, Vector

from . import margin
from .guard import Guard, safe_ratio, watch
from .hermite import quintic
from .maxima import NEAR_RECORD, WELL_INSIDE, WELL_INSIDE_CUBIC, End, Maximum, cubic, largest, spring, summit
from .model import acceleration, beam, beam_acceleration, shear, uplift_demand
from .runge_kutta import Step
from .runge_kutta import step as runge_kutta
from .scene import LoopState, Plan, Scene, after_impact, contact_mode, restart
from .settled import certificate

NEARLY = 0.95  # of the uplift demand
AT_ONCE = 100  # times the resolution of time: what the end of the scene follows so closely is not told from it
SAFETY, SHRINK, GROW = 0.85, 0.2, 5.0  # of the step-size control


class Decision(NamedTuple):
    """All that is discrete about an accepted step. Told these, a step can be repeated whatever its rounding."""

    h: Value
    reaches: Flag  # the stop
    lands: Flag  # on an event
    false_uplift: Flag
    mode: Value  # afterwards


class StepInfo(NamedTuple):
    """What may be kept of a trial: whether it was accepted, the time of the impact it ended on (else NaN), and how."""

    accepted: Flag
    impact_time: Value
    decision: Decision


def step(scene: Scene, plan: Plan, state: LoopState, replayed: Decision | None = None) -> tuple[LoopState, StepInfo]:
    """Advance one scene by one trial step; in full contact without anything elastic, to the next uplift at once.

    With a decision `told`, the accepted step that it comes from is repeated.
    """
    if plan.elastic:
        return trial(scene, plan, state, replayed)
    return jax.lax.cond(
        state.sigma == 0,
        lambda state: advance_to_uplift(scene, plan, state),
        lambda state: trial(scene, plan, state, replayed),
        state,
    )


# A function of its own to JAX, as are others inside: traced once for all programs and derivatives that are built of it. The
# compiler inlines it.
@functools.partial(jax.jit, static_argnames="plan")
def trial(scene: Scene, plan: Plan, state: LoopState, replayed: Decision | None = None) -> tuple[LoopState, StepInfo]:
    """Try a step, look at the guard over it, and either advance or try again with a shorter one."""
    ground = scene.excitation.piece(state.piece)
    trial = _attempt(scene, plan, state, ground, replayed)
    guard = watch(scene, plan, state, ground, trial.h, trial.a0, trial.end, trial.fresh)
    outcome = _classify(scene, plan, state, ground, trial, guard, replayed)
    advanced, info = _advance(scene, plan, state, trial, guard, outcome, replayed)
    repeated = _repeat(plan, state, trial, outcome)
    return jax.tree.map(lambda yes, no: jnp.where(outcome.accepted, yes, no), advanced, repeated), info


class _Trial(NamedTuple):
    """A trial step, and how accurate it is."""

    h: Value
    reaches: Flag  # the stop
    stop: Value  # the next breakpoint or the end of the scene; moves with the parameters
    ends: Flag  # the scene
    fresh: Flag  # on θ = 0, after an impact or an uplift
    a0: Vector
    end: Step
    error: Value  # over tolerance
    finite: Flag
    accurate: Flag
    tiny: Value  # the resolution of time


def _attempt(scene: Scene, plan: Plan, state: LoopState, ground, replayed: Decision | None) -> _Trial:
    constant = jax.lax.stop_gradient
    c, t = scene.c, state.t

    @jax.jit  # traced once for all stages
    def field(t, x, v):
        return acceleration(c, state.sigma, ground(t), x, v)

    # How far: to the next breakpoint at most, and over a hop in one step.
    tiny = 1e-13 * (jnp.abs(t) + 1 / constant(c.p))
    edge = scene.excitation.breakpoint(state.piece)
    # A breakpoint that the end follows at once is not looked at: the end is what moves the step.
    last = constant(scene.end) <= constant(edge) + AT_ONCE * tiny
    stop = jnp.where(last, scene.end, edge)
    a0 = field(t, state.x, state.v)
    fresh = (state.sigma != 0) & (state.x[0] == 0)
    h, reaches = _length(scene, state, constant(a0[0]), fresh, constant(stop))
    if replayed is not None:
        h, reaches = replayed.h, replayed.reaches
    h, reaches, a0 = jax.lax.optimization_barrier((h, reaches, a0))
    end = jax.lax.optimization_barrier(runge_kutta(plan.tableau, field, t, h, state.x, state.v, a0))
    error = constant(_error(scene, state, end))
    finite = jnp.isfinite(error)
    return _Trial(
        h, reaches, stop, reaches & last, fresh, a0, end, error, finite, finite & ((error <= 1) | (h < tiny)), tiny
    )


class _StepOutcome(NamedTuple):
    """What becomes of a trial."""

    accepted: Flag
    cut: Value  # fraction of the step to try instead, inf where there is no need
    lands: Flag  # ends on an event …
    after: Value  # … this long after its end; also carries the derivative of the time of a breakpoint
    false_uplift: Flag  # a lift that the next step does not confirm is none: back to full contact
    peaks: Flag  # |θ| has a maximum at the guard's turning point
    deformation: Value
    force: Value
    margin: Value  # of that maximum


def _classify(
    scene: Scene, plan: Plan, state: LoopState, ground, trial: _Trial, guard: Guard, replayed: Decision | None
) -> _StepOutcome:
    constant = jax.lax.stop_gradient
    c, h, tiny, rocking = scene.c, trial.h, trial.tiny, state.sigma != 0
    near = jnp.maximum(scene.landing * h, tiny)
    in_time = state.t + h + guard.time_past_end <= constant(trial.stop) + tiny
    left, slope = guard.ending.value(guard.time_past_end), guard.ending.slope(guard.time_past_end)
    known = jnp.abs(constant(safe_ratio(left, slope, guard.converges))) <= near
    lands = guard.converges & (jnp.abs(guard.time_past_end) <= near) & known & ~guard.breaks_before_turn & in_time
    # What happens at the end of the scene or just before it does not happen any more, but for overturning:
    # answers there move with the end, not with the event.
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
    after = jnp.where(lands, guard.time_past_end - newton, jnp.where(trial.reaches, trial.stop - constant(trial.stop), 0.0))
    broken = (guard.breaks_before_turn | guard.breaks_after_turn) & ~lands & ~over
    false_uplift = trial.fresh & (constant(state.v[0]) == 0) & broken & (h < 1e-9 / constant(c.p))
    event = jnp.where(broken & ~false_uplift, jnp.maximum(guard.inside, 0.02), jnp.inf)

    # Maxima inside the step; where the polynomial is not good enough for them, they are landed on as well.
    well_inside = (guard.turn > WELL_INSIDE) & (guard.turn < 1 - WELL_INSIDE)
    peaks = rocking & guard.rising & guard.turned
    record = guard.top > state.peak * (1 - NEAR_RECORD)
    margin_at_turn = _spare(scene, plan, state, ground, trial, guard, peaks) if plan.margin else jnp.ones_like(h)
    if plan.margin:
        record |= constant(margin_at_turn) < state.margin + NEAR_RECORD * (1 - state.margin)
    wanted = plan.refine & peaks & record
    # A demand that turns close under the threshold is looked at where it turns.
    doubtful = ~rocking & guard.turned & ~guard.breaks_before_turn & (jnp.abs(guard.top) > NEARLY * c.uplift)
    turning = jnp.where((wanted | doubtful) & well_inside, guard.turn, jnp.inf)
    deformation, force = _maxima(scene, plan, state, ground, trial, before, after)
    turning = jnp.minimum(turning, jnp.minimum(deformation.cut, force.cut))
    turning = jnp.where(h > tiny, turning, jnp.inf)
    # (A second-order method does not know the first motion after an uplift, θ ~ t³, well enough to be asked.)
    halve = jnp.where(guard.turns_twice & (h > tiny) & (plan.tableau.order > 2), 0.5, jnp.inf)

    cut = jnp.minimum(jnp.minimum(turning, event), halve)
    accepted = trial.accurate & ~(cut < 1)
    lands, false_uplift = lands & accepted, false_uplift & accepted
    if replayed is not None:
        accepted, lands, false_uplift = jnp.ones_like(accepted), replayed.lands, replayed.false_uplift
    return jax.lax.optimization_barrier(
        _StepOutcome(accepted, cut, lands, after, false_uplift, peaks, deformation.value, force.value, margin_at_turn)
    )


def _advance(
    scene: Scene, plan: Plan, state: LoopState, trial: _Trial, guard: Guard, outcome: _StepOutcome, replayed: Decision | None
) -> tuple[LoopState, StepInfo]:
    """The state after an accepted step: the automaton's transitions, and the records."""
    constant = jax.lax.stop_gradient
    c, t, h, sigma, rocking = scene.c, state.t, trial.h, state.sigma, state.sigma != 0
    accepted, lands, false_uplift = outcome.accepted, outcome.lands, outcome.false_uplift
    hit, toppled, lifted = lands & rocking & ~guard.rises_on, lands & rocking & guard.rises_on, lands & ~rocking

    # The state at the end, at the event where there is one; its time moves with the parameters.
    x, v = _past(scene, state, trial, outcome.after)
    now = jnp.where(lands, t + h + outcome.after, jnp.where(trial.reaches, trial.stop, t + h))
    stamp = jnp.where(lands, jnp.minimum(constant(now), constant(trial.stop)), constant(now))
    delta = jnp.where(lands | trial.reaches, now - constant(now), 0.0)
    piece = state.piece + (stamp >= constant(scene.excitation.breakpoint(state.piece)))
    ground = scene.excitation.piece(piece)(stamp)

    # The transitions.
    speed = jnp.abs(v[0])
    x0 = jnp.where(hit | lifted | false_uplift | ~rocking, 0.0, x[0])
    v0 = jnp.where(lifted | false_uplift | ~rocking, 0.0, v[0])
    q = uplift_demand(c, ground, (x0, *x[1:]), (v0, *v[1:]))
    onward, side = after_impact(scene, sigma, v0, q)
    x, v = (x0, *x[1:]), (jnp.where(hit, onward, v0), *v[1:])
    stays = jnp.where(rocking, sigma, contact_mode(c, q))
    mode = jnp.where(hit, side, jnp.where(lifted, -jnp.sign(guard.last), stays))
    mode = constant(jnp.where(false_uplift, 0.0, mode)) if replayed is None else replayed.mode
    starts = accepted & ~rocking & (mode != 0)

    # The records.
    step_peak, step_peak_time = _step_peak(scene, state, trial, guard, outcome, hit, toppled, now)
    raises = accepted & rocking & (step_peak > state.peak)
    first = starts & ~state.uplifted
    advanced = state._replace(
        t=stamp,
        event_time=now,
        x=x,
        v=v,
        sigma=mode,
        piece=piece,
        h=_next_length(scene, plan, state, h, trial.error, stamp),
        cut=jnp.full_like(h, jnp.inf),
        peak=jnp.where(raises, step_peak, state.peak),
        peak_time=jnp.where(raises, step_peak_time, state.peak_time),
        deformation=_larger(outcome.deformation, state.deformation) if plan.deformation else state.deformation,
        shear=_larger(outcome.force, state.shear) if plan.shear else state.shear,
        margin=_least_margin(scene, state, outcome, x, v, toppled, stamp) if plan.margin else state.margin,
        uplifted=state.uplifted | starts,
        uplift_time=jnp.where(first, now, state.uplift_time),
        overturn_time=jnp.where(toppled, now, state.overturn_time),
        impacts=state.impacts + hit,
        slowest=jnp.where(accepted & hit, jnp.minimum(state.slowest, speed), state.slowest),
        slowest_before_peak=jnp.where(raises, state.slowest, state.slowest_before_peak),
        steps=state.steps + 1,
    )
    code = jnp.where(stamp >= constant(scene.end), results.END_OF_TIME, results.RUNNING)
    if not plan.to_the_end:
        code = jnp.where(certificate(scene, plan, advanced, piece, ground), results.SETTLED, code)
    # Back to the stamp by the field after it. An event that falls on a breakpoint comes before it: from one to the other by
    # the field between them, where both move their own ways.
    stops = jnp.where(piece > state.piece, trial.stop - constant(trial.stop), delta)
    x, v = restart(scene, stamp, delta - stops, x, v, mode, state.piece)
    x, v = restart(scene, stamp, stops, x, v, mode, piece)
    advanced = advanced._replace(x=x, v=v, code=jnp.where(toppled, results.OVERTURNED, code))
    decision = Decision(h, trial.reaches, lands, false_uplift, mode)
    return advanced, StepInfo(accepted, jnp.where(accepted & hit, now, jnp.nan), decision)


def _repeat(plan: Plan, state: LoopState, trial: _Trial, outcome: _StepOutcome) -> LoopState:
    """The state after a rejected step: as before, to be tried shorter."""
    shrunk = trial.h * jnp.where(trial.finite, _factor(plan, trial.error), SHRINK)
    return state._replace(
        h=jnp.where(trial.accurate, state.h, shrunk),
        cut=jnp.where(trial.accurate, trial.h * outcome.cut, jnp.inf),
        code=jnp.where(~trial.finite & ~(trial.h > trial.tiny), results.NOT_FINITE, state.code),
        rejected=state.rejected + 1,
    )


def _step_peak(
    scene: Scene, state: LoopState, trial: _Trial, guard: Guard, outcome: _StepOutcome, hit: Flag, toppled: Flag, now: Value
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


def _spare(scene: Scene, plan: Plan, state: LoopState, ground, trial: _Trial, guard: Guard, peaks: Flag) -> Value:
    """The overturning margin of a maximum of |θ| at the guard's turning point."""
    h, sigma, path = trial.h, state.sigma, guard.path
    off = safe_ratio(path.slope(guard.turn), path.curvature(guard.turn), peaks)
    z = guard.turn - jnp.clip(off, -1.0, 1.0)  # moves with the parameters
    theta = path.value(z)
    x, v = (sigma * theta,), (jnp.zeros_like(h),)
    if plan.elastic:
        sway = quintic(state.x[1], state.v[1], trial.a0[1], trial.end.x[1], trial.end.v[1], trial.end.a[1], h)
        x, v = (*x, sway.value(z)), (*v, safe_ratio(sway.slope(z), h, h > 0))
    slowing = -sigma * acceleration(scene.c, sigma, ground(state.t + z * h), x, v)[0]
    return jnp.where(peaks, margin.at_turn(scene.c, scene.overturn_angle, theta, slowing), jnp.inf)


def _least_margin(
    scene: Scene, state: LoopState, outcome: _StepOutcome, x: Vector, v: Vector, toppled: Flag, stamp: Value
) -> Value:
    """The overturning margin so far, after an accepted step to the state (x, v)."""
    least = jnp.where(outcome.peaks & (outcome.margin < state.margin), outcome.margin, state.margin)
    # Out of time on the way up: what is left from there.
    rises = (stamp >= jax.lax.stop_gradient(scene.end)) & (x[0] * v[0] > 0)
    here = margin.at_rest(scene.c, scene.overturn_angle, jnp.abs(x[0]))
    least = jnp.where(rises & (here < least), here, least)
    return jnp.where(toppled, margin.at_fall(scene.c, scene.overturn_angle, v[0]), least)


@functools.partial(jax.jit, static_argnames="plan")
def advance_to_uplift(scene: Scene, plan: Plan, state: LoopState) -> tuple[LoopState, StepInfo]:
    """Full contact with nothing elastic: the next uplift is a root of the excitation."""
    constant = jax.lax.stop_gradient
    c, t, excitation = scene.c, state.t, scene.excitation
    lifts_at = constant(scene.outlook.next_exceedance(t, state.piece))
    end = constant(scene.end)
    lifts = lifts_at < end
    stamp = jnp.where(lifts, lifts_at, jnp.where(jnp.isinf(lifts_at), t, end))
    piece = jnp.where(lifts, excitation.locate(stamp), state.piece)
    side = constant(-jnp.sign(excitation.piece(piece)(stamp)))
    # The time of the uplift moves with the crossing, or with the breakpoint at which the ground jumps above. A crossing that
    # falls on a breakpoint, but for rounding, is that of the piece before.
    edge = excitation.breakpoint(piece - 1)
    on_edge = constant(edge) == stamp
    jump = excitation.piece(piece)(stamp) - excitation.piece(piece - 1)(stamp)
    jumps = on_edge & (jnp.abs(constant(jump)) > 1e-9 * constant(c.uplift))
    crossed = excitation.piece(piece - (on_edge & ~jumps))
    ground, slope = jax.jvp(crossed, (stamp,), (jnp.ones_like(stamp),))
    time_past_end = safe_ratio(-side * ground - c.uplift, -side * slope, lifts & ~jumps)
    now = jnp.where(jumps, edge, stamp - (time_past_end - constant(time_past_end)))
    now = jnp.where(lifts, now, stamp)
    mode = jnp.where(lifts, side, 0.0)
    x, v = restart(scene, stamp, now - constant(now), state.x, state.v, mode, piece)
    code = jnp.where(lifts, results.RUNNING, jnp.where(jnp.isinf(lifts_at), results.SETTLED, results.END_OF_TIME))
    force = state.shear
    if plan.shear:
        highest = scene.outlook.highest_time(t, jnp.minimum(lifts_at, end))
        force = _larger(jnp.abs(excitation(constant(highest))) / c.g, state.shear)
    leapt = state._replace(
        t=stamp,
        event_time=now,
        x=x,
        v=v,
        sigma=mode,
        piece=piece.astype(jnp.int32),
        shear=force,
        code=code.astype(jnp.int32),
        uplifted=state.uplifted | lifts,
        uplift_time=jnp.where(lifts & ~state.uplifted, now, state.uplift_time),
        steps=state.steps + 1,
    )
    no, yes = jnp.zeros((), bool), jnp.ones((), bool)
    return leapt, StepInfo(yes, jnp.full_like(t, jnp.nan), Decision(jnp.zeros_like(t), no, no, no, mode))


def _larger(new: Value, record: Value) -> Value:
    """The larger of two, with the derivative of one of them: `maximum` would take half of each where they tie."""
    return jnp.where(new > record, new, record)


def _length(scene: Scene, state: LoopState, angular: Value, fresh: Flag, stop: Value) -> tuple[Value, Flag]:
    """The length of the trial, and whether it reaches the stop."""
    room = stop - state.t
    h = jnp.where(state.h > 0.999 * room, room, jnp.where(state.h > 0.5 * room, 0.5 * room, state.h))
    # After an impact θ̈ is nearly constant over a short hop, which lasts 2|θ̇/θ̈|.
    speed = jax.lax.stop_gradient(state.v[0])
    returns = fresh & (speed * angular < 0)
    hop = jnp.where(returns, -2 * speed / jnp.where(returns, angular, 1.0), jnp.inf)
    h = jnp.minimum(h, jnp.minimum(state.cut, hop))
    return h, h >= room


def _error(scene: Scene, state: LoopState, trial: Step) -> Value:
    """Root mean square of the estimated error over tolerance, in natural units."""
    c = scene.c
    x_unit, v_unit = (c.alpha,), (c.p * c.alpha,)
    if c.elastic:
        sway = c.two_R * c.sin_alpha
        x_unit, v_unit = (*x_unit, sway), (*v_unit, sway * jnp.maximum(c.p, jnp.sqrt(c.omega2)))
    total = jnp.zeros_like(state.t)
    for old, new, error, units in (
        (state.x, trial.x, trial.x_error, x_unit),
        (state.v, trial.v, trial.v_error, v_unit),
    ):
        for y0, y1, e, unit in zip(old, new, error, units, strict=True):
            scale = scene.atol * unit + scene.rtol * jnp.maximum(jnp.abs(y0), jnp.abs(y1))
            total = total + (e / scale) ** 2
    return jnp.sqrt(total / (2 * len(state.x)))


def _factor(plan: Plan, error: Value) -> Value:
    # x^(−1/order) through exp and log, which vectorise; pow does not.
    growth = SAFETY * jnp.exp(-jnp.log(jnp.maximum(error, 1e-30)) / plan.tableau.order)
    return jnp.clip(growth, SHRINK, GROW)


def _next_length(scene: Scene, plan: Plan, state: LoopState, h: Value, error: Value, t: Value) -> Value:
    """The controller's next step. A step that an event or a breakpoint cut short says little about it."""
    proposed = h * _factor(plan, error)
    shortened = (h < 0.99 * state.h) & (error < 0.5)
    proposed = jnp.where(shortened, jnp.maximum(proposed, state.h), proposed)
    return jnp.minimum(proposed, jnp.where(t < scene.quiet, scene.longest_excited, scene.longest))


def _past(scene: Scene, state: LoopState, trial: _Trial, after: Value) -> tuple[Vector, Vector]:
    """The state shortly after the end of the step: along the quintic through both of its ends, from the end on."""
    h = trial.h
    z = safe_ratio(after, h, h > 0)
    # Over a very short step the quintic is a difference of nearly equal numbers, and the mean jerk is enough.
    long = h > 0.01 * scene.longest
    x, v = [], []
    for x0, v0, a0, x1, v1, a1 in zip(state.x, state.v, trial.a0, trial.end.x, trial.end.v, trial.end.a, strict=True):
        c3, c4, c5 = quintic(x0, v0, a0, x1, v1, a1, h)[3:]
        # Third to fifth derivative at the end, over 3!, 4!, 5!; the lower ones are known better than by differences.
        d3 = jnp.where(long, c3 + 4 * c4 + 10 * c5, (a1 - a0) * h**2 / 6)
        d4, d5 = jnp.where(long, c4 + 5 * c5, 0.0), jnp.where(long, c5, 0.0)
        x.append(x1 + after * (v1 + 0.5 * after * a1) + z**3 * (d3 + z * (d4 + z * d5)))
        v.append(v1 + after * a1 + safe_ratio(z**2 * (3 * d3 + z * (4 * d4 + z * 5 * d5)), h, h > 0))
    return tuple(x), tuple(v)


def _maxima(
    scene: Scene, plan: Plan, state: LoopState, ground, trial: _Trial, before: Value, after: Value
) -> tuple[Maximum, Maximum]:
    """Largest deformation and shear of the superstructure over the step, where they are wanted.

    The step begins `before` and ends `after` its time stamps.
    """
    c, h, sigma, a0, end = scene.c, trial.h, state.sigma, trial.a0, trial.end
    none = Maximum(jnp.zeros_like(h), jnp.full_like(h, jnp.inf))
    if plan.elastic and (plan.deformation or plan.shear):
        jets: list[tuple[Value, Value, Value]] = []
        for x, v, a in ((state.x, state.v, a0), (end.x, end.v, end.a)):
            u_b, u_b_dot = beam(c, sigma, x[0], v[0])
            jets.append((x[1] - u_b, v[1] - u_b_dot, a[1] - beam_acceleration(c, sigma, x[0], v[0], a[0])))
        path = quintic(*jets[0], *jets[1], h)
        deformation = force = none
        if plan.deformation:
            ends = (End(jets[0][0], jets[0][1], before), End(jets[1][0], jets[1][1], after))
            deformation = largest(path, h, state.deformation, ends)
        if plan.shear:
            first, last = ((c.omega2 * d + c.damping * r, c.omega2 * r + c.damping * s) for d, r, s in jets)
            ends = (End(*first, before), End(*last, after))
            force = largest(spring(path, c.omega2, c.damping, h), h, state.shear * c.g, ends)
            force = force._replace(value=force.value / c.g)
        # The shear takes a derivative of the polynomial: it is landed on whatever the order.
        return deformation if plan.refine else deformation._replace(cut=none.cut), force
    if not plan.elastic and plan.shear:

        def along(t, x, v):
            return shear(c, sigma, ground(t), x, v, acceleration(c, sigma, ground(t), x, v))

        one = jnp.ones_like(h)
        s0, rate0 = jax.jvp(along, (state.t, state.x, state.v), (one, state.v, a0))
        s1, rate1 = jax.jvp(along, (state.t + h, end.x, end.v), (one, end.v, end.a))
        ends = (End(s0, rate0, before), End(s1, rate1, after))
        return none, largest(cubic(s0, rate0, s1, rate1, h), h, state.shear, ends, WELL_INSIDE_CUBIC)
    return none, none
