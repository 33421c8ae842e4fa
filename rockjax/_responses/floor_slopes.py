"""Derivatives of the motion of floors with respect to the logarithms of named parameters, (L8)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rockjax._engine.coefficients import present
from rockjax._engine.flat import Nodes
from rockjax._engine.solve import solve
from rockjax._excitations.base import AbstractExcitation
from rockjax._excitations.sampled import common_size
from rockjax._options import Options
from rockjax._oscillators import Load
from rockjax._programs.derivatives import pushed
from rockjax._programs.program import StoredProgram
from rockjax._results import State
from rockjax._structures import Podium

from . import history
from .floor import Bodies, Motions, Pieces, bodies, in_direction, motions, padded_places, with_beam
from .sensitivities import moved


class Solution(NamedTuple):
    """A scene with derivatives along a first axis of parameters.

    - `nodes`: of the history; `breakpoints`, `start`: of the ground motion [s]; `weights`: of the floors
    - `slopes`: derivatives of these
    """

    nodes: Nodes
    breakpoints: Any
    start: Any
    weights: Any
    slopes: Any


@StoredProgram
def solved(
    podium: Podium,
    excitation: AbstractExcitation,
    initial: State,
    t_end: Any,
    options: Options,
    names: tuple[str, ...] = (),
    levels: tuple[Any, ...] = (),
    history: int = 0,
) -> Solution:
    """Solve a scene with derivatives with respect to the logarithms of the parameters `names`.

    - `podium`, `excitation`, `initial`, `t_end`, `options`: of the scene
    - `levels`: floors whose weights are returned; `history`: number of nodes that can be stored
    """

    def function(factors):
        changed = moved(podium, excitation, names, factors)
        (_, nodes), (_, (piece, used)) = solve(changed[0], changed[1], initial, t_end, options, history)
        top = changed[0].superstructure
        stories = None if top is None or not levels else top.story_weights
        weights = [present(stories)[level - 1] for level in levels]
        motion = changed[1]
        return (nodes, motion.breakpoints, motion.support[0], weights), (piece, used)

    ones = jnp.ones(len(names))
    floats, slopes, (piece, used) = pushed(function, [ones], [jnp.eye(len(names))], loops=True)
    nodes = floats[0]._replace(piece=piece, used=used)
    _, breakpoints, start, weights = floats
    return Solution(nodes, breakpoints, start, weights, slopes)


@StoredProgram
def along_with_slopes(
    scene: history.Solved, node_slopes: Nodes, t, left, node, names: tuple[str, ...] = ()
) -> tuple[Bodies, Bodies]:
    """Return the motion at times t (n,) as `bodies` does, and its derivatives along a first axis.

    - `scene`: solved scene; `node_slopes`: derivatives of its nodes along a first axis
    - `names`: the parameters
    """
    podium, excitation, nodes, end, method, rtol = scene

    def function(factors):
        changed = moved(podium, excitation, names, factors)
        move = lambda y, slope: y + jnp.tensordot(factors - 1, slope, axes=1)
        x, v = (jax.tree.map(move, *pair) for pair in ((nodes.x, node_slopes.x), (nodes.v, node_slopes.v)))
        changed_scene = (*changed, nodes._replace(x=x, v=v), end, method, rtol)
        return bodies(changed_scene, t, left, node), None

    ones = jnp.ones(len(names))
    found, slopes, _ = pushed(function, [ones], [jnp.eye(len(names))])
    return found, slopes


class Slopes(NamedTuple):
    """Derivatives of a scene's motion with respect to one parameter.

    - `motions`: of accelerations at fixed times, and of velocities; `times`: of the starts of pieces [s]
    - `weights`: of the weights of floors, by level
    """

    motions: Motions
    times: np.ndarray
    weights: dict[str, np.ndarray]


def capacity_for(used: int) -> int:
    """Return one of a few capacities for a history of about `used` nodes."""
    return common_size(used + used // 8 + 64, *history.NODES)


def motions_with_slopes(
    scene: history.Solved, solution: Solution, pieces: Pieces, names: tuple[str, ...], levels: Sequence[str]
) -> tuple[Motions, list[Slopes]]:
    """Return the motion in pieces, and its derivatives with respect to each parameter.

    - `scene`: scene with the nodes of `solution`
    - `levels`: those of `solution.weights`, as keys of `Slopes.weights`
    """
    node_slopes, breaks, start, weights = jax.tree.map(np.asarray, solution.slopes)
    places = pieces.places
    count = places[0].size
    found, slopes = along_with_slopes(scene, node_slopes, *padded_places(*places), names=names)
    found = jax.tree.map(lambda y: np.asarray(y)[:count], found)
    slopes = jax.tree.map(lambda y: np.asarray(y)[:, :count], slopes)
    moved_times = np.zeros((len(names), pieces.start.size))
    of_breaks = np.asarray(solution.breakpoints)
    own, first = np.isfinite(of_breaks), float(np.asarray(solution.start))
    stamps = np.asarray(solution.nodes.t)
    hit = np.isfinite(np.asarray(solution.nodes.impact_time))
    at_impacts = node_slopes.impact_time[:, hit]
    for at, slope in ((first, start[:, None]), (of_breaks[own], breaks[:, own]), (stamps[hit], at_impacts)):
        at = np.atleast_1d(at)
        place = np.searchsorted(pieces.start, at)
        there = (place < pieces.start.size) & (pieces.start[np.minimum(place, pieces.start.size - 1)] == at)
        moved_times[:, place[there]] = slope[:, there]
    of_each = [
        Slopes(
            motions(jax.tree.map(lambda y, q=q: y[q], slopes), pieces),
            moved_times[q],
            {level: weight[q] for level, weight in zip(levels, weights, strict=True)},
        )
        for q in range(len(names))
    ]
    return motions(found, pieces), of_each


def slope_of_load(
    load: Load,
    pieces: Pieces,
    found: Motions,
    slope: Slopes,
    weights: np.ndarray,
    change: np.ndarray,
    direction: str,
) -> Load:
    """Return the derivative of a load, (L8).

    - `load`, `pieces`, `found`: of the floor
    - `slope`: derivatives of the motion; `weights`: W_i and `change`, their derivatives, shape (modes,)
    - `direction`: "horizontal" or "vertical"

    Velocities at the fixed stamps of events differ by Δv' + (a⁺ − a⁻ − jump of ü_g) t', so the kick
    (a⁻ − a⁺) t' + Δv' of (L8) is that difference less the jump of ü_g times t'.
    """
    row = in_direction(with_beam(weights), direction)
    moved_row = in_direction(np.append(change, -change.sum()), direction)
    if direction == "vertical":
        moved_row = 0 * moved_row
    terms = slope.motions.terms @ row + found.terms @ moved_row
    differences = (slope.motions.after - slope.motions.before) @ row
    of_beam = (found.after - found.before)[:, -2:] @ moved_row[-2:]
    kick = differences + np.where(pieces.is_impact, of_beam, 0.0)
    kick -= found.jump[:, int(direction == "vertical")] * slope.times
    kick[0] = -load.terms[0, 0] * slope.times[0]  # floors start at rest, whatever their velocity
    return Load(load.start, load.length, terms, kick, load.kick * slope.times, slope.times)
