"""Preparation of a scene for the loop: the plan, the constants and the initial state.

A scene is one podium under one excitation. The plan holds the settings that are fixed at compilation. If
errors are estimated, every scene is solved twice. In the second solution `Options._stride` is below 1, and
this module chooses other settings, such as other step lengths, so that the errors of the two solutions
differ.
"""

from __future__ import annotations

import functools
from typing import Any

import jax
import jax.numpy as jnp

from rockjax import _results as results
from rockjax._excitations.base import AbstractExcitation, AbstractLookahead
from rockjax._excitations.ground import GroundMotion
from rockjax._excitations.sampled import AbstractSampled
from rockjax._options import Options
from rockjax._outputs.base import AbstractOutput
from rockjax._outputs.registry import REGISTRY
from rockjax._outputs.rotation import PeakRotation
from rockjax._outputs.views import Moment, Start
from rockjax._results import State
from rockjax._structures import Podium
from rockjax._structures.modes import repeat_scalar, stack_row
from rockjax._structures.superstructures import Oscillators
from rockjax._types import Value, Values, Vector

from .coefficients import Coefficients, Vibration, coefficients, not_none
from .fast_forward import allowed
from .fast_forward.samples import can_skip_samples
from .model import acceleration, uplift_demand
from .state import LoopState, Plan, Scene
from .tableaus import tableau_for
from .transitions import contact_mode, restart


def plan_for(
    podium: Podium,
    options: Options,
    history: bool,
    extra_outputs: tuple[AbstractOutput, ...] = (),
    vertical: bool = False,
) -> Plan:
    """Return the plan: the settings that are fixed at compilation.

    - `podium`, `options`: structure and solver options of the scenes
    - `history`: True if the accepted steps are stored
    - `extra_outputs`: outputs that are computed in addition to the requested ones
    - `vertical`: True if the ground also moves vertically
    """
    elastic = podium.vibrates
    depends_on_velocities = elastic or bool(podium.restrainers) or options.engine != "flat"
    tab = tableau_for(options.method, depends_on_velocities)  # pyright: ignore[reportArgumentType]
    requested = {output.name: output.of(podium) for output in options.requested if output.applies(podium)}
    rotation = PeakRotation(requested="peak_rotation" in requested)
    others = [output for name, output in requested.items() if name != "peak_rotation"]
    outputs = (rotation, *others, *extra_outputs)
    # A history stores every step, so neither bounces nor samples are skipped. To skip a sample means to cross
    # the sampling interval with a single step of order 8, without a trial step. Samples are therefore skipped
    # only if the requested method has at least order 7.
    eligible = [] if elastic else ["rest"] if history else ["rest", "bounces", *["samples"] * (tab.order > 6)]
    # With restrainers or vertical ground motion, joint forces in skipped parts cannot be computed.
    if (vertical or podium.restrainers) and any(output.needs_simple_contact for output in outputs):
        eligible = []
    names = allowed(outputs, eligible)
    # `follows_contact` assumes that a plan which skips samples or bounces also skips full contact.
    return Plan(
        elastic=elastic,
        outputs=outputs,
        unrequested=tuple(output.of(podium) for name, output in REGISTRY.items() if name not in requested),
        tableau=tab,
        to_the_end=history,
        fast_forwards=tuple(name for name in names if name == "rest" or "rest" in names),
    )


# In the second solution rocking stops some impacts later. The rest velocity (see `_rest_speed`) is multiplied
# by e^IMPACTS_LATER, clipped to [MIN_REST_FACTOR, MAX_REST_FACTOR], where e is the restitution factor. If
# nothing vibrates and impacts take little speed, 1 − e < LITTLE_LOSS · rtol, the factor is MIN_REST_FACTOR.
IMPACTS_LATER, MAX_REST_FACTOR, MIN_REST_FACTOR, LITTLE_LOSS = 3, 0.5, 1e-4, 100.0
# A step counts as ending on an event if the time between its end and the event, divided by its length, is at
# most LANDING · √rtol and at most MAX_LANDING. A Taylor expansion at the end of the step then carries the
# state to the event.
LANDING, MAX_LANDING = 10.0, 0.02
# A breakpoint of the ground motion (a jump or kink) may be less than two proposed steps away. The first
# solution then takes two equal steps to the breakpoint, or a single step if the proposed step is at least as
# long as the distance. The second solution takes other steps, so that the errors differ: its first step
# covers a third of the distance. It takes a single step only if the proposed step is equal to the distance
# (within 0.1 %) or more than UNSPLIT_SECOND times as long.
SPLIT, SPLIT_SECOND, UNSPLIT_SECOND = 0.5, 1 / 3, 2.0
LANDING_SECOND = 0.1  # factor on the landing fraction in the second solution, so that landing errors differ


def default_end(podium: Podium, excitation: AbstractExcitation) -> Value:
    """Return the default end of a scene [s]: max(30/p, 10 T_s) after the end of the excitation, or 30/p after
    it if nothing vibrates. p is the frequency parameter of the podium [rad/s], T_s the longest period of the
    superstructure [s]."""
    after = 30 / podium.p
    modes = None if podium.superstructure is None else podium.superstructure.oscillators
    if modes is not None:
        period = jnp.max(modes.T_s, axis=-1) if isinstance(modes, Oscillators) else modes.T_s
        after = jnp.maximum(after, 10 * period)
    return excitation.support[1] + after


def _by_solution(options: Options, second: Value | float, first: Value | float) -> Value:
    """Return `second` in the second solution, else `first`."""
    return jnp.where(options._stride < 1, second, first)


def _estimate_factor(plan: Plan, options: Options) -> Value | None:
    """Return the factor that corrects error estimates of unusually low order; None if the order is usual.

    For a method of order k, the usual order of the error estimate is k − 1. At the longest steps that the
    tolerance allows, an estimate of order k − 1 − n is larger than the usual one by a factor of about
    rtol^(−n/k). The result is rtol^(n/k).
    """
    missing_order = plan.tableau.order - 1 - plan.tableau.estimate
    return jnp.asarray(options.rtol) ** (missing_order / plan.tableau.order) if missing_order else None


def _max_step(c: Coefficients) -> Value:
    """Return the longest step [s]: 1/p, but at most 3/ω. Here p is the frequency parameter, and ω the highest
    frequency of the superstructure on lifted columns [rad/s] or, if nothing vibrates, the frequency of
    rocking due to tendons."""
    max_step = 1 / c.p
    fastest = None if c.restraint is None else c.restraint.restrained_frequency
    if c.vibration is not None:
        fastest = c.vibration.uplifted_frequency
    return max_step if fastest is None else jnp.minimum(max_step, 3 / fastest)


def _max_excited_step(excitation: AbstractExcitation, max_step: Value, options: Options) -> Value:
    """Return the longest step during the ground motion [s]: `options._stride` times the longest step that
    resolves the motion, but at most `max_step`."""
    longest = excitation.longest_step()
    max_excited_step = jnp.where(longest > 0, jnp.minimum(max_step, options._stride * longest), max_step)
    is_pair = isinstance(excitation, GroundMotion)
    components = (excitation.horizontal, excitation.vertical) if is_pair else (excitation,)
    intervals = [component.sampling.dt for component in components if isinstance(component, AbstractSampled)]
    # If all components are sampled, steps end on every sample, so they last at most one interval. The second
    # solution has shorter steps, so that its errors differ.
    if len(intervals) == len(components):
        shortest = functools.reduce(jnp.minimum, intervals)
        max_excited_step = _by_solution(
            options, jnp.minimum(max_excited_step, (1 - SPLIT_SECOND) * shortest), max_excited_step
        )
    return max_excited_step


def _lookahead(excitation: AbstractExcitation, c: Coefficients, plan: Plan) -> AbstractLookahead:
    """Return the lookahead, which bounds the remaining ground motion. If the podium goes directly from full
    contact to its next uplift, the lookahead also finds the time of this uplift, and, if joint forces are
    requested, the largest and the smallest ü_g in an interval."""
    threshold = None if plan.follows_contact else c.uplift
    if isinstance(excitation, GroundMotion):
        return excitation.lookahead(threshold, not_none(c.uplift_slope))
    lookahead = excitation.lookahead(threshold)
    return lookahead.with_sides() if plan.of_joints and not plan.follows_contact else lookahead


def _landing_fraction(options: Options) -> Value:
    """Return the largest time between an event and the end of a step that counts as ending on this event,
    divided by the length of the step."""
    fraction = jnp.minimum(LANDING * jnp.sqrt(options.rtol), MAX_LANDING)
    return fraction * _by_solution(options, LANDING_SECOND, 1.0)


def _rest_speed(c: Coefficients, options: Options) -> Value:
    """Return the rest velocity [rad/s]: columns come to rest at an impact if |θ̇| after the impact is at most
    this speed.

    In the second solution the rest velocity is lower, and rocking stops some impacts later, so that the
    difference of the solutions shows the error due to the rest velocity.
    """
    relative = options.rtol if options.rest_velocity is None else options.rest_velocity
    e = jnp.clip(c.restitution, 0.0, 1.0)
    factor = jnp.clip(e**IMPACTS_LATER, MIN_REST_FACTOR, MAX_REST_FACTOR)
    # A vibrating superstructure takes energy from the columns even if impacts take little speed.
    if c.vibration is None:
        factor = jnp.where(1 - e < LITTLE_LOSS * options.rtol, MIN_REST_FACTOR, factor)
    return relative * c.p * c.alpha * _by_solution(options, factor, 1.0)


def _start(modes: Vibration | None, initial: State) -> tuple[Vector, Vector]:
    """Return positions and velocities at the start. A scalar displacement u_t or velocity u̇_t of the
    superstructure applies to all modes."""
    if modes is None:
        return (initial.theta,), (initial.theta_dot,)

    def of_modes(value: Any) -> Values:
        if modes.modal is None:
            return value[0] if isinstance(value, tuple) else value
        return stack_row(repeat_scalar(value, modes.omega2.size))

    return (initial.theta, of_modes(initial.u_t)), (initial.theta_dot, of_modes(initial.u_t_dot))


def _total(values: Values) -> Value:
    """Return the sum of an array, which is finite only if all elements are; a scalar stays as it is."""
    return jnp.sum(values) if values.ndim else values


def prepare(
    podium: Podium,
    excitation: AbstractExcitation,
    initial: State,
    t_end: Value | None,
    options: Options,
    plan: Plan,
) -> tuple[Scene, LoopState]:
    """Return the prepared scene and its state at the start of the excitation.

    - `podium`, `excitation`: structure and ground motion, with scalar parameters
    - `initial`: initial state
    - `t_end`: end of the scene [s]; None for the default, `default_end`
    - `options`: options of the solver
    - `plan`: result of `plan_for`
    """
    scene = _scene(podium, excitation, t_end, options, plan)
    return scene, _first_state(scene, initial, plan)


def _scene(
    podium: Podium,
    excitation: AbstractExcitation,
    t_end: Value | None,
    options: Options,
    plan: Plan,
) -> Scene:
    constant = jax.lax.stop_gradient
    podium = podium.resolved()
    c = coefficients(podium, options.rtol, isinstance(excitation, GroundMotion), plan.of_joints)
    start, excitation_end = excitation.support
    end = default_end(podium, excitation) if t_end is None else t_end
    max_step = options._stride * _max_step(c)
    max_excited_step = _max_excited_step(excitation, max_step, options)
    rest_speed = constant(_rest_speed(c, options))
    return Scene(
        c=c,
        excitation=excitation,
        lookahead=_lookahead(excitation, c, plan),
        start=start,
        end=end,
        overturn_angle=options.overturn_ratio * c.alpha,
        rest_speed=rest_speed,
        estimate_factor=_estimate_factor(plan, options),
        skip_below=_by_solution(options, 0.0, 1.0),  # the second solution skips no sample
        log_restitution=constant(-jnp.log(jnp.clip(c.restitution, 0.0, 1.0))),
        min_impact_speed=constant(rest_speed / jnp.maximum(c.restitution, jnp.finfo(rest_speed.dtype).tiny)),
        landing_fraction=_landing_fraction(options),
        split_fraction=_by_solution(options, SPLIT_SECOND, SPLIT),
        unsplit_limit=_by_solution(options, UNSPLIT_SECOND, 1.0),
        rtol=jnp.asarray(options.rtol),
        atol=jnp.asarray(options.atol),
        max_step=constant(max_step),
        max_excited_step=constant(max_excited_step),
        excitation_end=constant(excitation_end),
    )


def _first_state(scene: Scene, initial: State, plan: Plan) -> LoopState:
    constant = jax.lax.stop_gradient
    c, excitation, start, end = scene.c, scene.excitation, scene.start, scene.end
    t = constant(start)
    piece = excitation.locate(t)
    is_rocking = (initial.theta != 0) | (initial.theta_dot != 0)
    x, v = _start(c.vibration, initial)
    q = uplift_demand(c, excitation.piece(piece)(t), x, v)
    # The contact mode has the sign of the initial rotation, or at θ = 0 the sign of the initial velocity.
    side = jnp.where(initial.theta != 0, jnp.sign(initial.theta), jnp.sign(initial.theta_dot))
    sigma = constant(jnp.where(is_rocking, side, contact_mode(c, q)))
    toppled = jnp.abs(initial.theta) >= scene.overturn_angle
    is_valid = jnp.all(jnp.isfinite(jnp.stack([*map(_total, jax.tree.leaves((c, start, end, x, v)))])))
    is_valid &= (c.alpha > 0) & (c.p > 0) & (c.inertia > 0)
    code = jnp.where(start >= end, results.END_OF_TIME, results.RUNNING)
    code = jnp.where(toppled, results.OVERTURNED, code)
    nan, inf = jnp.full_like(t, jnp.nan), jnp.full_like(t, jnp.inf)

    def moment() -> Moment:
        ground = excitation.piece(piece)(t)
        return Moment(c, sigma, t, ground, x, v, acceleration(c, sigma, ground, x, v))

    view = Start(scene, initial, start, moment)
    accumulators_and_notes = [output.start(view) for output in plan.outputs]
    x, v = restart(scene, t, start - t, x, v, sigma, piece)
    state = LoopState(
        t=t,
        event_time=start,
        x=x,
        v=v,
        sigma=sigma,
        piece=piece,
        h=0.05 * scene.max_excited_step,
        trial_limit=inf,
        code=jnp.where(is_valid, code, results.NOT_FINITE).astype(jnp.int32),
        accumulators=tuple(accumulator for accumulator, _ in accumulators_and_notes),
        notes=tuple(note for _, note in accumulators_and_notes),
        uplifted=sigma != 0,
        uplift_time=jnp.where(sigma != 0, start, nan),
        overturn_time=jnp.where(toppled, start, nan),
        impacts=jnp.zeros((), jnp.int32),
        min_impact_speed=inf,
        min_impact_speed_before_peak=inf,
        steps=jnp.zeros((), jnp.int32),
        rejected=jnp.zeros((), jnp.int32),
        may_skip=jnp.zeros((), bool) if can_skip_samples(scene, plan) else None,
    )
    if isinstance(excitation, GroundMotion):
        is_weightless = constant(c.g + excitation.vertical.lowest()[0]) <= 0
        code = jnp.where(is_weightless, results.WEIGHTLESS, state.code)
        state = state._replace(code=code.astype(jnp.int32))
    return state
