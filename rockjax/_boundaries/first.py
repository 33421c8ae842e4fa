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

from rockjax._roots import points_near_root

WIDTH = 32  # scenes side by side
DIPS = WIDTH // 2  # number of the lowest dips that are refined, on both sides …
MAX_ZOOMS = 7  # … this many times, each to half of their width
BRACKET_TOLERANCE = 1e-12  # relative width of a bracket that is narrow enough …
MAX_DIVISIONS = 12  # … or this many divisions of it, whichever comes first
ROOT_OFFSETS = np.logspace(-9, -1, WIDTH // 4)  # places beside the root of the straight line [bracket]

COARSE, SCAN, CONFIRM, ZOOM, NARROW = range(5)

# (scales, at the full accuracy?) → margins, NaN where a scene did not finish, and impacts
SolveRow = Callable[[Array, Array], tuple[Array, Array]]


class FirstBoundary(NamedTuple):
    """The first boundary of a range."""

    scale: Any  # inf where nothing overturns
    dip: Any  # the least dip of the margin below it, 1 without any
    certain: Any  # below the boundary, every overturning interval wider than this has been found
    impacts: Any


class _State(NamedTuple):
    stage: Array
    rounds: Array  # rows in this stage
    scanned_to: Array  # end of the scanned part
    lo: Array  # the last scale that survives …
    lo_margin: Array  # … its margin
    hi: Array  # the first that overturns, inf until one does …
    hi_margin: Array
    impacts: Array
    gap: Array  # the widest step between neighbours that survive
    before: Array  # the survivor before `lo`, and its margin
    previous_margin: Array
    dips: Array  # (DIPS, 3): scales around the lowest dips
    dip_margins: Array


def first_boundary(solve_row: SolveRow, limit: Array, spacing: Array) -> FirstBoundary:
    """Return the least scale in (0, limit] that overturns, searched at places `spacing` apart."""
    zero, one = jnp.zeros_like(limit), jnp.ones_like(limit)
    none = jnp.zeros((), jnp.int32)
    never = jnp.full_like(limit, jnp.inf)
    dips = jnp.zeros((DIPS, 3), limit.dtype)
    state = _State(none, none, zero, zero, one, never, -one, none, zero, zero, one, dips, dips + 1)

    def advance(state: _State) -> _State:
        scales = jax.lax.switch(
            state.stage, [functools.partial(scales_of, state, limit, spacing) for scales_of in _SCALES]
        )
        # Searches side by side wait for each other; those that have ended solve nothing.
        scales = jnp.where(_is_unfinished(state, limit), scales, 0.0)
        margin, impacts = solve_row(scales, state.stage >= CONFIRM)

        def apply(update) -> _State:
            after = update(state, scales, margin, impacts, limit)
            return jax.tree.map(lambda new, old: jnp.asarray(new, old.dtype), after, state)

        return jax.lax.switch(state.stage, [functools.partial(apply, update) for update in _UPDATES])

    state = jax.lax.while_loop(lambda state: _is_unfinished(state, limit), advance, state)
    found = jnp.isfinite(state.hi)
    below = (state.dips[:, 2] > 0) & (state.dips[:, 2] < state.hi)
    dip = jnp.min(jnp.where(below, state.dip_margins[:, 1], 1.0))
    scale = jnp.where(found, 0.5 * (state.lo + state.hi), jnp.inf)
    return FirstBoundary(scale, dip, state.gap, jnp.where(found, state.impacts, 0))


def _is_unfinished(state: _State, limit: Array) -> Array:
    wide = (
        jnp.isfinite(state.hi)
        & (state.hi - state.lo > BRACKET_TOLERANCE * state.hi)
        & (state.rounds < MAX_DIVISIONS)
    )
    return (state.stage < NARROW) | wide


def _steps(template: Array) -> Array:
    """Return 1 … WIDTH."""
    return jnp.arange(1, WIDTH + 1, dtype=template.dtype)


def _coarse_scales(state: _State, limit: Array, spacing: Array) -> Array:
    return limit * _steps(limit) / WIDTH


def _update_coarse(state: _State, scales: Array, margin: Array, impacts: Array, limit: Array) -> _State:
    """Skip the scales that do not lift the columns: columns at rest respond in proportion, so no lower scale
    does."""
    at_rest = jnp.max(jnp.where(margin == 1, scales, 0.0))
    stage = jnp.where(at_rest >= limit, ZOOM, SCAN)
    return state._replace(stage=stage, scanned_to=at_rest, lo=at_rest, before=at_rest)


def _scan_scales(state: _State, limit: Array, spacing: Array) -> Array:
    return jnp.minimum(state.scanned_to + spacing * _steps(limit), limit)


def _update_scan(state: _State, scales: Array, margin: Array, impacts: Array, limit: Array) -> _State:
    scales = jnp.concatenate([jnp.stack([state.before, state.lo]), scales])
    margin = jnp.concatenate([jnp.stack([state.previous_margin, state.lo_margin]), margin])
    found, first = _first_overturning(margin)
    index = jnp.arange(scales.size)
    survives = (margin > 0) & (index < first)
    ends = scales[-1] >= limit
    last = jnp.max(jnp.where(survives, index, 0))
    gap = _widest_step(scales, survives | (index == first))
    gap = jnp.where(ends & ~found, jnp.maximum(gap, limit - scales[last]), gap)
    previous = jnp.max(jnp.where(survives & (index < last), index, 0))
    is_dip = survives[:-2] & survives[1:-1] & survives[2:]
    is_dip &= (margin[1:-1] <= margin[:-2]) & (margin[1:-1] < margin[2:])
    triples = lambda y: jnp.stack([y[:-2], y[1:-1], y[2:]], axis=1)
    new_dips, new_margins = (
        jnp.where(is_dip[:, None], triples(scales), 0.0),
        jnp.where(is_dip[:, None], triples(margin), 1.0),
    )
    dips, margins = jnp.concatenate([state.dips, new_dips]), jnp.concatenate([state.dip_margins, new_margins])
    # Choose the dips where extended straight lines from both sides would meet lowest; count a dip that was
    # there before only once.
    depth = 2 * margins[:, 1] - 0.5 * (margins[:, 0] + margins[:, 2])
    _, lowest = jax.lax.top_k(-depth, DIPS)
    return state._replace(
        stage=jnp.where(found, CONFIRM, jnp.where(ends, ZOOM, SCAN)),
        scanned_to=scales[-1],
        lo=scales[last],
        lo_margin=margin[last],
        hi=jnp.where(found, scales[first], jnp.inf),
        hi_margin=jnp.where(found, margin[first], -1.0),
        impacts=jnp.where(found, impacts[jnp.maximum(first - 2, 0)], 0),
        gap=jnp.maximum(state.gap, gap),
        before=scales[previous],
        previous_margin=margin[previous],
        dips=dips[lowest],
        dip_margins=margins[lowest],
    )


def _confirm_scales(state: _State, limit: Array, spacing: Array) -> Array:
    """Return scales from the survivor before the last one to a step beyond the first that overturns."""
    end = jnp.minimum(state.hi + (state.hi - state.lo), limit)
    return state.before + (end - state.before) * _steps(limit) / WIDTH


def _update_confirm(state: _State, scales: Array, margin: Array, impacts: Array, limit: Array) -> _State:
    found, _ = _first_overturning(margin)
    unconfirmed = state._replace(
        lo=state.before, lo_margin=state.previous_margin, hi=jnp.full_like(state.hi, jnp.inf)
    )
    narrower = _update_narrowing(unconfirmed, scales, margin, impacts, limit)
    # Nothing overturns here: the scan was wrong within its tolerance, and continues above.
    next_stage = jnp.where(scales[-1] >= limit, ZOOM, SCAN)
    resumed = narrower._replace(scanned_to=scales[-1], before=narrower.lo, previous_margin=narrower.lo_margin)
    return jax.tree.map(
        lambda yes, no: jnp.where(found, yes, no),
        narrower._replace(stage=ZOOM, rounds=0),
        resumed._replace(stage=next_stage),
    )


def _zoom_scales(state: _State, limit: Array, spacing: Array) -> Array:
    return (0.5 * (state.dips[:, :2] + state.dips[:, 1:])).ravel()


def _update_zoom(state: _State, scales: Array, margin: Array, impacts: Array, limit: Array) -> _State:
    inside, margins = scales.reshape(DIPS, -1), margin.reshape(DIPS, -1)
    # A window narrower than the spacing may have been found.
    over = (margin <= 0) & (scales < state.hi)
    opened, at = jnp.any(over), jnp.argmin(jnp.where(over, scales, jnp.inf))
    hi = jnp.where(opened, scales[at], state.hi)
    candidates = jnp.concatenate([scales, state.dips.ravel(), state.lo[None]])
    candidate_margins = jnp.concatenate([margin, state.dip_margins.ravel(), state.lo_margin[None]])
    lowest = jnp.argmax(jnp.where((candidate_margins > 0) & (candidates < hi), candidates, -1.0))
    # The dips again, each between the neighbours of its lowest place.
    dip_scales, levels = (
        jnp.concatenate([state.dips, inside], axis=1),
        jnp.concatenate([state.dip_margins, margins], axis=1),
    )
    order = jnp.argsort(dip_scales, axis=1)
    dip_scales, levels = (jnp.take_along_axis(y, order, axis=1) for y in (dip_scales, levels))
    deepest = jnp.argmin(jnp.where(levels[:, 1:-1] > 0, levels[:, 1:-1], 1.0), axis=1)
    triples = jnp.stack([deepest, deepest + 1, deepest + 2], axis=1)
    rounds = state.rounds + 1
    return state._replace(
        stage=jnp.where(rounds == MAX_ZOOMS, NARROW, ZOOM),
        rounds=jnp.where(rounds == MAX_ZOOMS, 0, rounds),
        lo=jnp.where(opened, candidates[lowest], state.lo),
        lo_margin=jnp.where(opened, candidate_margins[lowest], state.lo_margin),
        hi=hi,
        hi_margin=jnp.where(opened, margin[at], state.hi_margin),
        impacts=jnp.where(opened, impacts[at], state.impacts),
        dips=jnp.take_along_axis(dip_scales, triples, axis=1),
        dip_margins=jnp.take_along_axis(levels, triples, axis=1),
    )


def _narrowing_scales(state: _State, limit: Array, spacing: Array) -> Array:
    part = points_near_root(
        state.lo_margin, state.hi_margin, WIDTH - 2 * ROOT_OFFSETS.size, ROOT_OFFSETS, jnp
    )
    return state.lo + (state.hi - state.lo) * part


def _update_narrowing(state: _State, scales: Array, margin: Array, impacts: Array, limit: Array) -> _State:
    """Return a narrower bracket, from ascending scales inside the present one."""
    found, first = _first_overturning(margin)
    index = jnp.arange(scales.size)
    survives = (margin > 0) & (index < first)
    any_survives, last = jnp.any(survives), jnp.max(jnp.where(survives, index, 0))
    at = jnp.minimum(first, scales.size - 1)
    return state._replace(
        rounds=state.rounds + 1,
        lo=jnp.where(any_survives, scales[last], state.lo),
        lo_margin=jnp.where(any_survives, margin[last], state.lo_margin),
        hi=jnp.where(found, scales[at], state.hi),
        hi_margin=jnp.where(found, margin[at], state.hi_margin),
        impacts=jnp.where(found, impacts[at], state.impacts),
    )


_SCALES = (_coarse_scales, _scan_scales, _confirm_scales, _zoom_scales, _narrowing_scales)
_UPDATES = (_update_coarse, _update_scan, _update_confirm, _update_zoom, _update_narrowing)


def _first_overturning(margin: Array) -> tuple[Array, Array]:
    """Return whether any place overturns, and the index of the first; the number of places if none does."""
    over = margin <= 0
    return jnp.any(over), jnp.where(jnp.any(over), jnp.argmax(over), margin.size)


def _widest_step(scales: Array, used: Array) -> Array:
    """Return the widest step between neighbours that are known, of ascending scales."""
    last = jax.lax.cummax(jnp.where(used, scales, -jnp.inf))
    steps = jnp.where(used[1:] & jnp.isfinite(last[:-1]), scales[1:] - last[:-1], 0.0)
    return jnp.max(steps)
