"""The literal form: one `diffrax.diffeqsolve` per segment, ended by a `diffrax.Event`, the impact map between segments.

A cross-check for the flat engine and a home for any Diffrax solver. It shares the equations, the guard, the impact map,
the certificate and the leap of rigid scenes with it, and mends what an event alone gets wrong: the root on the
interpolant is only a first guess, so the segment is solved again to end there and finished by Newton; a guard that was
broken and mended between the ends of a step is found on a dense sample, and the segment cut there; a segment that
starts on its own guard starts exactly on it, with a first step that fits the hop; a peak is solved to, not interpolated.
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
from .scene import Lane, Plan, Scene, after_impact, contact_mode
from .settled import certificate
from .step import leap

STEPS = 4096  # of one solve; a longer segment is continued
SAMPLES = 513  # of the interpolant, to look for peaks and missed events
State2 = tuple[Vector, Vector]


def run_segments(scene: Scene, how: Plan, lane: Lane, options: Options, capacity: int | None) -> tuple[Lane, Nodes | None]:
    """The lane at its end and, if `capacity` is given, its accepted steps on the way."""
    nodes = None
    if capacity is not None:
        nodes = blank_nodes(lane, capacity)
        nodes = _keep(nodes, lane, jnp.full((1,), lane.t), tuple(y[None] for y in lane.x), tuple(y[None] for y in lane.v))

    def running(carry):
        lane, _ = carry
        return runs(lane, options.max_steps)

    def body(carry):
        lane, nodes = carry
        if how.elastic:
            return _segment(scene, how, options, lane, nodes)

        def leaps(carry):
            lane, nodes = carry
            lane, _ = leap(scene, how, lane)
            if nodes is not None:
                one = (lane.t[None], tuple(y[None] for y in lane.x), tuple(y[None] for y in lane.v))
                nodes = _keep(nodes, lane, *one)
            return lane, nodes

        return jax.lax.cond(lane.sigma == 0, leaps, lambda c: _segment(scene, how, options, *c), (lane, nodes))

    lane, nodes = jax.lax.while_loop(running, body, (lane, nodes))
    code = closed(lane).code
    if nodes is not None:
        code = jnp.where(nodes.used > nodes.t.shape[0], results.HISTORY_FULL, code)
    return lane._replace(code=code), nodes


def _keep(nodes: Nodes, lane: Lane, ts, xs: Vector, vs: Vector, sigma=None, piece=None, impact_time=None) -> Nodes:
    """Append nodes; those with a time of inf are padding."""
    valid = jnp.isfinite(ts)
    at = jnp.where(valid, nodes.used + jnp.cumsum(valid) - 1, nodes.t.shape[0])

    def put(store, values):
        return store.at[at].set(jnp.broadcast_to(values, ts.shape), mode="drop")

    return Nodes(
        t=put(nodes.t, ts),
        x=tuple(put(s, y) for s, y in zip(nodes.x, xs, strict=True)),
        v=tuple(put(s, y) for s, y in zip(nodes.v, vs, strict=True)),
        sigma=put(nodes.sigma, lane.sigma if sigma is None else sigma),
        piece=put(nodes.piece, lane.piece if piece is None else piece),
        impact_time=put(nodes.impact_time, jnp.nan if impact_time is None else impact_time),
        used=nodes.used + jnp.sum(valid, dtype=jnp.int32),
    )


def _segment(scene: Scene, how: Plan, options: Options, lane: Lane, nodes: Nodes | None):
    c, sigma, t0 = scene.c, lane.sigma, lane.t
    rocking = sigma != 0
    ground = scene.excitation.piece(lane.piece)
    x_unit, v_unit = (c.alpha,), (c.p * c.alpha,)
    if how.elastic:
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
        return jnp.where(rocking, jnp.minimum(angle, scene.topple - angle), lift)

    stop = jnp.minimum(jnp.minimum(scene.excitation.breakpoint(lane.piece), scene.end), lane.cut)
    start = scaled((lane.x, lane.v))
    a0 = rates(t0, lane.x, lane.v)
    fresh = rocking & (lane.x[0] == 0)
    returns = fresh & (lane.v[0] * a0[0] < 0)
    hop = jnp.where(returns, -0.5 * lane.v[0] / jnp.where(returns, a0[0], 1.0), jnp.inf)
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

    # The automaton's arrows.
    piece = lane.piece + (ended >= scene.excitation.breakpoint(lane.piece))
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

    tip, tip_time = peak_of(lambda t, x, v: sigma * x[0], lane.peak)
    tip, tip_time = (
        jnp.where(toppled, scene.topple, jnp.minimum(tip, scene.topple)),
        jnp.where(toppled, ended, tip_time),
    )
    raises = rocking & (tip > lane.peak)
    deformation, force = lane.deformation, lane.shear
    if how.deformation:
        value, _ = peak_of(lambda t, x, v: x[1] - beam(c, sigma, x[0], v[0])[0], lane.deformation)
        deformation = jnp.maximum(lane.deformation, value)
    if how.shear:
        value, _ = peak_of(lambda t, x, v: shear(c, sigma, ground(t), x, v, rates(t, x, v)), lane.shear)
        force = jnp.maximum(lane.shear, value)
    starts = ~rocking & (mode != 0)
    advanced = lane._replace(
        t=ended,
        mark=ended,
        x=x,
        v=v,
        sigma=mode,
        piece=piece.astype(lane.piece.dtype),
        cut=jnp.full_like(ended, jnp.inf),
        peak=jnp.where(raises, tip, lane.peak),
        peak_time=jnp.where(raises, tip_time, lane.peak_time),
        deformation=deformation,
        shear=force,
        uplifted=lane.uplifted | starts,
        uplift_time=jnp.where(starts & ~lane.uplifted, ended, lane.uplift_time),
        overturn_time=jnp.where(toppled, ended, lane.overturn_time),
        impacts=lane.impacts + hit,
        slowest=jnp.where(hit, jnp.minimum(lane.slowest, speed), lane.slowest),
        slowest_before_peak=jnp.where(raises, lane.slowest, lane.slowest_before_peak),
        steps=lane.steps + jnp.maximum(count, 1).astype(lane.steps.dtype),
        rejected=lane.rejected + solution.stats["num_rejected_steps"].astype(lane.steps.dtype),
    )
    code = jnp.where(ended >= scene.end, results.END_OF_TIME, results.RUNNING)
    if not how.to_the_end:
        code = jnp.where(certificate(scene, how, advanced, piece, ground_now), results.SETTLED, code)
    code = jnp.where(toppled, results.OVERTURNED, code)
    advanced = advanced._replace(code=jnp.where(finite, code, results.NOT_FINITE).astype(lane.code.dtype))
    again = lane._replace(cut=cut, rejected=lane.rejected + jnp.maximum(count, 1).astype(lane.steps.dtype))
    after = jax.tree.map(lambda yes, no: jnp.where(missed, yes, no), again, advanced)
    if nodes is not None:
        # The solver's own steps, short of the end, then the end itself.
        inner = jnp.where((solution.ts < ended) & (solution.ts > t0) & ~missed, solution.ts, jnp.inf)
        xs, vs = jax.vmap(natural)(solution.ys)
        nodes = _keep(nodes, lane, inner, xs, vs)
        end = jnp.where(missed, jnp.inf, ended)[None]
        at_end = (tuple(y[None] for y in advanced.x), tuple(y[None] for y in advanced.v))
        nodes = _keep(nodes, lane, end, *at_end, mode, advanced.piece, jnp.where(hit, ended, jnp.nan))
        full = (nodes.used >= nodes.t.shape[0]) & (after.code == results.RUNNING)
        after = after._replace(code=jnp.where(full, results.HISTORY_FULL, after.code).astype(lane.code.dtype))
    return after, nodes
