"""The overturning boundary: the least scale at which a ground motion overturns a podium, and its derivatives
with respect to the parameters of podium and motion. A scale is a factor on the motion.

A scene is one podium under one scaled motion. A podium that overturns at one scale may survive a larger
scale. Under a record, windows (intervals of scales that overturn) may be as narrow as 1e-4 of the searched
range, and neighbouring scales may show no sign of them. The search therefore evaluates scales in ascending
order up to the first that overturns. The distances between the scales are chosen to find every window wider
than a requested width. The change from survival to overturning is then enclosed in ever narrower brackets. If
no value is traced by JAX, the scenes are solved as batches on all cores. Under `jit` a loop solves a fixed
number of scales at a time.

The overturning margin M of a scene is positive if the columns survive and negative if they overturn. The
implicit function theorem gives the derivatives of the boundary a*: da* = −dM/(∂M/∂a), where a is the scale,
and dM is the change of M due to a change of the parameters at a fixed scale. dM and ∂M/∂a are evaluated just
past the boundary. There the columns stay near the unstable equilibrium for a long time, but the derivatives
are well conditioned, because M passes through zero with a nonzero slope.
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
from rockjax._programs.program import StoredProgram
from rockjax._responses.arguments import check_range, check_types, warn_of_small_restitution
from rockjax._results import REST
from rockjax._structures import Podium
from rockjax._tree import Module
from rockjax._types import Value

from .crossings import scan
from .first import ROW_SIZE, FirstBoundary, first_boundary
from .implicit import boundary_gradient, traced_boundary_change
from .margin import DEFAULT_WIDTH, has_margin, margin_options, scan_options, signed_margin
from .refinement import SPACING_SHARE

MAX_ACCELERATION_RATIO = 12.0  # default end of the search for pulses, a_p/(g tan α) [–]
BOUNDARY = Options(rtol=1e-11, atol=1e-13)  # default options, which determine the accuracy of a boundary
ONE_SIDED_BELOW = 1e-4  # if the dip (see `Boundary`) is lower, the boundary is about to jump


class Boundary(Module):
    """Overturning boundary: the least scale at which a ground motion overturns a podium.

    - `scale`: the least factor on the motion that overturns [–], inf if the search finds none in the range;
      differentiable (the derivative is zero if `scale` is inf, and NaN if it cannot be computed). If scenes
      did not finish, a lower scale may overturn; see `finished_to`
    - `found`: True if the search finds a scale in the range that overturns
    - `impacts`: number of impacts before overturning, at a scale just past the boundary; 0 if no scale is
      found
    - `dip`: the lowest local minimum of the overturning margin at scales below the boundary; 1 if there is no
      minimum. If the dip became zero, the boundary would jump to the scale of this minimum
    - `one_sided`: True if the dip is so low that the boundary is about to jump; the derivative is then
      one-sided
    - `certain_width`: estimated width of the widest interval of overturning scales below `scale` that the
      search may have missed [–]. This width is at most the requested `width` times `max_scale`, unless scenes
      did not finish
    - `finished_to`: scale up to which all scenes of the search finished [–]; `max_scale` or the last scale
      of the search if all finished
    """

    scale: Float[Array, "*batch"]
    found: Bool[Array, "*batch"]
    impacts: Int[Array, "*batch"]
    dip: Float[Array, "*batch"]
    one_sided: Bool[Array, "*batch"]
    certain_width: Float[Array, "*batch"]
    finished_to: Float[Array, "*batch"]

    def __repr__(self):
        if isinstance(self.scale, Tracer) or jnp.ndim(self.scale):
            return f"Boundary(shape {jnp.shape(self.scale)})"
        if not self.found:
            return (
                f"Boundary: no overturning scale found; least dip of the margin {float(self.dip):.3g}, "
                f"and no window is wider than {float(self.certain_width):.2g}"
            )
        side = " (one-sided: the boundary is about to jump there)" if self.one_sided else ""
        after = f"after {int(self.impacts)} impacts"
        below = (
            f"below it the least dip of the margin is {float(self.dip):.3g}{side}, "
            f"and no window is wider than {float(self.certain_width):.2g}"
        )
        return f"Boundary: overturns from {float(self.scale):.10g} {after}; {below}"


_amplitude = StoredProgram(pulse_acceleration)


def overturning_acceleration(
    podium: Podium,
    pulse: Callable[[Any, Any], AbstractExcitation],
    T_p,
    *,
    max_acceleration_ratio=MAX_ACCELERATION_RATIO,
    options: Options = BOUNDARY,
    width: float = DEFAULT_WIDTH,
    resolution: int = 128,
) -> Value:
    """Return the least pulse acceleration a_p that overturns a podium [m/s²], or inf if the search finds
    none.

    The function works under `jit` and `vmap`. `grad` and `jacfwd` give derivatives with respect to `T_p` and
    every parameter of `podium`. The derivatives are exact unless the boundary jumps, and zero if the result
    is inf. If scenes did not finish, lower accelerations may overturn; [`rockjax.overturning_boundary`][]
    returns the details.

    - `podium`: podium with scalar parameters
    - `pulse`: a class of pulses such as `rockjax.Ricker`, or a function (a_p, T_p) ↦ excitation that is
      proportional to a_p. The function may also return a [`rockjax.GroundMotion`][], whose vertical
      component may be independent of a_p. Parameters of such a motion other than a_p and T_p are held
      constant under differentiation
    - `T_p`: pulse period, > 0 [s]
    - `max_acceleration_ratio`: end of the search, a_p/(g tan α), > 0 [–]
    - `options`: options of the scenes; a scene overturns if |θ|/α reaches `options.overturn_ratio`
    - `width`, `resolution`: see [`rockjax.overturning_boundary`][]

    Raises `ValueError` for invalid inputs that are not traced.
    """
    return acceleration_boundary(
        podium, pulse, T_p, max_acceleration_ratio, options=options, width=width, resolution=resolution
    ).scale


def acceleration_boundary(
    podium: Podium,
    pulse: Callable[[Any, Any], AbstractExcitation],
    T_p,
    max_acceleration_ratio=MAX_ACCELERATION_RATIO,
    **settings: Any,
) -> Boundary:
    """Return the boundary whose `scale` is the result of `overturning_acceleration`. All scales of the result
    are pulse accelerations [m/s²].

    - `podium`, `pulse`, `T_p`, `max_acceleration_ratio`: as for `overturning_acceleration`
    - `settings`: `options`, `width` and `resolution`, as for `overturning_boundary`

    Raises `ValueError` for invalid inputs that are not traced.
    """
    owner, options = "overturning_acceleration", settings.setdefault("options", BOUNDARY)
    check_types(owner, podium, options)
    require(owner, "T_p", T_p, lambda v: v > 0, "finite and > 0")
    check_limit(owner, "max_acceleration_ratio", max_acceleration_ratio)
    limit = _amplitude(_without_tangents(podium), as_float(max_acceleration_ratio))
    pulse = as_pulse(owner, pulse)
    motion = pulse(1.0, T_p)
    if isinstance(motion, GroundMotion):  # its vertical component need not be proportional to a_p
        motion = ScaledByAmplitude(as_float(T_p), pulse)
    return overturning_boundary(podium, motion, max_scale=limit, **settings)


def overturning_scale(
    podium: Podium,
    excitation: AnyMotion,
    *,
    max_scale: Float[ArrayLike, ""] = 10.0,
    options: Options = BOUNDARY,
    width: float = DEFAULT_WIDTH,
    resolution: int = 128,
) -> Value:
    """Return the least factor on a ground motion that overturns a podium [–], or inf if the search finds none
    up to `max_scale`. If scenes did not finish, lower factors may overturn; see [`rockjax.Boundary`][].

    - `podium`, `excitation`, `max_scale`, `options`, `width`, `resolution`: as for
      [`rockjax.overturning_boundary`][], whose result contains this factor as the field `scale`

    Raises `ValueError` for invalid inputs that are not traced.
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
    """Return the least factor in (0, max_scale] on a ground motion that overturns a podium, with details.

    The function works under `jit` and `vmap`. `scale` has derivatives with respect to every parameter of
    `podium` and `excitation`. A scene overturns if |θ| reaches the overturning angle,
    `options.overturn_ratio` times α. If this angle exceeds the stability angle, or if JAX traces
    `options.overturn_ratio`, there is no overturning margin. Dips then follow from the peak rotation, and
    derivatives follow from the time of overturning.

    - `podium`: podium with scalar parameters
    - `excitation`: ground motion that can be scaled
    - `max_scale`: end of the search, > 0 [–]
    - `options`: options of the scenes, which determine the accuracy of the boundary
    - `width`: resolution of the search as a fraction of `max_scale`, in (0, 0.1]. The search is designed to
      find every interval of overturning scales below the returned boundary that is wider than this fraction.
      The search takes fine steps only between the first scale at which the columns lift and the boundary. The
      length of these steps follows from derivatives of the margin; under `jit` it is about `width` times
      `max_scale`. A `max_scale` far above the boundary costs little time, but a range in which nothing
      overturns needs up to about 1/`width` scenes
    - `resolution`: a whole number ≥ 32; a `width` above 1/`resolution` is reduced to 1/`resolution`

    Raises `ValueError` for invalid inputs that are not traced.
    """
    owner = "overturning_boundary"
    check_types(owner, podium, options)
    warn_of_small_restitution(podium, stacklevel=3)
    podium = podium.split_rows().without_idle_restrainers().without_elevation()
    excitation = as_excitation(owner, excitation)
    check_range(owner, podium, excitation, None, options)
    check_limit(owner, "max_scale", max_scale)
    check_search(owner, width, resolution)
    if any(map(jnp.ndim, (*jax.tree.leaves(podium), *excitation.support, max_scale))):
        raise ValueError(
            f"{owner}: podium, excitation and max_scale must be scalar; for several use jax.vmap, or "
            f"rockjax.overturning_spectrum for all frequencies of a pulse"
        )
    excitation.scaled(1.0)  # raises for a motion that cannot be scaled
    spacing = as_float(array_module(width).minimum(width, 1 / resolution))
    return _boundary(podium, excitation, as_float(max_scale), options, spacing, has_margin(options, podium))


def check_search(owner: str, width, resolution) -> None:
    """Raise `ValueError` for an invalid width or resolution."""
    require(owner, "width", width, lambda v: (v > 0) & (v <= 0.1), "in (0, 0.1]")
    if jnp.ndim(width):
        raise ValueError(f"{owner}: width must be a single number, got shape {jnp.shape(width)}")
    if not isinstance(resolution, int) or resolution < ROW_SIZE:
        raise ValueError(f"{owner}: resolution must be a whole number ≥ {ROW_SIZE}, got {resolution!r}")


def check_limit(owner: str, name: str, value) -> None:
    """Raise `ValueError` unless the end of a search is one number, finite and > 0."""
    if np.ndim(value):
        raise ValueError(f"{owner}: {name} must be one number, got shape {np.shape(value)}")
    require(owner, name, value, lambda v: v > 0, "finite and > 0")


def _boundary(podium: Podium, excitation, limit, options: Options, width, uses_margin: bool) -> Boundary:
    excitation = excitation.common_form()
    leaves, structure = jax.tree.flatten((podium, excitation, limit, (options, width)))
    arguments_structure = jax.tree.structure((podium, excitation))
    search = _make_search(structure, uses_margin)

    def rule(primals, tangents):
        varied = tuple(not isinstance(tangent, SymbolicZero) for tangent in tangents)
        given_tangents = [tangent for tangent, is_varied in zip(tangents, varied, strict=True) if is_varied]
        positions = scalar_positions(primals[: arguments_structure.num_leaves])
        varied_indices = [k for k, is_varied in enumerate(varied) if is_varied]
        if all(map(is_concrete, primals)) and set(varied_indices) <= set(positions):
            arguments = jax.tree.unflatten(structure, primals)
            # The program of the derivatives is loaded or compiled in another thread during the search.
            boundary_gradient.prepare(
                arguments, np.zeros((), float_type()), positions=positions, uses_margin=uses_margin
            )
            first = search(*primals)
            slopes = boundary_gradient(arguments, first.scale, positions=positions, uses_margin=uses_margin)
            change = directional_derivative(
                np.asarray(slopes),
                dict(zip(map(positions.index, varied_indices), given_tangents, strict=True)),
            )
        else:
            first = search(*primals)
            change = traced_boundary_change(
                list(primals), given_tangents, first.scale, structure, varied, uses_margin
            )
        no_tangent = np.zeros(jnp.shape(first.impacts), jax.dtypes.float0)
        zero = array_module(first).zeros_like(first.scale)
        return first, FirstBoundary(change, zero, zero, no_tangent, zero)

    differentiable = jax.custom_jvp(search)
    differentiable.defjvp(rule, symbolic_zeros=True)  # pyright: ignore[reportArgumentType]
    first = jax.tree.map(as_array, differentiable(*leaves))
    values = _without_tangents(first)
    numpy = array_module(values)
    is_found, is_one_sided = numpy.isfinite(values.scale), numpy.less(values.dip, ONE_SIDED_BELOW)
    return Boundary(
        first.scale,
        as_array(is_found),
        first.impacts,
        first.dip,
        as_array(is_one_sided),
        first.certain_width,
        first.finished_to,
    )


def boundary_slopes(
    podium: Podium, excitation: AbstractExcitation, scale: float, max_scale: float, options: Options
) -> tuple[np.ndarray, tuple[int, ...]]:
    """Return the derivatives of a known boundary with respect to the k scalar parameters of podium and
    excitation, shape (k,), and the indices of these parameters among the leaves of (podium,
    excitation.common_form()).

    - `podium`, `excitation`, `max_scale`, `options`: arguments of the search; no value may be traced
    - `scale`: the boundary; if it is inf, the derivatives are zero
    """
    scene = podium, excitation.common_form()
    positions = scalar_positions(jax.tree.leaves(scene))
    arguments = (*scene, as_float(max_scale), (options, as_float(DEFAULT_WIDTH)))
    uses_margin = has_margin(options, podium)
    slopes = boundary_gradient(arguments, as_float(scale), positions=positions, uses_margin=uses_margin)
    return np.asarray(slopes), positions


def _without_tangents(tree):
    """Return the values of a pytree as numbers, without tangents. A pytree with traced values is returned
    unchanged. Later operations on numbers need no compilation, whereas outside jit every jnp operation on
    tangents compiles separately."""
    return jax.tree.map(value_of, tree) if all(map(is_concrete, jax.tree.leaves(tree))) else tree


def _make_search(structure, uses_margin: bool) -> Callable[..., FirstBoundary]:
    """Return the search as a function of all leaves of its arguments. If the leaves are numbers (not traced
    by JAX), the search uses NumPy, also under `vmap`."""

    @jax.custom_batching.custom_vmap
    def program(*leaves):
        return _search_in_program(leaves, structure, uses_margin)

    @program.def_vmap
    def _(count, mapped, *leaves):
        # Searches in batches share the same options and width.
        has_common_settings = not any(jax.tree.leaves(jax.tree.unflatten(structure, mapped)[3]))
        if has_common_settings and not _any_traced(leaves):
            rows = [
                np.asarray(y) if is_mapped else np.asarray(y)[None]
                for y, is_mapped in zip(leaves, mapped, strict=True)
            ]
            first = jax.tree.map(as_array, _search_in_batches(rows, count, structure, uses_margin))
            return first, FirstBoundary(*[True] * len(FirstBoundary._fields))
        axes = [0 if is_mapped else None for is_mapped in mapped]
        first = jax.vmap(lambda *leaves: _search_in_program(leaves, structure, uses_margin), axes)(*leaves)
        return first, FirstBoundary(*[True] * len(FirstBoundary._fields))

    def search(*leaves):
        if _any_traced(leaves):
            return program(*leaves)
        first = _search_in_batches([np.asarray(y)[None] for y in leaves], 1, structure, uses_margin)
        # NumPy arrays keep their values inside a transformation such as `grad`; JAX arrays would be traced.
        return jax.tree.map(lambda y: np.asarray(y[0]), first)

    return search


def _any_traced(leaves) -> bool:
    return any(isinstance(y, Tracer) for y in leaves)


def _search_in_batches(rows: list[np.ndarray], count: int, structure, uses_margin: bool) -> FirstBoundary:
    """Return the first boundaries of `count` searches, which are solved together.

    - `rows`: leaves of the arguments with a first axis of length 1 (common to all searches) or `count`
    - `count`: number of searches
    - `structure`: tree structure of (podium, excitation, limit, (options, width))
    - `uses_margin`: True if there is an overturning margin (see `has_margin`)
    """
    podium, excitation, limit, settings = jax.tree.unflatten(structure, rows)
    limits = np.broadcast_to(limit, count)

    # Each search is a line of the scan, along which the scale goes from 0 to 1 times the limit of the search.
    def plane(line, fraction):
        pick = lambda y: y[0] if y.shape[0] == 1 else y[np.asarray(line, np.int32)]
        motion = _pick_motions(excitation, np.asarray(line, np.int32), pick)
        return jax.tree.map(pick, podium), motion.scaled(fraction * limits[np.asarray(line, np.int32)])

    options, width = jax.tree.map(lambda y: float(y[0]), settings)
    result = scan(plane, np.arange(count), (0.0, 1.0), ROW_SIZE, options, first_only=True, width=width)
    first, impacts = result.crossings.first(count)
    scale = first * limits
    dtype = float_type()
    values = scale, result.dip, result.certain_width * limits, result.finished_to * limits
    scale, dip, certain, finished_to = (np.asarray(y, dtype) for y in values)
    return FirstBoundary(scale, dip, certain, np.maximum(impacts, 0), finished_to)


def _pick_motions(excitation, line: np.ndarray, pick) -> Any:
    """Return the motions of scenes. The samples of several records stay in one table and are not copied for
    every scene.

    - `excitation`: motion whose arrays have a first axis, of length 1 or as long as the number of searches
    - `line`: for each scene, the index of its search
    - `pick`: function that selects, from such an array, the element of each scene
    """
    if isinstance(excitation, GroundMotion):
        components = (_pick_motions(y, line, pick) for y in (excitation.horizontal, excitation.vertical))
        return GroundMotion(*components)
    if isinstance(excitation, PaddedRecord) and excitation.acceleration.shape[0] > 1:
        for_each_record = lambda y: np.broadcast_to(y, len(excitation.acceleration))
        dt, scale, start = (for_each_record(y) for y in (excitation.dt, excitation.scale, excitation.t_start))
        return Records(
            excitation.acceleration,
            as_array(for_each_record(excitation.count)),
            as_array(dt),
            as_array(start),
            line,
            scale[line],
        )
    return jax.tree.map(pick, excitation)


@functools.partial(jax.jit, static_argnames=("structure", "uses_margin"))
def _search_in_program(leaves, structure, uses_margin: bool) -> FirstBoundary:
    """Return the first boundary of one search inside a compiled program, with arguments as in
    `_search_in_batches`."""
    podium, excitation, limit, (options, width) = jax.tree.unflatten(structure, leaves)
    search_options = margin_options(options, uses_margin)
    coarse = scan_options(search_options, width)

    def solve_row(scales, accurate):
        accuracy = jax.tree.map(lambda a, b: jnp.where(accurate, a, b), search_options, coarse)

        def solve_scale(scale):
            (floats, _), (integers, _) = solve(podium, excitation.scaled(scale), REST, None, accuracy)
            value = signed_margin(floats, integers["overturned"], options.overturn_ratio, uses_margin)
            unfinished = results.did_not_finish(integers["code"])
            return jnp.where(unfinished, jnp.nan, value), integers["impacts"]

        return jax.vmap(solve_scale)(scales)

    return first_boundary(solve_row, limit, SPACING_SHARE * width * limit)
