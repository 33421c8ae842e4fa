"""Derivatives of programs, in forward mode together with the value.

A scene is one structure under one ground motion. Its answers are the floats and integers that its program
returns. There are two derivative rules. Outside jit, `differentiable` calls a stored program, which computes,
in one pass, the answers and the derivatives of the floats with respect to every scalar parameter of the
podium and the excitation. Inside a traced program, `_with_jacobian_rule` computes a Jacobian with respect to
only those scalars that are differentiated. `jax.grad`, `jacfwd` and `jvp` combine these derivatives.
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
from rockjax._programs.program import StoredProgram


def push_forward(
    function: Callable, arguments: Sequence[Any], slopes: Sequence[Any], *, loops: bool = False
) -> tuple[Any, Any, Any]:
    """Evaluate a function once, and propagate the derivatives of its arguments to its floats (forward mode).

    - `function`: function of `arguments` that returns (floats, other outputs)
    - `arguments`: arguments of the function: pytrees
    - `slopes`: for each argument, a pytree of the derivatives of its leaves with respect to n parameters,
      along a new first axis of length n; None for leaves that do not depend on the parameters
    - `loops`: whether the function has loops. With loops, the tangents are computed together with the
      values. Without loops, the function is linearised first, so that all n tangents share the
      intermediate results

    Returns (floats, derivatives of the floats along a new first axis of length n, other outputs).
    """
    is_none = lambda y: y is None
    leaves, structure = jax.tree.flatten(tuple(arguments), is_leaf=is_none)
    tangents = jax.tree.leaves(tuple(slopes), is_leaf=is_none)
    varied = [i for i, tangent in enumerate(tangents) if tangent is not None]
    point = [leaves[i] for i in varied]
    restricted = _restrict(lambda *leaves: function(*jax.tree.unflatten(structure, leaves)), leaves, varied)
    directions = [tangents[i] for i in varied]
    if loops:
        push = lambda *direction: jax.jvp(restricted, point, list(direction), has_aux=True)
        return jax.vmap(push, out_axes=(None, 0, None))(*directions)
    floats, linear, others = jax.linearize(restricted, *point, has_aux=True)
    # The barrier stores the coefficients of the linear function, so that all tangents share them.
    coefficients, linear_structure = jax.tree.flatten(linear)
    linear = jax.tree.unflatten(linear_structure, barrier(coefficients))
    return floats, jax.vmap(linear)(*directions), others


def _restrict(function: Callable, leaves: Sequence[Any], varied: Sequence[int]) -> Callable:
    """Return `function` as a function of the leaves with the indices `varied` only. The other leaves are
    fixed."""

    def restricted(*values):
        changed = list(leaves)
        for i, value in zip(varied, values, strict=True):
            changed[i] = value
        return function(*changed)

    return restricted


def _take_leaves(function: Callable, structure: Any, **keywords: Any) -> Callable:
    """Return `function` as a function of the leaves of its arguments. `structure` is the tree structure of
    the arguments."""
    return lambda *leaves: function(*jax.tree.unflatten(structure, leaves), **keywords)


def with_derivatives(function: Callable) -> Callable:
    """Give a function of a scene the derivative rule of `_with_jacobian_rule`.

    - `function`: function that returns (floats, integers). Its arguments are those of a scene, the solver's
      options last. It has two keywords: `capacity`, the number of accepted steps to store (None stores none),
      and `reversible`, True for loops that reverse mode can differentiate

    Returns a function of the same arguments and the keyword `capacity`.
    """

    @functools.wraps(function)
    def evaluate(*arguments, capacity: int | None = None):
        leaves, structure = jax.tree.flatten(arguments)
        plain, reversible = (
            _take_leaves(function, structure, capacity=capacity, reversible=y) for y in (False, True)
        )
        return _with_jacobian_rule(plain, reversible, arguments[-1].engine == "flat")(*leaves)

    return evaluate


def with_slopes(function: Callable) -> Callable:
    """Return a function that computes the answers of a scene and the derivatives of their floats.

    - `function`: as for `with_derivatives`

    The returned function has the keywords `leaf_indices` and `capacity`, and returns ((floats, integers),
    derivatives of the floats). The derivatives are with respect to the leaves of the arguments with the
    indices `leaf_indices`, one row per leaf.
    """

    @functools.wraps(function)
    def evaluate(*arguments, leaf_indices: tuple[int, ...], capacity: int | None = None):
        leaves, structure = jax.tree.flatten(arguments)
        function_of_leaves = _take_leaves(function, structure, capacity=capacity, reversible=False)
        floats, jacobian, integers = _with_jacobian(function_of_leaves, leaves, leaf_indices)
        return (floats, integers), jacobian

    return evaluate


def _with_jacobian(function: Callable, leaves: Sequence[Any], varied: Sequence[int]):
    """Return, from one pass, the floats, their derivatives with respect to the leaves with the indices
    `varied` (one row per leaf), and the integers."""
    point = [_first_order_only(y) if i in varied else y for i, y in enumerate(leaves)]
    unit_tangents: list[Any] = [None] * len(point)
    for k, i in enumerate(varied):
        unit_tangents[i] = jnp.eye(len(varied), dtype=point[i].dtype)[k]
    return push_forward(function, point, unit_tangents, loops=True)


def _with_jacobian_rule(function: Callable, reversible: Callable, has_derivatives: bool):
    """Give a function a derivative rule that computes the value and a Jacobian in one pass.

    - `function`: function leaves ↦ (floats, integers)
    - `reversible`: the same function with loops that reverse mode can differentiate; the rule uses this
      function for derivatives with respect to arrays
    - `has_derivatives`: whether the engine supports derivatives; if not, the rule raises an error
    """
    evaluate = jax.custom_jvp(function)

    def rule(primals, tangents):
        if not has_derivatives:
            raise NotImplementedError("rockjax: derivatives need Options(engine='flat')")
        varied = [i for i, tangent in enumerate(tangents) if not isinstance(tangent, SymbolicZero)]
        directions = tuple(tangents[i] for i in varied)
        if any(jnp.ndim(primals[i]) for i in varied):
            point = tuple(_first_order_only(primals[i]) for i in varied)
            restricted = _restrict(reversible, primals, varied)
            floats, floats_dot, integers = jax.jvp(restricted, point, directions, has_aux=True)
        else:
            floats, jacobian, integers = _with_jacobian(function, primals, varied)
            direction = jnp.stack(directions)
            floats_dot = jax.tree.map(lambda J: jnp.tensordot(direction, J, axes=1), jacobian)
        return (floats, integers), (floats_dot, _no_tangent(integers))

    evaluate.defjvp(rule, symbolic_zeros=True)
    return evaluate


def _no_tangent(integers: Any) -> Any:
    """Return the tangents that JAX expects for integers: zeros of type float0."""
    return jax.tree.map(lambda y: np.zeros(np.shape(y), jax.dtypes.float0), integers)


@jax.custom_jvp
def _first_order_only(x):
    """Return x in a form whose differentiation raises an error. Functions that compute first derivatives pass
    their arguments through this function. The first derivatives then cannot be differentiated again, because
    the derivatives of event times are exact only to first order."""
    return x


@_first_order_only.defjvp
def _first_order_only_jvp(primals, tangents):
    raise NotImplementedError(
        "rockjax has first derivatives only; second derivatives through events are not available"
    )


@jax.custom_jvp
def with_tangents(values):
    """Return values unchanged. If some of them have tangents, the others get zero tangents.

    JAX differentiates the body of a loop again whenever it finds a further field of the carry that has a
    tangent. If all fields have tangents from the start, JAX differentiates the body only once.
    """
    return values


def _with_tangents_jvp(primals, tangents):
    """Replace symbolic zeros by zero tangents, batched like the existing tangents."""
    # `zero` is computed from an existing tangent, so that `vmap` batches it like this tangent.
    is_absent = lambda y: isinstance(y, SymbolicZero)
    existing = next(y for y in jax.tree.leaves(tangents[0], is_leaf=is_absent) if not is_absent(y))
    zero = jax.lax.select(False, existing, jnp.zeros_like(existing))[(0,) * existing.ndim]

    def zeros(tangent):
        shape = tangent.aval.shape
        return jnp.broadcast_to(zero, shape) if shape else zero

    tangent = jax.tree.map(lambda y: zeros(y) if is_absent(y) else y, tangents[0], is_leaf=is_absent)
    return primals[0], tangent


with_tangents.defjvp(_with_tangents_jvp, symbolic_zeros=True)


def find_dependent_outputs(function: Callable, argument: Any) -> Any:
    """Return a pytree of booleans: for each output of a function, whether it depends on the argument. Only
    the shapes and types of `argument` are used."""
    dependences: list[Any] = []

    @jax.custom_jvp
    def probe(outputs):
        return outputs

    def rule(primals, tangents):
        dependences.append(jax.tree.map(lambda y: not isinstance(y, SymbolicZero), tangents[0]))
        return primals[0], tangents[0]

    probe.defjvp(rule, symbolic_zeros=True)
    jax.eval_shape(lambda x: jax.jvp(lambda y: probe(function(y)), (x,), (x,)), argument)
    if not dependences:  # JAX does not call the rule if no output depends on the argument
        return jax.tree.map(lambda _: False, jax.eval_shape(function, argument))
    return dependences[-1]


def is_concrete(leaf: Any) -> bool:
    """Return whether the value of a leaf is known. The values of numbers and arrays are known, and outside
    jit also those of tracers of `jax.grad` and `jax.jvp`."""
    if not isinstance(leaf, Tracer):
        return True
    # A tracer of `grad` or `jvp` holds the value at which the derivative is evaluated.
    value = getattr(leaf, "to_concrete_value", None)
    return value is not None and value() is not None


def value_of(leaf: Any) -> Any:
    """Return the value of a leaf for which `is_concrete` holds."""
    while isinstance(leaf, Tracer):
        leaf = leaf.to_concrete_value()  # pyright: ignore[reportAttributeAccessIssue]
    return leaf


@functools.cache
def differentiable(program: StoredProgram, slopes_of: StoredProgram, structure: Any, capacity: int | None):
    """Return a differentiable function that maps the leaves of a scene to its answers.

    - `program`: program that computes the answers
    - `slopes_of`: program that also computes the derivatives of the floats, see `with_slopes`
    - `structure`: tree structure of the arguments (podium, excitation, …)
    - `capacity`: number of nodes (accepted steps) to store; None stores none
    """

    @jax.custom_jvp
    def evaluate(*leaves):
        return program(*jax.tree.unflatten(structure, leaves), capacity=capacity)

    def rule(primals, tangents):
        varied = [i for i, tangent in enumerate(tangents) if not isinstance(tangent, SymbolicZero)]
        podium, excitation, *_ = structure.children()
        leaf_indices = scalar_positions(primals[: podium.num_leaves + excitation.num_leaves])
        if not set(varied) <= set(leaf_indices) or any(isinstance(y, Tracer) for y in primals):
            return _differentiate_traced(program, structure, capacity, primals, tangents, varied)
        scene = jax.tree.unflatten(structure, primals)
        answer, slopes = slopes_of(*scene, leaf_indices=leaf_indices, capacity=capacity)
        directions = {leaf_indices.index(i): tangents[i] for i in varied}
        _, integers = answer
        floats_dot = jax.tree.map(lambda slope: directional_derivative(np.asarray(slope), directions), slopes)
        return answer, (floats_dot, _no_tangent(integers))

    evaluate.defjvp(rule, symbolic_zeros=True)
    return evaluate


def scalar_positions(leaves) -> tuple[int, ...]:
    """Return the indices of the leaves that are floating-point scalars."""
    return tuple(
        i
        for i, y in enumerate(leaves)
        if np.ndim(y) == 0 and jnp.issubdtype(jnp.result_type(y), jnp.floating)
    )


def directional_derivative(slope: np.ndarray, directions: dict[int, Any]):
    """Return the derivative of one answer in a direction, Σ_k directions[k] · slope[k].

    - `slope`: derivatives of the answer with respect to the parameters, along the first axis
    - `directions`: scalar tangents of parameters, by the index k of the parameter on this axis

    Outside jit, JAX compiles every operation separately, so the function uses few operations, and only simple
    ones.
    """
    terms = []
    for k, direction in directions.items():
        factor = jax.lax.broadcast(direction, slope.shape[1:]) if slope.ndim > 1 else direction
        terms.append(jax.lax.mul(factor, slope[k]))
    return functools.reduce(jax.lax.add, terms)


def _differentiate_traced(
    program: StoredProgram, structure: Any, capacity: int | None, primals, tangents, varied
):
    """Differentiate the program through `jax.jit`. This is needed inside other transformations, and for
    derivatives with respect to samples, initial states or anything else but scalar parameters of the podium
    and the excitation."""
    traced = lambda *leaves: program.through_jit(*jax.tree.unflatten(structure, leaves), capacity=capacity)
    restricted = _restrict(traced, primals, varied)
    return jax.jvp(restricted, [primals[i] for i in varied], [tangents[i] for i in varied])
