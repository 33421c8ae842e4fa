"""Lanes that step side by side: those whose scene has ended write it out and take the next one.

One call of `advance` goes through one chunk of scenes on one core or device. Between calls its lanes keep the
scenes that are still running. Inside, they make trials through the same per-lane step as everywhere else;
every few of them the lanes that wait are served together.
"""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_batching import custom_vmap

from rockjax import _results as results
from rockjax._engine.contact import advance_to_uplift, cross_full_contact
from rockjax._engine.flat import closed, runs
from rockjax._engine.scene import plan_for, prepare
from rockjax._engine.solve import answers
from rockjax._engine.state import LoopState, Plan, Scene
from rockjax._engine.step import trial
from rockjax._options import Options
from rockjax._programs.program import remembered
from rockjax._types import Flag

PATIENCE = 5 / 64  # the share of the lanes that may wait before they are served


class LaneLayout(NamedTuple):
    """What a program is made for, besides the options."""

    axes: tuple[int | None, ...]  # of the leaves of a chunk: 0 where there is a row for each scene
    structure: Any  # of (podium, excitation, initial, t_end)
    lanes: int
    size: int  # scenes of a chunk, a multiple of the lanes
    # Lanes take further scenes; else a chunk is a scene for each lane, and all of them end with it.
    refill: bool


class Lanes(NamedTuple):
    """What the lanes hold from one chunk to the next."""

    lane: LoopState
    parts: list[Any]  # of `Scene`: what differs between scenes
    held: jax.Array  # which scene of the batch each lane holds, −1 where none


class Done(NamedTuple):
    """Scenes that have ended, in the order of their ends; so many of the rows are used."""

    which: jax.Array
    floats: dict[str, jax.Array]
    integers: dict[str, jax.Array]
    used: jax.Array
    trials: jax.Array  # of each lane
    useful: jax.Array  # of all lanes, those that moved a scene on


def _room_for(rows: int, answers: Any, index_type: Any) -> Done:
    """Room for the answers of so many scenes, of which none has ended."""
    floats, integers = jax.tree.map(lambda y: jnp.zeros((rows, *y.shape[1:]), y.dtype), answers)
    none = jnp.zeros((), index_type)
    return Done(jnp.zeros(rows, index_type), floats, integers, used=none, trials=none, useful=none)


class _Loop(NamedTuple):
    lanes: Lanes
    following: jax.Array  # the next scene of the chunk to hand out
    done: Done


def advance(
    held: Lanes, leaves, first, stride, count, options: Options, layout: LaneLayout
) -> tuple[Lanes, Done]:
    """Go on until the last scene of a chunk is handed out; with none in it, until every lane is at its end.

    The chunk holds `count` scenes of the batch, numbers `first`, `first + stride`, …
    """
    lanes, size, refill = layout.lanes, layout.size, layout.refill
    plan = plan_for(jax.tree.unflatten(layout.structure, leaves)[0], options, history=False)
    chunk = _crossed(_prepared(leaves, layout, options), plan, lanes, count)
    moves, settle = _automaton(plan, options)
    patience = max(1, round(PATIENCE * lanes))

    def over_lanes(function, *arguments):
        return jax.vmap(lambda parts, *rest: function(chunk.scene(parts), *rest))(*arguments)

    index_type = held.held.dtype
    if not refill:
        index = jnp.arange(lanes, dtype=index_type)
        number = jnp.where(index < count, first + stride * index, -1)
        held = Lanes(chunk.starts(lanes), [y[:lanes] for y in chunk.parts], number)

    def exchange(loop: _Loop) -> _Loop:
        state, done = loop.lanes, loop.done
        lane = over_lanes(settle, state.parts, state.lane)
        ended = (state.held >= 0) & ~runs(lane, options.max_steps)
        floats, integers = over_lanes(
            lambda scene, lane: answers(scene, plan, closed(scene, lane)), state.parts, lane
        )
        done = _kept(done, ended, state.held, floats, integers)
        free = ended | (state.held < 0)
        local = loop.following + jnp.cumsum(free, dtype=index_type) - 1
        loads = free & (local < count)
        place = jnp.clip(local, 0, size - 1)

        def load(store, differs, current):
            flag = loads.reshape((-1,) + (1,) * (current.ndim - 1))
            return jnp.where(flag, store[place] if differs else store, current)

        state = Lanes(
            jax.tree.map(load, chunk.lane, chunk.lane_differs, lane),
            [load(y, True, now) for y, now in zip(chunk.parts, state.parts, strict=True)]
            if refill
            else state.parts,
            jnp.where(loads, first + stride * local, jnp.where(free, -1, state.held)).astype(index_type),
        )
        return _Loop(state, jnp.minimum(loop.following + jnp.sum(free, dtype=index_type), count), done)

    def waiting(loop: _Loop) -> jax.Array:
        """How many lanes an exchange would help."""
        more = (loop.lanes.held >= 0) | (loop.following < count)
        return jnp.sum(~_moves(plan, options, loop.lanes.lane) & more)

    def busy(loop: _Loop) -> Flag:
        """An exchange costs about a trial: worth it for a few lanes, or when nothing else goes on."""
        return (waiting(loop) < patience) & jnp.any(_moves(plan, options, loop.lanes.lane))

    def body(loop: _Loop) -> _Loop:
        loop = exchange(loop)

        def trials(loop: _Loop) -> _Loop:
            lane, done = loop.lanes.lane, loop.done
            useful = done.useful + jnp.sum(_moves(plan, options, lane))
            lane = over_lanes(moves, loop.lanes.parts, lane)
            return loop._replace(
                lanes=loop.lanes._replace(lane=lane),
                done=done._replace(trials=done.trials + 1, useful=useful),
            )

        return jax.lax.while_loop(busy, trials, loop)

    blank = jax.eval_shape(
        functools.partial(over_lanes, lambda scene, lane: answers(scene, plan, lane)), held.parts, held.lane
    )
    done = _room_for(size + lanes, blank, index_type)
    start = jnp.where(refill, 0, jnp.minimum(count, lanes)).astype(index_type)
    drains = (count == 0) | (not refill)
    loop = jax.lax.while_loop(
        lambda loop: (loop.following < count) | (drains & jnp.any(loop.lanes.held >= 0)),
        body,
        _Loop(held, start, done),
    )
    return loop.lanes, loop.done


def _kept(done: Done, ended: Flag, which: jax.Array, floats, integers) -> Done:
    """The answers of the lanes whose scenes have ended, written after those that are kept already."""
    nowhere = done.which.shape[0]
    place = jnp.where(ended, done.used + jnp.cumsum(ended, dtype=done.used.dtype) - 1, nowhere)

    def write(stores, values):
        return jax.tree.map(lambda s, y: s.at[place].set(y, mode="drop"), stores, values)

    return done._replace(
        which=write(done.which, which),
        floats=write(done.floats, floats),
        integers=write(done.integers, integers),
        used=done.used + jnp.sum(ended, dtype=done.used.dtype),
    )


def _moves(plan: Plan, options: Options, lane: LoopState) -> Flag:
    """Whether a lane has trials to make; with nothing elastic, full contact is left at once, at the next
    exchange."""
    going = runs(lane, options.max_steps)
    return going if plan.elastic else going & (lane.sigma != 0)


def _automaton(plan: Plan, options: Options):
    """One trial of a lane that moves; and what a lane in full contact does before it can: go to its next
    uplift at once."""

    def moves(scene: Scene, lane: LoopState) -> LoopState:
        going = _moves(plan, options, lane)
        after, _ = trial(scene, plan, lane)
        return jax.tree.map(lambda new, old: jnp.where(going, new, old), after, lane)

    def settle(scene: Scene, lane: LoopState) -> LoopState:
        if plan.elastic:
            return lane
        waits = (lane.sigma == 0) & runs(lane, options.max_steps)
        lifted, _ = advance_to_uplift(scene, plan, lane)
        return jax.tree.map(lambda new, old: jnp.where(waits, new, old), lifted, lane)

    return moves, settle


class _Chunk(NamedTuple):
    """Scenes made ready: what differs between them has a row for each, what is common to all is there
    once."""

    parts: list[Any]  # of `Scene`: what differs
    common: list[Any]  # of `Scene`: what does not, None where it does
    structure: Any
    lane: LoopState  # at the start
    lane_differs: Any

    def scene(self, parts) -> Scene:
        parts = iter(parts)
        return jax.tree.unflatten(self.structure, [next(parts) if y is None else y for y in self.common])

    def starts(self, lanes: int) -> LoopState:
        def start(y, differs):
            return y[:lanes] if differs else jnp.broadcast_to(y, (lanes, *y.shape))

        return jax.tree.map(start, self.lane, self.lane_differs)


def _prepared(leaves, layout: LaneLayout, options: Options) -> _Chunk:
    axes, structure = layout.axes, layout.structure
    plan = plan_for(jax.tree.unflatten(structure, leaves)[0], options, history=False)
    _, settle = _automaton(plan, options)

    def ready(*leaves) -> tuple[Scene, LoopState]:
        podium, excitation, initial, t_end = jax.tree.unflatten(structure, leaves)
        scene, lane = prepare(podium, excitation, initial, t_end, options, plan)
        return scene, settle(scene, lane)

    differs = _differing(ready, axes, leaves)
    out_axes = jax.tree.map(lambda flag: 0 if flag else None, differs)
    scenes, lane = jax.vmap(ready, in_axes=axes, out_axes=out_axes)(*leaves)
    flat, scene_structure = jax.tree.flatten(scenes)
    own = jax.tree.leaves(differs[0])
    parts = [y for y, flag in zip(flat, own, strict=True) if flag]
    common = [None if flag else y for y, flag in zip(flat, own, strict=True)]
    return _Chunk(parts, common, scene_structure, lane, differs[1])


# What changes of a lane that crosses panels.
_CROSSED = ("t", "event_time", "x", "v", "piece", "code", "steps")


def _crossed(chunk: _Chunk, plan: Plan, lanes: int, count) -> _Chunk:
    """The lanes of a chunk where they first have to step, worked out in blocks that fit the cache."""
    if not plan.elastic:
        return chunk

    def block(arguments):
        def one(parts, lane: LoopState):
            lane = cross_full_contact(chunk.scene(parts), plan, lane)
            return {name: getattr(lane, name) for name in _CROSSED}

        return jax.vmap(one)(*arguments)

    size = chunk.parts[0].shape[0]
    split = lambda y: y.reshape(size // lanes, lanes, *y.shape[1:])
    starts = chunk.starts(size)
    used = jnp.arange(size) < count  # what fills up the chunk goes nowhere
    starts = starts._replace(code=jnp.where(used, starts.code, results.END_OF_TIME))
    blocks = jax.tree.map(split, (chunk.parts, starts))
    moved = jax.tree.map(lambda y: y.reshape(size, *y.shape[2:]), jax.lax.map(block, blocks))
    differs = chunk.lane_differs._replace(**jax.tree.map(lambda _: True, moved))
    return chunk._replace(lane=chunk.lane._replace(**moved), lane_differs=differs)


def idle(leaves, options: Options, layout: LaneLayout, devices: int) -> Lanes:
    """Lanes that hold nothing, those of several devices one after another; `leaves` are those of one
    chunk."""
    shapes = tuple((y.shape, y.dtype) for y in leaves)
    numbers, plan = jax.tree.flatten(options)
    blank = _blank_lanes(shapes, tuple(jnp.result_type(y) for y in numbers), plan, layout)
    none: Lanes = jax.tree.map(lambda y: np.zeros((devices * y.shape[0], *y.shape[1:]), y.dtype), blank)
    code = np.full_like(none.lane.code, results.END_OF_TIME)
    return none._replace(lane=none.lane._replace(code=code), held=np.full_like(none.held, -1))


@functools.lru_cache(maxsize=256)
def _blank_lanes(*plan) -> Lanes:
    """Lanes of one device, as zeros; finding their shapes needs tracing, so they are kept like programs."""
    shapes = functools.partial(_shapes_of_lanes, *plan)
    return remembered("lanes", plan, lambda: jax.tree.map(lambda y: np.zeros(y.shape, y.dtype), shapes()))


def _shapes_of_lanes(shapes, option_types, option_structure, layout: LaneLayout):
    def hold(leaves, numbers):
        chunk = _prepared(leaves, layout, jax.tree.unflatten(option_structure, numbers))
        parts = [y[: layout.lanes] for y in chunk.parts]
        return Lanes(chunk.starts(layout.lanes), parts, jnp.zeros(layout.lanes, jnp.result_type(int)))

    numbers = [jax.ShapeDtypeStruct((), dtype) for dtype in option_types]
    return jax.eval_shape(hold, [jax.ShapeDtypeStruct(*shape) for shape in shapes], numbers)


def _differing(function, axes, leaves):
    """For each output of the vmapped function, whether it differs between scenes."""
    found: list[Any] = []

    @custom_vmap
    def probe(outputs):
        return outputs

    @probe.def_vmap
    def _(axis_size, in_batched, outputs):
        del axis_size
        found.append(in_batched[0])
        return outputs, in_batched[0]

    jax.eval_shape(jax.vmap(lambda *leaves: probe(function(*leaves)), in_axes=axes), *leaves)
    return found[-1]
