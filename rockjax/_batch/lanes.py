"""Lanes, each of which solves one scene after another.

One call of `advance` processes one chunk of scenes on one core or device. A chunk is a set of scenes that are
prepared together. Between calls the lanes keep scenes that are still running. Within a call all lanes make
trial steps (trials) together. A lane that has no trials to make waits: its scene has ended, or its podium is
in full contact and is to be advanced to the next uplift without trials. Once enough lanes wait, these podiums
are advanced, and lanes whose scenes have ended store the answers and load new scenes (see `exchange.py`).
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from rockjax import _results as results
from rockjax._engine.coefficients import not_none
from rockjax._engine.fast_forward.samples import skip_sample
from rockjax._engine.flat import is_running, with_end_code
from rockjax._engine.solve import answers
from rockjax._engine.state import LoopState, Plan, Scene, differentiated_fields
from rockjax._options import Options
from rockjax._programs.program import StoredProgram
from rockjax._responses.sensitivities import slope_name
from rockjax._types import Flag

from .chunk import Chunk, LaneLayout, makes_trials, prepare_chunk, prepare_in_blocks, step_functions
from .edge_distance import least_edge_distance
from .exchange import Answers, DoneScenes, Lanes, Loop, empty_storage, exchange_scenes
from .scenes import SceneBatch, SceneIndices

WAITING_SHARE = 3 / 32  # an exchange takes place once this fraction of all lanes waits
# To skip a sample means to advance to the next sample of a record without a trial (see `skip_sample`). The
# lanes skip samples while more than 1/SKIPPING_DIVISOR of the running lanes can skip one.
SKIPPING_DIVISOR = 2


def advance(
    lanes: Lanes, leaves, first, stride, count, max_trials, options: Options, layout: LaneLayout
) -> tuple[Lanes, DoneScenes]:
    """Advance the lanes through a chunk of scenes.

    - `lanes`: lanes after the previous chunk
    - `leaves`: leaves of the scenes' arguments; a leaf with the entry 0 in `layout.axes` has a row for each
      scene
    - `first`, `stride`, `count`: the `count` scenes of the chunk have the indices `first`, `first + stride`,
      … in the batch
    - `max_trials`: number of trials after which the call may return with unfinished scenes
    - `options`: options of the solver
    - `layout`: layout of the lanes

    The call returns once the last scene of the chunk is loaded, and either all scenes have ended or at least
    `max_trials` trials have been made. Returns the lanes, and the answers of the scenes that have ended.
    """
    lane_count, size, refill = layout.lanes, layout.size, layout.refill
    plan = layout.plan(leaves, options)
    chunk = prepare_in_blocks(leaves, layout, options, count)
    try_step, lift_off = step_functions(plan, options)
    enough_waiting = max(1, round(WAITING_SHARE * lane_count))
    index_type = lanes.scene_index.dtype

    def apply(function, lanes: Lanes) -> Lanes:
        """Apply a function (scene, state) ↦ state to all lanes."""

        def with_fields(scene: Scene, state: LoopState):
            state = function(scene, state)
            return _fields_with_slopes(state, lanes), state

        _, state_slopes, states = chunk.in_lanes(with_fields, lanes.varying, lanes.states, lanes.slopes)
        slopes = None if lanes.slopes is None else lanes.slopes._replace(states=state_slopes)
        distance = lanes.edge_distance
        if distance is not None and state_slopes is not None:
            distance = least_edge_distance(distance, states, state_slopes)
        return lanes._replace(states=states, slopes=slopes, edge_distance=distance)

    if refill:
        lanes = _with_swapped_axes(lanes)
    else:
        index = jnp.arange(lane_count, dtype=index_type)
        scene_index = jnp.where(index < count, first + stride * index, -1)
        states, slopes = chunk.starts(lane_count)
        varying = [y[:lane_count] for y in chunk.varying]
        lanes = Lanes(states, varying, scene_index, slopes, _first_edge_distance(layout))

    def exchange(loop: Loop) -> Loop:
        lanes = apply(lift_off, loop.lanes)
        ended = (lanes.scene_index >= 0) & ~is_running(lanes.states, options.max_steps)
        lane_answers, indices = _answers_of(chunk, plan, lanes), SceneIndices(first, stride, count)
        return exchange_scenes(chunk, indices, loop._replace(lanes=lanes), ended, lane_answers, refill)

    def count_waiting(loop: Loop) -> jax.Array:
        """Return the number of lanes that wait for an exchange."""
        has_or_gets_scene = (loop.lanes.scene_index >= 0) | (loop.next_position < count)
        return jnp.sum(~makes_trials(plan, options, loop.lanes.states) & has_or_gets_scene)

    def is_unfinished(loop: Loop) -> Flag:
        return (loop.next_position < count) | (loop.done.trials < max_trials)

    def makes_more_trials(loop: Loop) -> Flag:
        """Return whether to make another trial before the next exchange. An exchange takes about as long as
        a trial. Therefore it is delayed until enough lanes wait, or until no lane has trials to make."""
        few_wait = count_waiting(loop) < enough_waiting
        return few_wait & jnp.any(makes_trials(plan, options, loop.lanes.states)) & is_unfinished(loop)

    def make_trial(loop: Loop) -> Loop:
        done = loop.done
        useful = done.useful + jnp.sum(makes_trials(plan, options, loop.lanes.states))
        skip = functools.partial(apply, lambda scene, state: skip_sample(scene, plan, state))
        lanes = apply(try_step, _skip_samples(plan, options, skip, loop.lanes))
        return loop._replace(lanes=lanes, done=done._replace(trials=done.trials + 1, useful=useful))

    def body(loop: Loop) -> Loop:
        return jax.lax.while_loop(makes_more_trials, make_trial, exchange(loop))

    answer_shapes = jax.eval_shape(lambda lanes: _answers_of(chunk, plan, lanes), lanes)
    # The storage has rows for the scenes of the chunk and for the scenes that the lanes held before. There is
    # one more row for each lane, because accelerators write a row for every lane in each exchange.
    done = empty_storage(size + 2 * lane_count, answer_shapes, index_type)
    # Without refilling, all scenes of the chunk are already in lanes.
    next_position = jnp.where(refill, 0, jnp.minimum(count, lane_count)).astype(index_type)
    loop = jax.lax.while_loop(
        lambda loop: (
            is_unfinished(loop) & ((loop.next_position < count) | jnp.any(loop.lanes.scene_index >= 0))
        ),
        body,
        Loop(lanes, next_position, done),
    )
    running = jnp.sum(loop.lanes.scene_index >= 0, dtype=index_type)
    lanes = _with_swapped_axes(loop.lanes) if refill else _without_states(loop.lanes.scene_index)
    return lanes, loop.done._replace(running=running)


def _skip_samples(plan: Plan, options: Options, skip: Callable[[Lanes], Lanes], lanes: Lanes) -> Lanes:
    """Skip samples in all lanes that can skip one, as long as there are enough such lanes."""
    if lanes.states.may_skip is None:
        return lanes
    running_count = jnp.sum(makes_trials(plan, options, lanes.states))
    enough_can_skip = lambda lanes: (
        SKIPPING_DIVISOR * jnp.sum(not_none(lanes.states.may_skip)) > running_count
    )
    return jax.lax.while_loop(enough_can_skip, skip, lanes)


def _fields_with_slopes(state: LoopState, lanes: Lanes) -> dict[str, Any]:
    """Return the fields of a state that have derivatives; none if no sensitivities are requested."""
    return {} if lanes.slopes is None else differentiated_fields(state)


def _first_edge_distance(layout: LaneLayout) -> jax.Array | None:
    """Return the edge distance before the first turning point, which is inf, for each lane; None if edge
    distances are not requested."""
    return jnp.full(layout.lanes, jnp.inf) if layout.edge_distance else None


def _with_swapped_axes(lanes: Lanes) -> Lanes:
    """Swap the first two axes of the slopes (lanes and parameters). Between calls of `advance`, the lanes are
    the first axis. In the loop of `advance` they are the second axis, which suits vector instructions."""
    return lanes._replace(slopes=jax.tree.map(lambda y: jnp.moveaxis(y, 1, 0), lanes.slopes))


def _answers_of(chunk: Chunk, plan: Plan, lanes: Lanes) -> Answers:
    """Return the answers of all lanes at the current states, with edge distances or sensitivities."""
    slopes = lanes.slopes if lanes.edge_distance is None else None
    floats, slopes, integers = chunk.in_lanes(
        lambda scene, state: answers(scene, plan, with_end_code(scene, state)),
        lanes.varying,
        lanes.states,
        slopes,
    )
    if lanes.edge_distance is not None:
        return floats | {"edge_distance": lanes.edge_distance}, integers
    if slopes is None:
        return floats, integers
    parameters_last = lambda y: jnp.moveaxis(y, 0, -1)
    return floats | {
        slope_name(variable.name): parameters_last(slopes[variable.name])
        for output in plan.outputs
        for variable in output.variables
        if variable.sensitive and variable.name in slopes
    }, integers


def _without_states(scene_index: Any) -> Lanes:
    """Return lanes between chunks, if they take no further scenes: the next chunk has states of its own."""
    nothing: Any = None
    return Lanes(nothing, nothing, scene_index)


def idle_lanes(scenes: SceneBatch, options: Options, layout: LaneLayout) -> Lanes:
    """Return lanes without scenes, for chunks of the batch `scenes`."""
    if not layout.refill:
        return _without_states(np.full(layout.lanes, -1, jnp.result_type(int)))
    shapes = tuple(
        (y.shape if axis is None else (layout.size, *y.shape[1:]), y.dtype)
        for y, axis in zip(scenes.leaves, layout.axes, strict=True)
    )
    values, option_structure = jax.tree.flatten(options)
    return _blank_lanes(shapes, tuple(np.asarray(y).dtype for y in values), option_structure, layout)


@functools.lru_cache(maxsize=256)
def _blank_lanes(shapes, option_types, option_structure, layout: LaneLayout) -> Lanes:
    """Return lanes without scenes. The result can be cached, because it depends only on shapes and types."""
    static = {"option_types": option_types, "option_structure": option_structure, "layout": layout}
    return jax.tree.map(np.asarray, _blank_lanes_program(shapes=shapes, **static))


@StoredProgram
def _blank_lanes_program(*, shapes, option_types, option_structure, layout: LaneLayout) -> Lanes:
    """Return lanes without scenes. Tracing the preparation of a chunk shows the shapes of their arrays. This
    is a stored program, so later processes need not repeat the tracing."""

    def lanes_at_start(leaves, values):
        chunk = prepare_chunk(leaves, layout, jax.tree.unflatten(option_structure, values))
        varying = [y[: layout.lanes] for y in chunk.varying]
        states, slopes = chunk.starts(layout.lanes)
        scene_index = jnp.zeros(layout.lanes, jnp.result_type(int))
        return _with_swapped_axes(Lanes(states, varying, scene_index, slopes, _first_edge_distance(layout)))

    values = [jax.ShapeDtypeStruct((), dtype) for dtype in option_types]
    lanes = jax.eval_shape(lanes_at_start, [jax.ShapeDtypeStruct(*shape) for shape in shapes], values)
    lanes = jax.tree.map(lambda y: jnp.zeros(y.shape, y.dtype), lanes)
    code = jnp.full_like(lanes.states.code, results.END_OF_TIME)
    return lanes._replace(
        states=lanes.states._replace(code=code), scene_index=jnp.full_like(lanes.scene_index, -1)
    )
