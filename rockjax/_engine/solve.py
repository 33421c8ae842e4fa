"""From a structure and an excitation to the end of the scene, with derivatives.

Derivatives with respect to numbers are a Jacobian found in forward mode alongside the value, in one pass; the rule hands
it to forward and reverse mode alike, so `jax.grad` costs what `jax.jacfwd` does. With respect to arrays (the samples of a
record) the loop itself is differentiated, by a form of it that reverse mode can walk with bounded memory.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array

from rockjax import _results as results
from rockjax._excitations.base import AbstractExcitation
from rockjax._options import Options
from rockjax._programs.program import KeptProgram
from rockjax._results import State
from rockjax._structures import Podium

from .derivatives import differentiable, known
from .flat import Nodes, rehearse, replay, run, run_with_history
from .scene import Lane, Plan, Scene, plan, prepare


def solve(
    podium: Podium,
    excitation: AbstractExcitation,
    initial: State,
    t_end: Array | None,
    options: Options,
    history: int | None = None,
) -> tuple[tuple[dict[str, Array], Any], tuple[dict[str, Array], Any]]:
    """((floats, nodes), (integers and flags, rest of the nodes)) of one scene.

    `history` is the number of steps to keep, None keeps none. Where all numbers are known, derivatives wanted or not, the
    programs are those that are kept between processes.
    """
    arguments = podium, excitation, initial, t_end, options
    leaves, structure = jax.tree.flatten(arguments)
    if options.engine == "flat" and any(isinstance(y, Tracer) for y in leaves) and all(map(known, leaves)):
        return differentiable(PROGRAM, structure, history)(*leaves)
    return PROGRAM(*arguments, history=history)


def _solve(
    podium: Podium,
    excitation: AbstractExcitation,
    initial: State,
    t_end: Array | None,
    options: Options,
    history: int | None = None,
) -> tuple[tuple[dict[str, Array], Any], tuple[dict[str, Array], Any]]:
    how = plan(podium, options, history is not None)
    leaves, structure = jax.tree.flatten((podium, excitation, initial, t_end, options))

    def scene(leaves) -> tuple[Scene, Lane]:
        podium, excitation, initial, t_end, options = jax.tree.unflatten(structure, leaves)
        return prepare(podium, excitation, initial, t_end, options, how)

    def function(*leaves):
        ready, lane = scene(leaves)
        if options.engine == "segments":
            from .segments import run_segments

            lane, nodes = run_segments(ready, how, lane, options, history)
        elif history is None:
            lane, nodes = run(ready, how, lane, options.max_steps), None
        else:
            lane, nodes = run_with_history(ready, how, lane, options.max_steps, history)
        return _with_nodes(answers(ready, how, lane), nodes)

    def rehearsed(*leaves):
        """The same for derivatives with respect to arrays, in forward and reverse mode."""
        constant = jax.lax.stop_gradient
        ready, lane = scene(leaves)
        last, decisions, count = rehearse(constant(ready), how, constant(lane), options.max_steps)
        lane, nodes = replay(ready, how, lane, decisions, count, history)
        floats, _ = answers(ready, how, lane)
        _, integers = answers(ready, how, last)
        return _with_nodes((floats, integers), nodes)

    return _differentiable(function, rehearsed, options.engine == "flat")(*leaves)


PROGRAM = KeptProgram(_solve)


def answers(scene: Scene, how: Plan, lane: Lane) -> tuple[dict[str, Array], dict[str, Array]]:
    """What a lane at its end has to say: numbers with derivatives, and integers and flags."""
    nan = jnp.full_like(lane.t, jnp.nan)
    absent = jnp.zeros_like(lane.t)
    ratio = lane.peak / scene.c.alpha
    floats = {
        "peak_rotation": ratio if how.rotation else nan,
        "peak_rotation_time": lane.peak_time if how.rotation else nan,
        "overturn_time": lane.overturn_time,
        "uplift_time": lane.uplift_time,
        "peak_deformation": lane.deformation if how.deformation else (nan if how.elastic else absent),
        "peak_shear": lane.shear if how.shear else (nan if how.superstructure else absent),
        "margin": lane.margin if how.margin else nan,
        "smallest_impact_speed": lane.slowest_before_peak,
        "end_time": lane.t,
    }
    if how.errors:
        # What is too much at the overturning angle, over the inertia.
        floats["fall"] = jnp.where(lane.code == results.OVERTURNED, lane.v[0] ** 2, nan)
    integers = {
        "exceeded_alpha": ratio >= 1,
        "overturned": lane.code == results.OVERTURNED,
        "uplifted": lane.uplifted,
        "impacts": lane.impacts,
        "code": lane.code,
        "steps": lane.steps,
        "rejected": lane.rejected,
    }
    return floats, integers


def _with_nodes(answer, nodes: Nodes | None):
    """Floats and integers apart: only the former have tangents."""
    floats, integers = answer
    if nodes is None:
        return (floats, None), (integers, None)
    return (floats, nodes._replace(piece=None, used=None)), (integers, (nodes.piece, nodes.used))


def _differentiable(function, for_arrays, provided: bool):
    """`function(*leaves)` → (floats, integers), with the derivative rule of this module."""
    evaluate = jax.custom_jvp(function)

    def rule(primals, tangents):
        if not provided:
            raise NotImplementedError("rockjax: derivatives need Options(engine='flat')")
        live = [i for i, tangent in enumerate(tangents) if not isinstance(tangent, SymbolicZero)]
        point = tuple(_first_order_only(primals[i]) for i in live)
        directions = tuple(tangents[i] for i in live)
        arrays = any(jnp.ndim(y) for y in point)

        def of_live(*values):
            leaves = list(primals)
            for i, value in zip(live, values, strict=True):
                leaves[i] = value
            return for_arrays(*leaves) if arrays else function(*leaves)

        if arrays:
            floats, floats_dot, integers = jax.jvp(of_live, point, directions, has_aux=True)
        else:
            units = tuple(jnp.eye(len(live), dtype=y.dtype)[k] for k, y in enumerate(point))
            floats, jacobian, integers = jax.vmap(
                lambda *unit: jax.jvp(of_live, point, unit, has_aux=True), out_axes=(None, 0, None)
            )(*units)
            direction = jnp.stack(directions)
            floats_dot = jax.tree.map(lambda J: jnp.tensordot(direction, J, axes=1), jacobian)
        no_tangent = jax.tree.map(lambda y: np.zeros(jnp.shape(y), jax.dtypes.float0), integers)
        return (floats, integers), (floats_dot, no_tangent)

    evaluate.defjvp(rule, symbolic_zeros=True)
    return evaluate


@jax.custom_jvp
def _first_order_only(x):
    """The identity. Event times are held fixed to first order, so a second derivative would be silently wrong."""
    return x


@_first_order_only.defjvp
def _first_order_only_jvp(primals, tangents):
    raise NotImplementedError("rockjax gives first derivatives only: second derivatives through events are not provided")
