"""The flat engine: one loop whose body is one step of its lane."""

from __future__ import annotations

from typing import NamedTuple

import equinox.internal as eqxi
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from rockjax import _results as results
from rockjax._types import Index, Value

from .contact import glide
from .scene import Lane, Plan, Scene
from .step import Decision, Landmark, step


class Nodes(NamedTuple):
    """The accepted steps of a scene: node k holds the state from which the next step starts, after any impact."""

    t: Float[Array, " n"]  # inf where unused
    x: tuple[Float[Array, " n"], ...]
    v: tuple[Float[Array, " n"], ...]
    sigma: Float[Array, " n"]
    piece: Array
    impact_time: Float[Array, " n"]  # NaN unless the node is an impact
    used: Index


def blank_nodes(lane: Lane, capacity: int) -> Nodes:
    """Room for `capacity` nodes, none of them used."""
    zeros = jnp.zeros((capacity,), lane.t.dtype)
    return Nodes(
        t=jnp.full_like(zeros, jnp.inf),
        x=tuple(zeros for _ in lane.x),
        v=tuple(zeros for _ in lane.v),
        sigma=zeros,
        piece=jnp.zeros((capacity,), lane.piece.dtype),
        impact_time=jnp.full_like(zeros, jnp.nan),
        used=jnp.zeros((), jnp.int32),
    )


def _put(buffers, at: Index, values):
    """Write values into row `at` of the buffers; past the end, nowhere."""
    return jax.tree.map(lambda b, y: b.at[at].set(y, mode="drop"), buffers, values)


def _append(nodes: Nodes, lane: Lane, impact_time: Value, valid: Array) -> Nodes:
    row = Nodes(lane.t, lane.x, lane.v, lane.sigma, lane.piece, impact_time, nodes.used)
    at = jnp.where(valid, nodes.used, nodes.t.shape[0])
    filled = _put(nodes._replace(used=None), at, row._replace(used=None))
    return filled._replace(used=nodes.used + valid)


def _first_node(lane: Lane, capacity: int) -> Nodes:
    return _append(blank_nodes(lane, capacity), lane, jnp.full_like(lane.t, jnp.nan), jnp.ones((), bool))


def runs(lane: Lane, max_steps: int) -> Array:
    """Whether a scene goes on."""
    return (lane.code == results.RUNNING) & (lane.steps + lane.rejected < max_steps)


def closed(lane: Lane) -> Lane:
    """Out of steps is a result as well."""
    return lane._replace(code=jnp.where(lane.code == results.RUNNING, results.OUT_OF_STEPS, lane.code))


def run(scene: Scene, how: Plan, lane: Lane, max_steps: int) -> Lane:
    """The lane at its end."""
    lane = glide(scene, how, lane)
    return closed(jax.lax.while_loop(lambda lane: runs(lane, max_steps), lambda lane: step(scene, how, lane)[0], lane))


def run_with_history(scene: Scene, how: Plan, lane: Lane, max_steps: int, capacity: int) -> tuple[Lane, Nodes]:
    """The lane at its end, and its accepted steps on the way."""

    def keep(lane: Lane, nodes: Nodes, landmark: Landmark) -> tuple[Lane, Nodes]:
        nodes = _append(nodes, lane, landmark.impact_time, landmark.accepted)
        full = (nodes.used >= capacity) & (lane.code == results.RUNNING)
        return lane._replace(code=jnp.where(full, results.HISTORY_FULL, lane.code)), nodes

    return _keeping(scene, how, lane, max_steps, keep, _first_node(lane, capacity))


def rehearse(scene: Scene, how: Plan, lane: Lane, max_steps: int) -> tuple[Lane, Decision, Index]:
    """The lane at its end, the decisions of every accepted step, and their number."""
    like = jax.eval_shape(lambda: step(scene, how, lane)[1].decision)
    decisions = jax.tree.map(lambda y: jnp.zeros((max_steps,), y.dtype), like)

    def keep(lane: Lane, kept: tuple[Decision, Index], landmark: Landmark) -> tuple[Lane, tuple[Decision, Index]]:
        decisions, count = kept
        decisions = _put(decisions, jnp.where(landmark.accepted, count, max_steps), landmark.decision)
        return lane, (decisions, count + landmark.accepted)

    lane, (decisions, count) = _keeping(scene, how, lane, max_steps, keep, (decisions, jnp.zeros((), jnp.int32)))
    return lane, decisions, count


def _keeping(scene: Scene, how: Plan, lane: Lane, max_steps: int, keep, kept):
    """The lane at its end, and what `keep(lane, kept, landmark)` has kept of every step.

    Lanes that have ended keep nothing any more. Were each lane to decide for itself when the loop ends, JAX would choose
    between old and new buffers as a whole in every step of a vmapped loop, where only a row of them is written.
    """

    def body(carry):
        lane, kept = carry
        goes_on = runs(lane, max_steps)
        after, landmark = step(scene, how, lane)
        after, kept = keep(after, kept, landmark._replace(accepted=landmark.accepted & goes_on))
        return jax.tree.map(lambda new, old: jnp.where(goes_on, new, old), after, lane), kept

    lane, kept = jax.lax.while_loop(lambda carry: eqxi.unvmap_any(runs(carry[0], max_steps)), body, (lane, kept))
    return closed(lane), kept


def replay(
    scene: Scene, how: Plan, lane: Lane, decisions: Decision, count: Index, capacity: int | None
) -> tuple[Lane, Nodes | None]:
    """The lane at its end through known decisions, in a loop that reverse mode can walk with bounded memory.

    Reverse mode computes steps again from checkpoints. Rounding differs from one compilation of a step to another, and
    a step rejected the second time only would leave states and cotangents at different times: hence the rehearsal.
    """

    def body(carry):
        lane, nodes, k = carry
        told = jax.tree.map(lambda y: y[k], decisions)
        lane, landmark = step(scene, how, lane, told)
        if nodes is not None:
            nodes = _append(nodes, lane, landmark.impact_time, landmark.accepted)
        return lane, nodes, k + 1

    start = (lane, None if capacity is None else _first_node(lane, capacity), jnp.zeros((), jnp.int32))
    max_steps = decisions.h.shape[0]
    lane, nodes, _ = eqxi.while_loop(lambda carry: carry[2] < count, body, start, max_steps=max_steps, kind="bounded")
    return lane, nodes
