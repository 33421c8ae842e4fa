"""Derivatives of a boundary with respect to numbers of podium and motion, by the implicit function theorem.

A residual M of a scene, the overturning margin, vanishes on the boundary a*. So da* = −dM/(∂M/∂a).
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
from rockjax._programs.program import KeptProgram
from rockjax._results import REST
from rockjax._structures import Podium

from .margin import boundary_residual, has_margin, margin_options

JUST_PAST = 1e-10  # relative distance to the boundary at which the margin is differentiated


def _residual(podium: Podium, motion: AbstractExcitation, options: Options, margin: bool):
    (floats, _), _ = solve(podium, motion, REST, None, margin_options(options, margin))
    return boundary_residual(floats, margin)


def _root_change(slope, change, fallback: float):
    """Return −`change`/`slope` of residuals, `fallback` where the slope is zero or not finite."""
    numpy = array_module(slope)
    usable = numpy.isfinite(slope) & (slope != 0)
    return jnp.where(usable, -change / numpy.where(usable, slope, 1.0), fallback)


def boundary_change(leaves, live_tangents, scale, structure, live: tuple[bool, ...], margin: bool):
    """Return the change of a boundary along tangents of its numbers; zero where there is no boundary.

    - `leaves`: all numbers of the search, as flattened from `structure`
    - `live_tangents`: tangents of the numbers that vary
    - `scale`: the boundary, inf where there is none
    - `structure`: pytree structure of (podium, excitation, limit, (options, width))
    - `live`: for each leaf, whether it varies
    - `margin`: whether the convention of overturning has a margin
    """
    numpy = array_module(leaves, scale)
    found = numpy.isfinite(scale)
    live_indices = [k for k, is_live in enumerate(live) if is_live]
    limit = jax.tree.unflatten(structure, leaves)[2]
    past = numpy.where(found, numpy.multiply(scale, 1 + JUST_PAST), limit)

    def residual(scale, *values):
        numbers = list(leaves)
        for k, value in zip(live_indices, values, strict=True):
            numbers[k] = value
        podium, excitation, _, (options, _) = jax.tree.unflatten(structure, numbers)
        return _residual(podium, excitation.scaled(scale), options, margin)

    point = tuple(leaves[k] for k in live_indices)
    # Separate calls, because reverse mode transposes the part that is linear in `live_tangents`.
    _, pushforward = jax.linearize(residual, past, *point)
    slope = numpy.asarray(pushforward(numpy.ones_like(past), *(numpy.zeros_like(y) for y in point)))
    change = pushforward(numpy.zeros_like(past), *live_tangents)
    return jnp.where(found, _root_change(slope, change, 0.0), 0.0)


@KeptProgram
def boundary_gradient(arguments, scale, *, numbers: tuple[int, ...], margin: bool):
    """Return the derivative of the boundary by each of some numbers of podium and motion, (numbers,).

    - `arguments`: (podium, excitation, limit, (options, width))
    - `scale`: the boundary, inf where there is none
    - `numbers`: indices of the leaves of `arguments` to differentiate by
    - `margin`: whether the convention of overturning has a margin
    """
    leaves, structure = jax.tree.flatten(arguments)
    live = tuple(k in numbers for k in range(len(leaves)))
    change_along = lambda unit: boundary_change(leaves, list(unit), scale, structure, live, margin)
    return jax.vmap(change_along)(jnp.eye(len(numbers), dtype=scale.dtype))


traced_boundary_change = jax.jit(boundary_change, static_argnames=("structure", "live", "margin"))


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
    """Return d ln a/d ln y at boundaries `a`, for the parameters y with these names (host).

    - `podium`: podium of single numbers
    - `a`: pulse accelerations [m/s²] or factors on records [–], NaN where there is no boundary; the
      derivatives are NaN there, too
    - `rows`: for each boundary the period `T_p` of the `pulse` [s], or `which` of the `records`, (n,)
    - `names`: parameters of the podium, or `"T_p"`
    - `options`: of the scenes
    - `pulse`: function (a_p, T_p) → excitation, or None for records
    - `records`: table of records, without a pulse
    """
    result = np.full((len(names), a.size), np.nan)
    at = np.flatnonzero(np.isfinite(a))
    for start in range(0, at.size, LANES):
        part = at[start : start + LANES]
        filled = np.concatenate([part, np.repeat(part[-1:], LANES - part.size)])
        chosen = {name: y[filled] for name, y in rows.items()}
        fixed = {"pulse": pulse, "names": names, "margin": has_margin(options, podium)}
        slopes = _log_slopes(podium, records, chosen, a[filled], options, **fixed)
        result[:, part] = np.asarray(slopes)[: part.size].T
    return result


@KeptProgram
def _log_slopes(
    podium: Podium, records, rows, a, options: Options, *, pulse, names: tuple[str, ...], margin: bool
):
    def one(row: dict[str, Array], a):
        def residual(logs):
            factors = dict(zip(names, jnp.exp(logs[1:]), strict=True))
            past = a * (1 + JUST_PAST) * jnp.exp(logs[0])
            if pulse is None:
                motion = records.pick(row["which"]).scaled(past)
            else:
                motion = pulse(past, row["T_p"] * factors.pop("T_p", 1.0))
            structure = with_factors(podium, list(factors), list(factors.values()))
            return _residual(structure, motion, options, margin)

        slopes = jax.jacfwd(residual)(jnp.zeros(1 + len(names), a.dtype))
        return _root_change(slopes[0], slopes[1:], jnp.nan)

    return jax.vmap(one)(rows, a)
