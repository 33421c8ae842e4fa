"""The first boundary of one scene, inside a compiled program: rows of scales from below until one of them
overturns.

1. A coarse row over the whole range shows below which scale the columns never lift.
2. From there rows at the requested spacing go up to the first scale that overturns.
3. A row at the full accuracy confirms the change; if it does not, the search continues upwards.
4. The lowest dips of the margin below are refined, because windows narrower than the spacing may open there.
5. The lowest change is narrowed down by dividing its bracket.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from rockjax._roots import beside_line

WIDTH = 32  # scenes side by side
DIPS = WIDTH // 2  # number of the lowest dips that are refined, on both sides …
ZOOMS = 7  # … this many times, each to half of their width
CLOSE = 1e-12  # relative width of a bracket that is narrow enough …
NARROW = 12  # … or this many divisions of it, whichever comes first
NEAR = np.logspace(-9, -1, WIDTH // 4)  # places beside the root of the straight line [bracket]

COARSE, SCAN, CONFIRM, ZOOM, NARROWING = range(5)

# (scales, at the full accuracy?) → margins, NaN where a scene did not finish, and impacts
Row = Callable[[Array, Array], tuple[Array, Array]]


class First(NamedTuple):
    """The first boundary of a range."""

    scale: Any  # inf where nothing overturns
    dip: Any  # the least dip of the margin below it, 1 without any
    certain: Any  # below the boundary, every overturning interval wider than this has been found
    impacts: Any


class _State(NamedTuple):
    stage: Array
    rounds: Array  # rows in this stage
    start: Array  # end of the scanned part
    lo: Array  # the last scale that survives …
    above: Array  # … its margin
    hi: Array  # the first that overturns, inf until one does …
    below: Array
    impacts: Array
    gap: Array  # the widest step between neighbours that survive
    before: Array  # the survivor before `lo`, and its margin
    margin_before: Array
    dips: Array  # (DIPS, 3): scales around the lowest dips
    dip_margins: Array


def first_boundary(row: Row, limit: Array, spacing: Array) -> First:
    """Return the least scale in (0, limit] that overturns, searched at places `spacing` apart."""
    zero, one = jnp.zeros_like(limit), jnp.ones_like(limit)
    none = jnp.zeros((), jnp.int32)
    never = jnp.full_like(limit, jnp.inf)
    dips = jnp.zeros((DIPS, 3), limit.dtype)
    state = _State(none, none, zero, zero, one, never, -one, none, zero, zero, one, dips, dips + 1)

    def look(state: _State) -> _State:
        scales = jax.lax.switch(state.stage, [functools.partial(ask, state, limit, spacing) for ask in _ASK])
        # Searches side by side wait for each other; those that have ended solve nothing.
        scales = jnp.where(_goes_on(state, limit), scales, 0.0)
        margin, impacts = row(scales, state.stage >= CONFIRM)

        def take(tell) -> _State:
            after = tell(state, scales, margin, impacts, limit)
            return jax.tree.map(lambda new, old: jnp.asarray(new, old.dtype), after, state)

        return jax.lax.switch(state.stage, [functools.partial(take, tell) for tell in _TELL])

    state = jax.lax.while_loop(lambda state: _goes_on(state, limit), look, state)
    found = jnp.isfinite(state.hi)
    below = (state.dips[:, 2] > 0) & (state.dips[:, 2] < state.hi)
    dip = jnp.min(jnp.where(below, state.dip_margins[:, 1], 1.0))
    scale = jnp.where(found, 0.5 * (state.lo + state.hi), jnp.inf)
    return First(scale, dip, state.gap, jnp.where(found, state.impacts, 0))


def _goes_on(state: _State, limit: Array) -> Array:
    wide = jnp.isfinite(state.hi) & (state.hi - state.lo > CLOSE * state.hi) & (state.rounds < NARROW)
    return (state.stage < NARROWING) | wide


def _steps(like: Array) -> Array:
    """Return 1 … WIDTH."""
    return jnp.arange(1, WIDTH + 1, dtype=like.dtype)


def _coarse_scales(state: _State, limit: Array, spacing: Array) -> Array:
    return limit * _steps(limit) / WIDTH


def _coarse(state: _State, scales: Array, margin: Array, impacts: Array, limit: Array) -> _State:
    """Skip the scales that do not lift the columns: columns at rest respond in proportion, so no lower scale
    does."""
    still = jnp.max(jnp.where(margin == 1, scales, 0.0))
    stage = jnp.where(still >= limit, ZOOM, SCAN)
    return state._replace(stage=stage, start=still, lo=still, before=still)


def _next_scales(state: _State, limit: Array, spacing: Array) -> Array:
    return jnp.minimum(state.start + spacing * _steps(limit), limit)


def _scanned(state: _State, scales: Array, margin: Array, impacts: Array, limit: Array) -> _State:
    scales = jnp.concatenate([jnp.stack([state.before, state.lo]), scales])
    margin = jnp.concatenate([jnp.stack([state.margin_before, state.above]), margin])
    found, first = _first(margin)
    index = jnp.arange(scales.size)
    survives = (margin > 0) & (index < first)
    ends = scales[-1] >= limit
    last = jnp.max(jnp.where(survives, index, 0))
    gap = _widest(scales, survives | (index == first))
    gap = jnp.where(ends & ~found, jnp.maximum(gap, limit - scales[last]), gap)
    previous = jnp.max(jnp.where(survives & (index < last), index, 0))
    inner = survives[:-2] & survives[1:-1] & survives[2:]
    inner &= (margin[1:-1] <= margin[:-2]) & (margin[1:-1] < margin[2:])
    three = lambda y: jnp.stack([y[:-2], y[1:-1], y[2:]], axis=1)
    new_dips, new_margins = (
        jnp.where(inner[:, None], three(scales), 0.0),
        jnp.where(inner[:, None], three(margin), 1.0),
    )
    dips, margins = jnp.concatenate([state.dips, new_dips]), jnp.concatenate([state.dip_margins, new_margins])
    # Choose the dips where extended straight lines from both sides would meet lowest; count a dip that was
    # there before only once.
    depth = 2 * margins[:, 1] - 0.5 * (margins[:, 0] + margins[:, 2])
    _, lowest = jax.lax.top_k(-depth, DIPS)
    return state._replace(
        stage=jnp.where(found, CONFIRM, jnp.where(ends, ZOOM, SCAN)),
        start=scales[-1],
        lo=scales[last],
        above=margin[last],
        hi=jnp.where(found, scales[first], jnp.inf),
        below=jnp.where(found, margin[first], -1.0),
        impacts=jnp.where(found, impacts[jnp.maximum(first - 2, 0)], 0),
        gap=jnp.maximum(state.gap, gap),
        before=scales[previous],
        margin_before=margin[previous],
        dips=dips[lowest],
        dip_margins=margins[lowest],
    )


def _bracket_scales(state: _State, limit: Array, spacing: Array) -> Array:
    """Return scales from the survivor before the last one to a step beyond the first that overturns."""
    end = jnp.minimum(state.hi + (state.hi - state.lo), limit)
    return state.before + (end - state.before) * _steps(limit) / WIDTH


def _confirmed(state: _State, scales: Array, margin: Array, impacts: Array, limit: Array) -> _State:
    found, _ = _first(margin)
    doubted = state._replace(lo=state.before, above=state.margin_before, hi=jnp.full_like(state.hi, jnp.inf))
    narrower = _narrowed(doubted, scales, margin, impacts, limit)
    # Nothing overturns here: the scan was wrong within its tolerance, and continues above.
    again = jnp.where(scales[-1] >= limit, ZOOM, SCAN)
    on = narrower._replace(start=scales[-1], before=narrower.lo, margin_before=narrower.above)
    return jax.tree.map(
        lambda yes, no: jnp.where(found, yes, no),
        narrower._replace(stage=ZOOM, rounds=0),
        on._replace(stage=again),
    )


def _dip_scales(state: _State, limit: Array, spacing: Array) -> Array:
    return (0.5 * (state.dips[:, :2] + state.dips[:, 1:])).ravel()


def _zoomed(state: _State, scales: Array, margin: Array, impacts: Array, limit: Array) -> _State:
    inside, margins = scales.reshape(DIPS, -1), margin.reshape(DIPS, -1)
    # A window narrower than the spacing may have been found.
    over = (margin <= 0) & (scales < state.hi)
    opened, at = jnp.any(over), jnp.argmin(jnp.where(over, scales, jnp.inf))
    hi = jnp.where(opened, scales[at], state.hi)
    places = jnp.concatenate([scales, state.dips.ravel(), state.lo[None]])
    spare = jnp.concatenate([margin, state.dip_margins.ravel(), state.above[None]])
    lowest = jnp.argmax(jnp.where((spare > 0) & (places < hi), places, -1.0))
    # The dips again, each between the neighbours of its lowest place.
    around, levels = (
        jnp.concatenate([state.dips, inside], axis=1),
        jnp.concatenate([state.dip_margins, margins], axis=1),
    )
    order = jnp.argsort(around, axis=1)
    around, levels = (jnp.take_along_axis(y, order, axis=1) for y in (around, levels))
    deepest = jnp.argmin(jnp.where(levels[:, 1:-1] > 0, levels[:, 1:-1], 1.0), axis=1)
    three = jnp.stack([deepest, deepest + 1, deepest + 2], axis=1)
    rounds = state.rounds + 1
    return state._replace(
        stage=jnp.where(rounds == ZOOMS, NARROWING, ZOOM),
        rounds=jnp.where(rounds == ZOOMS, 0, rounds),
        lo=jnp.where(opened, places[lowest], state.lo),
        above=jnp.where(opened, spare[lowest], state.above),
        hi=hi,
        below=jnp.where(opened, margin[at], state.below),
        impacts=jnp.where(opened, impacts[at], state.impacts),
        dips=jnp.take_along_axis(around, three, axis=1),
        dip_margins=jnp.take_along_axis(levels, three, axis=1),
    )


def _divided(state: _State, limit: Array, spacing: Array) -> Array:
    part = beside_line(state.above, state.below, WIDTH - 2 * NEAR.size, NEAR, jnp)
    return state.lo + (state.hi - state.lo) * part


def _narrowed(state: _State, scales: Array, margin: Array, impacts: Array, limit: Array) -> _State:
    """Return a narrower bracket, from ascending scales inside the present one."""
    found, first = _first(margin)
    index = jnp.arange(scales.size)
    survives = (margin > 0) & (index < first)
    any_survives, last = jnp.any(survives), jnp.max(jnp.where(survives, index, 0))
    at = jnp.minimum(first, scales.size - 1)
    return state._replace(
        rounds=state.rounds + 1,
        lo=jnp.where(any_survives, scales[last], state.lo),
        above=jnp.where(any_survives, margin[last], state.above),
        hi=jnp.where(found, scales[at], state.hi),
        below=jnp.where(found, margin[at], state.below),
        impacts=jnp.where(found, impacts[at], state.impacts),
    )


_ASK = (_coarse_scales, _next_scales, _bracket_scales, _dip_scales, _divided)
_TELL = (_coarse, _scanned, _confirmed, _zoomed, _narrowed)


def _first(margin: Array) -> tuple[Array, Array]:
    """Return whether any place overturns, and the index of the first; the number of places if none does."""
    over = margin <= 0
    return jnp.any(over), jnp.where(jnp.any(over), jnp.argmax(over), margin.size)


def _widest(scales: Array, known: Array) -> Array:
    """Return the widest step between neighbours that are known, of ascending scales."""
    last = jax.lax.cummax(jnp.where(known, scales, -jnp.inf))
    steps = jnp.where(known[1:] & jnp.isfinite(last[:-1]), scales[1:] - last[:-1], 0.0)
    return jnp.max(steps)
