"""Search, within a compiled program, for the first boundary of one motion: the least scale (factor on the
motion) that overturns.

The search solves rows of `ROW_SIZE` scenes. A scene is the podium under the motion at one scale. The margin
of a scene is 1 if the columns do not lift, and ≤ 0 if they overturn. The stages of the search are:

1. A coarse row over the whole range shows up to which scale the columns never lift.
2. From this scale on, rows at the requested spacing follow up to the first scale that overturns.
3. A row at full accuracy around this first overturning scale confirms the change from survival to
   overturning. If no scale of the row overturns, stage 2 continues above the row.
4. The lowest minima of the margin (dips) below the change are refined, because an overturning interval
   narrower than the spacing may lie there.
5. The lowest change is enclosed in ever narrower brackets.
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

ROW_SIZE = 32  # number of scales in a row
DIPS = ROW_SIZE // 2  # number of lowest dips that a row refines; each gets a new scale on either side
MAX_ZOOMS = 7  # number of rows that refine the dips
BRACKET_TOLERANCE = 1e-12  # relative width at which a bracket is narrow enough
MAX_DIVISIONS = 12  # largest number of rows that narrow the bracket
# Distances of scales from the linearly interpolated zero of the margin, divided by the width of the bracket.
ROOT_OFFSETS = np.logspace(-9, -1, ROW_SIZE // 4)

COARSE, SCAN, CONFIRM, ZOOM, NARROW = range(5)  # the stages

# (scales, whether at full accuracy) ↦ (margins, numbers of impacts). The margin is NaN if the scene did not
# finish.
SolveRow = Callable[[Array, Array], tuple[Array, Array]]


class FirstBoundary(NamedTuple):
    """The first boundary of a range."""

    scale: Any  # the least scale that overturns; inf if nothing overturns
    dip: Any  # the lowest dip of the margin below the boundary; 1 if there is none
    certain_width: Any  # largest width of an overturning interval below `scale` that may have been missed
    impacts: Any  # number of impacts before overturning; 0 if nothing overturns
    finished_to: Any  # scale up to which all scenes of the search finished


class _State(NamedTuple):
    """State of the search."""

    stage: Array
    rounds: Array  # number of rows solved in the present stage, counted in the stages ZOOM and NARROW
    scanned_to: Array  # end of the scanned part of the range
    lo: Array  # the last surviving scale below `hi`
    lo_margin: Array  # margin at `lo`
    hi: Array  # the first scale that overturns; inf until one is found
    hi_margin: Array  # margin at `hi`
    impacts: Array  # number of impacts at `hi`
    widest_step: Array  # largest step between neighbouring finished scenes up to `hi`
    finished_to: Array  # last scale of the scan before the first scene that did not finish; inf without one
    previous: Array  # the surviving scale before `lo`
    previous_margin: Array  # margin at `previous`
    dips: Array  # scales around the lowest dips: before, at and after the minimum, shape (DIPS, 3)
    dip_margins: Array  # margins at `dips`


def first_boundary(solve_row: SolveRow, limit: Array, spacing: Array) -> FirstBoundary:
    """Return the least scale in (0, limit] that overturns, with details.

    - `solve_row`: (scales, whether at full accuracy) ↦ (margins, numbers of impacts)
    - `limit`: end of the range
    - `spacing`: distance between the scales of the scan
    """
    zero, one = jnp.zeros_like(limit), jnp.ones_like(limit)
    zero_count = jnp.zeros((), jnp.int32)
    infinite = jnp.full_like(limit, jnp.inf)
    dips = jnp.zeros((DIPS, 3), limit.dtype)
    start = zero_count, zero_count, zero, zero, one, infinite, -one, zero_count, zero, infinite, zero, one
    state = _State(*start, dips, dips + 1)

    def advance(state: _State) -> _State:
        scales = jax.lax.switch(
            state.stage, [functools.partial(scales_of, state, limit, spacing) for scales_of in _SCALES]
        )
        # Under `vmap`, searches that have ended wait for the others, and meanwhile solve scenes of scale 0,
        # without motion.
        scales = jnp.where(_is_unfinished(state, limit), scales, 0.0)
        margin, impacts = solve_row(scales, state.stage >= CONFIRM)

        def apply(update) -> _State:
            after = update(state, scales, margin, impacts, limit)
            return jax.tree.map(lambda new, old: jnp.asarray(new, old.dtype), after, state)

        return jax.lax.switch(state.stage, [functools.partial(apply, update) for update in _UPDATES])

    state = jax.lax.while_loop(lambda state: _is_unfinished(state, limit), advance, state)
    is_found = jnp.isfinite(state.hi)
    is_below = (state.dips[:, 2] > 0) & (state.dips[:, 2] < state.hi)
    dip = jnp.min(jnp.where(is_below, state.dip_margins[:, 1], 1.0))
    scale = jnp.where(is_found, 0.5 * (state.lo + state.hi), jnp.inf)
    impacts = jnp.where(is_found, state.impacts, 0)
    return FirstBoundary(scale, dip, state.widest_step, impacts, jnp.minimum(state.finished_to, limit))


def _is_unfinished(state: _State, limit: Array) -> Array:
    is_bracket_wide = (
        jnp.isfinite(state.hi)
        & (state.hi - state.lo > BRACKET_TOLERANCE * state.hi)
        & (state.rounds < MAX_DIVISIONS)
    )
    return (state.stage < NARROW) | is_bracket_wide


def _row_numbers(template: Array) -> Array:
    """Return the integers 1 … ROW_SIZE with the type of `template`."""
    return jnp.arange(1, ROW_SIZE + 1, dtype=template.dtype)


def _coarse_scales(state: _State, limit: Array, spacing: Array) -> Array:
    return limit * _row_numbers(limit) / ROW_SIZE


def _update_coarse(state: _State, scales: Array, margin: Array, impacts: Array, limit: Array) -> _State:
    """Start the scan at the largest scale of the row that does not lift the columns (margin 1). No lower
    scale lifts the columns, because in full contact the response is proportional to the scale."""
    contact_scale = jnp.max(jnp.where(margin == 1, scales, 0.0))
    stage = jnp.where(contact_scale >= limit, ZOOM, SCAN)
    return state._replace(stage=stage, scanned_to=contact_scale, lo=contact_scale, previous=contact_scale)


def _scan_scales(state: _State, limit: Array, spacing: Array) -> Array:
    return jnp.minimum(state.scanned_to + spacing * _row_numbers(limit), limit)


def _update_scan(state: _State, scales: Array, margin: Array, impacts: Array, limit: Array) -> _State:
    scales = jnp.concatenate([jnp.stack([state.previous, state.lo]), scales])
    margin = jnp.concatenate([jnp.stack([state.previous_margin, state.lo_margin]), margin])
    is_found, first = _first_overturning(margin)
    index = jnp.arange(scales.size)
    survives = (margin > 0) & (index < first)
    at_limit = scales[-1] >= limit
    last = jnp.max(jnp.where(survives, index, 0))
    widest = _widest_step(scales, survives | (index == first))
    widest = jnp.where(at_limit & ~is_found, jnp.maximum(widest, limit - scales[last]), widest)
    is_unfinished = jnp.isnan(margin) & (index < first)
    before_unfinished = scales[jnp.maximum(jnp.argmax(is_unfinished) - 1, 0)]
    before_last = jnp.max(jnp.where(survives & (index < last), index, 0))
    is_dip = survives[:-2] & survives[1:-1] & survives[2:]
    is_dip &= (margin[1:-1] <= margin[:-2]) & (margin[1:-1] < margin[2:])
    triples = lambda y: jnp.stack([y[:-2], y[1:-1], y[2:]], axis=1)
    new_dips, new_margins = (
        jnp.where(is_dip[:, None], triples(scales), 0.0),
        jnp.where(is_dip[:, None], triples(margin), 1.0),
    )
    dips, margins = jnp.concatenate([state.dips, new_dips]), jnp.concatenate([state.dip_margins, new_margins])
    # Keep the dips with the lowest estimated minimum: the middle margin, minus the distance by which it lies
    # below the mean of its two neighbours.
    depth = 2 * margins[:, 1] - 0.5 * (margins[:, 0] + margins[:, 2])
    _, lowest = jax.lax.top_k(-depth, DIPS)
    # `scales` and `margin` begin with the two previous survivors, but `impacts` does not; hence `first - 2`.
    return state._replace(
        stage=jnp.where(is_found, CONFIRM, jnp.where(at_limit, ZOOM, SCAN)),
        scanned_to=scales[-1],
        lo=scales[last],
        lo_margin=margin[last],
        hi=jnp.where(is_found, scales[first], jnp.inf),
        hi_margin=jnp.where(is_found, margin[first], -1.0),
        impacts=jnp.where(is_found, impacts[jnp.maximum(first - 2, 0)], 0),
        widest_step=jnp.maximum(state.widest_step, widest),
        finished_to=jnp.minimum(
            state.finished_to, jnp.where(jnp.any(is_unfinished), before_unfinished, jnp.inf)
        ),
        previous=scales[before_last],
        previous_margin=margin[before_last],
        dips=dips[lowest],
        dip_margins=margins[lowest],
    )


def _confirm_scales(state: _State, limit: Array, spacing: Array) -> Array:
    """Return scales above the survivor before `lo`, up to the scale one step above `hi`."""
    end = jnp.minimum(state.hi + (state.hi - state.lo), limit)
    return state.previous + (end - state.previous) * _row_numbers(limit) / ROW_SIZE


def _update_confirm(state: _State, scales: Array, margin: Array, impacts: Array, limit: Array) -> _State:
    is_found, _ = _first_overturning(margin)
    unconfirmed = state._replace(
        lo=state.previous, lo_margin=state.previous_margin, hi=jnp.full_like(state.hi, jnp.inf)
    )
    narrower = _update_narrowing(unconfirmed, scales, margin, impacts, limit)
    # If nothing overturns at full accuracy, the scan continues above these scales.
    next_stage = jnp.where(scales[-1] >= limit, ZOOM, SCAN)
    resumed = narrower._replace(
        scanned_to=scales[-1], previous=narrower.lo, previous_margin=narrower.lo_margin
    )
    return jax.tree.map(
        lambda confirmed, not_confirmed: jnp.where(is_found, confirmed, not_confirmed),
        narrower._replace(stage=ZOOM, rounds=0),
        resumed._replace(stage=next_stage, rounds=0),
    )


def _zoom_scales(state: _State, limit: Array, spacing: Array) -> Array:
    return (0.5 * (state.dips[:, :2] + state.dips[:, 1:])).ravel()


def _update_zoom(state: _State, scales: Array, margin: Array, impacts: Array, limit: Array) -> _State:
    new_scales, new_margins = scales.reshape(DIPS, -1), margin.reshape(DIPS, -1)
    # A new scale may overturn, in an interval narrower than the spacing.
    overturns = (margin <= 0) & (scales < state.hi)
    is_opened, lowest_opened = jnp.any(overturns), jnp.argmin(jnp.where(overturns, scales, jnp.inf))
    hi = jnp.where(is_opened, scales[lowest_opened], state.hi)
    candidates = jnp.concatenate([scales, state.dips.ravel(), state.lo[None]])
    candidate_margins = jnp.concatenate([margin, state.dip_margins.ravel(), state.lo_margin[None]])
    last = jnp.argmax(jnp.where((candidate_margins > 0) & (candidates < hi), candidates, -1.0))
    # Each dip now has five scales. Of the inner three, keep the survivor with the lowest margin, together
    # with its two neighbours.
    dip_scales, dip_margins = (
        jnp.concatenate([state.dips, new_scales], axis=1),
        jnp.concatenate([state.dip_margins, new_margins], axis=1),
    )
    order = jnp.argsort(dip_scales, axis=1)
    dip_scales, dip_margins = (jnp.take_along_axis(y, order, axis=1) for y in (dip_scales, dip_margins))
    deepest = jnp.argmin(jnp.where(dip_margins[:, 1:-1] > 0, dip_margins[:, 1:-1], 1.0), axis=1)
    triples = jnp.stack([deepest, deepest + 1, deepest + 2], axis=1)
    rounds = state.rounds + 1
    return state._replace(
        stage=jnp.where(rounds == MAX_ZOOMS, NARROW, ZOOM),
        rounds=jnp.where(rounds == MAX_ZOOMS, 0, rounds),
        lo=jnp.where(is_opened, candidates[last], state.lo),
        lo_margin=jnp.where(is_opened, candidate_margins[last], state.lo_margin),
        hi=hi,
        hi_margin=jnp.where(is_opened, margin[lowest_opened], state.hi_margin),
        impacts=jnp.where(is_opened, impacts[lowest_opened], state.impacts),
        dips=jnp.take_along_axis(dip_scales, triples, axis=1),
        dip_margins=jnp.take_along_axis(dip_margins, triples, axis=1),
    )


def _narrowing_scales(state: _State, limit: Array, spacing: Array) -> Array:
    fractions = points_near_root(
        state.lo_margin, state.hi_margin, ROW_SIZE - 2 * ROOT_OFFSETS.size, ROOT_OFFSETS, jnp
    )
    return state.lo + (state.hi - state.lo) * fractions


def _update_narrowing(state: _State, scales: Array, margin: Array, impacts: Array, limit: Array) -> _State:
    """Return the state with a narrower bracket, from ascending scales inside the present bracket."""
    is_found, first = _first_overturning(margin)
    index = jnp.arange(scales.size)
    survives = (margin > 0) & (index < first)
    any_survives, last = jnp.any(survives), jnp.max(jnp.where(survives, index, 0))
    first = jnp.minimum(first, scales.size - 1)
    return state._replace(
        rounds=state.rounds + 1,
        lo=jnp.where(any_survives, scales[last], state.lo),
        lo_margin=jnp.where(any_survives, margin[last], state.lo_margin),
        hi=jnp.where(is_found, scales[first], state.hi),
        hi_margin=jnp.where(is_found, margin[first], state.hi_margin),
        impacts=jnp.where(is_found, impacts[first], state.impacts),
    )


_SCALES = (_coarse_scales, _scan_scales, _confirm_scales, _zoom_scales, _narrowing_scales)
_UPDATES = (_update_coarse, _update_scan, _update_confirm, _update_zoom, _update_narrowing)


def _first_overturning(margin: Array) -> tuple[Array, Array]:
    """Return whether any scale overturns, and the index of the first scale that overturns, or the number of
    scales if none overturns."""
    overturns = margin <= 0
    return jnp.any(overturns), jnp.where(jnp.any(overturns), jnp.argmax(overturns), margin.size)


def _widest_step(scales: Array, is_used: Array) -> Array:
    """Return the widest step between neighbours among the scales with `is_used`; `scales` are in ascending
    order."""
    last_used = jax.lax.cummax(jnp.where(is_used, scales, -jnp.inf))
    steps = jnp.where(is_used[1:] & jnp.isfinite(last_used[:-1]), scales[1:] - last_used[:-1], 0.0)
    return jnp.max(steps)
