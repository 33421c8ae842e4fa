"""Derivatives of one scene whose numbers are known: one program, kept between processes, serves whichever are
asked for.

It finds the answers and their derivatives with respect to every number of the podium and the excitation, in
one pass. What `jax.grad`, `jacfwd` or `jvp` then ask for is a combination of these.
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

from rockjax._engine.once import once
from rockjax._programs.program import KeptProgram


def pushed(
    function: Callable, arguments: Sequence[Any], slopes: Sequence[Any], *, loops: bool = False
) -> tuple[Any, Any, Any]:
    """(floats, their slopes, rest) of `function(*arguments)` → (floats, rest), the value worked out once.

    Slopes are derivatives with respect to some parameters in rows, beside each leaf of the arguments that
    moves with them, None beside those that do not.

    - `loops`: the function has loops in it, and goes through them once with value and slopes. One without is
      linearised first: rows then only multiply and add, and what they share is not worked out again for each
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
        along = lambda *row: jax.jvp(of_live, point, list(row), has_aux=True)
        return jax.vmap(along, out_axes=(None, 0, None))(*directions)
    floats, linear, rest = jax.linearize(of_live, *point, has_aux=True)
    # Held, or every row would work the coefficients out anew: a quarter of the time.
    coefficients, form = jax.tree.flatten(linear)
    linear = jax.tree.unflatten(form, once(coefficients))
    return floats, jax.vmap(linear)(*directions), rest


def which_move(function: Callable, at: Any) -> Any:
    """For each output of a function, whether it moves with its argument."""
    found: list[Any] = []

    @jax.custom_jvp
    def probe(outputs):
        return outputs

    def rule(primals, tangents):
        found.append(jax.tree.map(lambda y: not isinstance(y, SymbolicZero), tangents[0]))
        return primals[0], tangents[0]

    probe.defjvp(rule, symbolic_zeros=True)
    jax.eval_shape(lambda x: jax.jvp(lambda y: probe(function(y)), (x,), (x,)), at)
    return found[-1]


def known(leaf: Any) -> bool:
    """Whether the value of a leaf is known, though derivatives with respect to it may be wanted."""
    if not isinstance(leaf, Tracer):
        return True
    # Of a tracer for derivatives, the value that it is taken at.
    value = getattr(leaf, "to_concrete_value", None)
    return value is not None and value() is not None


def value_of(leaf: Any) -> Any:
    """The value of a leaf that is known, without derivatives."""
    while isinstance(leaf, Tracer):
        leaf = leaf.to_concrete_value()  # pyright: ignore[reportAttributeAccessIssue]
    return leaf


@functools.cache
def differentiable(program: KeptProgram, slopes_of: KeptProgram, structure: Any, history: int | None):
    """The answers of a scene from its leaves, with the derivative rule of this module.

    `slopes_of` gives the answers and the derivatives of their floats with respect to the leaves `numbers`, in
    rows.
    """

    @jax.custom_jvp
    def evaluate(*leaves):
        return program(*jax.tree.unflatten(structure, leaves), history=history)

    def rule(primals, tangents):
        live = [i for i, tangent in enumerate(tangents) if not isinstance(tangent, SymbolicZero)]
        podium, excitation, *_ = structure.children()
        numbers = numbers_of(primals[: podium.num_leaves + excitation.num_leaves])
        if not set(live) <= set(numbers) or any(isinstance(y, Tracer) for y in primals):
            return _traced(program, structure, history, primals, tangents, live)
        answer, slopes = slopes_of(*jax.tree.unflatten(structure, primals), numbers=numbers, history=history)
        directions = {numbers.index(i): tangents[i] for i in live}
        _, integers = answer
        floats_dot = jax.tree.map(lambda slope: along(np.asarray(slope), directions), slopes)
        return answer, (
            floats_dot,
            jax.tree.map(lambda y: np.zeros(np.shape(y), jax.dtypes.float0), integers),
        )

    evaluate.defjvp(rule, symbolic_zeros=True)
    return evaluate


def numbers_of(leaves) -> tuple[int, ...]:
    """Which leaves are single numbers, with respect to which there may be derivatives."""
    return tuple(
        i
        for i, y in enumerate(leaves)
        if np.ndim(y) == 0 and jnp.issubdtype(jnp.result_type(y), jnp.floating)
    )


def along(slope: np.ndarray, directions: dict[int, Any]):
    """The derivative of one answer along directions: as few and as small operations as can be, each of them
    is compiled."""
    terms = []
    for k, direction in directions.items():
        each = jax.lax.broadcast(direction, slope.shape[1:]) if slope.ndim > 1 else direction
        terms.append(jax.lax.mul(each, slope[k]))
    return functools.reduce(jax.lax.add, terms)


def _traced(program: KeptProgram, structure: Any, history: int | None, primals, tangents, live):
    """The rule where it has to be traced: with respect to samples, initial states, or inside another
    transformation."""

    def of_live(*values):
        leaves = list(primals)
        for i, value in zip(live, values, strict=True):
            leaves[i] = value
        return program.traced(*jax.tree.unflatten(structure, leaves), history=history)

    return jax.jvp(of_live, [primals[i] for i in live], [tangents[i] for i in live])
