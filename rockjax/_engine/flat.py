"""The flat engine: one loop whose body is one step of its scene."""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import equinox.internal as eqxi
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from rockjax import _results as results
from rockjax._types import Index, Value

from .state import Decision, LoopState, Plan, Scene, StepInfo, ready_for_tangents
from .step import step

MANY_STEPS = 50_000  # trials; only beyond this number is a cause searched for
BOUNCING = 0.2  # fraction of steps that end with an impact, above which the columns only bounce
MANY_RADIANS = 50_000  # of a superstructure's vibration on lifted columns, above which it counts as too stiff


class Nodes(NamedTuple):
    """Accepted steps of a scene: node k holds the state from which the next step starts, after any impact."""

    t: Float[Array, " n"]  # inf where unused
    x: tuple[Float[Array, " n ..."], ...]
    v: tuple[Float[Array, " n ..."], ...]
    sigma: Float[Array, " n"]
    piece: Array
    impact_time: Float[Array, " n"]  # NaN unless the node is an impact
    used: Index


def blank_nodes(state: LoopState, capacity: int) -> Nodes:
    """Return empty storage for `capacity` nodes."""
    zeros = jnp.zeros((capacity,), state.t.dtype)
    return Nodes(
        t=jnp.full_like(zeros, jnp.inf),
        x=tuple(jnp.zeros((capacity, *y.shape), y.dtype) if y.ndim else zeros for y in state.x),
        v=tuple(jnp.zeros((capacity, *y.shape), y.dtype) if y.ndim else zeros for y in state.v),
        sigma=zeros,
        piece=jnp.zeros((capacity,), state.piece.dtype),
        impact_time=jnp.full_like(zeros, jnp.nan),
        used=jnp.zeros((), jnp.int32),
    )


def _put(buffers, at: Index, values):
    """Write values into row `at` of the buffers; indices past the end are dropped."""
    return jax.tree.map(lambda b, y: b.at[at].set(y, mode="drop"), buffers, values)


def _append(nodes: Nodes, state: LoopState, impact_time: Value, valid: Array) -> Nodes:
    row = Nodes(state.t, state.x, state.v, state.sigma, state.piece, impact_time, nodes.used)
    at = jnp.where(valid, nodes.used, nodes.t.shape[0])
    filled = _put(nodes._replace(used=None), at, row._replace(used=None))
    return filled._replace(used=nodes.used + valid.astype(jnp.int32))


def _first_node(state: LoopState, capacity: int) -> Nodes:
    return _append(blank_nodes(state, capacity), state, jnp.full_like(state.t, jnp.nan), jnp.ones((), bool))


def runs(state: LoopState, max_steps: int) -> Array:
    """Return whether a scene is still running."""
    return (state.code == results.RUNNING) & (state.steps + state.rejected < max_steps)


def closed(scene: Scene, state: LoopState) -> LoopState:
    """Give a scene that has used up its steps a result, which names the cause if one of two known causes
    applies."""
    cause = jnp.full_like(state.code, results.OUT_OF_STEPS)
    many = state.steps + state.rejected >= MANY_STEPS
    if scene.c.vibration is not None:
        radians = jax.lax.stop_gradient(scene.c.vibration.uplifted_frequency * (scene.end - scene.start))
        cause = jnp.where(many & (radians > MANY_RADIANS), results.TOO_STIFF, cause)
    impacts, steps = (count.astype(state.t.dtype) for count in (state.impacts, state.steps))
    cause = jnp.where(many & (impacts > BOUNCING * steps), results.CHATTERING, cause)
    return state._replace(code=jnp.where(state.code == results.RUNNING, cause, state.code))


def run(scene: Scene, plan: Plan, state: LoopState, max_steps: int) -> LoopState:
    """Integrate a scene and return its final state.

    - `scene`, `plan`: the prepared scene and its static choices
    - `state`: initial state
    - `max_steps`: limit of accepted and rejected steps together
    """
    state = ready_for_tangents(state)
    state = jax.lax.while_loop(
        lambda state: runs(state, max_steps), lambda state: step(scene, plan, state)[0], state
    )
    return closed(scene, state)


def run_with_history(
    scene: Scene, plan: Plan, state: LoopState, max_steps: int, capacity: int
) -> tuple[LoopState, Nodes]:
    """Integrate a scene and return its final state and its accepted steps.

    - `scene`, `plan`: the prepared scene and its static choices
    - `state`: initial state
    - `max_steps`: limit of accepted and rejected steps together
    - `capacity`: number of nodes that can be stored; a scene with more ends with HISTORY_FULL
    """

    def keep(state: LoopState, nodes: Nodes, info: StepInfo) -> tuple[LoopState, Nodes]:
        nodes = _append(nodes, state, info.impact_time, info.accepted)
        full = (nodes.used >= capacity) & (state.code == results.RUNNING)
        return state._replace(code=jnp.where(full, results.HISTORY_FULL, state.code)), nodes

    return _keeping(scene, plan, state, max_steps, keep, _first_node(state, capacity))


def record_decisions(
    scene: Scene, plan: Plan, state: LoopState, max_steps: int
) -> tuple[LoopState, Decision, Index]:
    """Integrate a scene and return its final state, the decisions of all accepted steps, and their number.

    - `scene`, `plan`: the prepared scene and its static choices
    - `state`: initial state
    - `max_steps`: limit of accepted and rejected steps together, and length of the arrays of decisions
    """
    like = jax.eval_shape(lambda: step(scene, plan, state)[1].decision)
    decisions = jax.tree.map(lambda y: jnp.zeros((max_steps,), y.dtype), like)

    def keep(
        state: LoopState, stored: tuple[Decision, Index], info: StepInfo
    ) -> tuple[LoopState, tuple[Decision, Index]]:
        decisions, count = stored
        decisions = _put(decisions, jnp.where(info.accepted, count, max_steps), info.decision)
        return state, (decisions, count + info.accepted.astype(jnp.int32))

    state, (decisions, count) = _keeping(
        scene, plan, state, max_steps, keep, (decisions, jnp.zeros((), jnp.int32))
    )
    return state, decisions, count


def _keeping(scene: Scene, plan: Plan, state: LoopState, max_steps: int, keep, stored):
    """Integrate a scene and return its final state, and the data that `keep(state, stored, info)` stores for
    every step.

    Lanes that have ended store nothing more. If each lane decided for itself when the loop ends, JAX would
    select between old and new buffers as a whole in every step of a vmapped loop, although only one row is
    written.
    """

    def body(carry):
        state, stored = carry
        goes_on = runs(state, max_steps)
        after, info = step(scene, plan, state)
        after, stored = keep(after, stored, info._replace(accepted=info.accepted & goes_on))
        return jax.tree.map(lambda new, old: jnp.where(goes_on, new, old), after, state), stored

    state, stored = jax.lax.while_loop(
        lambda carry: eqxi.unvmap_any(runs(carry[0], max_steps)), body, (state, stored)
    )
    return closed(scene, state), stored


def replay(
    scene: Scene, plan: Plan, state: LoopState, decisions: Decision, count: Index, capacity: int | None
) -> tuple[LoopState, Nodes | None]:
    """Repeat a scene through recorded decisions, in a loop that reverse mode can differentiate with bounded
    memory.

    - `scene`, `plan`: the prepared scene and its static choices
    - `state`: initial state
    - `decisions`, `count`: recorded decisions in rows of length `max_steps`, and their number
    - `capacity`: number of nodes to store, None for none

    Returns the final state, and the nodes or None. Reverse mode computes steps again from checkpoints.
    Rounding differs between compilations of a step, and a step rejected only the second time would leave
    states and cotangents at different times; therefore the decisions are recorded beforehand.

    Checkpoints have two levels, √`max_steps` apart, and only the state before each step is stored: more
    levels or more data per step would double the compilation time.
    """
    first = state

    @functools.partial(jax.checkpoint, prevent_cse=False)
    def body(carry):
        state, nodes, k = carry
        # Under `vmap` finished lanes go on until the last has ended. Their results are dropped, but zero
        # times an infinite derivative is NaN: they repeat their first step. A lane that never made a step
        # has a decision of zeros; its length must not be zero.
        goes_on = k < count
        state = jax.tree.map(lambda now, at_first: jnp.where(goes_on, now, at_first), state, first)
        replayed = jax.tree.map(lambda y: y[jnp.where(goes_on, k, 0)], decisions)
        replayed = replayed._replace(h=jnp.where(count > 0, replayed.h, scene.max_step))
        state, info = step(scene, plan, state, replayed)
        if nodes is not None:
            nodes = _append(nodes, state, info.impact_time, info.accepted)
        return state, nodes, k + 1

    start = (state, None if capacity is None else _first_node(state, capacity), jnp.zeros((), jnp.int32))
    max_steps = decisions.h.shape[0]
    base = math.isqrt(max_steps) + 2  # its square is more than max_steps
    state, nodes, _ = eqxi.while_loop(
        lambda carry: carry[2] < count, body, start, max_steps=max_steps, kind="bounded", base=base
    )
    return state, nodes
