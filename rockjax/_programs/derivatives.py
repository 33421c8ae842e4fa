"""Derivatives of one scene with concrete numbers: one stored program serves all requested derivatives.

The program computes the answers and their derivatives with respect to every number of the podium and the
excitation, in one pass. `jax.grad`, `jacfwd` and `jvp` combine these derivatives.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.custom_derivatives import SymbolicZero

from rockjax._programs.barrier import barrier
from rockjax._programs.program import KeptProgram


def pushed(
    function: Callable, arguments: Sequence[Any], slopes: Sequence[Any], *, loops: bool = False
) -> tuple[Any, Any, Any]:
    """Return (floats, their slopes, rest) of `function(*arguments)` → (floats, rest), with one evaluation.

    - `function`: the function to push forward
    - `arguments`: its arguments, pytrees
    - `slopes`: a pytree for each argument: rows of derivatives with respect to some parameters, along a first
      axis; None beside leaves that do not depend on them
    - `loops`: True for a function with loops, which is evaluated once together with all slopes. A function
      without loops is linearised first, so that rows share all intermediate results
    """
    absent = lambda y: y is None
    leaves, structure = jax.tree.flatten(tuple(arguments), is_leaf=absent)
    rows = jax.tree.leaves(tuple(slopes), is_leaf=absent)
    live = [i for i, row in enumerate(rows) if row is not None]
    point = [leaves[i] for i in live]

    def of_live(*values):
        changed = list(leaves)
        for i, value in zip(live, values, strict=True):
            changed[i] = value
        return function(*jax.tree.unflatten(structure, changed))

    directions = [rows[i] for i in live]
    if loops:
        tangent = lambda *row: jax.jvp(of_live, point, list(row), has_aux=True)
        return jax.vmap(tangent, out_axes=(None, 0, None))(*directions)
    floats, linear, rest = jax.linearize(of_live, *point, has_aux=True)
    # Without the barrier every row would compute the coefficients again.
    coefficients, form = jax.tree.flatten(linear)
    linear = jax.tree.unflatten(form, barrier(coefficients))
    return floats, jax.vmap(linear)(*directions), rest


def find_dependent_outputs(function: Callable, at: Any) -> Any:
    """Return, for each output of a function, whether it depends on the argument."""
    found: list[Any] = []

    @jax.custom_jvp
    def probe(outputs):
        return outputs

    def rule(primals, tangents):
        found.append(jax.tree.map(lambda y: not isinstance(y, SymbolicZero), tangents[0]))
        return primals[0], tangents[0]

    probe.defjvp(rule, symbolic_zeros=True)
    jax.eval_shape(lambda x: jax.jvp(lambda y: probe(function(y)), (x,), (x,)), at)
    # Without any dependence the rule is not asked.
    return found[-1] if found else jax.tree.map(lambda _: False, jax.eval_shape(function, at))


def is_concrete(leaf: Any) -> bool:
    """Return whether the value of a leaf is concrete, possibly inside a derivative."""
    if not isinstance(leaf, Tracer):
        return True
    # A tracer of derivatives holds the concrete value at which they are taken.
    value = getattr(leaf, "to_concrete_value", None)
    return value is not None and value() is not None


def value_of(leaf: Any) -> Any:
    """Return the concrete value of a leaf, without derivatives."""
    while isinstance(leaf, Tracer):
        leaf = leaf.to_concrete_value()  # pyright: ignore[reportAttributeAccessIssue]
    return leaf


@functools.cache
def differentiable(program: KeptProgram, slopes_of: KeptProgram, structure: Any, history: int | None):
    """Return the function from the leaves of a scene to its answers, with the derivative rule of this module.

    - `program`: computes the answers
    - `slopes_of`: computes the answers and, in rows, the derivatives of their floats with respect to the
      leaves `numbers`
    - `structure`: tree structure of the arguments
    - `history`: number of steps to keep, None for none
    """

    @jax.custom_jvp
    def evaluate(*leaves):
        return program(*jax.tree.unflatten(structure, leaves), history=history)

    def rule(primals, tangents):
        live = [i for i, tangent in enumerate(tangents) if not isinstance(tangent, SymbolicZero)]
        podium, excitation, *_ = structure.children()
        numbers = scalar_positions(primals[: podium.num_leaves + excitation.num_leaves])
        if not set(live) <= set(numbers) or any(isinstance(y, Tracer) for y in primals):
            return _traced(program, structure, history, primals, tangents, live)
        answer, slopes = slopes_of(*jax.tree.unflatten(structure, primals), numbers=numbers, history=history)
        directions = {numbers.index(i): tangents[i] for i in live}
        _, integers = answer
        floats_dot = jax.tree.map(lambda slope: directional_derivative(np.asarray(slope), directions), slopes)
        return answer, (
            floats_dot,
            jax.tree.map(lambda y: np.zeros(np.shape(y), jax.dtypes.float0), integers),
        )

    evaluate.defjvp(rule, symbolic_zeros=True)
    return evaluate


def scalar_positions(leaves) -> tuple[int, ...]:
    """Return the positions of the leaves that are single floating-point numbers, which may be
    differentiated."""
    return tuple(
        i
        for i, y in enumerate(leaves)
        if np.ndim(y) == 0 and jnp.issubdtype(jnp.result_type(y), jnp.floating)
    )


def directional_derivative(slope: np.ndarray, directions: dict[int, Any]):
    """Return the derivative of one answer along directions, by few and small operations, since each is
    compiled."""
    terms = []
    for k, direction in directions.items():
        each = jax.lax.broadcast(direction, slope.shape[1:]) if slope.ndim > 1 else direction
        terms.append(jax.lax.mul(each, slope[k]))
    return functools.reduce(jax.lax.add, terms)


def _traced(program: KeptProgram, structure: Any, history: int | None, primals, tangents, live):
    """Apply the rule by tracing: with respect to samples or initial states, or inside another
    transformation."""

    def of_live(*values):
        leaves = list(primals)
        for i, value in zip(live, values, strict=True):
            leaves[i] = value
        return program.traced(*jax.tree.unflatten(structure, leaves), history=history)

    return jax.jvp(of_live, [primals[i] for i in live], [tangents[i] for i in live])
