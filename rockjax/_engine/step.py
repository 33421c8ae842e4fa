"""The step: one lane, one trial, read as the automaton it advances.

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
from .scene import Lane, Plan, Scene, after_impact, contact_mode, restart
from .settled import certificate

LANDED = 10.0  # times √rtol of the step, at most 2 %: the quintic of the step carries the state over the rest
NEARLY = 0.95  # of the uplift demand
AT_ONCE = 100  # times the resolution of time: what the end of the scene follows so closely is not told from it
SAFETY, SHRINK, GROW = 0.85, 0.2, 5.0  # of the step-size control


class Decision(NamedTuple):
    """All that is discrete about an accepted step. Told these, a step can be repeated whatever its rounding."""

    h: Value
    reaches: Flag  # the stop
    lands: Flag  # on an event
    fizzles: Flag
    mode: Value  # afterwards


class Landmark(NamedTuple):
    """What may be kept of a trial: whether it was accepted, the time of the impact it ended on (else NaN), and how."""

    accepted: Flag
    impact_time: Value
    decision: Decision


def step(scene: Scene, how: Plan, lane: Lane, told: Decision | None = None) -> tuple[Lane, Landmark]:
    """Advance one lane by one trial step; in full contact without anything elastic, to the next uplift at once.

    With a decision `told`, the accepted step that it comes from is repeated.
    """
    if how.elastic:
        return trial(scene, how, lane, told)
    return jax.lax.cond(
        lane.sigma == 0, lambda lane: leap(scene, how, lane), lambda lane: trial(scene, how, lane, told), lane
    )


# A function of its own to JAX, as are others inside: traced once for all programs and derivatives that are built of it. The
# compiler inlines it.
@functools.partial(jax.jit, static_argnames="how")
def trial(scene: Scene, how: Plan, lane: Lane, told: Decision | None = None) -> tuple[Lane, Landmark]:
    """Try a step, look at the guard over it, and either advance or try again with a shorter one."""
    ground = scene.excitation.piece(lane.piece)
    trial = _attempt(scene, how, lane, ground, told)
    guard = watch(scene, how, lane, ground, trial.h, trial.a0, trial.end, trial.fresh)
    verdict = _judge(scene, how, lane, ground, trial, guard, told)
    advanced, landmark = _advance(scene, how, lane, trial, guard, verdict, told)
    repeated = _repeat(how, lane, trial, verdict)
    return jax.tree.map(lambda yes, no: jnp.where(verdict.accepted, yes, no), advanced, repeated), landmark


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


def _attempt(scene: Scene, how: Plan, lane: Lane, ground, told: Decision | None) -> _Trial:
    constant = jax.lax.stop_gradient
    c, t = scene.c, lane.t

    @jax.jit  # traced once for all stages
    def field(t, x, v):
        return acceleration(c, lane.sigma, ground(t), x, v)

    # How far: to the next breakpoint at most, and over a hop in one step.
    tiny = 1e-13 * (jnp.abs(t) + 1 / constant(c.p))
    edge = scene.excitation.breakpoint(lane.piece)
    # A breakpoint that the end follows at once is not looked at: the end is what moves the step.
    last = constant(scene.end) <= constant(edge) + AT_ONCE * tiny
    stop = jnp.where(last, scene.end, edge)
    a0 = field(t, lane.x, lane.v)
    fresh = (lane.sigma != 0) & (lane.x[0] == 0)
    h, reaches = _length(scene, lane, constant(a0[0]), fresh, constant(stop))
    if told is not None:
        h, reaches = told.h, told.reaches
    h, reaches, a0 = jax.lax.optimization_barrier((h, reaches, a0))
    end = jax.lax.optimization_barrier(runge_kutta(how.tableau, field, t, h, lane.x, lane.v, a0))
    error = constant(_error(scene, lane, end))
    finite = jnp.isfinite(error)
    return _Trial(
        h, reaches, stop, reaches & last, fresh, a0, end, error, finite, finite & ((error <= 1) | (h < tiny)), tiny
    )


class _Verdict(NamedTuple):
    """What becomes of a trial."""

    accepted: Flag
    cut: Value  # fraction of the step to try instead, inf where there is no need
    lands: Flag  # ends on an event …
    after: Value  # … this long after its end; also carries the derivative of the time of a breakpoint
    fizzles: Flag  # a lift that the next step does not confirm is none: back to full contact
    peaks: Flag  # |θ| has a maximum at the guard's turning point
    deformation: Value
    force: Value
    margin: Value  # of that maximum


def _judge(scene: Scene, how: Plan, lane: Lane, ground, trial: _Trial, guard: Guard, told: Decision | None) -> _Verdict:
    constant = jax.lax.stop_gradient
    c, h, tiny, rocking = scene.c, trial.h, trial.tiny, lane.sigma != 0
    near = jnp.maximum(jnp.minimum(LANDED * jnp.sqrt(scene.rtol), 0.02) * h, tiny)
    in_time = lane.t + h + guard.ahead <= constant(trial.stop) + tiny
    left, slope = guard.ending.value(guard.ahead), guard.ending.slope(guard.ahead)
    known = jnp.abs(constant(safe_ratio(left, slope, guard.converges))) <= near
    lands = guard.converges & (jnp.abs(guard.ahead) <= near) & known & ~guard.early & in_time
    # What happens at the end of the scene or just before it does not happen any more, but for overturning:
    # answers there move with the end, not with the event.
    over = trial.ends & guard.converges & ~guard.early & (lane.t + h + guard.ahead > constant(trial.stop) - AT_ONCE * tiny)
    over &= ~(rocking & guard.rises_on)
    lands &= ~over
    if told is not None:
        lands = told.lands
    # Events and breakpoints move with the parameters: how far past its stamps the step begins and ends.
    newton = safe_ratio(left, slope, lands)
    before = lane.mark - constant(lane.mark)
    after = jnp.where(lands, guard.ahead - newton, jnp.where(trial.reaches, trial.stop - constant(trial.stop), 0.0))
    broken = (guard.early | guard.late) & ~lands & ~over
    fizzles = trial.fresh & (constant(lane.v[0]) == 0) & broken & (h < 1e-9 / constant(c.p))
    event = jnp.where(broken & ~fizzles, jnp.maximum(guard.inside, 0.02), jnp.inf)

    # Maxima inside the step; where the polynomial is not good enough for them, they are landed on as well.
    well_inside = (guard.turn > WELL_INSIDE) & (guard.turn < 1 - WELL_INSIDE)
    peaks = rocking & guard.rising & guard.turned
    record = guard.top > lane.peak * (1 - NEAR_RECORD)
    spare = _spare(scene, how, lane, ground, trial, guard, peaks) if how.margin else jnp.ones_like(h)
    if how.margin:
        record |= constant(spare) < lane.margin + NEAR_RECORD * (1 - lane.margin)
    wanted = how.refine & peaks & record
    # A demand that turns close under the threshold is looked at where it turns.
    doubtful = ~rocking & guard.turned & ~guard.early & (jnp.abs(guard.top) > NEARLY * c.uplift)
    turning = jnp.where((wanted | doubtful) & well_inside, guard.turn, jnp.inf)
    deformation, force = _maxima(scene, how, lane, ground, trial, before, after)
    turning = jnp.minimum(turning, jnp.minimum(deformation.cut, force.cut))
    turning = jnp.where(h > tiny, turning, jnp.inf)
    # (A second-order method does not know the first motion after an uplift, θ ~ t³, well enough to be asked.)
    halve = jnp.where(guard.winds & (h > tiny) & (how.tableau.order > 2), 0.5, jnp.inf)

    cut = jnp.minimum(jnp.minimum(turning, event), halve)
    accepted = trial.accurate & ~(cut < 1)
    lands, fizzles = lands & accepted, fizzles & accepted
    if told is not None:
        accepted, lands, fizzles = jnp.ones_like(accepted), told.lands, told.fizzles
    return jax.lax.optimization_barrier(
        _Verdict(accepted, cut, lands, after, fizzles, peaks, deformation.value, force.value, spare)
    )


def _advance(
    scene: Scene, how: Plan, lane: Lane, trial: _Trial, guard: Guard, verdict: _Verdict, told: Decision | None
) -> tuple[Lane, Landmark]:
    """The lane after an accepted step: the automaton's arrows, and the records."""
    constant = jax.lax.stop_gradient
    c, t, h, sigma, rocking = scene.c, lane.t, trial.h, lane.sigma, lane.sigma != 0
    accepted, lands, fizzles = verdict.accepted, verdict.lands, verdict.fizzles
    hit, toppled, lifted = lands & rocking & ~guard.rises_on, lands & rocking & guard.rises_on, lands & ~rocking

    # The state at the end, at the event where there is one; its time moves with the parameters.
    x, v = _past(scene, lane, trial, verdict.after)
    now = jnp.where(lands, t + h + verdict.after, jnp.where(trial.reaches, trial.stop, t + h))
    stamp = jnp.where(lands, jnp.minimum(constant(now), constant(trial.stop)), constant(now))
    delta = jnp.where(lands | trial.reaches, now - constant(now), 0.0)
    piece = lane.piece + (stamp >= constant(scene.excitation.breakpoint(lane.piece)))
    ground = scene.excitation.piece(piece)(stamp)

    # The arrows.
    speed = jnp.abs(v[0])
    x0 = jnp.where(hit | lifted | fizzles | ~rocking, 0.0, x[0])
    v0 = jnp.where(lifted | fizzles | ~rocking, 0.0, v[0])
    q = uplift_demand(c, ground, (x0, *x[1:]), (v0, *v[1:]))
    onward, side = after_impact(scene, sigma, v0, q)
    x, v = (x0, *x[1:]), (jnp.where(hit, onward, v0), *v[1:])
    stays = jnp.where(rocking, sigma, contact_mode(c, q))
    mode = jnp.where(hit, side, jnp.where(lifted, -jnp.sign(guard.last), stays))
    mode = constant(jnp.where(fizzles, 0.0, mode)) if told is None else told.mode
    starts = accepted & ~rocking & (mode != 0)

    # The records.
    tip, tip_time = _tip(scene, lane, trial, guard, verdict, hit, toppled, now)
    raises = accepted & rocking & (tip > lane.peak)
    first = starts & ~lane.uplifted
    advanced = lane._replace(
        t=stamp,
        mark=now,
        x=x,
        v=v,
        sigma=mode,
        piece=piece,
        h=_next_length(scene, how, lane, h, trial.error, stamp),
        cut=jnp.full_like(h, jnp.inf),
        peak=jnp.where(raises, tip, lane.peak),
        peak_time=jnp.where(raises, tip_time, lane.peak_time),
        deformation=_larger(verdict.deformation, lane.deformation) if how.deformation else lane.deformation,
        shear=_larger(verdict.force, lane.shear) if how.shear else lane.shear,
        margin=_least_margin(scene, lane, verdict, x, v, toppled, stamp) if how.margin else lane.margin,
        uplifted=lane.uplifted | starts,
        uplift_time=jnp.where(first, now, lane.uplift_time),
        overturn_time=jnp.where(toppled, now, lane.overturn_time),
        impacts=lane.impacts + hit,
        slowest=jnp.where(accepted & hit, jnp.minimum(lane.slowest, speed), lane.slowest),
        slowest_before_peak=jnp.where(raises, lane.slowest, lane.slowest_before_peak),
        steps=lane.steps + 1,
    )
    code = jnp.where(stamp >= constant(scene.end), results.END_OF_TIME, results.RUNNING)
    if not how.to_the_end:
        code = jnp.where(certificate(scene, how, advanced, piece, ground), results.SETTLED, code)
    # Back to the stamp by the field after it. An event that falls on a breakpoint comes before it: from one to the other by
    # the field between them, where both move their own ways.
    stops = jnp.where(piece > lane.piece, trial.stop - constant(trial.stop), delta)
    x, v = restart(scene, stamp, delta - stops, x, v, mode, lane.piece)
    x, v = restart(scene, stamp, stops, x, v, mode, piece)
    advanced = advanced._replace(x=x, v=v, code=jnp.where(toppled, results.OVERTURNED, code))
    decision = Decision(h, trial.reaches, lands, fizzles, mode)
    return advanced, Landmark(accepted, jnp.where(accepted & hit, now, jnp.nan), decision)


def _repeat(how: Plan, lane: Lane, trial: _Trial, verdict: _Verdict) -> Lane:
    """The lane after a rejected step: as before, to be tried shorter."""
    shrunk = trial.h * jnp.where(trial.finite, _factor(how, trial.error), SHRINK)
    return lane._replace(
        h=jnp.where(trial.accurate, lane.h, shrunk),
        cut=jnp.where(trial.accurate, trial.h * verdict.cut, jnp.inf),
        code=jnp.where(~trial.finite & ~(trial.h > trial.tiny), results.NOT_FINITE, lane.code),
        rejected=lane.rejected + 1,
    )


def _tip(
    scene: Scene, lane: Lane, trial: _Trial, guard: Guard, verdict: _Verdict, hit: Flag, toppled: Flag, now: Value
) -> tuple[Value, Value]:
    """The largest |θ| of the step and its time, with their derivatives."""
    end = summit(guard.path, 1.0)
    at_stop = jnp.where(end == 1, guard.at_end.value(verdict.after), guard.path.value(end))
    end_angle = jnp.where(hit, 0.0, jnp.where(toppled, scene.topple, at_stop))
    peak = guard.path.value(guard.turn)
    at_turn = verdict.peaks & (peak > end_angle)
    crest = jnp.where(at_turn, guard.turn, end)
    on_crest = at_turn | (~verdict.lands & (end != 1))
    off = safe_ratio(guard.path.slope(crest), guard.path.curvature(crest), on_crest)
    time = jnp.where(on_crest, lane.t + trial.h * (crest - jnp.clip(off, -1.0, 1.0)), now)
    return jnp.where(at_turn, peak, end_angle), time


def _spare(scene: Scene, how: Plan, lane: Lane, ground, trial: _Trial, guard: Guard, peaks: Flag) -> Value:
    """The overturning margin of a maximum of |θ| at the guard's turning point."""
    h, sigma, path = trial.h, lane.sigma, guard.path
    off = safe_ratio(path.slope(guard.turn), path.curvature(guard.turn), peaks)
    z = guard.turn - jnp.clip(off, -1.0, 1.0)  # moves with the parameters
    theta = path.value(z)
    x, v = (sigma * theta,), (jnp.zeros_like(h),)
    if how.elastic:
        sway = quintic(lane.x[1], lane.v[1], trial.a0[1], trial.end.x[1], trial.end.v[1], trial.end.a[1], h)
        x, v = (*x, sway.value(z)), (*v, safe_ratio(sway.slope(z), h, h > 0))
    slowing = -sigma * acceleration(scene.c, sigma, ground(lane.t + z * h), x, v)[0]
    return jnp.where(peaks, margin.at_turn(scene.c, scene.topple, theta, slowing), jnp.inf)


def _least_margin(scene: Scene, lane: Lane, verdict: _Verdict, x: Vector, v: Vector, toppled: Flag, stamp: Value) -> Value:
    """The overturning margin so far, after an accepted step to the state (x, v)."""
    least = jnp.where(verdict.peaks & (verdict.margin < lane.margin), verdict.margin, lane.margin)
    # Out of time on the way up: what is left from there.
    rises = (stamp >= jax.lax.stop_gradient(scene.end)) & (x[0] * v[0] > 0)
    here = margin.at_rest(scene.c, scene.topple, jnp.abs(x[0]))
    least = jnp.where(rises & (here < least), here, least)
    return jnp.where(toppled, margin.at_fall(scene.c, scene.topple, v[0]), least)


@functools.partial(jax.jit, static_argnames="how")
def leap(scene: Scene, how: Plan, lane: Lane) -> tuple[Lane, Landmark]:
    """Full contact with nothing elastic: the next uplift is a root of the excitation."""
    constant = jax.lax.stop_gradient
    c, t, excitation = scene.c, lane.t, scene.excitation
    lifts_at = constant(scene.outlook.next_exceedance(t, lane.piece))
    end = constant(scene.end)
    lifts = lifts_at < end
    stamp = jnp.where(lifts, lifts_at, jnp.where(jnp.isinf(lifts_at), t, end))
    piece = jnp.where(lifts, excitation.locate(stamp), lane.piece)
    side = constant(-jnp.sign(excitation.piece(piece)(stamp)))
    # The time of the uplift moves with the crossing, or with the breakpoint at which the ground jumps above. A crossing that
    # falls on a breakpoint, but for rounding, is that of the piece before.
    edge = excitation.breakpoint(piece - 1)
    on_edge = constant(edge) == stamp
    jump = excitation.piece(piece)(stamp) - excitation.piece(piece - 1)(stamp)
    jumps = on_edge & (jnp.abs(constant(jump)) > 1e-9 * constant(c.uplift))
    crossed = excitation.piece(piece - (on_edge & ~jumps))
    ground, slope = jax.jvp(crossed, (stamp,), (jnp.ones_like(stamp),))
    ahead = safe_ratio(-side * ground - c.uplift, -side * slope, lifts & ~jumps)
    now = jnp.where(jumps, edge, stamp - (ahead - constant(ahead)))
    now = jnp.where(lifts, now, stamp)
    mode = jnp.where(lifts, side, 0.0)
    x, v = restart(scene, stamp, now - constant(now), lane.x, lane.v, mode, piece)
    code = jnp.where(lifts, results.RUNNING, jnp.where(jnp.isinf(lifts_at), results.SETTLED, results.END_OF_TIME))
    force = lane.shear
    if how.shear:
        highest = scene.outlook.highest_time(t, jnp.minimum(lifts_at, end))
        force = _larger(jnp.abs(excitation(constant(highest))) / c.g, lane.shear)
    leapt = lane._replace(
        t=stamp,
        mark=now,
        x=x,
        v=v,
        sigma=mode,
        piece=piece.astype(jnp.int32),
        shear=force,
        code=code.astype(jnp.int32),
        uplifted=lane.uplifted | lifts,
        uplift_time=jnp.where(lifts & ~lane.uplifted, now, lane.uplift_time),
        steps=lane.steps + 1,
    )
    no, yes = jnp.zeros((), bool), jnp.ones((), bool)
    return leapt, Landmark(yes, jnp.full_like(t, jnp.nan), Decision(jnp.zeros_like(t), no, no, no, mode))


def _larger(new: Value, record: Value) -> Value:
    """The larger of two, with the derivative of one of them: `maximum` would take half of each where they tie."""
    return jnp.where(new > record, new, record)


def _length(scene: Scene, lane: Lane, angular: Value, fresh: Flag, stop: Value) -> tuple[Value, Flag]:
    """The length of the trial, and whether it reaches the stop."""
    room = stop - lane.t
    h = jnp.where(lane.h > 0.999 * room, room, jnp.where(lane.h > 0.5 * room, 0.5 * room, lane.h))
    # After an impact θ̈ is nearly constant over a short hop, which lasts 2|θ̇/θ̈|.
    speed = jax.lax.stop_gradient(lane.v[0])
    returns = fresh & (speed * angular < 0)
    hop = jnp.where(returns, -2 * speed / jnp.where(returns, angular, 1.0), jnp.inf)
    h = jnp.minimum(h, jnp.minimum(lane.cut, hop))
    return h, h >= room


def _error(scene: Scene, lane: Lane, trial: Step) -> Value:
    """Root mean square of the estimated error over tolerance, in natural units."""
    c = scene.c
    x_unit, v_unit = (c.alpha,), (c.p * c.alpha,)
    if c.elastic:
        sway = c.two_R * c.sin_alpha
        x_unit, v_unit = (*x_unit, sway), (*v_unit, sway * jnp.maximum(c.p, jnp.sqrt(c.omega2)))
    total = jnp.zeros_like(lane.t)
    for old, new, error, units in (
        (lane.x, trial.x, trial.x_error, x_unit),
        (lane.v, trial.v, trial.v_error, v_unit),
    ):
        for y0, y1, e, unit in zip(old, new, error, units, strict=True):
            scale = scene.atol * unit + scene.rtol * jnp.maximum(jnp.abs(y0), jnp.abs(y1))
            total = total + (e / scale) ** 2
    return jnp.sqrt(total / (2 * len(lane.x)))


def _factor(how: Plan, error: Value) -> Value:
    # x^(−1/order) through exp and log, which vectorise; pow does not.
    growth = SAFETY * jnp.exp(-jnp.log(jnp.maximum(error, 1e-30)) / how.tableau.order)
    return jnp.clip(growth, SHRINK, GROW)


def _next_length(scene: Scene, how: Plan, lane: Lane, h: Value, error: Value, t: Value) -> Value:
    """The controller's next step. A step that an event or a breakpoint cut short says little about it."""
    proposed = h * _factor(how, error)
    shortened = (h < 0.99 * lane.h) & (error < 0.5)
    proposed = jnp.where(shortened, jnp.maximum(proposed, lane.h), proposed)
    return jnp.minimum(proposed, jnp.where(t < scene.quiet, scene.longest_excited, scene.longest))


def _past(scene: Scene, lane: Lane, trial: _Trial, after: Value) -> tuple[Vector, Vector]:
    """The state shortly after the end of the step: along the quintic through both of its ends, from the end on."""
    h = trial.h
    z = safe_ratio(after, h, h > 0)
    # Over a very short step the quintic is a difference of nearly equal numbers, and the mean jerk is enough.
    long = h > 0.01 * scene.longest
    x, v = [], []
    for x0, v0, a0, x1, v1, a1 in zip(lane.x, lane.v, trial.a0, trial.end.x, trial.end.v, trial.end.a, strict=True):
        c3, c4, c5 = quintic(x0, v0, a0, x1, v1, a1, h)[3:]
        # Third to fifth derivative at the end, over 3!, 4!, 5!; the lower ones are known better than by differences.
        d3 = jnp.where(long, c3 + 4 * c4 + 10 * c5, (a1 - a0) * h**2 / 6)
        d4, d5 = jnp.where(long, c4 + 5 * c5, 0.0), jnp.where(long, c5, 0.0)
        x.append(x1 + after * (v1 + 0.5 * after * a1) + z**3 * (d3 + z * (d4 + z * d5)))
        v.append(v1 + after * a1 + safe_ratio(z**2 * (3 * d3 + z * (4 * d4 + z * 5 * d5)), h, h > 0))
    return tuple(x), tuple(v)


def _maxima(
    scene: Scene, how: Plan, lane: Lane, ground, trial: _Trial, before: Value, after: Value
) -> tuple[Maximum, Maximum]:
    """Largest deformation and shear of the superstructure over the step, where they are wanted.

    The step begins `before` and ends `after` its time stamps.
    """
    c, h, sigma, a0, end = scene.c, trial.h, lane.sigma, trial.a0, trial.end
    none = Maximum(jnp.zeros_like(h), jnp.full_like(h, jnp.inf))
    if how.elastic and (how.deformation or how.shear):
        jets: list[tuple[Value, Value, Value]] = []
        for x, v, a in ((lane.x, lane.v, a0), (end.x, end.v, end.a)):
            u_b, u_b_dot = beam(c, sigma, x[0], v[0])
            jets.append((x[1] - u_b, v[1] - u_b_dot, a[1] - beam_acceleration(c, sigma, x[0], v[0], a[0])))
        path = quintic(*jets[0], *jets[1], h)
        deformation = force = none
        if how.deformation:
            ends = (End(jets[0][0], jets[0][1], before), End(jets[1][0], jets[1][1], after))
            deformation = largest(path, h, lane.deformation, ends)
        if how.shear:
            first, last = ((c.omega2 * d + c.damping * r, c.omega2 * r + c.damping * s) for d, r, s in jets)
            ends = (End(*first, before), End(*last, after))
            force = largest(spring(path, c.omega2, c.damping, h), h, lane.shear * c.g, ends)
            force = force._replace(value=force.value / c.g)
        # The shear takes a derivative of the polynomial: it is landed on whatever the order.
        return deformation if how.refine else deformation._replace(cut=none.cut), force
    if not how.elastic and how.shear:

        def along(t, x, v):
            return shear(c, sigma, ground(t), x, v, acceleration(c, sigma, ground(t), x, v))

        one = jnp.ones_like(h)
        s0, rate0 = jax.jvp(along, (lane.t, lane.x, lane.v), (one, lane.v, a0))
        s1, rate1 = jax.jvp(along, (lane.t + h, end.x, end.v), (one, end.v, end.a))
        ends = (End(s0, rate0, before), End(s1, rate1, after))
        return none, largest(cubic(s0, rate0, s1, rate1, h), h, lane.shear, ends, WELL_INSIDE_CUBIC)
    return none, none
