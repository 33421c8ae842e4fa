"""Full contact without steps: a linear oscillator under a polynomial ground motion has an exact solution.

Before the first uplift nothing happens but Eq. (4). The ground motion over a panel of time is a polynomial
(to rounding for smooth pulses, by Chebyshev interpolation; exactly for a sampled record, whose panels are its
intervals); under it the oscillator moves along another polynomial plus a free vibration. As long as a bound
of the demand over the panel stays under Eq. (9), the columns provably stay down, and the panel is crossed at
once, however stiff the superstructure.

Where nothing is elastic, nothing moves before the next uplift, which is a root of the excitation.
"""

from __future__ import annotations

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from rockjax import _results as results
from rockjax._engine.once import once
from rockjax._excitations.base import Shaking
from rockjax._types import Flag, Index, Value, Values

from .coefficients import Coefficients, Vibration, present, summed, weighted
from .model import drift_weights, horizontal, uplift_demand
from .ratio import safe_ratio
from .records import larger
from .settled import certificate, every
from .state import Decision, LoopState, Plan, Scene, StepInfo
from .transitions import contact_mode, restart

_SERIES = 2.0  # radians per half panel up to which the particular solution is a Taylor series, …
_TERMS = 24  # … of so many terms; beyond, it follows the ground motion
_ROUNDING = 1e-14
_FEW = 1  # degree of a ground motion up to which the solutions under its powers are kept for all panels
_DAMPED = 0.95  # ζ up to which the free vibration is worked out; stronger damping is left to the steps


@functools.partial(jax.jit, static_argnames="plan")
def cross_full_contact(scene: Scene, plan: Plan, state: LoopState) -> LoopState:
    """Cross the panels over which the columns provably stay down, from the start of a scene on."""
    c, excitation, constant = scene.c, scene.excitation, jax.lax.stop_gradient
    modes = c.vibration
    if modes is None:
        return state
    degree, lengths = excitation.panels
    omega = jnp.sqrt(modes.omega2)
    swing = _Swing(c, plan, omega, 0.5 * modes.damping / omega)
    # Long panels as far as they go, then shorter ones.
    kinds = [(half, swing.over(half, degree)) for half in (0.5 * constant(y) for y in lengths)]
    shaking = excitation.piece(state.piece)(state.t)
    settled = (state.code == results.RUNNING) & certificate(scene, plan, state, state.piece, shaking)
    state = state._replace(code=jnp.where(settled, results.SETTLED, state.code).astype(state.code.dtype))
    highest = scene.lookahead.peak(state.t, state.piece, jnp.abs(horizontal(shaking)))
    nodes, to_powers, to_tail = _interpolation(degree)

    def panel(carry: tuple[LoopState, Index, Value, Index]) -> tuple[LoopState, Index, Value, Index]:
        state, level, _, _ = carry
        began = state.t, level
        half, over = kinds[0]
        for k, kind in enumerate(kinds[1:], start=1):
            half, over = jax.tree.map(lambda a, b, k=k: jnp.where(level == k, a, b), kind, (half, over))
        ground_at, edge, length = excitation.piece(state.piece), excitation.breakpoint(state.piece), 2 * half
        reaches = jnp.abs(state.t + length - constant(edge)) <= 1e-9 * length
        values = once(jax.vmap(ground_at)(state.t + half * (1 + jnp.asarray(nodes))))
        raised: list[Value] = []
        rounding: list[Value] = []
        if isinstance(values, Shaking):
            tilt = present(c.tilt)
            raised = [tilt * y for y in _combine(to_powers, values.vertical)]
            rounding = [tilt * y for y in _combine(to_tail, values.vertical)]
            values = values.horizontal
        force = list(once(_combine(to_powers, values)))
        move = swing.across(force, half, over, state.x[1], state.v[1])
        shaken = weighted(modes.demand, move.shaken)
        # With vertical motion ±q − K v̈_g, (C10).
        goes = move.most.demand + shaken + sum(map(jnp.abs, raised)) < c.uplift
        goes &= _under_records(scene, plan, state, move)
        for coefficient in rounding:
            goes &= jnp.abs(coefficient) <= _ROUNDING * c.uplift
        for coefficient in _combine(to_tail, values):
            goes &= jnp.abs(coefficient) <= _ROUNDING * highest
        # Not past the end of the scene, where it comes before the breakpoint.
        inside = jnp.where(
            reaches,
            constant(edge) <= constant(scene.end),
            state.t + length < constant(jnp.minimum(edge, scene.end)),
        )
        goes &= every(swing.zeta < _DAMPED)
        goes &= inside

        event_time = jnp.where(reaches, edge, state.t + length)
        crossed = _past_panel(scene, modes, state, event_time, reaches, move)
        # Where the ground jumps at the end of a panel and lifts the columns at once, a step has to see it.
        beyond = excitation.piece(crossed.piece)(crossed.t)
        goes &= contact_mode(c, uplift_demand(c, beyond, crossed.x, crossed.v)) == 0
        state = jax.tree.map(lambda new, old: jnp.where(goes, new, old), crossed, state)
        return state, level + (~goes).astype(jnp.int32), *began

    def may(carry: tuple[LoopState, Index, Value, Index]) -> Flag:
        state, level, before, level_before = carry
        # A comparison that is worked out twice may come out either way: neither on nor to the next kind.
        moved = (state.t > before) | (level > level_before)
        down = (level < len(kinds)) & (state.code == results.RUNNING) & (state.sigma == 0)
        return down & (state.t < scene.quiet) & moved

    level = jnp.zeros((), jnp.int32)
    return jax.lax.while_loop(may, panel, (state, level, jnp.full_like(state.t, -jnp.inf), level))[0]


class _Most(NamedTuple):
    """What a particular solution does not exceed over a panel; None of what is not wanted."""

    demand: Value
    deformation: Values | None
    shear: Value | None  # of springs and of what moves with the beam, over the mass
    drifts: Values | None
    floors: Values | None


class _Particular(NamedTuple):
    """A solution under the force of a panel: (y, y') at both ends of r ∈ [−1, 1], and its bounds."""

    first: Values
    last: Values
    slow: Values
    fast: Values
    most: _Most


class _Across(NamedTuple):
    """What is the same for all panels of one length."""

    turn: Values  # radians of half a panel
    free: tuple[Values, ...]  # the free vibration across all of it
    # For each power of r the solution under it alone, where the ground motion has few: a record is crossed
    # sample by sample, and adding these up takes half the time of solving anew.
    of_powers: _Particular | None


class _Moves(NamedTuple):
    """What modes do over a panel: bounds are of polynomials by their coefficients, of the free vibration by
    its energy."""

    most: _Most  # of the particular solution
    vibration: Values  # amplitude of the free vibration …
    shaken: Values  # … and of its ω²d + 2ζω ḋ
    x: Values  # displacement and velocity at the end
    v: Values


class _Swing(NamedTuple):
    """Modes in full contact."""

    c: Coefficients
    plan: Plan
    omega: Values
    zeta: Values

    def over(self, half: Value, degree: int) -> _Across:
        turn = self.omega * half
        of_powers = None
        if degree <= _FEW:
            of_powers = once(
                jax.vmap(lambda force: self.under(list(force), turn, half))(
                    jnp.eye(degree + 1, dtype=half.dtype)
                )
            )
        return _Across(turn, _free(self.zeta, turn), of_powers)

    def under(self, force: list[Value], turn: Values, half: Value) -> _Particular:
        """The particular solution under Σ f_k r^k."""
        modes, path = present(self.c.vibration), once(_particular(force, self.zeta, turn, half))
        rates = _rate(path)
        spring = modes.omega2[None] * path + (modes.damping / half)[None] * rates
        most = _most(self.c, self.plan, path, spring, _padded(force))
        (first, last), (slow, fast) = _ends(path), _ends(rates)
        return _Particular(first, last, slow, fast, most)

    def across(self, force: list[Value], half: Value, over: _Across, u: Values, u_dot: Values) -> _Moves:
        """The motion over a panel, from the displacement and velocity at its start."""
        turn, free, of_powers = over
        found = self.under(force, turn, half) if of_powers is None else _added(force, of_powers)
        # The free vibration is what the state at the start has besides the particular solution.
        offset, speed = once((u - found.first, u_dot * half - found.slow))
        x = found.last + free[0] * offset + free[1] * speed
        v = (found.fast + free[2] * offset + free[3] * speed) / half
        vibration = jnp.sqrt(offset**2 + (speed / turn) ** 2)
        shaken = present(self.c.vibration).omega2 * jnp.sqrt(1 + 4 * self.zeta**2) * vibration
        return _Moves(found.most, vibration, shaken, x, v)


def _added(force: list[Value], of_powers: _Particular) -> _Particular:
    """The solution under Σ f_k r^k from those under each power. Those of even and odd powers share next to
    no powers of r, so that their bounds add up to that of the sum."""

    def total(rows: Values, weights: list[Value]) -> Values:
        return sum((w * row for w, row in zip(weights, rows, strict=True)), jnp.zeros_like(rows[0]))

    sizes = [jnp.abs(f) for f in force]
    first, last, slow, fast = (total(rows, force) for rows in of_powers[:-1])
    return _Particular(first, last, slow, fast, jax.tree.map(lambda rows: total(rows, sizes), of_powers.most))


def _most(c: Coefficients, plan: Plan, path: Values, spring: Values, force: Values) -> _Most:
    """The bounds of a particular solution, by the coefficients of its deformations, of ω²d + 2ζω ḋ and of
    ü_g."""
    several = c.several
    demand = _size(force - _weighted_rows(present(c.vibration).demand, spring))
    found = _Most(demand, _size(path) if plan.deformation else None, None, None, None)
    if several is None:
        return found._replace(shear=_size(spring)) if plan.shear else found

    def carried(weights: Values) -> Value:
        rows = _weighted_rows(weights, spring)
        return _size(rows if several.residual is None else rows - (1 - summed(weights)) * force)

    if plan.shear:
        found = found._replace(shear=carried(several.shares))
    if plan.drifts:
        weights = drift_weights(present(several.floors))
        found = found._replace(drifts=jax.vmap(lambda each: _size(_weighted_rows(each, path)))(weights))
    if plan.floors:
        found = found._replace(floors=jax.vmap(carried)(present(several.floors)))
    return found


def _under_records(scene: Scene, plan: Plan, state: LoopState, move: _Moves) -> Flag | bool:
    """Whether what is wanted of the superstructure stays under its records over a panel."""
    c, several, under, most = scene.c, scene.c.several, True, move.most
    short, weak = scene.atol * c.two_R * c.sin_alpha, scene.atol * c.uplift
    # Of floors and stories, a row of weights for each.
    freely = lambda weights, modes: jax.vmap(lambda each: weighted(jnp.abs(each), modes))(weights)
    if plan.deformation:
        size = present(most.deformation) + move.vibration
        under &= every(size < jnp.maximum(present(state.deformation), short))
    if plan.shear:
        shaken = move.shaken if several is None else weighted(jnp.abs(several.shares), move.shaken)
        under &= present(most.shear) + shaken < jnp.maximum(present(state.shear) * c.g, weak)
    if several is not None and plan.drifts:
        drifts = present(most.drifts) + freely(drift_weights(present(several.floors)), move.vibration)
        under &= every(drifts < jnp.maximum(present(state.drifts), short))
    if several is not None and plan.floors:
        floors = present(most.floors) + freely(present(several.floors), move.shaken)
        under &= every(floors < jnp.maximum(present(state.floors), weak))
    return under


def _past_panel(
    scene: Scene, modes: Vibration, state: LoopState, event_time: Value, reaches: Flag, end: _Moves
) -> LoopState:
    """The state at the end of a panel, with displacements and velocities of the superstructure there."""
    t = jax.lax.stop_gradient(event_time)
    # A breakpoint moves with the parameters: to it with this panel's field, on with that of the next.
    past = event_time - t
    ground = horizontal(scene.excitation.piece(state.piece)(t))
    u_ddot = -ground - (modes.omega2 * end.x + modes.damping * end.v)
    x = state.x[0], end.x + past * end.v
    v = state.v[0], end.v + past * u_ddot
    piece = scene.excitation.past(state.piece, reaches)
    x, v = restart(scene, t, past, x, v, state.sigma, piece)
    return state._replace(t=t, event_time=event_time, x=x, v=v, piece=piece, steps=state.steps + 1)


@functools.partial(jax.jit, static_argnames="plan")
def advance_to_uplift(scene: Scene, plan: Plan, state: LoopState) -> tuple[LoopState, StepInfo]:
    """Full contact with nothing elastic: the next uplift is a root of the excitation."""
    constant = jax.lax.stop_gradient
    c, t, excitation = scene.c, state.t, scene.excitation
    lifts_at = constant(scene.lookahead.next_exceedance(t, state.piece))
    end = constant(scene.end)
    lifts = lifts_at < end
    stamp = jnp.where(lifts, lifts_at, jnp.where(jnp.isinf(lifts_at), t, end))
    piece = jnp.where(lifts, excitation.locate(stamp), state.piece)

    def demand_on(piece: Index):
        ground_at = excitation.piece(piece)
        return lambda t: uplift_demand(c, ground_at(t), state.x, state.v)

    side = constant(-jnp.sign(demand_on(piece)(stamp)))
    # The time of the uplift moves with the crossing, or with the breakpoint at which the ground jumps above.
    # A crossing that falls on a breakpoint, but for rounding, is that of the piece before.
    edge = excitation.breakpoint(excitation.before(piece))
    on_edge = constant(edge) == stamp
    jump = demand_on(piece)(stamp) - demand_on(excitation.before(piece))(stamp)
    jumps = on_edge & (jnp.abs(constant(jump)) > 1e-9 * constant(c.uplift))
    crossed = demand_on(excitation.before(piece, (on_edge & ~jumps).astype(jnp.int32)))
    ground, slope = jax.jvp(crossed, (stamp,), (jnp.ones_like(stamp),))
    time_past_end = safe_ratio(-side * ground - c.uplift, -side * slope, lifts & ~jumps)
    now = jnp.where(jumps, edge, stamp - (time_past_end - constant(time_past_end)))
    now = jnp.where(lifts, now, stamp)
    mode = jnp.where(lifts, side, 0.0)
    x, v = restart(scene, stamp, now - constant(now), state.x, state.v, mode, piece)
    code = jnp.where(
        lifts, results.RUNNING, jnp.where(jnp.isinf(lifts_at), results.SETTLED, results.END_OF_TIME)
    )
    force = state.shear
    if plan.shear:
        until = jnp.where(lifts, now, scene.end)
        # Where the ground jumps, the columns lift before the superstructure feels it.
        digit = jnp.finfo(t.dtype).eps * (jnp.abs(stamp) + 1 / constant(c.p))
        size = _largest_acceleration(scene, state.event_time, until, jnp.where(lifts & jumps, digit, 0.0))
        force = larger(size / c.g, present(state.shear))
    lifted = state._replace(
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
    return lifted, StepInfo(yes, jnp.full_like(t, jnp.nan), Decision(jnp.zeros_like(t), no, no, no, mode))


def _largest_acceleration(scene: Scene, start: Value, end: Value, short: Value) -> Value:
    """Return the largest |ü_g| between two times that move with the parameters, `short` of the second one
    [m/s²].

    It is 0 where nothing is left of the motion. On an end of the interval, or where the motion jumps or has a
    kink, the largest value moves with that time; where the motion turns smoothly, its time does not matter.
    """
    constant, excitation = jax.lax.stop_gradient, scene.excitation
    first, last = constant(start), constant(end) - short
    stays = (last > first) & (first < constant(excitation.support[1]))
    time = jnp.clip(constant(scene.lookahead.highest_time(first, last)), first, last)
    edge = excitation.breakpoint(excitation.before(excitation.locate(time)))
    moves = jnp.where(constant(edge) == time, edge, time)
    moves = jnp.where(time == first, start, jnp.where(time == last, end, moves))
    size = jnp.abs(excitation(time + (moves - constant(moves))))
    return jnp.where(stays, size, 0.0)


def _combine(weights: np.ndarray, values: Float[Array, " n"]) -> list[Value]:
    """`weights @ values`, written out so that it is done lane by lane, and with half the products.

    Nodes are symmetric, so a row of weights is even or odd over them.
    """
    count = values.shape[0]
    pairs = [(values[j], values[count - 1 - j]) for j in range((count + 1) // 2)]
    sums, differences = [a + b for a, b in pairs], [a - b for a, b in pairs]
    if count % 2:
        sums[-1] = pairs[-1][0]  # the node in the middle is its own mirror image
    sums, differences = once((sums, differences))
    combined: list[Value] = []
    for row in weights:
        half = row[: len(pairs)]
        folded = sums if np.allclose(row, row[::-1]) else differences
        combined.append(
            sum((float(w) * y for w, y in zip(half, folded, strict=True)), jnp.zeros_like(values[0]))
        )
    return combined


def _padded(coefficients: list[Value]) -> Values:
    """A row for each power, as many as a particular solution has."""
    return jnp.stack([*coefficients, *[jnp.zeros_like(coefficients[0])] * (_TERMS - len(coefficients))])


def _weighted_rows(weights: Values, rows: Values) -> Values:
    """Σ w_i y_i over modes, of each power."""
    return jax.vmap(weighted, in_axes=(None, 0))(weights, rows)


def _size(rows: Values) -> Values:
    """What a polynomial does not exceed on [−1, 1]."""
    return jnp.sum(jnp.abs(rows), axis=0)


def _rate(rows: Values) -> Values:
    """The derivative of a polynomial."""
    powers = np.arange(1.0, _TERMS).reshape(-1, *[1] * (rows.ndim - 1))
    return jnp.concatenate([powers * rows[1:], jnp.zeros_like(rows[:1])])


def _ends(rows: Values) -> tuple[Values, Values]:
    """A polynomial at −1 and at 1."""
    even, odd = once((jnp.sum(rows[::2], axis=0), jnp.sum(rows[1::2], axis=0)))
    return even - odd, even + odd


def _free(zeta: Values, turn: Values) -> tuple[Values, Values, Values, Values]:
    """The free vibration across a panel: (y, y')(1) from (y, y')(−1), with y'' + 2ζΩy' + Ω²y = 0, Ω =
    `turn`."""
    decay = zeta * turn
    damped = turn * jnp.sqrt(jnp.maximum(1 - zeta**2, 1 - _DAMPED**2))
    fall = jnp.exp(-2 * decay)
    cos, sin = fall * jnp.cos(2 * damped), fall * jnp.sin(2 * damped) / damped
    return cos + decay * sin, sin, -(turn**2) * sin, cos - decay * sin


def _particular(force: list[Value], zeta: Values, turn: Values, half: Value) -> Values:
    """The rows y_k of a solution Σ y_k r^k of y'' + 2ζΩy' + Ω²y = −h²Σ f_k r^k on r ∈ [−1, 1].

    For a stiff oscillator the one that follows the ground motion, a polynomial of the same degree, from the
    highest power down; for a soft one the Taylor series from rest at r = 0, from the lowest power up.
    """
    zero = jnp.zeros_like(turn)
    load = [-(half**2) * f for f in force] + [zero] * (_TERMS - len(force))
    stiff = turn > _SERIES
    safe = jnp.where(stiff, turn, 1.0)
    inverse, drag = 1 / safe**2, 2 * zeta * safe
    # Held, or the recursions would be worked out again for everything that uses them.
    following = [zero] * (_TERMS + 2)
    for k in reversed(range(len(force))):
        y = inverse * (load[k] - drag * (k + 1) * following[k + 1] - (k + 2) * (k + 1) * following[k + 2])
        following[k] = once(y)
    slow = jnp.where(stiff, 0.0, turn)
    square, drag = slow**2, 2 * zeta * slow
    series = [zero, zero]
    for k in range(_TERMS - 2):
        series.append(
            once((load[k] - drag * (k + 1) * series[k + 1] - square * series[k]) / ((k + 2) * (k + 1)))
        )
    return jnp.where(stiff[None], jnp.stack(following[:_TERMS]), jnp.stack(series))


def _interpolation(degree: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes on [−1, 1]; values there to powers of r; values to the last Chebyshev coefficients, none where it
    is exact."""
    j = np.arange(degree + 1)
    nodes = -np.cos(np.pi * j / degree)
    chebyshev = np.linalg.inv(np.polynomial.chebyshev.chebvander(nodes, degree))
    powers = np.zeros((degree + 1, degree + 1))
    for k in j:
        powers[: k + 1, k] = np.polynomial.chebyshev.cheb2poly(np.eye(degree + 1)[k])[: k + 1]
    tail = chebyshev[-2:] if degree > 1 else np.zeros((0, degree + 1))
    return nodes, powers @ chebyshev, tail
