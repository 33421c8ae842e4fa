"""Exchange of finished scenes: lanes store answers and load the next scenes.

A lane solves one scene at a time. A chunk is a set of scenes that were prepared together. To serve a lane
means to store the answers (all outputs) of its finished scene, and to load the next scene of the chunk. The
few lanes of a CPU are served one after another. Then only changed rows are copied, and the loop over a chunk
compiles to one function of machine code. The thousands of lanes of an accelerator are served in parallel.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from rockjax._engine.state import LoopState, differentiated_fields
from rockjax._types import Flag

from .chunk import Chunk, LaneDerivatives
from .scenes import SceneIndices

MAX_SERIAL_LANES = 64  # largest number of lanes that are served one after another


class Lanes(NamedTuple):
    """Data that the lanes hold from one chunk to the next. Lanes that take no further scenes hold only the
    indices then, and None in place of the other data."""

    states: LoopState  # states, with a row for each lane
    varying: list[Any]  # leaves of `Scene` that vary between scenes, with a row for each lane
    scene_index: jax.Array  # for each lane, index of its scene in the batch; −1 without a scene
    slopes: LaneDerivatives | None = None  # derivatives; None if no sensitivities are requested
    edge_distance: jax.Array | None = None  # edge distances so far (`edge_distance.py`), if requested


class DoneScenes(NamedTuple):
    """Answers of scenes that have ended, in the order in which they were stored. The first `used` rows are
    valid."""

    scene_index: jax.Array  # indices of the scenes in the batch
    floats: dict[str, jax.Array]  # floating-point answers
    integers: dict[str, jax.Array]  # answers that are integers or flags
    used: jax.Array  # number of scenes that have ended
    trials: jax.Array  # number of trials (trial steps); a trial that all lanes make together counts once
    useful: jax.Array  # number of trials that advanced a scene, summed over all lanes
    running: jax.Array  # number of lanes that still hold a scene


class Loop(NamedTuple):
    """State of the loop over a chunk of scenes."""

    lanes: Lanes
    next_position: jax.Array  # position in the chunk of the next scene to load
    done: DoneScenes


Answers = tuple[dict[str, jax.Array], dict[str, jax.Array]]  # floats and integers of every lane


def empty_storage(rows: int, answers: Answers, index_type: Any) -> DoneScenes:
    """Return empty storage for the answers of `rows` scenes."""
    floats, integers = jax.tree.map(lambda y: jnp.zeros((rows, *y.shape[1:]), y.dtype), answers)
    zero = jnp.zeros((), index_type)
    counters = {"used": zero, "trials": zero, "useful": zero, "running": zero}
    return DoneScenes(jnp.zeros(rows, index_type), floats, integers, **counters)


def exchange_scenes(
    chunk: Chunk, indices: SceneIndices, loop: Loop, ended: Flag, answers: Answers, refill: bool
) -> Loop:
    """Serve all lanes whose scene has ended and, as long as scenes of the chunk remain, lanes without a
    scene.

    - `chunk`, `indices`: the chunk of scenes, and the indices of these scenes in the batch
    - `loop`: state of the loop
    - `ended`: True for lanes whose scene has ended
    - `answers`: answers of all lanes
    - `refill`: True if lanes take further scenes, False if each lane solves only one scene of the chunk

    Returns the new state of the loop.
    """
    serve = _one_by_one if ended.size <= MAX_SERIAL_LANES else _in_parallel
    return serve(chunk, indices, loop, ended, answers, refill)


def _one_by_one(
    chunk: Chunk, indices: SceneIndices, loop: Loop, ended: Flag, answers: Answers, refill: bool
) -> Loop:
    """Serve the lanes one after another; arguments and result as for `exchange_scenes`."""
    lane_indices = jnp.arange(ended.size, dtype=jnp.int32)

    def put(stores, values, at, axis=0):
        """Write values into one row of each store."""
        return jax.tree.map(
            lambda store, y: jax.lax.dynamic_update_index_in_dim(
                store, jnp.asarray(y, store.dtype), at, axis
            ),
            stores,
            values,
        )

    def row(stores, at, axis=0):
        return jax.tree.map(lambda y: jax.lax.dynamic_index_in_dim(y, at, axis, keepdims=False), stores)

    def serve_first(carry: tuple[Loop, Flag]) -> tuple[Loop, Flag]:
        (lanes, next_position, done), waits = carry
        k = jnp.min(jnp.where(waits, lane_indices, ended.size))
        write = lambda stores, values: put(stores, row(values, k), done.used)
        done = _store_answers(done, write, lanes.scene_index, answers, row(ended, k))
        loads = next_position < indices.scenes

        def load(store, differs, current, axis=0):
            new = row(store, jnp.where(loads, next_position, 0), axis) if differs else store
            return put(current, jnp.where(loads, new, row(current, k, axis)), k, axis)

        scene_index = put(lanes.scene_index, jnp.where(loads, indices.at(next_position), -1), k)
        lanes = _load_scenes(chunk, lanes, load, refill)._replace(scene_index=scene_index)
        return Loop(lanes, next_position + loads.astype(next_position.dtype), done), put(waits, False, k)

    waits = ended | ((loop.lanes.scene_index < 0) & (loop.next_position < indices.scenes))
    return jax.lax.while_loop(lambda carry: jnp.any(carry[1]), serve_first, (loop, waits))[0]


def _in_parallel(
    chunk: Chunk, indices: SceneIndices, loop: Loop, ended: Flag, answers: Answers, refill: bool
) -> Loop:
    """Serve all lanes at once; arguments and result as for `exchange_scenes`."""
    lanes, next_position, done = loop
    done = _append_answers(done, ended, lanes.scene_index, answers)
    is_free = ended | (lanes.scene_index < 0)
    position = next_position + jnp.cumsum(is_free, dtype=next_position.dtype) - 1
    loads = is_free & (position < indices.scenes)
    loaded = jnp.where(loads, position, 0)

    def load(store, differs, current, axis=0):
        flag = jnp.expand_dims(loads, [k for k in range(current.ndim) if k != axis])
        new = jnp.take(store, loaded, axis=axis) if differs else jnp.expand_dims(store, axis)
        return jnp.where(flag, new, current)

    scene_index = jnp.where(loads, indices.at(position), jnp.where(is_free, -1, lanes.scene_index)).astype(
        lanes.scene_index.dtype
    )
    next_position = jnp.minimum(next_position + jnp.sum(is_free, dtype=next_position.dtype), indices.scenes)
    return Loop(
        _load_scenes(chunk, lanes, load, refill)._replace(scene_index=scene_index), next_position, done
    )


def _load_scenes(chunk: Chunk, lanes: Lanes, load, refill: bool) -> Lanes:
    """Return the lanes with the next scenes.

    - `chunk`, `lanes`: the chunk of scenes, and the lanes
    - `load`: (stored, differs, current, axis) ↦ new values of one array of the lanes, from its values in the
      chunk (`stored`, with a row for each scene if `differs`) and in the lanes (`current`)
    - `refill`: True if lanes take further scenes
    """

    def load_all(stores, currents, axis=0):
        return [y if y is None else load(s, True, y, axis) for s, y in zip(stores, currents, strict=True)]

    states = jax.tree.map(load, chunk.states, chunk.states_differ, lanes.states)
    varying = load_all(chunk.varying, lanes.varying) if refill else lanes.varying
    lanes = lanes._replace(states=states, varying=varying)
    if lanes.edge_distance is not None:
        lanes = lanes._replace(edge_distance=load(jnp.inf, False, lanes.edge_distance))
    if lanes.slopes is None or chunk.slopes is None:
        return lanes
    # The first axis of derivatives belongs to the parameters, the second to the lanes.
    load_slope = lambda store, differs, current: load(store, differs, current, 1)
    differs = differentiated_fields(chunk.states_differ)
    state_slopes = jax.tree.map(load_slope, chunk.slopes.states, differs, lanes.slopes.states)
    varying_slopes = (
        load_all(chunk.slopes.varying, lanes.slopes.varying, 1) if refill else lanes.slopes.varying
    )
    return lanes._replace(slopes=LaneDerivatives(varying_slopes, state_slopes))


def _append_answers(done: DoneScenes, ended: Flag, scene_index: jax.Array, answers: Answers) -> DoneScenes:
    """Append the answers of the lanes whose scenes have ended.

    A row is written for every lane. The rows of lanes whose scenes have ended come first. The other rows are
    overwritten later, or ignored.
    """
    lane_indices, ended_so_far = jnp.arange(ended.size), jnp.cumsum(ended)
    position = jnp.where(ended, ended_so_far - 1, ended.size)
    ended_first = jnp.zeros_like(lane_indices).at[position].set(lane_indices, mode="drop")

    def write(stores, values):
        return jax.tree.map(
            lambda store, y: jax.lax.dynamic_update_slice_in_dim(store, y[ended_first], done.used, 0),
            stores,
            values,
        )

    return _store_answers(done, write, scene_index, answers, ended_so_far[-1])


def _store_answers(
    done: DoneScenes, write, scene_index: jax.Array, answers: Answers, count: jax.Array
) -> DoneScenes:
    """Store the answers of `count` scenes.

    - `done`: the storage
    - `write`: function (array of the storage, values of the lanes) ↦ new array of the storage
    - `scene_index`, `answers`: indices of the lanes' scenes in the batch, and answers of the lanes
    - `count`: number of scenes
    """
    floats, integers = answers
    return done._replace(
        scene_index=write(done.scene_index, scene_index),
        floats=write(done.floats, floats),
        integers=write(done.integers, integers),
        used=done.used + count.astype(done.used.dtype),
    )
