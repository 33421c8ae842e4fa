"""Exchange of finished scenes: lanes write their answers and take the next scenes.

The few lanes of a CPU are served one after another, so that only changed rows are copied, and the whole loop
over a chunk compiles to one function of machine code. The thousands of lanes of an accelerator are served in
parallel.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from rockjax._engine.state import LoopState, differentiated_fields
from rockjax._types import Flag

from .chunk import Chunk, Slopes
from .scenes import Numbers

ONE_BY_ONE = 64  # largest number of lanes that are served one after another


class Lanes(NamedTuple):
    """Data that the lanes hold from one chunk to the next."""

    lane: LoopState
    parts: list[Any]  # of `Scene`: leaves that differ between scenes
    held: jax.Array  # number in the batch of the scene that each lane holds, −1 for none
    slopes: Slopes | None = None  # None without sensitivities
    reach: jax.Array | None = None  # of each scene so far; None if not requested


class Done(NamedTuple):
    """Scenes that have ended, in the order of their ends; the first `used` rows are valid."""

    which: jax.Array
    floats: dict[str, jax.Array]
    integers: dict[str, jax.Array]
    used: jax.Array
    trials: jax.Array  # of each lane
    useful: jax.Array  # trials of all lanes that advanced a scene
    left: jax.Array  # lanes that still hold a scene


class Loop(NamedTuple):
    """A chunk on its way through the lanes."""

    lanes: Lanes
    following: jax.Array  # the next place of the chunk to hand out
    done: Done


Answers = tuple[dict[str, jax.Array], dict[str, jax.Array]]  # floats and integers of every lane


def room_for(rows: int, answers: Answers, index_type: Any) -> Done:
    """Return empty storage for the answers of `rows` scenes."""
    floats, integers = jax.tree.map(lambda y: jnp.zeros((rows, *y.shape[1:]), y.dtype), answers)
    none = jnp.zeros((), index_type)
    return Done(jnp.zeros(rows, index_type), floats, integers, used=none, trials=none, useful=none, left=none)


def exchanged(
    chunk: Chunk, numbers: Numbers, loop: Loop, ended: Flag, answers: Answers, refill: bool
) -> Loop:
    """Serve all lanes that have ended or hold no scene.

    - `chunk`, `numbers`: the chunk of scenes, and their numbers in the batch
    - `loop`: state of the loop
    - `ended`: lanes whose scene has ended
    - `answers`: answers of all lanes
    - `refill`: whether lanes take further scenes

    Returns the new state of the loop.
    """
    serve = _one_by_one if ended.size <= ONE_BY_ONE else _together
    return serve(chunk, numbers, loop, ended, answers, refill)


def _one_by_one(
    chunk: Chunk, numbers: Numbers, loop: Loop, ended: Flag, answers: Answers, refill: bool
) -> Loop:
    count = jnp.arange(ended.size, dtype=jnp.int32)

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

    def one(carry: tuple[Loop, Flag]) -> tuple[Loop, Flag]:
        (state, following, done), waits = carry
        k = jnp.min(jnp.where(waits, count, count.size))
        write = lambda stores, values: put(stores, row(values, k), done.used)
        done = _written(done, write, state.held, answers, row(ended, k))
        loads = following < numbers.scenes

        def load(store, differs, current, axis=0):
            new = row(store, jnp.where(loads, following, 0), axis) if differs else store
            return put(current, jnp.where(loads, new, row(current, k, axis)), k, axis)

        held = put(state.held, jnp.where(loads, numbers.of(following), -1), k)
        state = _loaded(chunk, state, load, refill)._replace(held=held)
        return Loop(state, following + loads.astype(following.dtype), done), put(waits, False, k)

    waits = ended | ((loop.lanes.held < 0) & (loop.following < numbers.scenes))
    return jax.lax.while_loop(lambda carry: jnp.any(carry[1]), one, (loop, waits))[0]


def _together(
    chunk: Chunk, numbers: Numbers, loop: Loop, ended: Flag, answers: Answers, refill: bool
) -> Loop:
    state, following, done = loop
    done = _kept(done, ended, state.held, answers)
    free = ended | (state.held < 0)
    place = following + jnp.cumsum(free, dtype=following.dtype) - 1
    loads = free & (place < numbers.scenes)
    local = jnp.where(loads, place, 0)

    def load(store, differs, current, axis=0):
        flag = jnp.expand_dims(loads, [k for k in range(current.ndim) if k != axis])
        new = jnp.take(store, local, axis=axis) if differs else jnp.expand_dims(store, axis)
        return jnp.where(flag, new, current)

    held = jnp.where(loads, numbers.of(place), jnp.where(free, -1, state.held)).astype(state.held.dtype)
    following = jnp.minimum(following + jnp.sum(free, dtype=following.dtype), numbers.scenes)
    return Loop(_loaded(chunk, state, load, refill)._replace(held=held), following, done)


def _loaded(chunk: Chunk, state: Lanes, load, refill: bool) -> Lanes:
    """Return the lanes with their next scenes. `load(stored, differs, current, axis)` returns the new values
    of one array of the lanes, from its values in the chunk and whether they differ between scenes."""

    def over(stores, currents, axis=0):
        return [y if y is None else load(s, True, y, axis) for s, y in zip(stores, currents, strict=True)]

    lane = jax.tree.map(load, chunk.lane, chunk.lane_differs, state.lane)
    state = state._replace(lane=lane, parts=over(chunk.parts, state.parts) if refill else state.parts)
    if state.reach is not None:
        state = state._replace(reach=load(jnp.inf, False, state.reach))
    if state.slopes is None or chunk.slopes is None:
        return state
    # A row for each parameter comes before the lanes.
    beside = lambda store, differs, current: load(store, differs, current, 1)
    differs = differentiated_fields(chunk.lane_differs)
    rows = jax.tree.map(beside, chunk.slopes.lane, differs, state.slopes.lane)
    of_parts = over(chunk.slopes.parts, state.slopes.parts, 1) if refill else state.slopes.parts
    return state._replace(slopes=Slopes(of_parts, rows))


def _kept(done: Done, ended: Flag, which: jax.Array, answers: Answers) -> Done:
    """Append the answers of the lanes whose scenes have ended.

    All lanes are written, those that have ended first; the others are overwritten later, or not used.
    """
    count, number = jnp.arange(ended.size), jnp.cumsum(ended)
    place = jnp.where(ended, number - 1, ended.size)
    first = jnp.zeros_like(count).at[place].set(count, mode="drop")

    def write(stores, values):
        return jax.tree.map(
            lambda store, y: jax.lax.dynamic_update_slice_in_dim(store, y[first], done.used, 0),
            stores,
            values,
        )

    return _written(done, write, which, answers, number[-1])


def _written(done: Done, write, which: jax.Array, answers: Answers, number: jax.Array) -> Done:
    """Store the answers of `number` scenes with `write(stores, values of the lanes)`."""
    floats, integers = answers
    return done._replace(
        which=write(done.which, which),
        floats=write(done.floats, floats),
        integers=write(done.integers, integers),
        used=done.used + number.astype(done.used.dtype),
    )
