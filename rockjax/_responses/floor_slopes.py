"""Derivatives of floor motions with respect to the logarithms of named parameters, (L8) of docs/floors.md.

The module `floor` defines bodies, nodes and pieces.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rockjax._engine.coefficients import not_none
from rockjax._engine.flat import Nodes
from rockjax._engine.solve import solve
from rockjax._excitations.base import AbstractExcitation
from rockjax._excitations.sampled import common_size
from rockjax._options import Options
from rockjax._oscillators import Load
from rockjax._programs.derivatives import push_forward
from rockjax._programs.program import StoredProgram
from rockjax._results import State
from rockjax._structures import Podium

from . import history
from .floor import (
    POINTS,
    Bodies,
    PieceMotions,
    Pieces,
    before_and_at,
    bodies,
    in_direction,
    pad,
    terms_of,
    with_beam,
)
from .sensitivities import with_unit_factors


class Solution(NamedTuple):
    """A solved scene, and its derivatives with respect to the logarithms of the named parameters.

    - `nodes`: nodes of the history
    - `breakpoints`, `start`: breakpoints and start of the ground motion [s]
    - `weights`: for each level, the weights of the modes in the motion of this floor, shape (modes,)
    - `slopes`: derivatives of (nodes, breakpoints, start, weights), with the parameters along the first axis
    """

    nodes: Nodes
    breakpoints: Any
    start: Any
    weights: Any
    slopes: Any


@StoredProgram
def solve_with_slopes(
    podium: Podium,
    excitation: AbstractExcitation,
    initial: State,
    t_end: Any,
    options: Options,
    names: tuple[str, ...] = (),
    levels: tuple[Any, ...] = (),
    history: int = 0,
) -> Solution:
    """Solve a scene with derivatives with respect to the logarithms of named parameters.

    - `podium`, `excitation`, `initial`, `t_end`, `options`: the scene
    - `names`: names of the parameters
    - `levels`: numbers of the stories for which weights are returned
    - `history`: number of nodes that the history can hold
    """

    def function(factors):
        structure, motion = with_unit_factors(podium, excitation, names, factors)
        (_, nodes), (_, (piece, used)) = solve(structure, motion, initial, t_end, options, history)
        top = structure.superstructure
        stories = None if top is None or not levels else top.story_weights
        weights = [not_none(stories)[level - 1] for level in levels]
        return (nodes, motion.breakpoints, motion.support[0], weights), (piece, used)

    ones = jnp.ones(len(names))
    floats, slopes, (piece, used) = push_forward(function, [ones], [jnp.eye(len(names))], loops=True)
    nodes = floats[0]._replace(piece=piece, used=used)
    _, breakpoints, start, weights = floats
    return Solution(nodes, breakpoints, start, weights, slopes)


@StoredProgram
def bodies_with_slopes(
    scene: history.Solved, node_slopes: Nodes, t, left, node, names: tuple[str, ...] = ()
) -> tuple[Bodies, Bodies]:
    """Return the result of `bodies`, and its derivatives at fixed times with respect to the logarithms of
    named parameters. The derivatives have the parameters along the first axis.

    - `scene`: solved scene; `node_slopes`: derivatives of the nodes, with the parameters along the first axis
    - `t`, `left`, `node`: as for `bodies`
    - `names`: names of the parameters
    """
    podium, excitation, nodes, end, method, rtol = scene

    def function(factors):
        changed = with_unit_factors(podium, excitation, names, factors)
        # `node_slopes` are derivatives at fixed times, so `nodes.t` stays constant.
        move = lambda y, slope: y + jnp.tensordot(factors - 1, slope, axes=1)
        x, v = (jax.tree.map(move, *pair) for pair in ((nodes.x, node_slopes.x), (nodes.v, node_slopes.v)))
        changed_scene = (*changed, nodes._replace(x=x, v=v), end, method, rtol)
        return bodies(changed_scene, t, left, node), None

    ones = jnp.ones(len(names))
    motion, slopes, _ = push_forward(function, [ones], [jnp.eye(len(names))])
    return motion, slopes


class Slopes(NamedTuple):
    """Derivatives of the motion of a scene with respect to the logarithm of one parameter.

    - `motions`: derivatives of the motion of modes and beam at fixed times
    - `times`: derivatives of the starts of the pieces [s]
    - `ground`: `times` multiplied by the jumps of the ground acceleration at the starts of the pieces,
      horizontal and vertical, shape (n, 2) [m/s]
    - `weights`: derivatives of the weights of the modes, by level
    """

    motions: PieceMotions
    times: np.ndarray
    ground: np.ndarray
    weights: dict[str, np.ndarray]


def capacity_for(used: int) -> int:
    """Return the capacity of a history for about `used` nodes. It is one of a few sizes, so that compiled
    programs are reused."""
    return common_size(used + used // 8 + 64, *history.NODES)


def motions_with_slopes(
    scene: history.Solved, solution: Solution, pieces: Pieces, names: tuple[str, ...], levels: Sequence[str]
) -> tuple[PieceMotions, list[Slopes]]:
    """Return the motion in pieces, and its derivatives with respect to the logarithm of each parameter.

    - `scene`: the solved scene, with the nodes of `solution`
    - `solution`: the scene with its derivatives
    - `pieces`: pieces of the scene; `names`: names of the parameters
    - `levels`: levels of `solution.weights`, which become the keys of `Slopes.weights`
    """
    node_slopes, breaks, start, weights = jax.tree.map(np.asarray, solution.slopes)
    (t, node), starts = pieces.points, before_and_at(pieces.start)
    samples = tuple(map(np.concatenate, zip((t, np.zeros(t.size, bool), node), starts, strict=True)))
    sampled, slopes = bodies_with_slopes(scene, node_slopes, *pad(*samples), names=names)
    sampled = jax.tree.map(lambda y: np.asarray(y)[: samples[0].size], sampled)
    ground = sampled.ground[t.size :].reshape(2, -1, 2)
    time_slopes = np.zeros((len(names), pieces.start.size))
    breakpoints = np.asarray(solution.breakpoints)
    is_finite = np.isfinite(breakpoints)
    is_impact = np.isfinite(np.asarray(solution.nodes.impact_time))
    # The start of a piece depends on the parameters only if it is the start of the ground motion, a
    # breakpoint or an impact.
    for times, slope in (
        (np.atleast_1d(np.asarray(solution.start)), start[:, None]),
        (breakpoints[is_finite], breaks[:, is_finite]),
        (np.asarray(solution.nodes.t)[is_impact], node_slopes.impact_time[:, is_impact]),
    ):
        index = np.searchsorted(pieces.start, times)
        is_start = pieces.start[np.minimum(index, pieces.start.size - 1)] == times
        is_start &= index < pieces.start.size
        time_slopes[:, index[is_start]] = slope[:, is_start]
    slopes_of_parameters = [
        Slopes(
            _motions(jax.tree.map(lambda y, q=q: np.asarray(y)[q, : samples[0].size], slopes), pieces),
            time_slopes[q],
            (ground[1] - ground[0]) * time_slopes[q][:, None],
            {level: weight[q] for level, weight in zip(levels, weights, strict=True)},
        )
        for q in range(len(names))
    ]
    return _motions(sampled, pieces), slopes_of_parameters


def _motions(sampled: Bodies, pieces: Pieces) -> PieceMotions:
    """Return the motion in pieces, or its derivative.

    `sampled` has three blocks of values: first at the points of the pieces, then just before the starts of
    the pieces, then at these starts.
    """
    size = pieces.start.size
    count = size * POINTS.size
    before, after = sampled.velocities[count:].reshape(2, size, -1)
    accelerations = sampled.accelerations[:count].reshape(size, POINTS.size, -1)
    return PieceMotions(terms_of(accelerations), after - before)


def slope_of_load(
    load: Load,
    pieces: Pieces,
    motion: PieceMotions,
    slope: Slopes,
    weights: np.ndarray,
    change: np.ndarray,
    direction: str,
) -> Load:
    """Return the derivative of the load of a floor with respect to the logarithm of one parameter, (L8).

    - `load`: the acceleration of the floor, and the jumps of its velocity
    - `pieces`, `motion`: pieces of the scene, and the motion of modes and beam in them
    - `slope`: derivatives of the motion
    - `weights`, `change`: weights W_i of the floor and their derivatives, shape (modes,)
    - `direction`: "horizontal" or "vertical"

    Let t' and Δv' be the derivatives of the time t of an event and of its velocity jump Δv, and let a⁻ and a⁺
    be the accelerations of the floor just before and just after the event. Velocities are relative to the
    ground, but accelerations are absolute. The derivatives of the velocity at fixed times just before and
    just after the event therefore differ by Δv' + (a⁻ − a⁺ + jump of ü_g) t'. (L8) needs this difference
    without the jump of ü_g, Δv' + (a⁻ − a⁺) t', which is the field `kick` of the result.
    """
    row = in_direction(with_beam(weights), direction)
    row_slope = in_direction(np.append(change, -change.sum()), direction)
    if direction == "vertical":  # all floors move vertically with the beam, whatever their weights
        row_slope = 0 * row_slope
    terms = slope.motions.terms @ row + motion.terms @ row_slope
    differences = slope.motions.jumps @ row
    of_beam = motion.jumps[:, -2:] @ row_slope[-2:]  # velocities of modes do not jump at impacts
    kick = differences + np.where(pieces.is_impact, of_beam, 0.0)
    kick -= slope.ground[:, int(direction == "vertical")]
    # Oscillators start at rest relative to the floor, so only the term −a⁺ t' remains at the start.
    kick[0] = -load.terms[0, 0] * slope.times[0]
    return Load(load.start, load.length, terms, kick, load.kick * slope.times, slope.times)
