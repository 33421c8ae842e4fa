"""Solution of one scene from a structure and an excitation, with derivatives.

Derivatives with respect to scalar parameters are a Jacobian, computed in forward mode in one pass
together with the value. Forward and reverse mode both use it, so `jax.grad` costs as much as
`jax.jacfwd`. For arrays (the samples of a record) the loop itself is differentiated, in a form that
reverse mode can differentiate with bounded memory.
"""

from __future__ import annotations

from typing import Any

import jax
from jax.core import Tracer
from jaxtyping import Array

from rockjax import _results as results
from rockjax._excitations.base import AbstractExcitation
from rockjax._options import Options, as_compiled
from rockjax._outputs.views import Ended
from rockjax._programs.derivatives import differentiable, is_concrete, with_jacobian, with_jacobian_rule
from rockjax._programs.program import StoredProgram
from rockjax._results import State
from rockjax._structures import Podium

from .flat import Nodes, record_decisions, replay, run, run_with_history
from .scene import plan_for, prepare
from .state import LoopState, Plan, Scene


def solve(
    podium: Podium,
    excitation: AbstractExcitation,
    initial: State,
    t_end: Array | None,
    options: Options,
    history: int | None = None,
) -> tuple[tuple[dict[str, Array], Any], tuple[dict[str, Array], Any]]:
    """Solve one scene.

    - `podium`, `excitation`: structure and ground motion, with scalar parameters
    - `initial`: initial state
    - `t_end`: end of the scene [s]; None for the default
    - `options`: options of the solver
    - `history`: number of steps to store; None stores none

    Returns ((floats, nodes), (integers and flags, rest of the nodes)). Stored programs are used if all
    values are concrete; `jax.grad` and `jax.jvp` of concrete values count as concrete.
    """
    podium = podium.split().without_idle_restrainers()
    podium = podium if options.of_joints else podium.without_elevation()
    arguments = podium, excitation, initial, t_end, options
    leaves = jax.tree.leaves(arguments)
    if options.engine != "flat" or not all(map(is_concrete, leaves)):
        return PROGRAM(*arguments, history=history)
    arguments = podium, excitation.common_form(), initial, t_end, as_compiled(podium, options)
    if any(isinstance(y, Tracer) for y in leaves):
        leaves, structure = jax.tree.flatten(arguments)
        return differentiable(PROGRAM, SLOPES, structure, history)(*leaves)
    return PROGRAM(*arguments, history=history)


def _solve(
    podium: Podium,
    excitation: AbstractExcitation,
    initial: State,
    t_end: Array | None,
    options: Options,
    history: int | None = None,
) -> tuple[tuple[dict[str, Array], Any], tuple[dict[str, Array], Any]]:
    leaves, structure = jax.tree.flatten((podium, excitation, initial, t_end, options))
    function, recorded = _functions(
        structure, plan_for(podium, options, history is not None), options, history
    )
    return with_jacobian_rule(function, recorded, options.engine == "flat")(*leaves)


def _solve_with_slopes(
    podium: Podium,
    excitation: AbstractExcitation,
    initial: State,
    t_end: Array | None,
    options: Options,
    numbers: tuple[int, ...],
    history: int | None = None,
):
    """Return the answers, and the derivatives of their floats with respect to the leaves with the indices
    `numbers`, one row per leaf."""
    leaves, structure = jax.tree.flatten((podium, excitation, initial, t_end, options))
    function, _ = _functions(structure, plan_for(podium, options, history is not None), options, history)
    floats, jacobian, integers = with_jacobian(function, leaves, numbers)
    return (floats, integers), jacobian


def _functions(structure: Any, plan: Plan, options: Options, history: int | None):
    """Return the function from the leaves of the arguments to the answers, and a second form of it for
    derivatives with respect to arrays."""

    def scene(leaves) -> tuple[Scene, LoopState]:
        podium, excitation, initial, t_end, options = jax.tree.unflatten(structure, leaves)
        return prepare(podium, excitation, initial, t_end, options, plan)

    def function(*leaves):
        ready, state = scene(leaves)
        if options.engine == "segments":
            from .segments import run_segments

            state, nodes = run_segments(ready, plan, state, options, history)
        elif history is None:
            state, nodes = run(ready, plan, state, options.max_steps), None
        else:
            state, nodes = run_with_history(ready, plan, state, options.max_steps, history)
        return _with_nodes(answers(ready, plan, state), nodes)

    def recorded(*leaves):
        """Return the answers from recorded decisions, for derivatives with respect to arrays in forward and
        reverse mode."""
        constant = jax.lax.stop_gradient
        ready, state = scene(leaves)
        state = state._replace(passing=None)  # no sample is passed, so every step has a decision
        final, decisions, count = record_decisions(constant(ready), plan, constant(state), options.max_steps)
        state, nodes = replay(ready, plan, state, decisions, count, history)
        floats, _ = answers(ready, plan, state)
        _, integers = answers(ready, plan, final)
        return _with_nodes((floats, integers), nodes)

    return function, recorded


PROGRAM = StoredProgram(_solve)
SLOPES = StoredProgram(_solve_with_slopes)


def answers(scene: Scene, plan: Plan, state: LoopState) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return the outputs of a finished scene by name: floats, which have derivatives, and integers and
    flags."""
    floats = {
        "overturn_time": state.overturn_time,
        "uplift_time": state.uplift_time,
        "smallest_impact_speed": state.min_impact_speed_before_peak,
        "end_time": state.t,
    }
    ended = Ended(scene, state.t, state.x, state.v, state.code, state.overturn_time)
    for output, record, note in zip(plan.outputs, state.records, state.notes, strict=True):
        floats |= output.answer(ended, record, note)
    for output in plan.absent:
        floats |= output.absent(ended)
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
    """Return ((floats, nodes), (integers, integers of the nodes)), since only floats have tangents."""
    floats, integers = answer
    if nodes is None:
        return (floats, None), (integers, None)
    return (floats, nodes._replace(piece=None, used=None)), (integers, (nodes.piece, nodes.used))
