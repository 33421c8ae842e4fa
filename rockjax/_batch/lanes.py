"""Lanes, each of which solves one scene at a time and takes the next scene when its scene has ended.

One call of `advance` processes one chunk of scenes on one core or device. Between calls the lanes keep
scenes that are still running. Within a call all lanes make trial steps together; after some trials, the
lanes that wait for a scene are served together (see `exchange.py`).
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from rockjax import _results as results
from rockjax._engine.coefficients import present
from rockjax._engine.fast_forward.samples import past_sample
from rockjax._engine.flat import closed, is_running
from rockjax._engine.solve import answers
from rockjax._engine.state import LoopState, Plan, Scene, differentiated_fields
from rockjax._options import Options
from rockjax._programs.program import StoredProgram
from rockjax._responses.sensitivities import slope_name
from rockjax._types import Flag

from .chunk import Chunk, LaneLayout, automaton, makes_trials, prepare_chunk, prepare_in_blocks
from .edge_distance import least_edge_distance
from .exchange import Answers, Done, Lanes, Loop, empty_storage, exchange_scenes
from .scenes import SceneBatch, SceneIndices

PATIENCE = 3 / 32  # waiting lanes are served once they are this fraction of all lanes
PASSING_SHARE = 2  # samples are passed while more than 1/PASSING_SHARE of the running lanes can pass one


def advance(
    lanes: Lanes, leaves, first, stride, count, max_trials, options: Options, layout: LaneLayout
) -> tuple[Lanes, Done]:
    """Advance the lanes through a chunk of scenes.

    - `lanes`: lanes after the previous chunk
    - `leaves`: leaves of the arguments of the scenes. Leaves whose entry in `layout.axes` is 0 have a row for
      each scene
    - `first`, `stride`, `count`: the `count` scenes have the indices `first`, `first + stride`, … in the
      batch
    - `max_trials`: limit of trials after the last scene of the chunk is loaded
    - `options`: options of the solver
    - `layout`: layout of the lanes

    The call returns once the last scene is loaded and, after that, all lanes have ended or the number of
    trials in this call has reached `max_trials`. Returns the lanes, and the scenes that have ended.
    """
    lane_count, size, refill = layout.lanes, layout.size, layout.refill
    plan = layout.plan(leaves, options)
    chunk = prepare_in_blocks(leaves, layout, options, count)
    try_step, lift_off = automaton(plan, options)
    patience = max(1, round(PATIENCE * lane_count))
    lanes = _with_swapped_axes(lanes)

    def apply(function, state: Lanes) -> Lanes:
        """Apply a function (scene, state) ↦ state to all lanes."""

        def with_fields(scene: Scene, lane: LoopState):
            lane = function(scene, lane)
            return _fields_with_slopes(lane, state), lane

        _, lane_slopes, lane = chunk.in_lanes(with_fields, state.parts, state.lane, state.slopes)
        slopes = None if state.slopes is None else state.slopes._replace(lane=lane_slopes)
        distance = state.edge_distance
        if distance is not None and lane_slopes is not None:
            distance = least_edge_distance(distance, lane, lane_slopes)
        return state._replace(lane=lane, slopes=slopes, edge_distance=distance)

    index_type = lanes.scene_index.dtype
    if not refill:
        index = jnp.arange(lane_count, dtype=index_type)
        number = jnp.where(index < count, first + stride * index, -1)
        lane, slopes = chunk.starts(lane_count)
        lanes = Lanes(
            lane, [y[:lane_count] for y in chunk.parts], number, slopes, _first_edge_distance(layout)
        )

    def exchange(loop: Loop) -> Loop:
        state = apply(lift_off, loop.lanes)
        ended = (state.scene_index >= 0) & ~is_running(state.lane, options.max_steps)
        lane_answers, indices = _answers_of(chunk, plan, state), SceneIndices(first, stride, count)
        return exchange_scenes(chunk, indices, loop._replace(lanes=state), ended, lane_answers, refill)

    def count_waiting(loop: Loop) -> jax.Array:
        """Return the number of lanes that wait for an exchange."""
        can_load = (loop.lanes.scene_index >= 0) | (loop.following < count)
        return jnp.sum(~makes_trials(plan, options, loop.lanes.lane) & can_load)

    def is_unfinished(loop: Loop) -> Flag:
        return (loop.following < count) | (loop.done.trials < max_trials)

    def makes_more_trials(loop: Loop) -> Flag:
        """Return whether to make trials before the next exchange. An exchange takes about as long as a
        trial, so it is delayed until several lanes wait or no lane has trials to make."""
        few_wait = count_waiting(loop) < patience
        return few_wait & jnp.any(makes_trials(plan, options, loop.lanes.lane)) & is_unfinished(loop)

    def make_trial(loop: Loop) -> Loop:
        done = loop.done
        useful = done.useful + jnp.sum(makes_trials(plan, options, loop.lanes.lane))
        pass_sample = functools.partial(apply, lambda scene, lane: past_sample(scene, plan, lane))
        state = apply(try_step, _pass_samples(plan, options, pass_sample, loop.lanes))
        return loop._replace(lanes=state, done=done._replace(trials=done.trials + 1, useful=useful))

    def body(loop: Loop) -> Loop:
        return jax.lax.while_loop(makes_more_trials, make_trial, exchange(loop))

    answer_shapes = jax.eval_shape(lambda state: _answers_of(chunk, plan, state), lanes)
    # There is storage for the scenes of the chunk, for the scenes that the lanes held before, and for one
    # more row per lane: an accelerator writes the rows of all lanes at once.
    done = empty_storage(size + 2 * lane_count, answer_shapes, index_type)
    start = jnp.where(refill, 0, jnp.minimum(count, lane_count)).astype(index_type)
    loop = jax.lax.while_loop(
        lambda loop: is_unfinished(loop) & ((loop.following < count) | jnp.any(loop.lanes.scene_index >= 0)),
        body,
        Loop(lanes, start, done),
    )
    left = jnp.sum(loop.lanes.scene_index >= 0, dtype=index_type)
    return _with_swapped_axes(loop.lanes), loop.done._replace(left=left)


def _pass_samples(plan: Plan, options: Options, pass_sample: Callable[[Lanes], Lanes], state: Lanes) -> Lanes:
    """Pass samples at which no event occurs, as long as enough lanes can do so."""
    if state.lane.passing is None:
        return state
    running = jnp.sum(makes_trials(plan, options, state.lane))
    enough_pass = lambda state: PASSING_SHARE * jnp.sum(present(state.lane.passing)) > running
    return jax.lax.while_loop(enough_pass, pass_sample, state)


def _fields_with_slopes(lane: LoopState, state: Lanes) -> dict[str, Any]:
    """Return the fields of a lane that have derivatives; none without sensitivities."""
    return {} if state.slopes is None else differentiated_fields(lane)


def _first_edge_distance(layout: LaneLayout) -> jax.Array | None:
    """Return the edge distance of lanes before their first turning point; None if it is not requested."""
    return jnp.full(layout.lanes, jnp.inf) if layout.edge_distance else None


def _with_swapped_axes(state: Lanes) -> Lanes:
    """Swap the first two axes of the slopes, parameters and lanes. In the loop the lanes are the second axis,
    so that they fill a vector."""
    return state._replace(slopes=jax.tree.map(lambda y: jnp.moveaxis(y, 1, 0), state.slopes))


def _answers_of(chunk: Chunk, plan: Plan, state: Lanes) -> Answers:
    """Return the answers of all lanes at their present states, including the edge distance or the
    sensitivities."""
    slopes = state.slopes if state.edge_distance is None else None
    floats, slopes, integers = chunk.in_lanes(
        lambda scene, lane: answers(scene, plan, closed(scene, lane)), state.parts, state.lane, slopes
    )
    if state.edge_distance is not None:
        return floats | {"edge_distance": state.edge_distance}, integers
    if slopes is None:
        return floats, integers
    parameters_last = lambda y: jnp.moveaxis(y, 0, -1)
    return floats | {
        slope_name(variable.name): parameters_last(slopes[variable.name])
        for output in plan.outputs
        for variable in output.variables
        if variable.sensitive and variable.name in slopes
    }, integers


def idle_lanes(scenes: SceneBatch, options: Options, layout: LaneLayout) -> Lanes:
    """Return lanes without scenes, for a program that processes chunks of the batch `scenes`."""
    shapes = tuple(
        (y.shape if axis is None else (layout.size, *y.shape[1:]), y.dtype)
        for y, axis in zip(scenes.leaves, layout.axes, strict=True)
    )
    values, plan = jax.tree.flatten(options)
    return _blank_lanes(shapes, tuple(np.asarray(y).dtype for y in values), plan, layout)


@functools.lru_cache(maxsize=256)
def _blank_lanes(shapes, option_types, option_structure, layout: LaneLayout) -> Lanes:
    """Return lanes without scenes. Only the shapes and types of the arguments are needed, so the result
    is cached."""
    static = {"option_types": option_types, "option_structure": option_structure, "layout": layout}
    return jax.tree.map(np.asarray, _no_scenes(shapes=shapes, **static))


@StoredProgram
def _no_scenes(*, shapes, option_types, option_structure, layout: LaneLayout) -> Lanes:
    """Return lanes without scenes. This is a stored program, because their shapes are only known from
    tracing."""

    def hold(leaves, values):
        chunk = prepare_chunk(leaves, layout, jax.tree.unflatten(option_structure, values))
        parts = [y[: layout.lanes] for y in chunk.parts]
        lane, slopes = chunk.starts(layout.lanes)
        number = jnp.zeros(layout.lanes, jnp.result_type(int))
        return _with_swapped_axes(Lanes(lane, parts, number, slopes, _first_edge_distance(layout)))

    values = [jax.ShapeDtypeStruct((), dtype) for dtype in option_types]
    lanes = jax.eval_shape(hold, [jax.ShapeDtypeStruct(*shape) for shape in shapes], values)
    lanes = jax.tree.map(lambda y: jnp.zeros(y.shape, y.dtype), lanes)
    code = jnp.full_like(lanes.lane.code, results.END_OF_TIME)
    return lanes._replace(
        lane=lanes.lane._replace(code=code), scene_index=jnp.full_like(lanes.scene_index, -1)
    )
