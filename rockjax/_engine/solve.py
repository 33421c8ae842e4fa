"""Solution of one scene (one podium under one excitation), with derivatives with respect to the parameters.

The derivatives with respect to scalar parameters are computed in forward mode, together with the value. Both
`jax.jacfwd` and `jax.grad` use these derivatives, so they cost the same. For derivatives with respect to
arrays (the samples of a record), JAX differentiates the loop itself; in reverse mode, this loop recomputes
steps from checkpoints, so that its memory is bounded.
"""

from __future__ import annotations

from typing import Any

import jax
from jax.core import Tracer
from jaxtyping import Array

from rockjax import _results as results
from rockjax._excitations.base import AbstractExcitation
from rockjax._excitations.ground import GroundMotion
from rockjax._options import Options, canonical_options
from rockjax._outputs.views import Ended
from rockjax._programs.derivatives import (
    differentiable,
    is_concrete,
    scalar_positions,
    with_derivatives,
    with_slopes,
)
from rockjax._programs.program import StoredProgram
from rockjax._results import State
from rockjax._structures import Podium

from .flat import Nodes, solve_scene
from .scene import plan_for, prepare
from .state import LoopState, Plan, Scene


def solve(
    podium: Podium,
    excitation: AbstractExcitation,
    initial: State,
    t_end: Array | None,
    options: Options,
    capacity: int | None = None,
) -> tuple[tuple[dict[str, Array], Any], tuple[dict[str, Array], Any]]:
    """Solve one scene.

    - `podium`, `excitation`: structure and ground motion, with scalar parameters
    - `initial`: initial state
    - `t_end`: end of the scene [s]; None for the default, `default_end`
    - `options`: options of the solver
    - `capacity`: number of nodes to store; None stores none

    Returns ((floats, float fields of the nodes), (integers and flags, integer fields of the nodes)). The
    floats are a dict of outputs by name, the integers and flags another. The nodes are the stored steps
    (`flat.Nodes`), or None without a `capacity`.

    Outside `jax.jit`, where all values are known, the function calls a stored program. With `engine="flat"`
    it also does so inside `jax.grad` and `jax.jvp`, for derivatives with respect to scalar parameters of the
    podium and the excitation.
    """
    podium = podium.split_rows().without_idle_restrainers()
    podium = podium if options.of_joints else podium.without_elevation()
    arguments = podium, excitation, initial, t_end, options
    leaves = jax.tree.leaves(arguments)
    if options.engine != "flat" or not all(map(is_concrete, leaves)):
        return PROGRAM(*arguments, capacity=capacity)
    arguments = podium, excitation.common_form(), initial, t_end, canonical_options(podium, options)
    if any(isinstance(y, Tracer) for y in leaves):
        leaves, structure = jax.tree.flatten(arguments)
        return differentiable(PROGRAM, SLOPES, structure, capacity)(*leaves)
    return PROGRAM(*arguments, capacity=capacity)


def solve_with_slopes(
    podium: Podium, excitation: AbstractExcitation, initial: State, t_end: Array | None, options: Options
) -> tuple[dict[str, Array], dict[str, Array], tuple[int, ...]]:
    """Solve one scene of concrete values (numbers, not JAX tracers), with derivatives of its outputs.

    - arguments: as for `solve`

    The parameters are the scalar leaves of (podium.split_rows(), excitation.common_form()). Unless joint
    forces are requested, the elevation of the podium is left out, because it does not affect the motion.

    Returns the floats by name, their derivatives with the parameters along the first axis, and the indices of
    the parameters among the leaves.
    """
    arguments, indices = _slopes_arguments(podium, excitation, initial, t_end, options)
    ((floats, _), _), (slopes, _) = SLOPES(*arguments, leaf_indices=indices, capacity=None)
    return floats, slopes, indices


def prepare_slopes(
    podium: Podium, excitation: AbstractExcitation, initial: State, t_end: Array | None, options: Options
) -> None:
    """Start to load or compile the program of `solve_with_slopes` for these arguments in another thread."""
    arguments, indices = _slopes_arguments(podium, excitation, initial, t_end, options)
    SLOPES.prepare(*arguments, leaf_indices=indices, capacity=None)


def _slopes_arguments(
    podium: Podium, excitation: AbstractExcitation, initial: State, t_end: Array | None, options: Options
) -> tuple[tuple, tuple[int, ...]]:
    """Return the arguments of `SLOPES` for the arguments of `solve_with_slopes`, and the indices of the
    scalar leaves."""
    podium = podium.split_rows()
    podium = podium if options.of_joints else podium.without_elevation()
    arguments = podium, excitation.common_form(), initial, t_end, canonical_options(podium, options)
    return arguments, scalar_positions(jax.tree.leaves(arguments[:2]))


def _answers(
    podium: Podium,
    excitation: AbstractExcitation,
    initial: State,
    t_end: Array | None,
    options: Options,
    *,
    capacity: int | None,
    reversible: bool,
):
    """Compute the results of `solve`, with the same arguments. With `reversible`, reverse mode can
    differentiate the loop."""
    plan = plan_for(podium, options, capacity is not None, vertical=isinstance(excitation, GroundMotion))
    scene, state = prepare(podium, excitation, initial, t_end, options, plan)
    if options.engine == "segments":
        from .segments import run_segments

        state, nodes = run_segments(scene, plan, state, options, capacity)
        return _with_nodes(answers(scene, plan, state), nodes)
    state, final, nodes = solve_scene(scene, plan, state, options.max_steps, capacity, reversible)
    return _with_nodes(answers(scene, plan, state, final), nodes)


_solve = with_derivatives(_answers)
PROGRAM = StoredProgram(_solve)
SLOPES = StoredProgram(with_slopes(_answers))


def answers(
    scene: Scene, plan: Plan, state: LoopState, final: LoopState | None = None
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return the outputs of a finished scene by name, in two dicts: first floats, then integers and flags.

    - `scene`, `state`: the prepared scene and its final state
    - `plan`: settings that are fixed at compilation, such as the outputs
    - `final`: state from which integers and flags are read; None to read them from `state`
    """
    floats = {
        "overturn_time": state.overturn_time,
        "uplift_time": state.uplift_time,
        "smallest_impact_speed": state.min_impact_speed_before_peak,
        "end_time": state.t,
    }
    ended = Ended(scene, state.t, state.x, state.v, state.code, state.overturn_time)
    for output, accumulator, note in zip(plan.outputs, state.accumulators, state.notes, strict=True):
        floats |= output.answer(ended, accumulator, note)
    for output in plan.unrequested:
        floats |= output.absent(ended)
    state = state if final is None else final
    ratio = state.peak / scene.c.alpha
    integers = {
        "exceeded_alpha": ratio >= 1,
        "overturned": state.code == results.OVERTURNED,
        "uplifted": state.uplifted,
        "impacts": state.impacts,
        "code": state.code,
        "steps": state.steps,
        "rejected": state.rejected,
    }
    return floats, integers


def _with_nodes(answer, nodes: Nodes | None):
    """Return ((floats, float fields of the nodes), (integers, integer fields of the nodes)), with None in
    place of missing nodes. The two parts are separate because only floats have tangents."""
    floats, integers = answer
    if nodes is None:
        return (floats, None), (integers, None)
    return (floats, nodes._replace(piece=None, used=None)), (integers, (nodes.piece, nodes.used))
