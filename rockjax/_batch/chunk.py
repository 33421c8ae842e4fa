"""Preparation of a chunk of scenes for the lanes, and the step of a lane.

With sensitivities, all quantities that depend on the parameters get a row for each parameter beside them: in
the scenes, and in the states of the lanes. A function of scene and state is then pushed forward, by the same
rules as the derivatives of a single scene.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap

from rockjax._engine.fast_forward.rest import advance_to_uplift
from rockjax._engine.flat import is_running
from rockjax._engine.scene import plan_for, prepare
from rockjax._engine.state import LoopState, Plan, Scene, differentiated_fields
from rockjax._engine.step import trial
from rockjax._options import Options
from rockjax._outputs.margin import TurningPoints
from rockjax._programs.barrier import barrier
from rockjax._programs.derivatives import find_dependent_outputs, pushed
from rockjax._responses.sensitivities import moved
from rockjax._types import Flag


class LaneLayout(NamedTuple):
    """Static choices of a program for lanes, besides the options."""

    axes: tuple[int | None, ...]  # of the leaves of a chunk: 0 where there is a row for each scene
    structure: Any  # of (podium, excitation, initial, t_end)
    lanes: int
    size: int  # scenes of a chunk, a multiple of the lanes
    # Lanes take further scenes; otherwise a chunk holds one scene for each lane, and ends with the last one.
    refill: bool
    sensitivities: tuple[str, ...] = ()  # parameters for derivatives with respect to their logarithms
    edge_distance: bool = False  # whether it is requested; the only parameter is the scale then

    def plan(self, leaves, options: Options) -> Plan:
        """Return the choices made before tracing, from the leaves of a chunk."""
        podium = jax.tree.unflatten(self.structure, leaves)[0]
        return plan_for(
            podium, options, history=False, extra_outputs=(TurningPoints(),) if self.edge_distance else ()
        )


class LaneDerivatives(NamedTuple):
    """Derivatives beside the scenes and states of lanes, with a row for each parameter."""

    parts: list[Any]  # of `Scene`: None beside leaves that do not depend on the parameters
    lane: dict[str, Any]  # the `differentiated_fields` of a `LoopState`


def makes_trials(plan: Plan, options: Options, lane: LoopState) -> Flag:
    """Return whether a lane has trials to make. A rigid podium leaves full contact directly, at the next
    exchange."""
    goes_on = is_running(lane, options.max_steps)
    return goes_on if plan.follows_contact else goes_on & (lane.sigma != 0)


def automaton(plan: Plan, options: Options):
    """Return two functions of scene and lane: one trial of a moving lane, and the direct step to the next
    uplift of a rigid podium in full contact."""

    def try_step(scene: Scene, lane: LoopState) -> LoopState:
        goes_on = barrier(makes_trials(plan, options, lane))
        after, _ = trial(scene, plan, lane)
        return jax.tree.map(lambda new, old: jnp.where(goes_on, new, old), after, lane)

    def lift_off(scene: Scene, lane: LoopState) -> LoopState:
        if plan.follows_contact:
            return lane
        waits = (lane.sigma == 0) & is_running(lane, options.max_steps)
        lifted, _ = advance_to_uplift(scene, plan, lane)
        return jax.tree.map(lambda new, old: jnp.where(waits, new, old), lifted, lane)

    return try_step, lift_off


class _ChunkDerivatives(NamedTuple):
    """Derivatives beside the scenes and states of a chunk."""

    parts: list[Any]
    common: list[Any]
    lane: dict[str, Any]


class Chunk(NamedTuple):
    """Prepared scenes: quantities that differ between them have a row for each, common ones are
    stored once."""

    parts: list[Any]  # of `Scene`: leaves that differ
    common: list[Any]  # of `Scene`: common leaves, None where they differ
    structure: Any
    lane: LoopState  # at the start
    lane_differs: Any
    slopes: _ChunkDerivatives | None

    def starts(self, lanes: int) -> tuple[LoopState, LaneDerivatives | None]:
        """Return initial states of the first scenes, one for each lane, and the slopes beside them."""

        def start(y, differs):
            return y[:lanes] if differs else jnp.broadcast_to(y, (lanes, *y.shape))

        state = jax.tree.map(start, self.lane, self.lane_differs)
        if self.slopes is None:
            return state, None
        beside = lambda rows, differs: jax.vmap(lambda row: start(row, differs))(rows)
        lane = jax.tree.map(beside, self.slopes.lane, differentiated_fields(self.lane_differs))
        return state, LaneDerivatives([None if y is None else y[:, :lanes] for y in self.slopes.parts], lane)

    def in_lanes(
        self,
        function: Callable,
        parts: list[Any],
        lane: LoopState,
        slopes: LaneDerivatives | None,
        loops: bool = False,
    ):
        """Return (floats, their slopes, rest) of `function(scene, lane)` → (floats, rest) in every lane.

        - `function`: the function of scene and state
        - `parts`, `lane`: leaves of the scenes that differ, and states, a row for each lane
        - `slopes`: derivatives of both, or None; the result's slopes are then None as well
        - `loops`: see `pushed`
        """

        def scene(parts, common) -> Scene:
            parts = iter(parts)
            return jax.tree.unflatten(self.structure, [next(parts) if y is None else y for y in common])

        def every(parts, common, lane):
            return jax.vmap(lambda parts, lane: function(scene(parts, common), lane))(parts, lane)

        if slopes is None or self.slopes is None:
            floats, rest = every(parts, self.common, lane)
            return floats, None, rest
        beside = jax.tree.map(lambda _: None, lane)._replace(**slopes.lane)
        beside = slopes.parts, self.slopes.common, beside
        single = slopes.lane["event_time"].shape[0] == 1  # one row shares nothing, and compiles faster
        return pushed(every, (parts, self.common, lane), beside, loops=loops or single)


def prepare_chunk(leaves, layout: LaneLayout, options: Options) -> Chunk:
    """Return the scenes of a chunk, prepared at their starts."""
    structure, names = layout.structure, layout.sensitivities
    plan = layout.plan(leaves, options)
    _, lift_off = automaton(plan, options)

    def ready(factors, *leaves) -> tuple[Scene, LoopState]:
        podium, excitation, initial, t_end = jax.tree.unflatten(structure, leaves)
        if names:
            podium, excitation = moved(podium, excitation, names, factors)
        scene, lane = prepare(podium, excitation, initial, t_end, options, plan)
        return scene, lift_off(scene, lane)

    factors = jnp.ones(len(names)) if names else None
    leaves, axes = _with_own_states(leaves, layout) if names else (leaves, layout.axes)
    axes = (None, *axes)
    differs = _differing(ready, axes, (factors, *leaves))
    out_axes = jax.tree.map(lambda flag: 0 if flag else None, differs)
    every = jax.vmap(ready, in_axes=axes, out_axes=out_axes)
    has_rows = jax.tree.leaves(differs[0])
    selected = lambda scenes, differ: [
        y if flag == differ else None for y, flag in zip(scenes, has_rows, strict=True)
    ]
    if names:
        one = [y if axis is None else y[0] for y, axis in zip(leaves, axes[1:], strict=True)]
        depends = jax.tree.leaves(find_dependent_outputs(lambda factors: ready(factors, *one), factors)[0])

        def of_factors(factors):
            scenes, lane = every(factors, *leaves)
            flat = jax.tree.leaves(scenes)
            flat = [y if flag else None for y, flag in zip(flat, depends, strict=True)]
            return (flat, differentiated_fields(lane)), (scenes, lane)

        _, (rows, of_lane), (scenes, lane) = pushed(
            of_factors, (factors,), (jnp.eye(len(names)),), loops=True
        )
        of_parts = [y for y, flag in zip(rows, has_rows, strict=True) if flag]
        slopes = _ChunkDerivatives(of_parts, selected(rows, False), of_lane)
    else:
        (scenes, lane), slopes = every(factors, *leaves), None
    flat, scene_structure = jax.tree.flatten(scenes)
    parts = [y for y, flag in zip(flat, has_rows, strict=True) if flag]
    return Chunk(parts, selected(flat, False), scene_structure, lane, differs[1], slopes)


def _with_own_states(leaves, layout: LaneLayout) -> tuple[list[Any], tuple[int | None, ...]]:
    """Return the leaves of a chunk with an initial state for each scene, and their axes.

    Derivatives of a common initial state differ from scene to scene. If its value were shared, the derivative
    of `restart` would have another shape than its value.
    """
    _, _, initial, _ = jax.tree.unflatten(layout.structure, range(len(leaves)))
    positions = jax.tree.leaves(initial)
    wide = [
        jnp.broadcast_to(y, (layout.size,)) if k in positions and layout.axes[k] is None else y
        for k, y in enumerate(leaves)
    ]
    return wide, tuple(0 if k in positions else axis for k, axis in enumerate(layout.axes))


def prepare_in_blocks(leaves, layout: LaneLayout, options: Options, count) -> Chunk:
    """Prepare the first `count` scenes of a chunk in blocks that fit the cache.

    - `leaves`: arguments of the scenes, with a row for each scene where `layout.axes` is 0
    - `layout`: layout of the lanes
    - `options`: options of the solver
    - `count`: number of scenes to prepare; the rows after them are undefined
    """
    lanes = layout.lanes

    def block(start) -> Chunk:
        some = [
            y if axis is None else jax.lax.dynamic_slice_in_dim(y, start, lanes)
            for y, axis in zip(leaves, layout.axes, strict=True)
        ]
        return prepare_chunk(some, layout._replace(size=lanes), options)

    # With several blocks only the common quantities of this one are used; the loop below prepares all scenes.
    first = block(0)
    if layout.size == lanes:
        return first
    rows, axes, put_back = _rows_of_scenes(first)
    room = lambda y, axis: jnp.zeros((*y.shape[:axis], layout.size, *y.shape[axis + 1 :]), y.dtype)

    def fill_block(k, stores):
        write = lambda store, y, axis: jax.lax.dynamic_update_slice_in_dim(store, y, k * lanes, axis)
        return [write(*each) for each in zip(stores, _rows_of_scenes(block(k * lanes))[0], axes, strict=True)]

    stores = [room(*each) for each in zip(rows, axes, strict=True)]
    return put_back(jax.lax.fori_loop(0, -(-count // lanes), fill_block, stores))


def _rows_of_scenes(chunk: Chunk) -> tuple[list[Any], list[int], Callable[[list[Any]], Chunk]]:
    """Return all arrays with a row for each scene, the axes of these rows, and a function that puts such
    arrays back into a chunk."""
    lane, lane_structure = jax.tree.flatten(chunk.lane)
    differs = jax.tree.leaves(chunk.lane_differs)
    slopes, slope_structure = jax.tree.flatten(chunk.slopes and (chunk.slopes.parts, chunk.slopes.lane))
    differ = chunk.slopes and differentiated_fields(chunk.lane_differs)
    slope_differs = jax.tree.leaves(chunk.slopes and (chunk.slopes.parts, differ))
    has_rows = [*(True for _ in chunk.parts), *differs, *(flag is not False for flag in slope_differs)]
    every = [*chunk.parts, *lane, *slopes]
    axes = [*(0 for _ in chunk.parts), *(0 for _ in lane), *(1 for _ in slopes)]

    def put_back(stores: list[Any]) -> Chunk:
        stored = iter(stores)
        arrays = [next(stored) if keep else y for y, keep in zip(every, has_rows, strict=True)]
        parts, others = arrays[: len(chunk.parts)], arrays[len(chunk.parts) :]
        state = jax.tree.unflatten(lane_structure, others[: len(lane)])
        beside = jax.tree.unflatten(slope_structure, others[len(lane) :])
        rows = chunk.slopes and chunk.slopes._replace(parts=beside[0], lane=beside[1])
        return chunk._replace(parts=parts, lane=state, slopes=rows)

    chosen = [k for k, keep in enumerate(has_rows) if keep]
    return [every[k] for k in chosen], [axes[k] for k in chosen], put_back


def _differing(function, axes, leaves):
    """Return, for each output of the vmapped function, whether it differs between scenes."""
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
