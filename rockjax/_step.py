"""The step: one lane, one trial, read as the automaton it advances.

A trial Runge–Kutta step is taken; a quintic through both of its ends is the guard: σθ while rocking, the demand q in
full contact. If the guard is broken inside the step, the step is shortened to end there and tried again; once it ends
on the event (to a small part of its length, the rest by Taylor) the event is applied. So an event costs the
solver's own accuracy, and nothing about it needs remembering from one trial to the next.

Times, step lengths and roots are constants for derivatives. An event is differentiated by moving the state to it and
back (`restart`), which is exact in forward and reverse mode.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from . import _results as results
from ._hermite import Quintic, crossing, quintic, turning_point, turns_twice
from ._maxima import NEAR_RECORD, WELL_INSIDE, End, Maximum, Spring, cubic, largest, summit
from ._model import Vector, acceleration, beam, beam_acceleration, shear, uplift_demand
from ._runge_kutta import Step
from ._runge_kutta import step as runge_kutta
from ._scene import Flag, Lane, Plan, Scene, Value, after_impact, contact_mode, restart
from ._settled import certificate

LANDED = 0.3  # times √rtol of the step: Taylor, whose error in the velocity is quadratic, carries the state over the rest
NEARLY = 0.95  # of the uplift demand
SAFETY, SHRINK, GROW = 0.9, 0.2, 5.0  # of the step-size control


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
        return _trial(scene, how, lane, told)
    return jax.lax.cond(
        lane.sigma == 0, lambda lane: leap(scene, how, lane), lambda lane: _trial(scene, how, lane, told), lane
    )


def _trial(scene: Scene, how: Plan, lane: Lane, told: Decision | None) -> tuple[Lane, Landmark]:
    constant = jax.lax.stop_gradient
    c, sigma, t = scene.c, lane.sigma, lane.t
    rocking = sigma != 0
    ground = scene.excitation.piece(lane.piece)

    def field(t, x, v):
        return acceleration(c, sigma, ground(t), x, v)

    # How far: to the next breakpoint at most, and over a hop in one step.
    stop = jnp.minimum(scene.excitation.breakpoint(lane.piece), scene.end)
    a0 = field(t, lane.x, lane.v)
    fresh = rocking & (lane.x[0] == 0)
    h, reaches = _length(scene, lane, constant(a0[0]), fresh, constant(stop))
    if told is not None:
        h, reaches = told.h, told.reaches

    h, reaches, a0 = jax.lax.optimization_barrier((h, reaches, a0))
    trial = jax.lax.optimization_barrier(runge_kutta(how.tableau, field, t, h, lane.x, lane.v, a0))
    error = constant(_error(scene, lane, trial))
    tiny = 1e-13 * (jnp.abs(t) + 1 / c.p)
    finite = jnp.isfinite(error)
    accurate = finite & ((error <= 1) | (h < constant(tiny)))

    # The guard over the step, monotone on both sides of at most one turning point.
    guard, at_end = jax.lax.optimization_barrier(_guard(scene, how, lane, ground, h, a0, trial))
    fixed: Quintic = constant(guard)
    one = jnp.ones_like(h)
    rising = (fixed.c1 > 0) | ((fixed.c1 == 0) & (fixed.c2 > 0)) | fresh
    rises_on = constant(at_end.c1) > 0
    turned = rising != rises_on
    turn = jnp.where(turned, turning_point(fixed, rising), one)
    last = constant(at_end.c0)
    top = jnp.where(turned, fixed.value(turn), last)
    topple = constant(scene.topple)

    def broken(value):
        return jnp.where(rocking, (value < 0) | (value >= topple), jnp.abs(value) > c.uplift)

    early = turned & broken(top)
    late = broken(last) & ~early
    edge = jnp.where(early, top, last)
    margin = _margin(scene, rocking, guard, edge, edge < 0)
    inside = crossing(constant(margin), jnp.where(late & turned, turn, 0.0), jnp.where(early, turn, one))

    # Does the step end on the event?
    ending = _margin(scene, rocking, at_end, last, ~rises_on)
    ahead, converges = _newton_to(ending, 0.5 * h)
    near = jnp.maximum(LANDED * jnp.sqrt(scene.rtol) * h, constant(tiny))
    lands = converges & (jnp.abs(ahead) <= near) & ~early & (t + h + ahead <= constant(stop + tiny))
    if told is not None:
        lands = told.lands
    # Events and breakpoints move with the parameters: how far past its stamps the step begins and ends.
    moving = ahead - _safe_ratio(ending.value(ahead), ending.slope(ahead), lands)
    before = lane.mark - constant(lane.mark)
    after = jnp.where(lands, moving, jnp.where(reaches, stop - constant(stop), 0.0))
    # A lift that the next step does not confirm is none: back to full contact.
    fizzles = fresh & (constant(lane.v[0]) == 0) & (early | late) & ~lands & (h < 1e-9 / constant(c.p))

    # Maxima inside the step; where the polynomial is not good enough for them, they are landed on as well.
    peak = guard.value(turn)
    peaks = rocking & rising & turned
    wanted = how.refine & peaks & (top > lane.peak * (1 - NEAR_RECORD)) & (turn > WELL_INSIDE) & (turn < 1 - WELL_INSIDE)
    # A demand that turns close under the threshold is looked at where it turns.
    doubtful = ~rocking & turned & ~early & (jnp.abs(top) > NEARLY * c.uplift)
    doubtful &= (turn > WELL_INSIDE) & (turn < 1 - WELL_INSIDE)
    cut = jnp.where(wanted | doubtful, turn, jnp.inf)
    deformation, force = _maxima(scene, how, lane, ground, h, a0, trial, before, after)
    cut = jnp.minimum(cut, jnp.minimum(deformation.cut, force.cut)) if how.elastic or how.shear else cut
    event = jnp.where((early | late) & ~lands & ~fizzles, jnp.maximum(inside, 0.02), jnp.inf)
    # (A second-order method does not know the first motion after an uplift, θ ~ t³, well enough to ask.)
    winding = turns_twice(fixed, rising, rises_on) & (h > tiny) & (how.tableau.order > 2)
    busy = rocking | (sum(jnp.abs(k) for k in fixed) > c.uplift)  # else no lift is possible
    halve = jnp.where(winding & busy, 0.5, jnp.inf)
    cut = jnp.minimum(jnp.minimum(cut, event), halve)
    accepted = accurate & ~(cut < 1)
    lands, fizzles = lands & accepted, fizzles & accepted
    if told is not None:
        accepted, lands, fizzles = jnp.ones_like(accepted), told.lands, told.fizzles

    # The state at the end, at the event where there is one; its time moves with the parameters.
    x, v = _past(trial, after)
    now = jnp.where(lands, t + h + after, jnp.where(reaches, stop, t + h))
    stamp = jnp.where(lands, jnp.minimum(constant(now), constant(stop)), constant(now))
    delta = jnp.where(lands | reaches, now - constant(now), 0.0)
    hit = lands & rocking & ~rises_on
    toppled = lands & rocking & rises_on
    lifted = lands & ~rocking

    # The automaton's arrows.
    piece = lane.piece + (stamp >= constant(scene.excitation.breakpoint(lane.piece)))
    speed = jnp.abs(v[0])
    ground_now = scene.excitation.piece(piece)(stamp)
    x0 = jnp.where(hit | lifted | fizzles | ~rocking, 0.0, x[0])
    v0 = jnp.where(lifted | fizzles | ~rocking, 0.0, v[0])
    q = uplift_demand(c, ground_now, (x0, *x[1:]), (v0, *v[1:]))
    onward, side = after_impact(scene, sigma, v0, q)
    v0 = jnp.where(hit, onward, v0)
    mode = jnp.where(hit, side, jnp.where(lifted, -jnp.sign(last), jnp.where(rocking, sigma, contact_mode(c, q))))
    mode = constant(jnp.where(fizzles, 0.0, mode)) if told is None else told.mode
    x, v = (x0, *x[1:]), (v0, *v[1:])
    starts = accepted & ~rocking & (mode != 0)

    # The records.
    end = summit(guard, 1.0)
    at_stop = jnp.where(end == 1, at_end.value(after), guard.value(end))
    end_angle = jnp.where(hit, 0.0, jnp.where(toppled, scene.topple, at_stop))
    at_turn = peaks & (peak > end_angle)
    tip = jnp.where(at_turn, peak, end_angle)
    raises = accepted & rocking & (tip > lane.peak)
    crest = jnp.where(at_turn, turn, end)
    on_crest = at_turn | (~lands & (end != 1))
    off = _safe_ratio(guard.slope(crest), guard.curvature(crest), on_crest)
    tip_time = jnp.where(on_crest, t + h * (crest - jnp.clip(off, -1.0, 1.0)), now)
    slowest = jnp.where(accepted & hit, jnp.minimum(lane.slowest, speed), lane.slowest)
    first = starts & ~lane.uplifted
    advanced = lane._replace(
        t=stamp,
        mark=now,
        x=x,
        v=v,
        sigma=mode,
        piece=piece,
        h=_next_length(scene, how, lane, h, error, stamp),
        cut=jnp.full_like(h, jnp.inf),
        peak=jnp.where(raises, tip, lane.peak),
        peak_time=jnp.where(raises, tip_time, lane.peak_time),
        deformation=_larger(deformation.value, lane.deformation) if how.deformation else lane.deformation,
        shear=_larger(force.value, lane.shear) if how.shear else lane.shear,
        uplifted=lane.uplifted | starts,
        uplift_time=jnp.where(first, now, lane.uplift_time),
        overturn_time=jnp.where(toppled, now, lane.overturn_time),
        impacts=lane.impacts + hit,
        slowest=slowest,
        slowest_before_peak=jnp.where(raises, lane.slowest, lane.slowest_before_peak),
        steps=lane.steps + 1,
    )
    x, v = restart(scene, stamp, delta, advanced.x, advanced.v, mode, piece)
    code = jnp.where(stamp >= constant(scene.end), results.END_OF_TIME, results.RUNNING)
    if not how.to_the_end:
        code = jnp.where(certificate(scene, how, advanced, piece, ground_now), results.SETTLED, code)
    code = jnp.where(toppled, results.OVERTURNED, code)
    advanced = advanced._replace(x=x, v=v, code=code)

    shorter = jnp.where(accurate, lane.h, h * jnp.where(finite, _factor(how, error), SHRINK))
    repeated = lane._replace(
        h=shorter,
        cut=jnp.where(accurate, h * cut, jnp.inf),
        code=jnp.where(~finite & ~(h > tiny), results.NOT_FINITE, lane.code),
        rejected=lane.rejected + 1,
    )
    decision = Decision(h, reaches, lands, fizzles, mode)
    landmark = Landmark(accepted, jnp.where(accepted & hit, now, jnp.nan), decision)
    return jax.tree.map(lambda yes, no: jnp.where(accepted, yes, no), advanced, repeated), landmark


def leap(scene: Scene, how: Plan, lane: Lane) -> tuple[Lane, Landmark]:
    """Full contact with nothing elastic: the next uplift is a root of the excitation."""
    constant = jax.lax.stop_gradient
    c, t, excitation = scene.c, lane.t, scene.excitation
    lifts_at = constant(scene.outlook.next_exceedance(t, lane.piece))
    end = constant(scene.end)
    lifts = lifts_at < end
    stamp = jnp.where(lifts, lifts_at, jnp.where(jnp.isinf(lifts_at), t, end))
    piece = jnp.where(lifts, excitation.locate(stamp), lane.piece)
    ground, slope = jax.jvp(excitation.piece(piece), (stamp,), (jnp.ones_like(stamp),))
    side = constant(-jnp.sign(ground))
    # The time of the uplift moves with the crossing, or with the breakpoint at which the ground jumps above.
    edge = excitation.breakpoint(piece - 1)
    jumps = (constant(edge) == stamp) & (jnp.abs(constant(ground)) > c.uplift * (1 + 1e-9))
    ahead = _safe_ratio(-side * ground - c.uplift, -side * slope, lifts & ~jumps)
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


def _safe_ratio(a: Value, b: Value, wanted: Flag) -> Value:
    """a/b where wanted, else 0; never a NaN, in derivatives neither."""
    good = wanted & (b != 0)
    return jnp.where(good, a, 0.0) / jnp.where(good, b, 1.0)


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


def _guard(scene: Scene, how: Plan, lane: Lane, ground, h: Value, a0: Vector, trial: Step) -> tuple[Quintic, Quintic]:
    """σθ while rocking; in full contact the demand q, whose derivatives follow because everything is linear there.

    Over the step, and as a parabola in the time past its end: over a very short step the quintic of the step knows the
    value only, its slopes are differences of nearly equal numbers.
    """
    c, sigma = scene.c, lane.sigma
    angle = tuple(sigma * y for y in (lane.x[0], lane.v[0], a0[0], trial.x[0], trial.v[0], trial.a[0]))
    if not how.elastic:
        return _through(angle, h)

    def jet(t, x, v, a):
        one = jnp.ones_like(t)
        rate = lambda s: jax.jvp(ground, (s,), (one,))[1]
        g0, (g1, g2) = ground(t), jax.jvp(rate, (t,), (one,))
        jerk = acceleration(c, jnp.zeros_like(t), g1, (jnp.zeros_like(t), *v[1:]), (jnp.zeros_like(t), *a[1:]))
        return uplift_demand(c, g0, x, v), uplift_demand(c, g1, v, a), uplift_demand(c, g2, a, jerk)

    demand = (*jet(lane.t, lane.x, lane.v, a0), *jet(lane.t + h, trial.x, trial.v, trial.a))
    return _through((jnp.where(sigma != 0, y, q) for y, q in zip(angle, demand, strict=True)), h)


def _through(ends: Iterable[Value], h: Value) -> tuple[Quintic, Quintic]:
    """The quintic through (value, slope, curvature) at the start and at the end, and the parabola at the end."""
    x0, v0, a0, x1, v1, a1 = ends
    zero = jnp.zeros_like(x1)
    return quintic(x0, v0, a0, x1, v1, a1, h), Quintic(x1, v1, 0.5 * a1, zero, zero, zero)


def _margin(scene: Scene, rocking: Flag, guard: Quintic, edge: Value, falling: Flag) -> Quintic:
    """What is left until the guard breaks: to impact or overturning while rocking, to uplift in full contact."""
    sign = jnp.where(rocking, jnp.where(falling, 1.0, -1.0), -jnp.sign(edge))
    limit = jnp.where(rocking, jnp.where(falling, 0.0, scene.topple), scene.c.uplift)
    scaled = Quintic(*(sign * k for k in guard))
    return scaled._replace(c0=scaled.c0 + limit)


def _newton_to(margin: Quintic, most: Value) -> tuple[Value, Flag]:
    """How long past the end of the step (s, at most `most`) the margin ends, if it falls there; a constant."""
    margin = jax.lax.stop_gradient(margin)
    ahead = jnp.zeros_like(margin.c0)
    falls = margin.c1 < 0
    for _ in range(3):
        slope = margin.slope(ahead)
        ahead = ahead - _safe_ratio(margin.value(ahead), slope, falls & (slope < 0))
        ahead = jax.lax.optimization_barrier(jnp.clip(ahead, -most, most))
    return ahead, falls


def _past(trial: Step, after: Value) -> tuple[Vector, Vector]:
    """The state shortly after the end of the step."""
    x = tuple(p + after * (r + 0.5 * after * s) for p, r, s in zip(trial.x, trial.v, trial.a, strict=True))
    return x, tuple(r + after * s for r, s in zip(trial.v, trial.a, strict=True))


def _maxima(
    scene: Scene, how: Plan, lane: Lane, ground, h: Value, a0: Vector, trial: Step, before: Value, after: Value
) -> tuple[Maximum, Maximum]:
    """Largest deformation and shear of the superstructure over the step, where they are wanted.

    The step begins `before` and ends `after` its time stamps.
    """
    c, sigma = scene.c, lane.sigma
    none = Maximum(jnp.zeros_like(h), jnp.full_like(h, jnp.inf))
    if how.elastic and (how.deformation or how.shear):
        jets: list[tuple[Value, Value, Value]] = []
        for x, v, a in ((lane.x, lane.v, a0), (trial.x, trial.v, trial.a)):
            u_b, u_b_dot = beam(c, sigma, x[0], v[0])
            jets.append((x[1] - u_b, v[1] - u_b_dot, a[1] - beam_acceleration(c, sigma, x[0], v[0], a[0])))
        path = quintic(*jets[0], *jets[1], h)
        deformation = force = none
        if how.deformation:
            ends = (End(jets[0][0], jets[0][1], before), End(jets[1][0], jets[1][1], after))
            deformation = largest(path, lane.deformation, ends)
        if how.shear:
            first, last = ((c.omega2 * d + c.damping * r, c.omega2 * r + c.damping * s) for d, r, s in jets)
            ends = (End(*first, before), End(*last, after))
            force = largest(Spring(path, c.omega2, c.damping, h), lane.shear * c.g, ends)
            force = force._replace(value=force.value / c.g)
        # The shear takes a derivative of the polynomial: it is landed on whatever the order.
        return deformation if how.refine else deformation._replace(cut=none.cut), force
    if not how.elastic and how.shear:

        def along(t, x, v):
            return shear(c, sigma, ground(t), x, v, acceleration(c, sigma, ground(t), x, v))

        one = jnp.ones_like(h)
        s0, rate0 = jax.jvp(along, (lane.t, lane.x, lane.v), (one, lane.v, a0))
        s1, rate1 = jax.jvp(along, (lane.t + h, trial.x, trial.v), (one, trial.v, trial.a))
        ends = (End(s0, rate0, before), End(s1, rate1, after))
        return none, largest(cubic(s0, rate0, s1, rate1, h), lane.shear, ends)
    return none, none
