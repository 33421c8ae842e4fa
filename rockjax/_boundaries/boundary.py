"""The overturning boundary of a podium: the least scale of a ground motion that overturns it, with
derivatives.

Survival is not monotone in the amplitude, and under a record windows of overturning may be as narrow as 1e-4
of the range, with no sign of them at neighbouring scales. So scales are evaluated from below, as close to
each other as the narrowest window that must not be missed, up to the first that overturns; that change is
narrowed down by dividing its bracket. If all numbers are concrete, the scenes go through the batch path on
all cores; under `jit` they are rows of one loop.

Derivatives follow from the implicit function theorem, da* = −dM/(∂M/∂a), with the margin M just past the
boundary. M passes through zero with a nonzero slope, so this is well conditioned even though the trajectory
lingers at the saddle.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from rockjax import _results as results
from rockjax._checks import array_module, as_array, as_float, float_type, require
from rockjax._engine.solve import solve
from rockjax._excitations.base import AbstractExcitation
from rockjax._excitations.ground import GroundMotion, ScaledByAmplitude
from rockjax._motions.convert import AnyMotion, as_excitation, as_pulse
from rockjax._motions.record import PaddedRecord
from rockjax._motions.records import Records
from rockjax._options import Options
from rockjax._parameters.variants import pulse_acceleration
from rockjax._programs.derivatives import directional_derivative, is_concrete, scalar_positions, value_of
from rockjax._programs.program import KeptProgram
from rockjax._responses.arguments import check_range, check_types
from rockjax._results import REST
from rockjax._structures import Podium
from rockjax._tree import Module
from rockjax._types import Value

from .crossings import scan
from .first import WIDTH, FirstBoundary, first_boundary
from .implicit import boundary_gradient, traced_boundary_change
from .margin import DEFAULT_WIDTH, has_margin, margin_options, scan_options, signed_margin
from .refinement import SPACING_SHARE

BOUNDARY = Options(rtol=1e-11, atol=1e-13)  # the accuracy of a boundary is that of its scenes
ONE_SIDED_BELOW = 1e-4  # a surviving dip of the margin below this: another branch is about to take over


class Boundary(Module):
    """Overturning boundary: the least scale at which a ground motion overturns a podium.

    - `scale`: the least factor of the motion that overturns, inf if none in the range does; differentiable,
      with derivative zero where it is inf [–]
    - `found`: whether there is one
    - `impacts`: number of impacts before overturning, just past the boundary
    - `dip`: the least overturning margin at a surviving scale below the boundary where the margin has a
      minimum, 1 without any: the distance to another branch at lower scales
    - `one_sided`: the dip is so low that the minimum is about to jump to another branch; the derivative is
      one-sided
    - `certain_width`: every interval of overturning scales below `scale` that is wider than this has been
      found: the requested `width` times `max_scale`, more if scenes did not finish [–]
    """

    scale: Float[Array, "*batch"]
    found: Bool[Array, "*batch"]
    impacts: Int[Array, "*batch"]
    dip: Float[Array, "*batch"]
    one_sided: Bool[Array, "*batch"]
    certain_width: Float[Array, "*batch"]

    def __repr__(self):
        if isinstance(self.scale, Tracer) or jnp.ndim(self.scale):
            return f"Boundary(of shape {jnp.shape(self.scale)})"
        if not self.found:
            return f"Boundary: nothing overturns; least dip of the margin {float(self.dip):.3g}"
        side = ", one-sided: the minimum is about to jump" if self.one_sided else ""
        after = f"after {int(self.impacts)} impacts"
        below = (
            f"dip below "
            f"{float(self.dip):.3g}{side}; no window wider than {float(self.certain_width):.2g} below"
        )
        return f"Boundary: overturns from {float(self.scale):.10g} {after}; {below}"


_amplitude = KeptProgram(pulse_acceleration)


def overturning_acceleration(
    podium: Podium,
    pulse: Callable[[Any, Any], AbstractExcitation],
    T_p,
    *,
    max_acceleration_ratio=12.0,
    options: Options = BOUNDARY,
    width: float = DEFAULT_WIDTH,
    resolution: int = 128,
) -> Value:
    """Return the least pulse acceleration a_p that overturns a podium [m/s²], inf if none up to the limit
    does.

    Works under `jit`, `vmap`, `grad`, `jacfwd` with respect to every number of `podium` and to `T_p`; the
    derivative is exact on its branch, and zero where the result is inf. [`rockjax.overturning_boundary`][]
    returns more details.

    - `podium`: podium of single numbers
    - `pulse`: a pulse class such as `rockjax.Ricker`, or a function (a_p, T_p) → excitation that scales with
      a_p. A function may also return a [`rockjax.GroundMotion`][], whose vertical motion need not depend on
      a_p; its numbers then are constants
    - `T_p`: pulse period, > 0 [s]
    - `max_acceleration_ratio`: end of the search, a_p/(g tan α) [–]
    - `options`: of the scenes; `options.overturn_ratio` defines overturning
    - `width`, `resolution`: see [`rockjax.overturning_boundary`][]

    Raises `ValueError` for invalid inputs, if they are concrete.
    """
    owner = "overturning_acceleration"
    check_types(owner, podium, options)
    require(owner, "T_p", T_p, lambda v: v > 0, "finite and > 0")
    positive_limit(owner, "max_acceleration_ratio", max_acceleration_ratio)
    limit = _amplitude(_without_tangents(podium), as_float(max_acceleration_ratio))
    pulse = as_pulse(owner, pulse)
    motion = pulse(1.0, T_p)
    if isinstance(motion, GroundMotion):  # need not be proportional to a_p
        motion = ScaledByAmplitude(as_float(T_p), pulse)
    return overturning_boundary(
        podium, motion, max_scale=limit, options=options, width=width, resolution=resolution
    ).scale


def overturning_scale(
    podium: Podium,
    excitation: AnyMotion,
    *,
    max_scale: Float[ArrayLike, ""] = 10.0,
    options: Options = BOUNDARY,
    width: float = DEFAULT_WIDTH,
    resolution: int = 128,
) -> Value:
    """Return the least factor of a ground motion that overturns a podium [–], inf if none does.

    - `podium`, `excitation`, `max_scale`, `options`, `width`, `resolution`: as for
      [`rockjax.overturning_boundary`][], whose `scale` this is

    Raises `ValueError` for invalid inputs, if they are concrete.
    """
    return overturning_boundary(
        podium, excitation, max_scale=max_scale, options=options, width=width, resolution=resolution
    ).scale


def overturning_boundary(
    podium: Podium,
    excitation: AnyMotion,
    *,
    max_scale: Float[ArrayLike, ""] = 10.0,
    options: Options = BOUNDARY,
    width: float = DEFAULT_WIDTH,
    resolution: int = 128,
) -> Boundary:
    """Return the least factor in (0, max_scale] by which a ground motion overturns a podium, with its
    details.

    Works under `jit` and `vmap`; `scale` has derivatives with respect to every number of `podium` and
    `excitation`. `options.overturn_ratio` defines overturning; above 1 there is no margin, the dips are those
    of the peak rotation, and the derivative is that of the time of overturning.

    - `podium`: podium of single numbers
    - `excitation`: ground motion that can be scaled
    - `max_scale`: end of the search, > 0 [–]
    - `options`: of the scenes; they determine the accuracy of the boundary
    - `width`: every interval of overturning scales below the boundary that is wider than this share of
      `max_scale` is found, in (0, 0.1]. From the first scale that lifts the columns up to the boundary, the
      spacing of the scales follows from their derivatives, under `jit` it is `width`: a `max_scale` far above
      the boundary costs little, a range in which nothing overturns up to 1/`width` scenes
    - `resolution`: least number of scales in the range, regardless of `width`

    Raises `ValueError` for invalid inputs, if they are concrete.
    """
    owner = "overturning_boundary"
    check_types(owner, podium, options)
    podium = podium.split().without_idle_restrainers().without_elevation()
    excitation = as_excitation(owner, excitation)
    check_range(owner, podium, excitation, None, options)
    positive_limit(owner, "max_scale", max_scale)
    check_search(owner, width, resolution)
    if any(map(jnp.ndim, (*jax.tree.leaves(podium), *excitation.support, max_scale))):
        raise ValueError(
            f"{owner}: podium, excitation and its end must be single ones; for several use jax.vmap, or "
            f"rockjax.overturning_spectrum for all frequencies of a pulse"
        )
    excitation.scaled(1.0)  # raises for a motion that cannot be scaled
    spacing = as_float(array_module(width).minimum(width, 1 / resolution))
    return _boundary(podium, excitation, as_float(max_scale), options, spacing, has_margin(options, podium))


def check_search(owner: str, width, resolution) -> None:
    """Raise `ValueError`, in the name of `owner`, for an invalid width or resolution."""
    require(owner, "width", width, lambda v: (v > 0) & (v <= 0.1), "in (0, 0.1]")
    if jnp.ndim(width):
        raise ValueError(f"{owner}: width must be a single number, got shape {jnp.shape(width)}")
    if not isinstance(resolution, int) or resolution < WIDTH:
        raise ValueError(f"{owner}: resolution must be a whole number ≥ {WIDTH}, got {resolution!r}")


def positive_limit(owner: str, name: str, value) -> None:
    require(owner, name, value, lambda v: v > 0, "finite and > 0")


def _boundary(podium: Podium, excitation, limit, options: Options, width, margin: bool) -> Boundary:
    excitation = excitation.common_form()
    leaves, structure = jax.tree.flatten((podium, excitation, limit, (options, width)))
    arguments_structure = jax.tree.structure((podium, excitation))
    search = _make_search(structure, margin)

    def rule(primals, tangents):
        live = tuple(not isinstance(tangent, SymbolicZero) for tangent in tangents)
        live_tangents = [tangent for tangent, is_live in zip(tangents, live, strict=True) if is_live]
        numbers = scalar_positions(primals[: arguments_structure.num_leaves])
        live_indices = [k for k, is_live in enumerate(live) if is_live]
        if all(map(is_concrete, primals)) and set(live_indices) <= set(numbers):
            arguments = jax.tree.unflatten(structure, primals)
            boundary_gradient.ahead(arguments, np.zeros((), float_type()), numbers=numbers, margin=margin)
            first = search(*primals)
            slopes = boundary_gradient(arguments, first.scale, numbers=numbers, margin=margin)
            change = directional_derivative(
                np.asarray(slopes), dict(zip(map(numbers.index, live_indices), live_tangents, strict=True))
            )
        else:
            first = search(*primals)
            change = traced_boundary_change(
                list(primals), live_tangents, first.scale, structure, live, margin
            )
        none = np.zeros(jnp.shape(first.impacts), jax.dtypes.float0)
        zero = array_module(first).zeros_like(first.scale)
        return first, FirstBoundary(change, zero, zero, none)

    differentiable = jax.custom_jvp(search)
    differentiable.defjvp(rule, symbolic_zeros=True)  # pyright: ignore[reportArgumentType]
    first = jax.tree.map(as_array, differentiable(*leaves))
    values = _without_tangents(first)
    numpy = array_module(values)
    is_found, low = numpy.isfinite(values.scale), numpy.less(values.dip, ONE_SIDED_BELOW)
    return Boundary(first.scale, as_array(is_found), first.impacts, first.dip, as_array(low), first.certain)


def _without_tangents(tree):
    """Return concrete numbers without derivatives; outside jit, every jnp operation would compile
    separately."""
    return jax.tree.map(value_of, tree) if all(map(is_concrete, jax.tree.leaves(tree))) else tree


def _make_search(structure, margin: bool) -> Callable[..., FirstBoundary]:
    """Return the search as a function of all numbers; it runs on the host if they are concrete, single or
    batched."""

    @jax.custom_batching.custom_vmap
    def program(*leaves):
        return _search_in_program(leaves, structure, margin)

    @program.def_vmap
    def _(count, mapped, *leaves):
        # The settings of the search are common to all.
        common = not any(jax.tree.leaves(jax.tree.unflatten(structure, mapped)[3]))
        if common and not _any_traced(leaves):
            rows = [
                np.asarray(y) if own else np.asarray(y)[None] for y, own in zip(leaves, mapped, strict=True)
            ]
            first = jax.tree.map(as_array, _search_on_host(rows, count, structure, margin))
            return first, FirstBoundary(True, True, True, True)
        axes = [0 if own else None for own in mapped]
        first = jax.vmap(lambda *leaves: _search_in_program(leaves, structure, margin), axes)(*leaves)
        return first, FirstBoundary(True, True, True, True)

    def search(*leaves):
        if _any_traced(leaves):
            return program(*leaves)
        first = _search_on_host([np.asarray(y)[None] for y in leaves], 1, structure, margin)
        # NumPy, because under a transformation JAX would trace even concrete numbers.
        return jax.tree.map(lambda y: np.asarray(y[0]), first)

    return search


def _any_traced(leaves) -> bool:
    return any(isinstance(y, Tracer) for y in leaves)


def _search_on_host(rows: list[np.ndarray], count: int, structure, margin: bool) -> FirstBoundary:
    """Return the first boundaries of `count` searches side by side; `rows` hold a number once for all, or
    once for each search."""
    podium, excitation, limit, settings = jax.tree.unflatten(structure, rows)
    limits = np.broadcast_to(limit, count)

    def plane(line, part):
        pick = lambda y: y[0] if y.shape[0] == 1 else y[np.asarray(line, np.int32)]
        motion = _pick_motions(excitation, np.asarray(line, np.int32), pick)
        return jax.tree.map(pick, podium), motion.scaled(part * limits[np.asarray(line, np.int32)])

    options, width = jax.tree.map(lambda y: float(y[0]), settings)
    found = scan(plane, np.arange(count), (0.0, 1.0), WIDTH, options, refine="first", width=width)
    first, impacts = (y[:, 0] for y in found.crossings.table(count))
    scale = np.where(np.isnan(first), np.inf, first) * limits
    dtype = float_type()
    scale, dip, certain = (np.asarray(y, dtype) for y in (scale, found.dip, found.certain * limits))
    return FirstBoundary(scale, dip, certain, np.maximum(impacts, 0))


def _pick_motions(excitation, line: np.ndarray, pick) -> Any:
    """Return the motions of scenes of these searches; the samples of many records stay in one table."""
    if isinstance(excitation, GroundMotion):
        both = (_pick_motions(y, line, pick) for y in (excitation.horizontal, excitation.vertical))
        return GroundMotion(*both)
    if isinstance(excitation, PaddedRecord) and excitation.acceleration.shape[0] > 1:
        one = lambda y: np.broadcast_to(y, len(excitation.acceleration))
        dt, scale, start = (one(y) for y in (excitation.dt, excitation.scale, excitation.t_start))
        return Records(
            excitation.acceleration,
            as_array(one(excitation.count)),
            as_array(dt),
            as_array(start),
            line,
            scale[line],
        )
    return jax.tree.map(pick, excitation)


@functools.partial(jax.jit, static_argnames=("structure", "margin"))
def _search_in_program(leaves, structure, margin: bool) -> FirstBoundary:
    podium, excitation, limit, (options, width) = jax.tree.unflatten(structure, leaves)
    search_options = margin_options(options, margin)
    coarse = scan_options(search_options, width)

    def solve_row(scales, sharp):
        accuracy = jax.tree.map(lambda a, b: jnp.where(sharp, a, b), search_options, coarse)

        def one(scale):
            (floats, _), (integers, _) = solve(podium, excitation.scaled(scale), REST, None, accuracy)
            value = signed_margin(floats, integers["overturned"], options.overturn_ratio, margin)
            return jnp.where(integers["code"] > results.OVERTURNED, jnp.nan, value), integers["impacts"]

        return jax.vmap(one)(scales)

    return first_boundary(solve_row, limit, SPACING_SHARE * width * limit)
