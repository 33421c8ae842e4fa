"""The overturning boundary of a podium: the least scale of a ground motion that overturns it, with derivatives.

Survival is not monotone in the amplitude. The scale is scanned; where the margin bends so much between neighbours that it
may cross zero unseen, it is looked at more closely; the lowest change from survival to overturning is narrowed down by
dividing its bracket. All of that is one loop that runs a row of scenes at a time.

Derivatives follow from the implicit function theorem, da* = −dM/(∂M/∂a), with the margin M just past the boundary. M
passes through zero with a slope, so this is well conditioned though the trajectory lingers at the saddle.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from rockjax._checks import as_float, concrete, require
from rockjax._engine.solve import solve
from rockjax._excitations.base import AbstractExcitation
from rockjax._options import Options
from rockjax._responses.arguments import check_range, check_types
from rockjax._results import REST
from rockjax._structures import Podium
from rockjax._types import Value

BOUNDARY = Options(rtol=1e-11, atol=1e-13)  # a boundary is as sharp as the scenes that find it
WIDTH = 32  # scenes side by side
DIVE = 6  # rows of scenes where the margin is not resolved …
INTERVALS = 4  # … in so many intervals each
CLOSE = 1e-12  # relative width of a bracket that is narrow enough …
NARROW = 12  # … or this many divisions of it, whatever comes first
PAST = 1e-10  # relative distance to the boundary at which the margin is differentiated
_TINY = float(np.finfo(np.float32).tiny)
GRAZES = 1e-4  # a surviving dip of the margin this low: another branch is about to take over


class Boundary(eqx.Module):
    """Where a ground motion begins to overturn a podium.

    - `scale`: the least factor of the motion that overturns, inf where none in the range does; differentiable, with
      derivative zero where it is inf [–]
    - `found`: whether there is one
    - `impacts`: before overturning, just past the boundary
    - `dip`: the least overturning margin at a surviving scale below the boundary where the margin has a minimum, 1
      without any: how far another branch of lower scales is from opening
    - `one_sided`: the dip is so low that the minimum is about to jump to another branch; the derivative holds to one side
    """

    scale: Float[Array, "*batch"]
    found: Bool[Array, "*batch"]
    impacts: Int[Array, "*batch"]
    dip: Float[Array, "*batch"]
    one_sided: Bool[Array, "*batch"]

    def __repr__(self):
        if isinstance(self.scale, Tracer) or jnp.ndim(self.scale):
            return f"Boundary(of shape {jnp.shape(self.scale)})"
        if not self.found:
            return f"Boundary: nothing overturns; least dip of the margin {float(self.dip):.3g}"
        side = ", one-sided: the minimum is about to jump" if self.one_sided else ""
        after = f"after {int(self.impacts)} impacts"
        return f"Boundary: overturns from {float(self.scale):.10g} {after}; dip below {float(self.dip):.3g}{side}"


def overturning_acceleration(
    podium: Podium,
    pulse: Callable[[Any, Any], AbstractExcitation],
    T_p,
    *,
    max_acceleration_ratio=12.0,
    options: Options = BOUNDARY,
    resolution: int = 128,
) -> Value:
    """The least pulse acceleration a_p that overturns a podium [m/s²], inf where none up to the limit does.

    Works under `jit`, `vmap`, `grad`, `jacfwd` with respect to every number of `podium` and to `T_p`; the derivative is
    exact on its branch, and zero where the result is inf. [`rockjax.overturning_boundary`][] says more about the result.

    - `pulse`: a pulse class such as `rockjax.Ricker`, or a function (a_p, T_p) → excitation that scales with a_p
    - `T_p`: pulse period, > 0 [s]
    - `max_acceleration_ratio`: end of the search, a_p/(g tan α) [–]
    - `resolution`: scales of the first scan, equally spaced up to the limit; dips between them are looked at closer

    Raises `ValueError` for inputs that make no sense, where they are concrete.
    """
    require("overturning_acceleration", "T_p", T_p, lambda v: v > 0, "finite and > 0")
    positive_limit("overturning_acceleration", "max_acceleration_ratio", max_acceleration_ratio)
    limit = as_float(max_acceleration_ratio) * podium.g * jnp.tan(podium.alpha)
    motion = pulse(1.0, T_p)
    return overturning_boundary(podium, motion, max_scale=limit, options=options, resolution=resolution).scale


def overturning_scale(
    podium: Podium,
    excitation: AbstractExcitation,
    *,
    max_scale: Float[ArrayLike, ""] = 10.0,
    options: Options = BOUNDARY,
    resolution: int = 128,
) -> Value:
    """The least factor of a ground motion that overturns a podium [–]: `scale` of [`rockjax.overturning_boundary`][]."""
    return overturning_boundary(podium, excitation, max_scale=max_scale, options=options, resolution=resolution).scale


def overturning_boundary(
    podium: Podium,
    excitation: AbstractExcitation,
    *,
    max_scale: Float[ArrayLike, ""] = 10.0,
    options: Options = BOUNDARY,
    resolution: int = 128,
) -> Boundary:
    """The least factor in (0, max_scale] by which a ground motion overturns a podium, with what is around it.

    Works under `jit` and `vmap`; `scale` has derivatives with respect to every number of `podium` and `excitation`.
    `options.overturn_ratio` decides what overturned means; above 1 there is no margin, the dips are those of the peak
    rotation, and the derivative is that of the time of overturning.

    Raises `ValueError` for inputs that make no sense, where they are concrete.
    """
    owner = "overturning_boundary"
    check_types(owner, podium, excitation, options)
    check_range(owner, podium, excitation, None, options)
    positive_limit(owner, "max_scale", max_scale)
    if not isinstance(resolution, int) or resolution < WIDTH:
        raise ValueError(f"{owner}: resolution must be a whole number ≥ {WIDTH}, got {resolution!r}")
    if any(map(jnp.ndim, (*jax.tree.leaves(podium), *excitation.support, max_scale))):
        raise ValueError(
            f"{owner}: podium, excitation and its end must be single ones; for several use jax.vmap, or "
            f"rockjax.overturning_spectrum for all frequencies of a pulse"
        )
    excitation.scaled(1.0)  # raises for a motion that cannot be
    return _boundary(podium, excitation, as_float(max_scale), options, resolution, has_margin(options))


def positive_limit(owner: str, name: str, value) -> None:
    require(owner, name, value, lambda v: v > 0, "finite and > 0")


def has_margin(options: Options) -> bool:
    """Whether the convention of overturning has a margin: known to be |θ| = α at most."""
    ratio = concrete(options.overturn_ratio)
    return ratio is not None and bool(np.all(ratio <= 1))


def judge(floats: dict[str, Any], overturned, overturn_ratio, margin: bool, xp: Any = jnp):
    """A number > 0 where a scene survives and ≤ 0 where it overturned; the overturning margin where there is one."""
    if margin:
        value = floats["margin"]
        # The sign is that of the verdict, rounding or not.
        return xp.where(overturned, xp.minimum(value, 0.0), xp.maximum(value, _TINY))
    return xp.where(overturned, -1.0, xp.maximum(1 - floats["peak_rotation"] / overturn_ratio, _TINY))


def footing(floats: dict[str, Any], margin: bool):
    """What is differentiated just past the boundary: the margin; without one, the time of overturning.

    That time grows without bound towards the boundary, and its derivatives in the ratio that keeps a scene on it.
    """
    return floats["margin" if margin else "overturn_time"]


def margin_options(options: Options, margin: bool) -> Options:
    """The same accuracy, with no outputs but what the boundary needs."""
    return options.replace(outputs=("margin" if margin else "peak_rotation",), throw=False)


class _Table(NamedTuple):
    """Scales looked at so far, those to come at inf; their margins and impacts."""

    scale: Array
    margin: Array
    impacts: Array

    def sorted(self) -> _Table:
        order = jnp.argsort(self.scale)
        return _Table(self.scale[order], self.margin[order], self.impacts[order])

    def first(self) -> tuple[Array, Array]:
        """Of a sorted table: the index of the lowest scale that overturns, and whether there is one."""
        over = (self.margin <= 0) & jnp.isfinite(self.scale)
        return jnp.argmax(over), jnp.any(over)


def doubt(y, margin, together, xp: Any = jnp):
    """How far the margin may bend away between neighbours, over what is between it and zero: (n−1,) for n places.

    Up to 1 the margin cannot cross zero unseen (or, between neighbours on both sides of the boundary, more than once), as
    far as second differences tell. `together` says which neighbours belong to one line.
    """
    h = xp.where(together, y[1:] - y[:-1], 1.0)
    h = xp.where(h > 0, h, 1.0)
    slope = xp.where(together, (margin[1:] - margin[:-1]) / h, 0.0)
    inner = together[1:] & together[:-1]
    bend = xp.where(inner, xp.abs(slope[1:] - slope[:-1]) / (h[1:] + h[:-1]), 0.0)  # half the second derivative
    none = xp.zeros_like(bend[:1])
    bend = xp.maximum(xp.concatenate([none, bend]), xp.concatenate([bend, none]))
    left, right = margin[:-1], margin[1:]
    apart = (left > 0) != (right > 0)
    spare = xp.where(apart, xp.abs(left - right), 2 * xp.minimum(xp.abs(left), xp.abs(right)))
    return xp.where(together & (h > 0), bend * h**2 / xp.maximum(spare, 1e-300), 0.0)


def _dip(table: _Table) -> Array:
    """Of a sorted table: the least dip of the margin among the survivors below the boundary, at most 1."""
    first, found = table.first()
    left, here, right = table.margin[:-2], table.margin[1:-1], table.margin[2:]
    inner = jnp.arange(1, table.scale.size - 1)
    below = jnp.where(found, inner + 1 < first, jnp.isfinite(table.scale[2:]))
    return jnp.min(jnp.where(below & (here > 0) & (here <= left) & (here < right), here, 1.0))


def _closer(table: _Table) -> Array:
    """Scales inside the intervals below the boundary where a lower one is the least unlikely."""
    first, found = table.first()
    known = jnp.isfinite(table.scale)
    scale, margin = jnp.where(known, table.scale, 0.0), jnp.where(known, table.margin, 1.0)
    below = jnp.arange(scale.size - 1) < jnp.where(found, first, scale.size)
    doubtful = jnp.where(below, doubt(scale, margin, known[1:] & known[:-1]), 0.0)
    _, at = jax.lax.top_k(doubtful, INTERVALS)
    part = jnp.arange(1, WIDTH // INTERVALS + 1) / (WIDTH // INTERVALS + 1)
    return (scale[at, None] + jnp.outer(scale[at + 1] - scale[at], part)).ravel()


def divisions(lo, hi, above, below, count: int = WIDTH, xp: Any = jnp):
    """Scales that divide brackets (…,) with margins `above` > 0 at one end and `below` ≤ 0 at the other: (…, count).

    Half of them equally spaced, for certainty, and half close around the root of the straight line, for speed.
    """
    half = count // 2
    root = (above / xp.where(above > below, above - below, 1.0))[..., None]
    even, reach = np.arange(1, half + 1) / (half + 1), np.logspace(-9, -1, half // 2)
    even, reach = (xp.broadcast_to(y, (*root.shape[:-1], y.size)) for y in (even, reach))
    part = xp.concatenate([even, root - reach, root + reach], axis=-1)
    lo, hi = lo[..., None], hi[..., None]
    return xp.clip(lo + (hi - lo) * part, xp.minimum(lo, hi), xp.maximum(lo, hi))


@functools.partial(jax.jit, static_argnames=("resolution", "margin"))
def _boundary(podium: Podium, excitation, limit, options: Options, resolution: int, margin: bool) -> Boundary:
    leaves, structure = jax.tree.flatten((podium, excitation, limit, options))

    def scene(leaves, scale):
        """The margin (…) of one scene, and the impacts in it; for derivatives, something with the same zero."""
        podium, excitation, _, options = jax.tree.unflatten(structure, leaves)
        wanted = margin_options(options, margin)
        (floats, _), (integers, _) = solve(podium, excitation.scaled(scale), REST, None, wanted)
        value = judge(floats, integers["overturned"], options.overturn_ratio, margin)
        return value, integers["impacts"], footing(floats, margin)

    def search(*leaves):
        limit = leaves[-1 - len(jax.tree.leaves(options))]

        def row(scales):
            value, impacts, _ = jax.vmap(lambda s: scene(leaves, s))(scales)
            return value, impacts

        return _search(row, limit, resolution)

    def rule(primals, tangents):
        scale, dip, impacts = search(*primals)
        found = jnp.isfinite(scale)
        past = jnp.where(found, scale * (1 + PAST), primals[-1 - len(jax.tree.leaves(options))])
        live = [i for i, tangent in enumerate(tangents) if not isinstance(tangent, SymbolicZero)]

        def margin_of(scale, *values):
            leaves = list(primals)
            for i, value in zip(live, values, strict=True):
                leaves[i] = value
            return scene(leaves, scale)[2]

        point = tuple(primals[i] for i in live)
        _, along = jax.linearize(margin_of, past, *point)
        slope = along(jnp.ones_like(past), *(jnp.zeros_like(y) for y in point))
        change = along(jnp.zeros_like(past), *(tangents[i] for i in live))
        usable = found & (slope != 0) & jnp.isfinite(slope)
        weight = jnp.where(usable, -1 / jnp.where(usable, slope, 1.0), 0.0)
        none = np.zeros(jnp.shape(impacts), jax.dtypes.float0)
        return (scale, dip, impacts), (weight * jnp.where(usable, change, 0.0), jnp.zeros_like(dip), none)

    found = jax.custom_jvp(search)
    found.defjvp(rule, symbolic_zeros=True)  # pyright: ignore[reportArgumentType]
    scale, dip, impacts = found(*leaves)
    return Boundary(scale, jnp.isfinite(scale), impacts, dip, dip < GRAZES)


def _search(row: Callable[[Array], tuple[Array, Array]], limit: Value, resolution: int) -> tuple[Array, Array, Array]:
    """(least scale that overturns or inf, lowest dip below it, impacts there), from `row`: scales → margins, impacts."""
    scan = -(-resolution // WIDTH)
    size = WIDTH * (scan + DIVE + NARROW)
    nothing = jnp.full((size,), jnp.nan, limit.dtype)
    known = _Table(jnp.full_like(nothing, jnp.inf), nothing, jnp.zeros((size,), jnp.int32))

    def bracket(table: _Table):
        first, found = table.first()
        lo = jnp.where(first > 0, table.scale[first - 1], 0.0)
        above = jnp.where(first > 0, table.margin[first - 1], 1.0)
        return lo, table.scale[first], above, table.margin[first], found

    def goes_on(carry) -> Array:
        k, known = carry
        lo, hi, _, _, found = bracket(known.sorted())
        return (k < scan + DIVE) | (found & (hi - lo > CLOSE * hi) & (k < scan + DIVE + NARROW))

    def look(carry):
        k, known = carry
        table = known.sorted()
        lo, hi, above, below, _ = bracket(table)
        scales = jax.lax.switch(
            (k >= scan).astype(int) + (k >= scan + DIVE),
            (
                lambda: limit * (k * WIDTH + jnp.arange(1, WIDTH + 1)) / (scan * WIDTH),
                lambda: _closer(table),
                lambda: divisions(lo, hi, above, below),
            ),
        )
        found = _Table(scales, *row(scales))
        place = lambda whole, part: jax.lax.dynamic_update_slice(whole, part, (k * WIDTH,))
        return k + 1, jax.tree.map(place, known, found)

    _, known = jax.lax.while_loop(goes_on, look, (jnp.zeros((), jnp.int32), known))
    table = known.sorted()
    lo, hi, _, _, found = bracket(table)
    first, _ = table.first()
    scale = jnp.where(found, 0.5 * (lo + hi), jnp.inf)
    return scale, _dip(table), jnp.where(found, table.impacts[first], 0)
