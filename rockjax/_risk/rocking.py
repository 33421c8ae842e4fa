"""Probabilities of failure of rocking structures under Gaussian ground motions, and the most likely motions
that cause it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from rockjax._motions.record import Record
from rockjax._responses.arguments import check_single
from rockjax._structures import Podium

from .gaussian import GaussianMotion
from .reliability import (
    FailureProbability,
    check_arguments,
    estimate_probability,
    find_design_points,
    starting_directions,
)
from .structure import StructureLimitState, parse_limit


@dataclasses.dataclass(frozen=True)
class DesignPoint:
    """A local minimum of |u| among the motions that cause failure.

    - `u`: point in standard normal space, shape (dimension,); `beta`: |u|, the reliability index
    - `record`: the motion of u, locally the most likely one that causes failure
    - `mode`: number of impacts before the fall, or in the scene; -1 if they continue beyond the steps of a
      scene
    - `smooth`: whether u is normal to the limit state; otherwise the point is at an edge, where the mode of
      failure changes
    - `sensitivities`: location of y → dβ/dy, for every parameter y of structure and ground motion; one-sided
      if not `smooth`. Locations are for instance `"alpha"`, `"restrainers[0].prestress"`,
      `"superstructure.masses[2]"`
    """

    u: np.ndarray
    beta: float
    record: Record
    mode: int
    smooth: bool
    sensitivities: Mapping[str, float]

    def __repr__(self):
        edge_note = "" if self.smooth else ", at an edge of the limit state"
        return f"DesignPoint: β = {self.beta:.4f} after {self.mode} impacts{edge_note}"


def design_points(
    podium: Podium,
    motion: GaussianMotion,
    *,
    limit: Any = "overturning",
    starts: int = 8,
    seed: int = 0,
) -> list[DesignPoint]:
    """Return the most likely ground motions of a Gaussian model that make a structure fail (host).

    - `podium`: of single numbers; `motion`: a [`rockjax.GaussianMotion`][]
    - `limit`: `"overturning"`, or `("rotation", max|θ|/α)`, `("deformation", m)`, `("shear", V_s/(m_t g))`,
      and for a building `("drift", m)`, `("floor acceleration", m/s²)`: the worst of its stories
    - `starts`: number of directions from which to search; `seed`: of the random numbers; equal seeds give
      equal results

    Returns local minima of |u| on the limit state, nearest first; without a pulse each has its mirror image.
    G jumps where the number of impacts before the fall changes: some minima are edges, where no derivative is
    zero. Φ(−β) is a probability only if the limit state is nearly plane, and in hundreds of dimensions it is
    not: see [`rockjax.failure_probability`][].

    Raises `ValueError` for invalid arguments, if the structure fails at rest, and if no motion makes it fail.
    """
    owner = "design_points"
    check_arguments(owner, "importance", 0.1, seed, starts, 1000)
    state = limit_state(owner, podium, motion, limit)
    points = find_design_points(owner, state, starting_directions(state, starts, seed))
    _, slope, named = state.with_sensitivities(points.u)
    impacts = state.impacts(points.u)
    length = np.linalg.norm(slope, axis=1)
    return [
        DesignPoint(
            u=points.u[k],
            beta=float(points.beta[k]),
            record=motion.record(points.u[k]),
            mode=-1 if np.isnan(impacts[k]) else int(impacts[k]),
            smooth=bool(points.aligned[k]),
            sensitivities={name: float(y[k] / length[k]) for name, y in named.items()},
        )
        for k in range(points.beta.size)
    ]


def failure_probability(
    podium: Podium,
    motion: GaussianMotion,
    *,
    limit: Any = "overturning",
    method: str = "subset",
    cov: float = 0.1,
    seed: int = 0,
    starts: int = 8,
    max_scenes: int = 1_000_000,
    progress: Any = False,
) -> FailureProbability:
    """Return the probability that a Gaussian ground motion makes a structure fail (host).

    - `podium`, `motion`, `limit`, `starts`, `seed`: as for [`rockjax.design_points`][]
    - `method`: `"subset"`, `"monte-carlo"`: without design points or derivatives; `"importance"`, `"line"`:
      around the design points
    - `cov`: coefficient of variation to reach, in (0, 1); `max_scenes`: simulations, after which no further
      round begins
    - `progress`: `True` for a progress bar, or anything with `update(number_of_scenes)`

    Scenes are simulated in batches on all cores. Many moderate motions of no particular shape make a rocking
    structure fail, far from any design point. The methods around design points may miss them, and then their
    estimates are too small. An estimate that has not converged warns (`RuntimeWarning`); it has an interval
    only with `"monte-carlo"`. Ctrl-C raises [`rockjax.Interrupted`][] with the estimate so far.

    With `"line"` the result has `sensitivities`, dP/dy with standard errors for every parameter y of
    structure and ground motion. They need one reverse pass for each crossing of a line with the surface of
    failure. They do not include the parts of this surface where G jumps, whose share is `jumps`.

    Raises `ValueError` for invalid arguments and, if the method needs design points, in the same cases as
    `design_points`.
    """
    owner = "failure_probability"
    check_arguments(owner, method, cov, seed, starts, max_scenes)
    state = limit_state(owner, podium, motion, limit)
    directions = starting_directions(state, starts, seed)
    return estimate_probability(owner, state, directions, method, cov, seed, max_scenes, progress)


def limit_state(owner: str, podium: Podium, motion: GaussianMotion, limit: Any) -> StructureLimitState:
    """Return the limit state of a podium under a Gaussian motion.

    - `owner`: name of the calling function, for messages
    - `podium`: of single numbers; `motion`: a `GaussianMotion`
    - `limit`: as for [`rockjax.design_points`][]

    Raises `ValueError` for invalid arguments.
    """
    if not isinstance(podium, Podium):
        raise ValueError(f"{owner}: podium must be a rockjax.Podium, got {type(podium).__name__}")
    if not isinstance(motion, GaussianMotion):
        raise ValueError(f"{owner}: motion must be a rockjax.GaussianMotion, got {type(motion).__name__}")
    check_single(owner, podium)
    return StructureLimitState(podium, motion, parse_limit(owner, limit, podium))
