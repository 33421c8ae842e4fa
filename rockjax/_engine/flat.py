"""The flat engine: a single loop over the trial steps of a scene (one podium under one excitation). A trial
step is a step that may be rejected, or shortened to end on an event.

The loop can store the state after each accepted step as a node. It can also store the decision of each step
(its length and event), from which the same steps can be repeated.
"""

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

# The result of a scene that has used up its steps can be CHATTERING or TOO_STIFF only after at least this
# many trials; otherwise it is OUT_OF_STEPS.
MANY_STEPS = 50_000
# The result is CHATTERING if more than this fraction of the accepted steps end with an impact.
BOUNCING = 0.2
# The result is TOO_STIFF if the duration of the scene times the highest frequency of the superstructure on
# lifted columns exceeds this [rad].
MAX_RADIANS = 50_000


class Nodes(NamedTuple):
    """Accepted steps of a scene. Node k is the state after k steps. If step k ends with an event, node k is
    the state after the event."""

    t: Float[Array, " n"]  # times [s]; inf for unused nodes
    x: tuple[Float[Array, " n ..."], ...]  # positions
    v: tuple[Float[Array, " n ..."], ...]  # velocities
    sigma: Float[Array, " n"]  # contact modes
    piece: Array  # pieces of the excitation
    impact_time: Float[Array, " n"]  # time of the impact that ends the step [s]; NaN for other steps
    event_time: Float[Array, " n"]  # `t` with its derivatives, which `t` itself does not have [s]
    used: Index  # number of appended nodes; may exceed the capacity n


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
        event_time=jnp.full_like(zeros, jnp.inf),
        used=jnp.zeros((), jnp.int32),
    )


def _put(buffers, at: Index, values):
    """Write values into row `at` of the buffers. A row past the end is dropped."""
    return jax.tree.map(lambda b, y: b.at[at].set(y, mode="drop"), buffers, values)


def _append(nodes: Nodes, state: LoopState, impact_time: Value, valid: Array) -> Nodes:
    """Append the state as a node if `valid` is True."""
    row = Nodes(
        state.t, state.x, state.v, state.sigma, state.piece, impact_time, state.event_time, nodes.used
    )
    at = jnp.where(valid, nodes.used, nodes.t.shape[0])
    filled = _put(nodes._replace(used=None), at, row._replace(used=None))
    return filled._replace(used=nodes.used + valid.astype(jnp.int32))


def _first_node(state: LoopState, capacity: int) -> Nodes:
    return _append(blank_nodes(state, capacity), state, jnp.full_like(state.t, jnp.nan), jnp.ones((), bool))


def is_running(state: LoopState, max_steps: int) -> Array:
    """Return whether a scene has no result yet, and has tried fewer than `max_steps` steps."""
    return (state.code == results.RUNNING) & (state.steps + state.rejected < max_steps)


def with_end_code(scene: Scene, state: LoopState) -> LoopState:
    """Return the state with the result CHATTERING, TOO_STIFF or OUT_OF_STEPS if the scene has used up its
    steps. A scene that already has a result keeps it."""
    code = jnp.full_like(state.code, results.OUT_OF_STEPS)
    has_many_steps = state.steps + state.rejected >= MANY_STEPS
    if scene.c.vibration is not None:
        radians = jax.lax.stop_gradient(scene.c.vibration.uplifted_frequency * (scene.end - scene.start))
        code = jnp.where(has_many_steps & (radians > MAX_RADIANS), results.TOO_STIFF, code)
    impacts, steps = (count.astype(state.t.dtype) for count in (state.impacts, state.steps))
    code = jnp.where(has_many_steps & (impacts > BOUNCING * steps), results.CHATTERING, code)
    return state._replace(code=jnp.where(state.code == results.RUNNING, code, state.code))


def run(scene: Scene, plan: Plan, state: LoopState, max_steps: int) -> LoopState:
    """Integrate a scene and return its final state.

    - `scene`: the prepared scene; `plan`: settings that are fixed at compilation, such as the outputs
    - `state`: initial state
    - `max_steps`: limit of accepted and rejected steps together
    """
    state = ready_for_tangents(state)
    state = jax.lax.while_loop(
        lambda state: is_running(state, max_steps), lambda state: step(scene, plan, state)[0], state
    )
    return with_end_code(scene, state)


def run_with_history(
    scene: Scene, plan: Plan, state: LoopState, max_steps: int, capacity: int
) -> tuple[LoopState, Nodes]:
    """Integrate a scene and return its final state and its accepted steps.

    - `scene`: the prepared scene; `plan`: settings that are fixed at compilation, such as the outputs
    - `state`: initial state
    - `max_steps`: limit of accepted and rejected steps together
    - `capacity`: number of nodes that can be stored; a scene with more nodes ends with HISTORY_FULL
    """

    def store(state: LoopState, nodes: Nodes, info: StepInfo) -> tuple[LoopState, Nodes]:
        nodes = _append(nodes, state, info.impact_time, info.accepted)
        full = (nodes.used >= capacity) & (state.code == results.RUNNING)
        return state._replace(code=jnp.where(full, results.HISTORY_FULL, state.code)), nodes

    return _run_and_store(scene, plan, state, max_steps, store, _first_node(state, capacity))


def record_decisions(
    scene: Scene, plan: Plan, state: LoopState, max_steps: int
) -> tuple[LoopState, Decision, Index]:
    """Integrate a scene and return its final state, the decisions of all accepted steps, and their number.

    - `scene`: the prepared scene; `plan`: settings that are fixed at compilation, such as the outputs
    - `state`: initial state
    - `max_steps`: limit of accepted and rejected steps together, and length of the arrays of decisions
    """
    shapes = jax.eval_shape(lambda: step(scene, plan, state)[1].decision)
    decisions = jax.tree.map(lambda y: jnp.zeros((max_steps,), y.dtype), shapes)

    def store(
        state: LoopState, stored: tuple[Decision, Index], info: StepInfo
    ) -> tuple[LoopState, tuple[Decision, Index]]:
        decisions, count = stored
        decisions = _put(decisions, jnp.where(info.accepted, count, max_steps), info.decision)
        return state, (decisions, count + info.accepted.astype(jnp.int32))

    state, (decisions, count) = _run_and_store(
        scene, plan, state, max_steps, store, (decisions, jnp.zeros((), jnp.int32))
    )
    return state, decisions, count


def solve_scene(
    scene: Scene, plan: Plan, state: LoopState, max_steps: int, capacity: int | None, reversible: bool
) -> tuple[LoopState, LoopState, Nodes | None]:
    """Integrate a scene in a loop that reverse mode can differentiate (`reversible`), or in a plain loop.

    - `scene`, `plan`, `state`, `max_steps`: as in `run`
    - `capacity`: number of nodes to store; None stores none. A scene with more nodes ends with HISTORY_FULL
    - `reversible`: True to integrate twice: first to record the decisions, then to repeat the recorded steps
      in a loop that reverse mode can differentiate

    Returns two final states, and the nodes or None. Read floats from the first state, and integers and flags
    from the second. Unless `reversible`, both are the same state.
    """
    if not reversible:
        if capacity is None:
            final, nodes = run(scene, plan, state, max_steps), None
        else:
            final, nodes = run_with_history(scene, plan, state, max_steps, capacity)
        return final, final, nodes
    constant = jax.lax.stop_gradient
    state = state._replace(may_skip=None)  # no sample is skipped, so every step has a decision
    final, decisions, count = record_decisions(constant(scene), plan, constant(state), max_steps)
    state, nodes = replay(scene, plan, state, decisions, count, capacity)
    if nodes is not None and capacity is not None:
        final = final._replace(code=jnp.where(nodes.used > capacity, results.HISTORY_FULL, final.code))
    return state, final, nodes


def _run_and_store(scene: Scene, plan: Plan, state: LoopState, max_steps: int, store, stored):
    """Integrate a scene and store data of every accepted step.

    - `scene`, `plan`, `state`, `max_steps`: as in `run`
    - `store`: (state, stored, info) ↦ (state, stored), called after every trial
    - `stored`: storage at the start

    Returns the final state and the storage. Under `vmap` each scene is a lane of one loop. All lanes leave
    the loop together, and a lane whose scene has ended stores nothing more. This common condition saves time:
    an iteration writes one row of the storage of each lane, whereas JAX would copy all rows if each lane had
    its own condition.
    """

    def body(carry):
        state, stored = carry
        goes_on = is_running(state, max_steps)
        after, info = step(scene, plan, state)
        after, stored = store(after, stored, info._replace(accepted=info.accepted & goes_on))
        return jax.tree.map(lambda new, old: jnp.where(goes_on, new, old), after, state), stored

    state, stored = jax.lax.while_loop(
        lambda carry: eqxi.unvmap_any(is_running(carry[0], max_steps)), body, (state, stored)
    )
    return with_end_code(scene, state), stored


def replay(
    scene: Scene, plan: Plan, state: LoopState, decisions: Decision, count: Index, capacity: int | None
) -> tuple[LoopState, Nodes | None]:
    """Repeat a scene from recorded decisions, in a loop that reverse mode can differentiate with bounded
    memory.

    - `scene`: the prepared scene; `plan`: settings that are fixed at compilation, such as the outputs
    - `state`: initial state
    - `decisions`, `count`: recorded decisions, arrays of length `max_steps`, and their number
    - `capacity`: number of nodes to store; None stores none

    Returns the final state, and the nodes or None. Reverse mode computes every step a second time, from
    checkpoints. The two computations round differently, so without recorded decisions a step might be
    accepted in the first and rejected in the second. States and cotangents would then belong to different
    times.

    Checkpoints have two levels: one before each block of about √`max_steps` steps, and one before each step
    of the block that is being computed again. A checkpoint contains only the state. More levels or more data
    would double the compilation time.
    """
    initial = state

    @functools.partial(jax.checkpoint, prevent_cse=False)
    def body(carry):
        state, nodes, k = carry
        # Under `vmap` finished lanes continue until the last lane has ended. Their results are dropped, but
        # an infinite derivative would become NaN even if multiplied by zero. Finished lanes therefore repeat
        # their first step. A lane without any step has no recorded length and uses `max_step`.
        goes_on = k < count
        state = jax.tree.map(lambda now, at_start: jnp.where(goes_on, now, at_start), state, initial)
        replayed = jax.tree.map(lambda y: y[jnp.where(goes_on, k, 0)], decisions)
        replayed = replayed._replace(h=jnp.where(count > 0, replayed.h, scene.max_step))
        state, info = step(scene, plan, state, replayed)
        if nodes is not None:
            nodes = _append(nodes, state, info.impact_time, info.accepted)
        return state, nodes, k + 1

    start = (state, None if capacity is None else _first_node(state, capacity), jnp.zeros((), jnp.int32))
    max_steps = decisions.h.shape[0]
    base = math.isqrt(max_steps) + 2  # base² > max_steps, so that two levels suffice
    state, nodes, _ = eqxi.while_loop(
        lambda carry: carry[2] < count, body, start, max_steps=max_steps, kind="bounded", base=base
    )
    return state, nodes
