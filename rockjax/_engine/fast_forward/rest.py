"""Fast-forward through full contact of a rigid podium (with a rigid superstructure or none).

Relative to the ground, nothing moves until the uplift demand exceeds its threshold again. At this time the
columns lift. docs/model.md defines demand and threshold, Eq. (9).
"""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp

from rockjax import _results as results
from rockjax._engine.model import uplift_demand
from rockjax._engine.ratio import safe_ratio
from rockjax._engine.state import Decision, LoopState, Plan, Scene, StepInfo
from rockjax._engine.transitions import restart
from rockjax._outputs.views import Rest
from rockjax._types import Index


@functools.partial(jax.jit, static_argnames="plan")
def advance_to_uplift(scene: Scene, plan: Plan, state: LoopState) -> tuple[LoopState, StepInfo]:
    """Advance a rigid podium in full contact to its next uplift.

    Returns the state after the uplift and the `StepInfo`. If the columns do not lift before the end of the
    scene, the scene ends: at once if the demand never exceeds the threshold again, otherwise at its end time.
    """
    constant = jax.lax.stop_gradient
    c, t, excitation = scene.c, state.t, scene.excitation
    lifts_at = constant(scene.lookahead.next_exceedance(t, state.piece))
    end = constant(scene.end)
    lifts = lifts_at < end
    # `stamp` is the time of the uplift, or the time at which the scene ends, without derivatives; `now` below
    # is the same time with derivatives.
    stamp = jnp.where(lifts, lifts_at, jnp.where(jnp.isinf(lifts_at), t, end))
    piece = jnp.where(lifts, excitation.locate(stamp), state.piece)

    def demand_on(piece: Index):
        ground_at = excitation.piece(piece)
        return lambda t: uplift_demand(c, ground_at(t), state.x, state.v)

    side = constant(-jnp.sign(demand_on(piece)(stamp)))
    # Uplift occurs where the demand crosses the threshold, or at a breakpoint where the demand jumps above
    # the threshold. The time of the uplift has the derivatives of the crossing or of the breakpoint. If the
    # demand crosses the threshold at a breakpoint without a jump, these derivatives follow from the piece
    # before the breakpoint.
    previous_breakpoint = excitation.breakpoint(excitation.before(piece))
    at_breakpoint = constant(previous_breakpoint) == stamp
    jump = demand_on(piece)(stamp) - demand_on(excitation.before(piece))(stamp)
    jumps = at_breakpoint & (jnp.abs(constant(jump)) > 1e-9 * constant(c.uplift))
    demand_at = demand_on(excitation.before(piece, (at_breakpoint & ~jumps).astype(jnp.int32)))
    demand, slope = jax.jvp(demand_at, (stamp,), (jnp.ones_like(stamp),))
    newton_correction = safe_ratio(-side * demand - c.uplift, -side * slope, lifts & ~jumps)
    now = jnp.where(jumps, previous_breakpoint, stamp - (newton_correction - constant(newton_correction)))
    now = jnp.where(lifts, now, stamp)
    mode = jnp.where(lifts, side, 0.0)
    x, v = restart(scene, stamp, now - constant(now), state.x, state.v, mode, piece)
    code = jnp.where(
        lifts, results.RUNNING, jnp.where(jnp.isinf(lifts_at), results.SETTLED, results.END_OF_TIME)
    )
    until = jnp.where(lifts, now, scene.end)
    # If the ground acceleration jumps at the uplift, outputs over the rest must not include its value after
    # the jump.
    rounding = jnp.finfo(t.dtype).eps * (jnp.abs(stamp) + 1 / constant(c.p))
    rest = Rest(scene, state.event_time, until, jnp.where(lifts & jumps, rounding, 0.0))
    accumulators = tuple(
        output.over_rest(rest, accumulator)
        for output, accumulator in zip(plan.outputs, state.accumulators, strict=True)
    )
    lifted = state._replace(
        t=stamp,
        event_time=now,
        x=x,
        v=v,
        sigma=mode,
        piece=piece.astype(jnp.int32),
        accumulators=accumulators,
        code=code.astype(jnp.int32),
        uplifted=state.uplifted | lifts,
        uplift_time=jnp.where(lifts & ~state.uplifted, now, state.uplift_time),
        steps=state.steps + 1,
    )
    false, true = jnp.zeros((), bool), jnp.ones((), bool)
    decision = Decision(jnp.zeros_like(t), false, false, false, mode)
    return lifted, StepInfo(true, jnp.full_like(t, jnp.nan), decision)
