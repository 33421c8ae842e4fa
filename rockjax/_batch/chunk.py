"""Preparation of a chunk of scenes for the lanes, and the step of a lane.

A lane solves one scene at a time. A chunk is a set of scenes that are prepared together. If sensitivities are
requested, every quantity that depends on the parameters has a second array, its slopes. These are the
derivatives with respect to the logarithms of the parameters, with a row for each parameter. `push_forward`
evaluates functions of scene and state together with the slopes of their results.
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
from rockjax._excitations.ground import GroundMotion
from rockjax._options import Options
from rockjax._outputs.margin import TurningPoints
from rockjax._programs.barrier import barrier
from rockjax._programs.derivatives import find_dependent_outputs, push_forward
from rockjax._responses.sensitivities import with_unit_factors
from rockjax._types import Flag


class LaneLayout(NamedTuple):
    """Layout of the lanes: properties of a batch that are fixed when its program is compiled."""

    axes: tuple[int | None, ...]  # for each leaf of a chunk, 0 if it has a row for each scene, else None
    structure: Any  # tree structure of (podium, excitation, initial, t_end)
    lanes: int  # number of lanes
    size: int  # number of scenes in a chunk, a multiple of the lanes
    refill: bool  # True if lanes take further scenes, False if a chunk has only one scene for each lane
    sensitivities: tuple[str, ...] = ()  # parameters y of the derivatives with respect to ln y
    edge_distance: bool = False  # True if edge distances are requested; then `sensitivities` is ("scale",)

    def plan(self, leaves, options: Options) -> Plan:
        """Return the plan for scenes with the leaves of a chunk."""
        podium, excitation, *_ = jax.tree.unflatten(self.structure, leaves)
        return plan_for(
            podium,
            options,
            history=False,
            extra_outputs=(TurningPoints(),) if self.edge_distance else (),
            vertical=isinstance(excitation, GroundMotion),
        )


class LaneDerivatives(NamedTuple):
    """Slopes of the scenes and states of lanes, with a row for each parameter."""

    varying: list[Any]  # derivatives of `Lanes.varying`; None for leaves without derivatives
    states: dict[str, Any]  # derivatives of the `differentiated_fields` of a `LoopState`


def makes_trials(plan: Plan, options: Options, state: LoopState) -> Flag:
    """Return whether a lane has trials (trial steps) to make.

    If the plan skips full contact (`Plan.follows_contact` is False), a podium in full contact (σ = 0) needs
    no trials. It is advanced to its next uplift when finished scenes are exchanged. Plans skip full contact
    only for a rigid superstructure or none.
    """
    goes_on = is_running(state, options.max_steps)
    return goes_on if plan.follows_contact else goes_on & (state.sigma != 0)


def step_functions(plan: Plan, options: Options):
    """Return two functions (scene, state) ↦ state.

    The first makes a trial, but returns the state unchanged if there is no trial to make. The second advances
    a podium from full contact to its next uplift, but returns the state unchanged if the podium is not in
    full contact, if the scene has ended, or if the plan does not skip full contact.
    """

    def try_step(scene: Scene, state: LoopState) -> LoopState:
        goes_on = barrier(makes_trials(plan, options, state))
        after, _ = trial(scene, plan, state)
        return jax.tree.map(lambda new, old: jnp.where(goes_on, new, old), after, state)

    def lift_off(scene: Scene, state: LoopState) -> LoopState:
        if plan.follows_contact:
            return state
        waits = (state.sigma == 0) & is_running(state, options.max_steps)
        lifted, _ = advance_to_uplift(scene, plan, state)
        return jax.tree.map(lambda new, old: jnp.where(waits, new, old), lifted, state)

    return try_step, lift_off


class _ChunkDerivatives(NamedTuple):
    """Slopes of the scenes and states of a chunk, with a row for each parameter."""

    varying: list[Any]  # derivatives of `Chunk.varying`
    common: list[Any]  # derivatives of `Chunk.common`
    states: dict[str, Any]  # derivatives of the `differentiated_fields` of `Chunk.states`


class Chunk(NamedTuple):
    """Prepared scenes. Quantities that differ between scenes have a row for each scene; quantities that all
    scenes share are stored once."""

    varying: list[Any]  # only the leaves of `Scene` that vary between scenes
    common: list[Any]  # leaves of `Scene` that all scenes share; None for leaves that vary
    structure: Any  # tree structure of `Scene`
    states: LoopState  # states at the start
    states_differ: Any  # for each leaf of `states`, whether it has a row for each scene
    slopes: _ChunkDerivatives | None  # None if no sensitivities are requested

    def starts(self, lanes: int) -> tuple[LoopState, LaneDerivatives | None]:
        """Return the initial states of the first `lanes` scenes, and the slopes of scenes and states; the
        slopes are None if no sensitivities are requested."""

        def start(y, differs):
            return y[:lanes] if differs else jnp.broadcast_to(y, (lanes, *y.shape))

        states = jax.tree.map(start, self.states, self.states_differ)
        if self.slopes is None:
            return states, None
        start_slope = lambda rows, differs: jax.vmap(lambda row: start(row, differs))(rows)
        varying = [None if y is None else y[:, :lanes] for y in self.slopes.varying]
        differs = differentiated_fields(self.states_differ)
        return states, LaneDerivatives(varying, jax.tree.map(start_slope, self.slopes.states, differs))

    def in_lanes(
        self,
        function: Callable,
        varying: list[Any],
        states: LoopState,
        slopes: LaneDerivatives | None,
        loops: bool = False,
    ):
        """Evaluate a function in every lane. Return (floats, slopes of the floats, other outputs).

        - `function`: (scene, state) ↦ (floats, other outputs)
        - `varying`: the leaves of `Scene` that vary between scenes, with a row for each lane
        - `states`: states, with a row for each lane
        - `slopes`: derivatives of `varying` and `states`; if None, the returned slopes are also None
        - `loops`: True if the function contains loops; passed to `push_forward`
        """

        def scene(varying, common) -> Scene:
            leaves = iter(varying)
            return jax.tree.unflatten(self.structure, [next(leaves) if y is None else y for y in common])

        def in_all_lanes(varying, common, states):
            return jax.vmap(lambda leaves, state: function(scene(leaves, common), state))(varying, states)

        if slopes is None or self.slopes is None:
            floats, rest = in_all_lanes(varying, self.common, states)
            return floats, None, rest
        state_slopes = jax.tree.map(lambda _: None, states)._replace(**slopes.states)
        all_slopes = slopes.varying, self.slopes.common, state_slopes
        # With `loops`, `push_forward` uses a form that compiles faster but computes each row of derivatives
        # separately. With a single row this takes no longer.
        is_single = slopes.states["event_time"].shape[0] == 1
        return push_forward(
            in_all_lanes, (varying, self.common, states), all_slopes, loops=loops or is_single
        )


def prepare_chunk(leaves, layout: LaneLayout, options: Options) -> Chunk:
    """Return the prepared scenes of a chunk.

    - `leaves`: leaves of the scenes' arguments; a leaf with the entry 0 in `layout.axes` has a row for each
      scene
    - `layout`: layout of the lanes
    - `options`: options of the solver
    """
    structure, names = layout.structure, layout.sensitivities
    plan = layout.plan(leaves, options)
    _, lift_off = step_functions(plan, options)

    def prepare_scene(factors, *leaves) -> tuple[Scene, LoopState]:
        podium, excitation, initial, t_end = jax.tree.unflatten(structure, leaves)
        if names:
            podium, excitation = with_unit_factors(podium, excitation, names, factors)
        scene, state = prepare(podium, excitation, initial, t_end, options, plan)
        return scene, lift_off(scene, state)

    factors = jnp.ones(len(names)) if names else None
    leaves, axes = _with_own_states(leaves, layout) if names else (leaves, layout.axes)
    axes = (None, *axes)
    differs = _differing(prepare_scene, axes, (factors, *leaves))
    out_axes = jax.tree.map(lambda flag: 0 if flag else None, differs)
    prepare_all = jax.vmap(prepare_scene, in_axes=axes, out_axes=out_axes)
    has_rows = jax.tree.leaves(differs[0])
    selected = lambda scenes, differ: [
        y if flag == differ else None for y, flag in zip(scenes, has_rows, strict=True)
    ]
    if names:
        first_scene = [y if axis is None else y[0] for y, axis in zip(leaves, axes[1:], strict=True)]
        prepare_first = lambda factors: prepare_scene(factors, *first_scene)
        depends = jax.tree.leaves(find_dependent_outputs(prepare_first, factors)[0])

        def scenes_and_states(factors):
            scenes, states = prepare_all(factors, *leaves)
            flat = jax.tree.leaves(scenes)
            flat = [y if flag else None for y, flag in zip(flat, depends, strict=True)]
            return (flat, differentiated_fields(states)), (scenes, states)

        _, (scene_slopes, state_slopes), (scenes, states) = push_forward(
            scenes_and_states, (factors,), (jnp.eye(len(names)),), loops=True
        )
        varying_slopes = [y for y, flag in zip(scene_slopes, has_rows, strict=True) if flag]
        slopes = _ChunkDerivatives(varying_slopes, selected(scene_slopes, False), state_slopes)
    else:
        (scenes, states), slopes = prepare_all(factors, *leaves), None
    flat, scene_structure = jax.tree.flatten(scenes)
    varying = [y for y, flag in zip(flat, has_rows, strict=True) if flag]
    return Chunk(varying, selected(flat, False), scene_structure, states, differs[1], slopes)


def _with_own_states(leaves, layout: LaneLayout) -> tuple[list[Any], tuple[int | None, ...]]:
    """Return the leaves of a chunk, with a separate initial state for each scene, and the axes of the leaves.

    The derivatives of the initial state may differ between scenes even if all scenes have the same initial
    state. If the scenes shared one array, the results of the engine's function `restart` would then differ in
    shape from their derivatives.
    """
    _, _, initial, _ = jax.tree.unflatten(layout.structure, range(len(leaves)))
    positions = jax.tree.leaves(initial)
    new_leaves = [
        jnp.broadcast_to(y, (layout.size,)) if k in positions and layout.axes[k] is None else y
        for k, y in enumerate(leaves)
    ]
    return new_leaves, tuple(0 if k in positions else axis for k, axis in enumerate(layout.axes))


def prepare_in_blocks(leaves, layout: LaneLayout, options: Options, count) -> Chunk:
    """Return the first `count` scenes of a chunk, prepared in blocks that fit into the cache.

    - `leaves`, `layout`, `options`: as in `prepare_chunk`
    - `count`: number of scenes to prepare; rows after them are undefined
    """
    lanes = layout.lanes

    def prepare_block(start) -> Chunk:
        block = [
            y if axis is None else jax.lax.dynamic_slice_in_dim(y, start, lanes)
            for y, axis in zip(leaves, layout.axes, strict=True)
        ]
        return prepare_chunk(block, layout._replace(size=lanes), options)

    # If there are several blocks, only the quantities that all scenes share are used from this first block.
    # The loop below prepares the scenes of all blocks.
    first_block = prepare_block(0)
    if layout.size == lanes:
        return first_block
    rows, axes, put_back = _rows_of_scenes(first_block)
    empty = lambda y, axis: jnp.zeros((*y.shape[:axis], layout.size, *y.shape[axis + 1 :]), y.dtype)

    def fill_block(k, stores):
        new_rows = _rows_of_scenes(prepare_block(k * lanes))[0]
        return [
            jax.lax.dynamic_update_slice_in_dim(store, y, k * lanes, axis)
            for store, y, axis in zip(stores, new_rows, axes, strict=True)
        ]

    stores = [empty(y, axis) for y, axis in zip(rows, axes, strict=True)]
    return put_back(jax.lax.fori_loop(0, -(-count // lanes), fill_block, stores))


def _rows_of_scenes(chunk: Chunk) -> tuple[list[Any], list[int], Callable[[list[Any]], Chunk]]:
    """Return all arrays of a chunk that have a row for each scene, the axis of the scenes in each array, and
    a function that puts other such arrays into the chunk."""
    states, state_structure = jax.tree.flatten(chunk.states)
    differs = jax.tree.leaves(chunk.states_differ)
    slopes, slope_structure = jax.tree.flatten(chunk.slopes and (chunk.slopes.varying, chunk.slopes.states))
    differ = chunk.slopes and differentiated_fields(chunk.states_differ)
    slope_differs = jax.tree.leaves(chunk.slopes and (chunk.slopes.varying, differ))
    # `slope_differs` has flags for the slopes of states. For the slopes of `varying`, which always have a row
    # for each scene, it has the arrays themselves.
    has_rows = [*(True for _ in chunk.varying), *differs, *(flag is not False for flag in slope_differs)]
    all_arrays = [*chunk.varying, *states, *slopes]
    axes = [*(0 for _ in chunk.varying), *(0 for _ in states), *(1 for _ in slopes)]

    def put_back(stores: list[Any]) -> Chunk:
        stored = iter(stores)
        arrays = [next(stored) if flag else y for y, flag in zip(all_arrays, has_rows, strict=True)]
        varying, others = arrays[: len(chunk.varying)], arrays[len(chunk.varying) :]
        new_states = jax.tree.unflatten(state_structure, others[: len(states)])
        new_slopes = jax.tree.unflatten(slope_structure, others[len(states) :])
        slopes = chunk.slopes and chunk.slopes._replace(varying=new_slopes[0], states=new_slopes[1])
        return chunk._replace(varying=varying, states=new_states, slopes=slopes)

    chosen = [k for k, flag in enumerate(has_rows) if flag]
    return [all_arrays[k] for k in chosen], [axes[k] for k in chosen], put_back


def _differing(function, axes, leaves):
    """Return for each output of a function whether the output differs between scenes.

    - `function`: function of the leaves of a single scene
    - `axes`, `leaves`: leaves for all scenes, and the axes over which `vmap` maps them
    """
    # Under `vmap`, JAX calls the batching rule of `probe` and passes flags. A flag is True if the output
    # depends on the scene.
    flags: list[Any] = []

    @custom_vmap
    def probe(outputs):
        return outputs

    @probe.def_vmap
    def _(axis_size, in_batched, outputs):
        del axis_size
        flags.append(in_batched[0])
        return outputs, in_batched[0]

    jax.eval_shape(jax.vmap(lambda *leaves: probe(function(*leaves)), in_axes=axes), *leaves)
    return flags[-1]
