"""The segments engine: one `diffrax.diffeqsolve` per segment, ended by a `diffrax.Event`.

A segment is the motion from one event or breakpoint to the next; the impact map and the other transitions
apply between segments. This engine accepts any Diffrax solver and serves as a check of the flat engine
(`flat.py`). Both engines share the equations, the transitions, the certificate (the proof that no output can
change any more) and the search for the next uplift of a rigid podium (with a rigid superstructure or none).
Diffrax's events alone are not accurate enough. This engine therefore adds four measures:

- The time of the event that Diffrax finds from its interpolant is a first guess. The segment is solved again
  up to this time, and Newton's method finds the event from there.
- The interpolant is sampled densely. If Diffrax has missed an event because the guard (see `guard.py`) leaves
  its limits and returns within a step, the segment is solved again up to the first sample outside the limits.
- After an impact the guard is exactly zero. The first step is then at most a quarter of the hop (the motion
  up to the next impact), so that it cannot miss this impact.
- The interpolant only locates peaks. To compute a peak, the segment is solved again up to the time of the
  peak.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Float

from rockjax import _results as results
from rockjax._options import Options
from rockjax._outputs.views import Moment
from rockjax._roots import bisect
from rockjax._types import Flag, Index, Value, Values, Vector

from .attempt import natural_units
from .certificate import certificate
from .fast_forward.rest import advance_to_uplift
from .flat import Nodes, blank_nodes, is_running, with_end_code
from .model import acceleration, uplift_demand
from .state import LoopState, Plan, Scene
from .transitions import transition

STEPS = 4096  # largest number of steps of one solve; another solve continues a segment with more steps
SAMPLES = 513  # number of samples of the interpolant, among which peaks and missed events are sought
Motion = tuple[Vector, Vector]  # positions and velocities
Rows = tuple[Float[Array, " n ..."], ...]  # for each degree of freedom, values at n nodes


def run_segments(
    scene: Scene, plan: Plan, state: LoopState, options: Options, capacity: int | None
) -> tuple[LoopState, Nodes | None]:
    """Integrate a scene segment by segment.

    - `scene`: the prepared scene; `plan`: settings that are fixed at compilation, such as the outputs
    - `state`: initial state
    - `options`: options, which hold the Diffrax solver
    - `capacity`: number of nodes to store; None stores none

    Returns the final state, and the accepted steps as nodes or None.
    """
    nodes = None if capacity is None else _append(blank_nodes(state, capacity), state, *_row(state))

    def body(carry):
        if plan.follows_contact:
            return _segment(scene, plan, options, *carry)
        return jax.lax.cond(carry[0].sigma == 0, advance, lambda c: _segment(scene, plan, options, *c), carry)

    def advance(carry):
        state, nodes = carry
        state, _ = advance_to_uplift(scene, plan, state)
        return state, None if nodes is None else _append(nodes, state, *_row(state))

    state, nodes = jax.lax.while_loop(
        lambda carry: is_running(carry[0], options.max_steps), body, (state, nodes)
    )
    code = with_end_code(scene, state).code
    if nodes is not None:
        code = jnp.where(nodes.used > nodes.t.shape[0], results.HISTORY_FULL, code)
    return state._replace(code=code), nodes


def _row(state: LoopState) -> tuple[Any, Rows, Rows]:
    """Return time, positions and velocities of a state as arguments of `_append`, with a first axis of length
    1."""
    return jax.tree.map(lambda y: y[None], (state.t, state.x, state.v))


def _append(nodes: Nodes, state: LoopState, ts, xs: Rows, vs: Rows, impact_time: Any = jnp.nan) -> Nodes:
    """Append nodes at the times `ts` with positions `xs` and velocities `vs`; nodes with the time inf are
    left out. Contact mode and piece are those of `state`."""
    valid = jnp.isfinite(ts)
    at = jnp.where(valid, nodes.used + jnp.cumsum(valid, dtype=jnp.int32) - 1, nodes.t.shape[0])

    def put(store, values):
        return store.at[at].set(jnp.broadcast_to(values, (*ts.shape, *store.shape[1:])), mode="drop")

    return Nodes(
        t=put(nodes.t, ts),
        x=tuple(map(put, nodes.x, xs)),
        v=tuple(map(put, nodes.v, vs)),
        sigma=put(nodes.sigma, state.sigma),
        piece=put(nodes.piece, state.piece),
        impact_time=put(nodes.impact_time, impact_time),
        event_time=put(nodes.event_time, ts),
        used=nodes.used + jnp.sum(valid, dtype=jnp.int32),
    )


class _ContactMode(NamedTuple):
    """Equations of one contact mode on one piece of the ground motion. Diffrax integrates scaled states:
    states divided by `natural_units`."""

    scene: Scene
    sigma: Value  # contact mode
    ground_at: Callable[[Value], Value]  # t ↦ ground acceleration on the piece [m/s²]
    units: Motion  # units of positions and velocities (`natural_units`)

    @property
    def rocking(self) -> Flag:
        return self.sigma != 0

    def scaled(self, y: Motion) -> Motion:
        return jax.tree.map(lambda a, unit: a / unit, y, self.units)

    def natural(self, y: Motion) -> Motion:
        return jax.tree.map(lambda a, unit: a * unit, y, self.units)

    def accelerations(self, t: Value, x: Vector, v: Vector) -> Vector:
        return acceleration(self.scene.c, self.sigma, self.ground_at(t), x, v)

    def field(self, t, y, args):
        del args
        x, v = self.natural(y)
        return self.scaled((v, self.accelerations(t, x, v)))

    def guard(self, t, x, v):
        """Return the distance of the guard to its nearest limit, positive as long as the contact mode lasts:
        [rad] while rocking, [m/s²] in full contact."""
        angle = self.sigma * x[0]
        lift = self.scene.c.uplift - jnp.abs(uplift_demand(self.scene.c, self.ground_at(t), x, v))
        return jnp.where(self.rocking, jnp.minimum(angle, self.scene.overturn_angle - angle), lift)


def _solver(mode: _ContactMode, options: Options, state: LoopState, stop: Value) -> Callable[..., Any]:
    """Return the function (t1, saveat, event) ↦ Diffrax solution from the given state to the time t1, or to
    the event if that is earlier."""
    scene, t0 = mode.scene, state.t
    start = mode.scaled((state.x, state.v))
    a0 = mode.accelerations(t0, state.x, state.v)
    starts_at_zero = mode.rocking & (state.x[0] == 0)
    returns = starts_at_zero & (state.v[0] * a0[0] < 0)
    hop = jnp.where(returns, -0.5 * state.v[0] / jnp.where(returns, a0[0], 1.0), jnp.inf)
    first_step = jnp.minimum(jnp.minimum(0.05 * scene.max_excited_step, hop), stop - t0)
    controller = diffrax.PIDController(
        rtol=scene.rtol,
        atol=scene.atol,
        dtmax=jnp.where(t0 < scene.excitation_end, scene.max_excited_step, scene.max_step) / 4,
    )
    term, solver = diffrax.ODETerm(mode.field), options.solver

    def solve(t1, saveat, event=None):
        return diffrax.diffeqsolve(
            term,
            solver,
            t0,
            t1,
            jnp.minimum(first_step, t1 - t0),
            start,
            saveat=saveat,
            stepsize_controller=controller,
            event=event,
            max_steps=STEPS,
            throw=False,
            adjoint=diffrax.ForwardMode(),
        )

    return solve


class _Path(NamedTuple):
    """A segment, solved until the guard leaves its limits or the time is `stop`."""

    mode: _ContactMode
    solve: Callable[..., Any]  # as returned by `_solver`
    solution: Any  # Diffrax's solution
    start: Value  # time of the start [s]
    stop: Value  # time of the next breakpoint, the end of the scene or `trial_limit`, whichever is first [s]
    reached: Value  # time that the solution has reached [s]
    fired: Flag  # Diffrax reported an event
    times: Value  # times of the samples [s]
    samples: Motion  # positions and velocities at the times of the samples

    def solve_to(self, t1) -> Motion:
        """Return the state at t1, from a new solution that ends there."""
        t0, p = self.start, self.mode.scene.c.p
        inside = jnp.maximum(t1, t0 + 4 * jnp.finfo(t0.dtype).eps * (jnp.abs(t0) + 1 / p))
        solution = self.solve(inside, diffrax.SaveAt(t1=True))
        return self.mode.natural(jax.tree.map(lambda y: y[0], solution.ys))

    def missed(self) -> tuple[Flag, Value]:
        """Return whether the guard is outside its limits at a sample before the reported event or the end of
        the segment, and the time of the first such sample [s]; inf if there is none."""
        mode, c, times = self.mode, self.mode.scene.c, self.times
        values = jax.vmap(mode.guard)(times, *self.samples)
        scale = jnp.where(mode.rocking, c.alpha, c.uplift)
        broken = (values < -1e-9 * scale) & (times < self.reached) & (times > self.start)
        missed = jnp.any(broken)
        return missed, jnp.where(missed, times[jnp.argmax(broken)], jnp.inf)

    def end(self) -> tuple[Value, Vector, Vector]:
        """Return time and state at the end of the segment.

        The segment is solved again up to the reported time of the event. Two Newton steps then find the
        event. Without an event, the result is the state at the time `reached`.
        """
        mode, fired, t0 = self.mode, self.fired, self.start
        x, v = self.solve_to(self.reached)

        def newton(_, carry):
            t, x, v = carry
            a = mode.accelerations(t, x, v)
            clearance, slope = jax.jvp(mode.guard, (t, x, v), (jnp.ones_like(t), v, a))
            delta = jnp.where(fired & (slope < 0), -clearance / jnp.where(slope < 0, slope, -1.0), 0.0)
            delta = jnp.clip(delta, t0 - t, self.stop - t)
            x = tuple(y + delta * r + 0.5 * delta**2 * s for y, r, s in zip(x, v, a, strict=True))
            v = tuple(r + delta * s for r, s in zip(v, a, strict=True))
            return t + delta, x, v

        return jax.lax.fori_loop(0, 2, newton, (self.reached, x, v))

    def largest(self, quantity, accumulator) -> tuple[Value, Value]:
        """Return the largest |quantity| in the segment, and the time of this maximum [s].

        - `quantity`: (t, x, v) ↦ the quantity
        - `accumulator`: largest value so far

        If a maximum inside the segment may exceed the accumulator, the segment is solved again up to the time
        of this maximum.
        """
        values = jnp.abs(jax.vmap(quantity)(self.times, *self.samples))
        k = jnp.argmax(values)
        middle = self.times[k]

        def at_time(t):
            return quantity(t, *self.mode.natural(self.solution.evaluate(t)))

        rate = lambda t: jax.jvp(at_time, (t,), (jnp.ones_like(t),))[1]
        spacing = (self.reached - self.start) / (SAMPLES - 1)
        lo, hi = jnp.maximum(middle - spacing, self.start), jnp.minimum(middle + spacing, self.reached)
        sign = jnp.sign(at_time(middle))
        rises = lambda t: sign * rate(t) > 0
        inside = rises(lo) & (sign * rate(hi) < 0)
        lo, _ = bisect(rises, lo, hi, 40, jnp)
        time = jnp.where(inside, lo, middle)
        may_exceed = values[k] > accumulator * (1 - 1e-2)
        value = jax.lax.cond(
            may_exceed & inside, lambda: jnp.abs(quantity(time, *self.solve_to(time))), lambda: values[k]
        )
        return value, time


def _path(mode: _ContactMode, options: Options, state: LoopState) -> _Path:
    scene, t0 = mode.scene, state.t
    stop = jnp.minimum(jnp.minimum(scene.excitation.breakpoint(state.piece), scene.end), state.trial_limit)
    solve = _solver(mode, options, state, stop)
    event = diffrax.Event(
        lambda t, y, args, **_: mode.guard(t, *mode.natural(y)),
        root_finder=optx.Bisection(rtol=1e-12, atol=1e-12, flip="detect", expand_if_necessary=True),
        direction=False,
    )
    solution = solve(stop, diffrax.SaveAt(steps=True, dense=True), event)
    fired = solution.result == diffrax.RESULTS.event_occurred
    exhausted = solution.result == diffrax.RESULTS.max_steps_reached
    latest = jnp.max(jnp.where(jnp.isfinite(solution.ts), solution.ts, -jnp.inf))
    reached = jnp.where(exhausted | fired, latest, stop)
    times = t0 + (reached - t0) * jnp.linspace(0.0, 1.0, SAMPLES)
    samples = jax.vmap(lambda t: mode.natural(solution.evaluate(t)))(times)
    return _Path(mode, solve, solution, t0, stop, reached, fired, times, samples)


class _Arrival(NamedTuple):
    """The end of a segment, after the transition between contact modes."""

    t: Value  # time [s]
    x: Vector  # positions
    v: Vector  # velocities
    sigma: Value  # contact mode
    piece: Index  # piece of the excitation that follows
    ground: Value  # ground acceleration on that piece [m/s²]
    speed: Value  # |θ̇| before the transition [rad/s]
    hit: Flag  # the segment ended with an impact
    toppled: Flag  # the segment ended at the overturning angle
    finite: Flag  # time and state before the transition are finite


def _arrival(path: _Path, state: LoopState) -> _Arrival:
    mode, scene, sigma = path.mode, path.mode.scene, state.sigma
    c, rocking, fired = scene.c, mode.rocking, path.fired
    ended, x, v = path.end()
    finite = jnp.all(jnp.stack([jnp.all(jnp.isfinite(y)) for y in (ended, *x, *v)]))
    falling = sigma * v[0] < 0
    hit, toppled, lifted = fired & rocking & falling, fired & rocking & ~falling, fired & ~rocking
    piece = scene.excitation.past(state.piece, ended >= scene.excitation.breakpoint(state.piece))
    ground_now = scene.excitation.piece(piece)(ended)
    speed = jnp.abs(v[0])
    demand = uplift_demand(c, mode.ground_at(ended), x, v)
    x, v, after = transition(scene, sigma, x, v, ground_now, hit, lifted, demand)
    return _Arrival(ended, x, v, after, piece, ground_now, speed, hit, toppled, finite)


def _raised(path: _Path, output: Any, accumulator: Values) -> Values:
    """Return the accumulator of an output (the value up to the present time) after the segment. The elements
    of an array are updated one by one."""
    mode = path.mode

    def quantity(t, x, v):
        a = mode.accelerations(t, x, v)
        return output.quantity(Moment(mode.scene.c, mode.sigma, t, mode.ground_at(t), x, v, a))

    if not accumulator.ndim:
        return jnp.maximum(accumulator, path.largest(quantity, accumulator)[0])

    def raise_element(index_and_accumulator):
        k, accumulator = index_and_accumulator
        largest, _ = path.largest(lambda t, x, v: quantity(t, x, v)[k], accumulator)
        return jnp.maximum(accumulator, largest)

    return jax.lax.map(raise_element, (jnp.arange(accumulator.size), accumulator))


def _advanced(path: _Path, plan: Plan, state: LoopState, end: _Arrival) -> LoopState:
    """Return the state after the segment, with updated accumulators."""
    mode, scene = path.mode, path.mode.scene
    sigma = mode.sigma
    peak, peak_time = path.largest(lambda t, x, v: sigma * x[0], state.peak)
    peak = jnp.where(end.toppled, scene.overturn_angle, jnp.minimum(peak, scene.overturn_angle))
    peak_time = jnp.where(end.toppled, end.t, peak_time)
    raises_peak = mode.rocking & (peak > state.peak)
    accumulators = [jnp.where(raises_peak, peak, state.peak)]
    notes = [jnp.where(raises_peak, peak_time, state.notes[0])]
    # The first output, the rotation, has just been updated.
    for output, accumulator, note in list(zip(plan.outputs, state.accumulators, state.notes, strict=True))[
        1:
    ]:
        accumulators.append(accumulator if output.follows_impacts else _raised(path, output, accumulator))
        notes.append(note)
    uplifts = ~mode.rocking & (end.sigma != 0)
    stats = path.solution.stats
    return state._replace(
        t=end.t,
        event_time=end.t,
        x=end.x,
        v=end.v,
        sigma=end.sigma,
        piece=end.piece.astype(state.piece.dtype),
        trial_limit=jnp.full_like(end.t, jnp.inf),
        accumulators=tuple(accumulators),
        notes=tuple(notes),
        uplifted=state.uplifted | uplifts,
        uplift_time=jnp.where(uplifts & ~state.uplifted, end.t, state.uplift_time),
        overturn_time=jnp.where(end.toppled, end.t, state.overturn_time),
        impacts=state.impacts + end.hit.astype(jnp.int32),
        min_impact_speed=jnp.minimum(state.min_impact_speed, jnp.where(end.hit, end.speed, jnp.inf)),
        min_impact_speed_before_peak=jnp.where(
            raises_peak, state.min_impact_speed, state.min_impact_speed_before_peak
        ),
        steps=state.steps + jnp.maximum(stats["num_accepted_steps"], 1).astype(state.steps.dtype),
        rejected=state.rejected + stats["num_rejected_steps"].astype(state.steps.dtype),
    )


def _segment(scene: Scene, plan: Plan, options: Options, state: LoopState, nodes: Nodes | None):
    """Advance by one segment, and append its steps to the nodes. Return the state and the nodes.

    If Diffrax has missed an event (`_Path.missed`), the motion does not advance. The segment is then solved
    again, up to the time that is returned as `trial_limit`.
    """
    ground_at = scene.excitation.piece(state.piece)
    path = _path(_ContactMode(scene, state.sigma, ground_at, natural_units(scene.c)), options, state)
    missed, retry_until = path.missed()
    end = _arrival(path, state)
    advanced = _advanced(path, plan, state, end)
    code = jnp.where(end.t >= scene.end, results.END_OF_TIME, results.RUNNING)
    if not plan.to_the_end:
        code = jnp.where(certificate(scene, plan, advanced, end.piece, end.ground), results.SETTLED, code)
    code = jnp.where(end.toppled, results.OVERTURNED, code)
    advanced = advanced._replace(
        code=jnp.where(end.finite, code, results.NOT_FINITE).astype(state.code.dtype)
    )
    count = path.solution.stats["num_accepted_steps"]
    rejected = state.rejected + jnp.maximum(count, 1).astype(state.steps.dtype)
    repeated = state._replace(trial_limit=retry_until, rejected=rejected)
    after = jax.tree.map(lambda yes, no: jnp.where(missed, yes, no), repeated, advanced)
    if nodes is not None:
        ts = path.solution.ts
        inner_times = jnp.where((ts < end.t) & (ts > state.t) & ~missed, ts, jnp.inf)
        xs, vs = jax.vmap(path.mode.natural)(path.solution.ys)
        nodes = _append(nodes, state, inner_times, xs, vs)
        t, x, v = _row(advanced)
        impact_time = jnp.where(end.hit, end.t, jnp.nan)
        nodes = _append(nodes, advanced, jnp.where(missed, jnp.inf, t), x, v, impact_time)
        full = (nodes.used >= nodes.t.shape[0]) & (after.code == results.RUNNING)
        after = after._replace(
            code=jnp.where(full, results.HISTORY_FULL, after.code).astype(state.code.dtype)
        )
    return after, nodes
