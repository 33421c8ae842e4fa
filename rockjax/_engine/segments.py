"""The literal form: one `diffrax.diffeqsolve` per segment, ended by a `diffrax.Event`, the impact map between segments.

A cross-check for the flat engine and a home for any Diffrax solver. It shares with it the equations, the guard, the impact
map, the certificate and the direct way of rigid scenes to the next uplift, and corrects what an event alone gets wrong: the
root on the interpolant is only a first guess, so the segment is solved again to end there and finished by Newton; a guard
that was broken and met again between the ends of a step is found on a dense sample, and the segment cut there; a segment
that starts on its own guard starts exactly on it, with a first step that fits the hop; a peak is solved to, not
interpolated.
"""

from __future__ import annotations

import diffrax
import jax
import jax.numpy as jnp
import optimistix as optx

from rockjax import _results as results
from rockjax._options import Options
from rockjax._types import Value, Vector

from .flat import Nodes, blank_nodes, closed, runs
from .model import acceleration, beam, shear, uplift_demand
from .scene import LoopState, Plan, Scene, after_impact, contact_mode
from .settled import certificate
from .step import advance_to_uplift

STEPS = 4096  # of one solve; a longer segment is continued
SAMPLES = 513  # of the interpolant, to look for peaks and missed events
State2 = tuple[Vector, Vector]


def run_segments(
    scene: Scene, plan: Plan, state: LoopState, options: Options, capacity: int | None
) -> tuple[LoopState, Nodes | None]:
    """The state at its end and, if `capacity` is given, its accepted steps on the way."""
    nodes = None
    if capacity is not None:
        nodes = blank_nodes(state, capacity)
        nodes = _keep(
            nodes, state, jnp.full((1,), state.t), tuple(y[None] for y in state.x), tuple(y[None] for y in state.v)
        )

    def running(carry):
        state, _ = carry
        return runs(state, options.max_steps)

    def body(carry):
        state, nodes = carry
        if plan.elastic:
            return _segment(scene, plan, options, state, nodes)

        def leaps(carry):
            state, nodes = carry
            state, _ = advance_to_uplift(scene, plan, state)
            if nodes is not None:
                one = (state.t[None], tuple(y[None] for y in state.x), tuple(y[None] for y in state.v))
                nodes = _keep(nodes, state, *one)
            return state, nodes

        return jax.lax.cond(state.sigma == 0, leaps, lambda c: _segment(scene, plan, options, *c), (state, nodes))

    state, nodes = jax.lax.while_loop(running, body, (state, nodes))
    code = closed(state).code
    if nodes is not None:
        code = jnp.where(nodes.used > nodes.t.shape[0], results.HISTORY_FULL, code)
    return state._replace(code=code), nodes


def _keep(nodes: Nodes, state: LoopState, ts, xs: Vector, vs: Vector, sigma=None, piece=None, impact_time=None) -> Nodes:
    """Append nodes; those with a time of inf are padding."""
    valid = jnp.isfinite(ts)
    at = jnp.where(valid, nodes.used + jnp.cumsum(valid) - 1, nodes.t.shape[0])

    def put(store, values):
        return store.at[at].set(jnp.broadcast_to(values, ts.shape), mode="drop")

    return Nodes(
        t=put(nodes.t, ts),
        x=tuple(put(s, y) for s, y in zip(nodes.x, xs, strict=True)),
        v=tuple(put(s, y) for s, y in zip(nodes.v, vs, strict=True)),
        sigma=put(nodes.sigma, state.sigma if sigma is None else sigma),
        piece=put(nodes.piece, state.piece if piece is None else piece),
        impact_time=put(nodes.impact_time, jnp.nan if impact_time is None else impact_time),
        used=nodes.used + jnp.sum(valid, dtype=jnp.int32),
    )


def _segment(scene: Scene, plan: Plan, options: Options, state: LoopState, nodes: Nodes | None):
    c, sigma, t0 = scene.c, state.sigma, state.t
    rocking = sigma != 0
    ground = scene.excitation.piece(state.piece)
    x_unit, v_unit = (c.alpha,), (c.p * c.alpha,)
    if plan.elastic:
        sway = c.two_R * c.sin_alpha
        x_unit, v_unit = (*x_unit, sway), (*v_unit, sway * jnp.maximum(c.p, jnp.sqrt(c.omega2)))
    units: State2 = (x_unit, v_unit)

    def scaled(y: State2) -> State2:
        return jax.tree.map(lambda a, unit: a / unit, y, units)

    def natural(y: State2) -> State2:
        return jax.tree.map(lambda a, unit: a * unit, y, units)

    def rates(t: Value, x: Vector, v: Vector) -> Vector:
        return acceleration(c, sigma, ground(t), x, v)

    def field(t, y, args):
        del args
        x, v = natural(y)
        return scaled((v, rates(t, x, v)))

    def guard(t, x, v):
        """Positive inside the mode, as in the flat engine."""
        angle = sigma * x[0]
        lift = c.uplift - jnp.abs(uplift_demand(c, ground(t), x, v))
        return jnp.where(rocking, jnp.minimum(angle, scene.overturn_angle - angle), lift)

    stop = jnp.minimum(jnp.minimum(scene.excitation.breakpoint(state.piece), scene.end), state.cut)
    start = scaled((state.x, state.v))
    a0 = rates(t0, state.x, state.v)
    fresh = rocking & (state.x[0] == 0)
    returns = fresh & (state.v[0] * a0[0] < 0)
    hop = jnp.where(returns, -0.5 * state.v[0] / jnp.where(returns, a0[0], 1.0), jnp.inf)
    first = jnp.minimum(jnp.minimum(0.05 * scene.longest_excited, hop), stop - t0)
    controller = diffrax.PIDController(
        rtol=scene.rtol, atol=scene.atol, dtmax=jnp.where(t0 < scene.quiet, scene.longest_excited, scene.longest) / 4
    )
    term, solver = diffrax.ODETerm(field), options.solver

    def solve(t1, saveat, event=None):
        return diffrax.diffeqsolve(
            term,
            solver,
            t0,
            t1,
            jnp.minimum(first, t1 - t0),
            start,
            saveat=saveat,
            stepsize_controller=controller,
            event=event,
            max_steps=STEPS,
            throw=False,
            adjoint=diffrax.ForwardMode(),
        )

    def solve_to(t1) -> State2:
        """The state at t1, by a solve that ends there."""
        inside = jnp.maximum(t1, t0 + 4 * jnp.finfo(t0.dtype).eps * (jnp.abs(t0) + 1 / c.p))
        solution = solve(inside, diffrax.SaveAt(t1=True))
        return natural(jax.tree.map(lambda y: y[0], solution.ys))

    event = diffrax.Event(
        lambda t, y, args, **_: guard(t, *natural(y)),
        root_finder=optx.Bisection(rtol=1e-12, atol=1e-12, flip="detect", expand_if_necessary=True),
        direction=False,
    )
    solution = solve(stop, diffrax.SaveAt(steps=True, dense=True), event)
    assert solution.ts is not None
    assert solution.ys is not None
    count = solution.stats["num_accepted_steps"]
    fired = solution.result == diffrax.RESULTS.event_occurred
    exhausted = solution.result == diffrax.RESULTS.max_steps_reached
    latest = jnp.max(jnp.where(jnp.isfinite(solution.ts), solution.ts, -jnp.inf))
    reached = jnp.where(exhausted | fired, latest, stop)

    # What the ends of the steps did not see.
    times = t0 + (reached - t0) * jnp.linspace(0.0, 1.0, SAMPLES)
    path = jax.vmap(lambda t: natural(solution.evaluate(t)))(times)
    samples = jax.vmap(guard)(times, *path)
    scale = jnp.where(rocking, c.alpha, c.uplift)
    broken = (samples < -1e-9 * scale) & (times < reached) & (times > t0)
    missed = jnp.any(broken)
    cut = jnp.where(missed, times[jnp.argmax(broken)], jnp.inf)

    # Land on the event: solve to the guess, finish by Newton.
    guess = jnp.where(fired, reached, t0 + 0.5 * (reached - t0))
    x, v = solve_to(jnp.where(fired, guess, reached))
    ended = jnp.where(fired, guess, reached)

    def newton(_, carry):
        t, x, v = carry
        a = rates(t, x, v)
        margin, slope = jax.jvp(guard, (t, x, v), (jnp.ones_like(t), v, a))
        delta = jnp.where(fired & (slope < 0), -margin / jnp.where(slope < 0, slope, -1.0), 0.0)
        delta = jnp.clip(delta, t0 - t, stop - t)
        x = tuple(y + delta * r + 0.5 * delta**2 * s for y, r, s in zip(x, v, a, strict=True))
        v = tuple(r + delta * s for r, s in zip(v, a, strict=True))
        return t + delta, x, v

    ended, x, v = jax.lax.fori_loop(0, 2, newton, (ended, x, v))
    finite = jnp.all(jnp.isfinite(jnp.stack([ended, *x, *v])))
    falling = sigma * v[0] < 0
    hit, toppled, lifted = fired & rocking & falling, fired & rocking & ~falling, fired & ~rocking

    # The transitions of the automaton.
    piece = state.piece + (ended >= scene.excitation.breakpoint(state.piece))
    ground_now = scene.excitation.piece(piece)(ended)
    speed = jnp.abs(v[0])
    side = jnp.sign(uplift_demand(c, ground(ended), x, v))
    x = (jnp.where(hit | ~rocking, 0.0, x[0]), *x[1:])
    v = (jnp.where(~rocking, 0.0, v[0]), *v[1:])
    q = uplift_demand(c, ground_now, x, v)
    onward, other = after_impact(scene, sigma, v[0], q)
    v = (jnp.where(hit, onward, v[0]), *v[1:])
    mode = jnp.where(hit, other, jnp.where(lifted, -side, jnp.where(rocking, sigma, contact_mode(c, q))))

    # The records.
    def peak_of(quantity, record):
        """(value, time) of the largest |quantity| of the segment: solved to if it lies inside and beats the record."""
        values = jnp.abs(jax.vmap(quantity)(times, *path))
        k = jnp.argmax(values)
        here = times[k]

        def along(t):
            return quantity(t, *natural(solution.evaluate(t)))

        rate = lambda t: jax.jvp(along, (t,), (jnp.ones_like(t),))[1]
        spacing = (reached - t0) / (SAMPLES - 1)
        lo, hi = jnp.maximum(here - spacing, t0), jnp.minimum(here + spacing, reached)
        sign = jnp.sign(along(here))
        inside = (sign * rate(lo) > 0) & (sign * rate(hi) < 0)

        def halve(_, bracket):
            lo, hi = bracket
            mid = 0.5 * (lo + hi)
            up = sign * rate(mid) > 0
            return jnp.where(up, mid, lo), jnp.where(up, hi, mid)

        lo, _ = jax.lax.fori_loop(0, 40, halve, (lo, hi))
        at = jnp.where(inside, lo, here)
        worth = values[k] > record * (1 - 1e-2)
        best = jax.lax.cond(worth & inside, lambda: jnp.abs(quantity(at, *solve_to(at))), lambda: values[k])
        return best, at

    step_peak, step_peak_time = peak_of(lambda t, x, v: sigma * x[0], state.peak)
    step_peak, step_peak_time = (
        jnp.where(toppled, scene.overturn_angle, jnp.minimum(step_peak, scene.overturn_angle)),
        jnp.where(toppled, ended, step_peak_time),
    )
    raises = rocking & (step_peak > state.peak)
    deformation, force = state.deformation, state.shear
    if plan.deformation:
        value, _ = peak_of(lambda t, x, v: x[1] - beam(c, sigma, x[0], v[0])[0], state.deformation)
        deformation = jnp.maximum(state.deformation, value)
    if plan.shear:
        value, _ = peak_of(lambda t, x, v: shear(c, sigma, ground(t), x, v, rates(t, x, v)), state.shear)
        force = jnp.maximum(state.shear, value)
    starts = ~rocking & (mode != 0)
    advanced = state._replace(
        t=ended,
        event_time=ended,
        x=x,
        v=v,
        sigma=mode,
        piece=piece.astype(state.piece.dtype),
        cut=jnp.full_like(ended, jnp.inf),
        peak=jnp.where(raises, step_peak, state.peak),
        peak_time=jnp.where(raises, step_peak_time, state.peak_time),
        deformation=deformation,
        shear=force,
        uplifted=state.uplifted | starts,
        uplift_time=jnp.where(starts & ~state.uplifted, ended, state.uplift_time),
        overturn_time=jnp.where(toppled, ended, state.overturn_time),
        impacts=state.impacts + hit,
        slowest=jnp.where(hit, jnp.minimum(state.slowest, speed), state.slowest),
        slowest_before_peak=jnp.where(raises, state.slowest, state.slowest_before_peak),
        steps=state.steps + jnp.maximum(count, 1).astype(state.steps.dtype),
        rejected=state.rejected + solution.stats["num_rejected_steps"].astype(state.steps.dtype),
    )
    code = jnp.where(ended >= scene.end, results.END_OF_TIME, results.RUNNING)
    if not plan.to_the_end:
        code = jnp.where(certificate(scene, plan, advanced, piece, ground_now), results.SETTLED, code)
    code = jnp.where(toppled, results.OVERTURNED, code)
    advanced = advanced._replace(code=jnp.where(finite, code, results.NOT_FINITE).astype(state.code.dtype))
    again = state._replace(cut=cut, rejected=state.rejected + jnp.maximum(count, 1).astype(state.steps.dtype))
    after = jax.tree.map(lambda yes, no: jnp.where(missed, yes, no), again, advanced)
    if nodes is not None:
        # The solver's own steps, short of the end, then the end itself.
        inner = jnp.where((solution.ts < ended) & (solution.ts > t0) & ~missed, solution.ts, jnp.inf)
        xs, vs = jax.vmap(natural)(solution.ys)
        nodes = _keep(nodes, state, inner, xs, vs)
        end = jnp.where(missed, jnp.inf, ended)[None]
        at_end = (tuple(y[None] for y in advanced.x), tuple(y[None] for y in advanced.v))
        nodes = _keep(nodes, state, end, *at_end, mode, advanced.piece, jnp.where(hit, ended, jnp.nan))
        full = (nodes.used >= nodes.t.shape[0]) & (after.code == results.RUNNING)
        after = after._replace(code=jnp.where(full, results.HISTORY_FULL, after.code).astype(state.code.dtype))
    return after, nodes
