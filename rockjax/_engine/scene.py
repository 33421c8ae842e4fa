"""A scene made ready for the loop, and the state that the loop carries of it."""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from rockjax import _results as results
from rockjax._excitations.base import AbstractExcitation, AbstractOutlook
from rockjax._options import Options
from rockjax._results import State
from rockjax._structures import Elastic, Podium
from rockjax._types import Flag, Index, Value, Vector

from . import margin
from .model import Coefficients, acceleration, coefficients, impact, uplift_demand
from .runge_kutta import Tableau, tableau


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
    tableau: Tableau


def plan_for(podium: Podium, options: Options, history: bool) -> Plan:
    elastic = isinstance(podium.superstructure, Elastic)
    tab = tableau(options.solver)  # pyright: ignore[reportArgumentType]
    return Plan(
        elastic=elastic,
        superstructure=podium.superstructure is not None,
        rotation="peak_rotation" in options.outputs,
        deformation=elastic and "peak_deformation" in options.outputs,
        shear=podium.superstructure is not None and "peak_shear" in options.outputs,
        impacts="impacts" in options.outputs,
        margin="margin" in options.outputs,
        errors="errors" in options.outputs,
        to_the_end=history,
        refine=tab.order > 5,
        tableau=tab,
    )


IMPACTS_LATER, LEAST_REST = 3, 1e-4  # of a closer look: impacts, and at most this much of the rest velocity
LANDED, FARTHEST = 10.0, 0.02  # times √rtol of the step, and at most: its quintic carries the state over the rest …
LANDED_CLOSER = 0.1  # … of a closer look over so much of that, or errors of landing would be the same in both


class Scene(NamedTuple):
    """One podium under one excitation, with everything the loop needs computed once."""

    c: Coefficients
    excitation: AbstractExcitation
    outlook: AbstractOutlook
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
    """The automaton's state. Times and steps are constants for derivatives; states at them carry the tangents."""

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
    deformation: Value  # None where not wanted
    shear: Value  # likewise
    margin: Value  # likewise
    uplifted: Flag
    uplift_time: Value
    overturn_time: Value
    impacts: Index
    slowest: Value  # least impact speed so far …
    slowest_before_peak: Value  # … and up to the peak
    steps: Index
    rejected: Index


def contact_mode(c: Coefficients, q: Value) -> Value:
    """The mode of columns at rest under the demand q: they lift where |q| exceeds Eq. (9), touching it is not uplift."""
    return jnp.where(jnp.abs(q) > c.uplift, -jnp.sign(q), 0.0)


def default_end(podium: Podium, excitation: AbstractExcitation) -> Value:
    """End of the excitation plus 30/p, or 10 T_s where that is longer [s]."""
    after = 30 / podium.p
    if isinstance(podium.superstructure, Elastic):
        after = jnp.maximum(after, 10 * podium.superstructure.T_s)
    return excitation.support[1] + after


def prepare(
    podium: Podium, excitation: AbstractExcitation, initial: State, t_end: Value | None, options: Options, plan: Plan
) -> tuple[Scene, LoopState]:
    """The scene and its state at the start of the excitation."""
    constant = jax.lax.stop_gradient
    c = coefficients(podium)
    start, quiet = excitation.support
    end = default_end(podium, excitation) if t_end is None else t_end
    rest = options.rtol if options.rest_velocity is None else options.rest_velocity
    longest = 1 / c.p
    if plan.elastic:
        longest = jnp.minimum(longest, 3 / c.uplifted_frequency)
    longest = options.stride * longest
    # A closer look lets columns rest some impacts later, so that what the rest velocity takes away shows in it.
    closer = options.stride < 1
    later = jnp.maximum(jnp.clip(c.restitution, 0.0, 1.0) ** IMPACTS_LATER, LEAST_REST)
    rest = rest * c.p * c.alpha * jnp.where(closer, later, 1.0)
    duration = quiet - start
    excited = jnp.where(duration > 0, jnp.minimum(longest, options.stride * duration / 16), longest)
    degree, pieces = excitation.panels
    if degree == 1:  # steps end on every sample, the longest are as long as the sampling
        excited = jnp.where(closer, jnp.minimum(excited, options.stride * pieces[0]), excited)
    scene = Scene(
        c=c,
        excitation=excitation,
        outlook=excitation.outlook(None if plan.elastic else c.uplift),
        start=start,
        end=end,
        overturn_angle=options.overturn_ratio * c.alpha,
        rest=constant(rest),
        landing=jnp.minimum(LANDED * jnp.sqrt(options.rtol), FARTHEST) * jnp.where(closer, LANDED_CLOSER, 1.0),
        rtol=jnp.asarray(options.rtol),
        atol=jnp.asarray(options.atol),
        longest=constant(longest),
        longest_excited=constant(excited),
        quiet=constant(quiet),
    )
    t = constant(start)
    piece = excitation.locate(t)
    moves = (initial.theta != 0) | (initial.theta_dot != 0)
    x, v = (initial.theta,), (initial.theta_dot,)
    if plan.elastic:
        x, v = (*x, initial.u_t), (*v, initial.u_t_dot)
    q = uplift_demand(c, excitation.piece(piece)(t), x, v)
    side = jnp.where(initial.theta != 0, jnp.sign(initial.theta), jnp.sign(initial.theta_dot))
    sigma = constant(jnp.where(moves, side, contact_mode(c, q)))
    # An initial rotation is where the scene begins; on θ = 0 an initial velocity starts to that side.
    toppled = jnp.abs(initial.theta) >= scene.overturn_angle
    sane = jnp.all(jnp.isfinite(jnp.stack([*jax.tree.leaves(c), start, end, *x, *v])))
    sane &= (c.alpha > 0) & (c.p > 0) & (c.inertia > 0)
    code = jnp.where(toppled, results.OVERTURNED, jnp.where(start >= end, results.END_OF_TIME, results.RUNNING))
    absent: Any = None
    nan, inf = jnp.full_like(t, jnp.nan), jnp.full_like(t, jnp.inf)
    x, v = restart(scene, t, start - t, x, v, sigma, piece)
    state = LoopState(
        t=t,
        event_time=start,
        x=x,
        v=v,
        sigma=sigma,
        piece=piece,
        h=0.05 * scene.longest_excited,
        cut=inf,
        code=jnp.where(sane, code, results.NOT_FINITE).astype(jnp.int32),
        peak=jnp.minimum(jnp.abs(initial.theta), scene.overturn_angle),
        peak_time=start,
        deformation=jnp.zeros_like(t) if plan.deformation else absent,
        shear=jnp.zeros_like(t) if plan.shear else absent,
        margin=margin.at_rest(c, scene.overturn_angle, jnp.abs(initial.theta)) if plan.margin else absent,
        uplifted=sigma != 0,
        uplift_time=jnp.where(sigma != 0, start, nan),
        overturn_time=jnp.where(toppled, start, nan),
        impacts=jnp.zeros((), jnp.int32),
        slowest=inf,
        slowest_before_peak=inf,
        steps=jnp.zeros((), jnp.int32),
        rejected=jnp.zeros((), jnp.int32),
    )
    return scene, state


@jax.custom_jvp
def restart(scene: Scene, t: Value, delta: Value, x: Vector, v: Vector, sigma: Value, piece: Index) -> tuple[Vector, Vector]:
    """The state (x, v) at the time of an event, seen at the fixed time stamp t.

    The event's time moves with the parameters, by `delta` (zero in value); the stamp does not. With the state taken to
    the event by the field before it, mapped, and brought back by the field after it, the pair is the saltation matrix.
    The way back is zero in value, so only derivatives pay for it.
    """
    del scene, t, delta, sigma, piece
    return x, v


@restart.defjvp
def _restart_jvp(primals, tangents):
    scene, t, _, x, v, sigma, piece = primals
    delta_dot, x_dot, v_dot = tangents[2], tangents[3], tangents[4]
    a = acceleration(scene.c, sigma, scene.excitation.piece(piece)(t), x, v)
    x_dot = tuple(dx - delta_dot * rate for dx, rate in zip(x_dot, v, strict=True))
    v_dot = tuple(dv - delta_dot * rate for dv, rate in zip(v_dot, a, strict=True))
    return (x, v), (x_dot, v_dot)


def after_impact(scene: Scene, sigma: Value, theta_dot: Value, q: Value) -> tuple[Value, Value]:
    """(θ̇⁺, σ⁺) of an impact: Eq. (27), over to the other side; below the rest velocity, full contact or uplift anew."""
    onward = impact(scene.c, theta_dot)
    moves = jnp.abs(onward) > scene.rest
    return jnp.where(moves, onward, 0.0), jnp.where(moves, -sigma, contact_mode(scene.c, q))
