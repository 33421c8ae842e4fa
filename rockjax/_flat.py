"""The flat engine: one loop whose body is one step of its lane."""

from __future__ import annotations

from typing import NamedTuple

import equinox.internal as eqxi
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from . import _results as results
from ._model import Value, Vector
from ._scene import Index, Lane, Plan, Scene
from ._step import step


class Nodes(NamedTuple):
    """The accepted steps of a scene: node k holds the state from which the next step starts, after any impact."""

    t: Float[Array, " n"]  # inf where unused
    x: tuple[Float[Array, " n"], ...]
    v: tuple[Float[Array, " n"], ...]
    sigma: Float[Array, " n"]
    piece: Array
    impact_time: Float[Array, " n"]  # NaN unless the node is an impact
    count: Index


def _runs(lane: Lane, max_steps: int) -> Array:
    return (lane.code == results.RUNNING) & (lane.steps + lane.rejected < max_steps)


def _closed(lane: Lane) -> Lane:
    """Out of steps is a result as well."""
    return lane._replace(code=jnp.where(lane.code == results.RUNNING, results.OUT_OF_STEPS, lane.code))


def run(scene: Scene, how: Plan, lane: Lane, max_steps: int, reverse: bool) -> Lane:
    """The lane at its end. `reverse` takes a loop that can be differentiated in reverse, with bounded memory."""
    return _closed(
        eqxi.while_loop(
            lambda lane: _runs(lane, max_steps),
            lambda lane: step(scene, how, lane)[0],
            lane,
            max_steps=max_steps if reverse else None,
            kind="bounded" if reverse else "lax",
        )
    )


def run_with_history(
    scene: Scene, how: Plan, lane: Lane, max_steps: int, capacity: int, reverse: bool
) -> tuple[Lane, Nodes]:
    """The lane at its end, and its accepted steps on the way."""
    unused = jnp.full((capacity,), jnp.inf, lane.t.dtype)

    def written(nodes: Nodes, lane: Lane, at: Index, impact_time: Value) -> Nodes:
        def put(buffer, value):
            return buffer.at[at].set(value, mode="drop")

        def each(buffers: Vector, values: Vector):
            return tuple(put(b, y) for b, y in zip(buffers, values, strict=True))

        return Nodes(
            put(nodes.t, lane.t),
            each(nodes.x, lane.x),
            each(nodes.v, lane.v),
            put(nodes.sigma, lane.sigma),
            put(nodes.piece, lane.piece),
            put(nodes.impact_time, impact_time),
            nodes.count,
        )

    blank = Nodes(
        t=unused,
        x=tuple(jnp.zeros_like(unused) for _ in lane.x),
        v=tuple(jnp.zeros_like(unused) for _ in lane.v),
        sigma=jnp.zeros_like(unused),
        piece=jnp.zeros((capacity,), lane.piece.dtype),
        impact_time=jnp.full_like(unused, jnp.nan),
        count=jnp.ones((), jnp.int32),
    )
    nodes = written(blank, lane, jnp.zeros((), jnp.int32), jnp.full_like(lane.t, jnp.nan))

    def body(carry):
        lane, nodes = carry
        lane, landmark = step(scene, how, lane)
        # A rejected trial is written past the end, that is nowhere.
        at = jnp.where(landmark.accepted, nodes.count, capacity)
        nodes = written(nodes, lane, at, landmark.impact_time)
        nodes = nodes._replace(count=nodes.count + landmark.accepted)
        full = (nodes.count >= capacity) & (lane.code == results.RUNNING)
        return lane._replace(code=jnp.where(full, results.HISTORY_FULL, lane.code)), nodes

    lane, nodes = eqxi.while_loop(
        lambda carry: _runs(carry[0], max_steps),
        body,
        (lane, nodes),
        max_steps=max_steps if reverse else None,
        kind="bounded" if reverse else "lax",
    )
    return _closed(lane), nodes
