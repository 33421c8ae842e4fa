"""Derivatives of a boundary with respect to parameters of podium and motion, by the implicit function
theorem.

The boundary a* is the least factor a on the motion, or the least amplitude a, that overturns the podium. At
the boundary the overturning margin M is zero (see docs/overturning.md). Therefore da* = −dM/(∂M/∂a), where dM
is the change of M due to a change of the parameters at a fixed a. If scenes have no margin, the time of
overturning replaces M (see `boundary_residual`). M, or the time that replaces it, is called the residual.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from rockjax._batch.batch import LANES
from rockjax._checks import array_module
from rockjax._engine.solve import solve
from rockjax._excitations.base import AbstractExcitation
from rockjax._motions.records import RecordPairs, Records
from rockjax._options import Options
from rockjax._parameters.sensitivities import with_factors
from rockjax._programs.program import StoredProgram
from rockjax._results import REST
from rockjax._structures import Podium

from .crossings import BRACKET_RTOL_SHARE
from .margin import boundary_residual, has_margin, margin_options

JUST_PAST = 1e-10  # least relative distance past the boundary at which the residual is differentiated


def _just_past(scale, options: Options):
    """Return the scale at which the residual of a boundary `scale` is differentiated. It lies on the
    overturning side, because its distance from the boundary is at least the width of the bracket of which the
    boundary is the middle."""
    numpy = array_module(scale, options.rtol)
    return numpy.multiply(scale, 1 + numpy.maximum(JUST_PAST, BRACKET_RTOL_SHARE * options.rtol))


def _residual(podium: Podium, motion: AbstractExcitation, options: Options, uses_margin: bool):
    (floats, _), _ = solve(podium, motion, REST, None, margin_options(options, uses_margin))
    return boundary_residual(floats, uses_margin)


def _root_factor(slope):
    """Return the derivative of the root of a function with respect to the function's value at the root,
    −1/`slope`, or NaN if `slope` is zero or not finite. `slope` is the derivative of the function at its
    root."""
    numpy = array_module(slope)
    is_usable = numpy.isfinite(slope) & (slope != 0)
    return numpy.where(is_usable, -1.0 / numpy.where(is_usable, slope, 1.0), numpy.nan)


def boundary_change(leaves, varied_tangents, scale, structure, varied: tuple[bool, ...], uses_margin: bool):
    """Return the tangent of a boundary (its change), given the tangents of parameters.

    The result is zero if there is no boundary, and NaN if the derivative of the residual with respect to the
    scale is zero or not finite.

    - `leaves`: leaves of the arguments of the search, with the tree structure `structure`
    - `varied_tangents`: tangents of the leaves that vary
    - `scale`: the boundary; inf if there is none
    - `structure`: tree structure of (podium, excitation, limit, (options, width))
    - `varied`: for each leaf, whether it varies
    - `uses_margin`: whether the overturning margin applies, see `has_margin`
    """
    numpy = array_module(leaves, scale)
    is_found = numpy.isfinite(scale)
    varied_indices = [k for k, is_varied in enumerate(varied) if is_varied]
    _, _, limit, (options, _) = jax.tree.unflatten(structure, leaves)
    past = numpy.where(is_found, _just_past(scale, options), limit)

    def residual(scale, *values):
        new_leaves = list(leaves)
        for k, value in zip(varied_indices, values, strict=True):
            new_leaves[k] = value
        podium, excitation, _, (options, _) = jax.tree.unflatten(structure, new_leaves)
        return _residual(podium, excitation.scaled(scale), options, uses_margin)

    point = tuple(leaves[k] for k in varied_indices)
    # The slope needs a separate call, because reverse mode transposes the call with `varied_tangents`.
    _, pushforward = jax.linearize(residual, past, *point)
    slope = numpy.asarray(pushforward(numpy.ones_like(past), *(numpy.zeros_like(y) for y in point)))
    change = pushforward(numpy.zeros_like(past), *varied_tangents)
    # Reverse mode multiplies by this factor even if there is no boundary, so it must be finite there.
    factor = numpy.where(is_found, _root_factor(slope), 0.0)
    return jnp.where(is_found, factor * change, 0.0)


@StoredProgram
def boundary_gradient(arguments, scale, *, positions: tuple[int, ...], uses_margin: bool):
    """Return the derivatives of the boundary with respect to parameters of podium and motion, one for each
    element of `positions`.

    - `arguments`: (podium, excitation, limit, (options, width))
    - `scale`: the boundary; inf if there is none
    - `positions`: indices of the parameters among the leaves of `arguments`
    - `uses_margin`: whether the overturning margin applies, see `has_margin`
    """
    leaves, structure = jax.tree.flatten(arguments)
    varied = tuple(k in positions for k in range(len(leaves)))
    change_along = lambda unit: boundary_change(leaves, list(unit), scale, structure, varied, uses_margin)
    return jax.vmap(change_along)(jnp.eye(len(positions), dtype=scale.dtype))


traced_boundary_change = jax.jit(boundary_change, static_argnames=("structure", "varied", "uses_margin"))


def log_sensitivities(
    podium: Podium,
    a: Float[np.ndarray, " n"],
    rows: dict[str, np.ndarray],
    names: tuple[str, ...],
    options: Options,
    *,
    pulse: Callable[[Any, Any], AbstractExcitation] | None = None,
    records: Records | RecordPairs | None = None,
) -> Float[np.ndarray, "names n"]:
    """Return d ln a/d ln y at boundaries a, for the parameters y.

    - `podium`: podium with scalar parameters
    - `a`: boundaries: pulse accelerations [m/s²] or factors on records [–], shape (n,). The derivatives
      are NaN for a boundary that is not finite
    - `rows`: for pulses the dict {"T_p": periods [s]}, for records {"which": indices in `records`}, both of
      shape (n,)
    - `names`: names of the parameters y: parameters of the podium, or `"T_p"`
    - `options`: options of the scenes
    - `pulse`: function (a_p, T_p) ↦ excitation, or None for records
    - `records`: table of records, or None for a pulse
    """
    result = np.full((len(names), a.size), np.nan)
    finite = np.flatnonzero(np.isfinite(a))
    for start in range(0, finite.size, LANES):
        group = finite[start : start + LANES]
        # All groups have the same size, so that they share one compiled program.
        padded = np.concatenate([group, np.repeat(group[-1:], LANES - group.size)])
        group_rows = {name: y[padded] for name, y in rows.items()}
        static = {"pulse": pulse, "names": names, "uses_margin": has_margin(options, podium)}
        slopes = _log_slopes(podium, records, group_rows, a[padded], options, **static)
        result[:, group] = np.asarray(slopes)[: group.size].T
    return result


@StoredProgram
def _log_slopes(
    podium: Podium, records, rows, a, options: Options, *, pulse, names: tuple[str, ...], uses_margin: bool
):
    def slopes_of_row(row: dict[str, Array], a):
        # `logs` are the logarithms of a factor on a and of a factor on each parameter.
        def residual(logs):
            factors = dict(zip(names, jnp.exp(logs[1:]), strict=True))
            past = _just_past(a, options) * jnp.exp(logs[0])
            if pulse is None:
                motion = records.pick(row["which"]).scaled(past)
            else:
                motion = pulse(past, row["T_p"] * factors.pop("T_p", 1.0))
            structure = with_factors(podium, list(factors), list(factors.values()))
            return _residual(structure, motion, options, uses_margin)

        slopes = jax.jacfwd(residual)(jnp.zeros(1 + len(names), a.dtype))
        return _root_factor(slopes[0]) * slopes[1:]

    return jax.vmap(slopes_of_row)(rows, a)
