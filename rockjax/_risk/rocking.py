"""Failure of rocking structures under Gaussian ground motions: probabilities and most likely motions.

A vector u of independent standard normal numbers determines the motion. The limit-state function G(u) is ≤ 0
if the structure fails. The surface of failure in the space of u separates motions that cause failure from
motions that do not.
"""

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

    - `u`: point in standard normal space, shape (dimension,)
    - `beta`: reliability index |u|
    - `record`: the motion that u determines, locally the most likely motion that causes failure
    - `mode`: failure mode, which is the number of impacts, or of impacts before overturning if the columns
      overturn. −1 if the simulation that counts the impacts did not finish
    - `smooth`: True if the vector u is normal to the surface of failure; otherwise the point is usually at an
      edge of the surface, where the failure mode changes
    - `sensitivities`: dβ/dy for every parameter y of structure and ground motion. Keys are the locations of
      the parameters, such as `"alpha"`, `"restrainers[0].prestress"`, `"superstructure.masses[2]"`. If
      `smooth` is False, the derivatives are one-sided
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
    """Return the most likely ground motions of a Gaussian model that make a structure fail.

    - `podium`: podium with scalar parameters
    - `motion`: a [`rockjax.GaussianMotion`][]
    - `limit`: definition of failure. `"overturning"` means that the columns overturn. A tuple (name, value)
      with value > 0 means that they overturn, or that the peak with this name reaches the value. If there is
      a peak for each mode, story, floor or joint, the worst one counts. The names are

        - for all podiums `"rotation"` (divided by the slenderness α, value < 1), `"friction"` (shear force of
          a joint divided by its axial force), `"unloading"` (loss of axial force of a joint, divided by its
          dead load) and `"foundation shear"` (divided by the total weight)
        - for podiums with a superstructure also `"shear"` (base shear divided by the weight of the
          superstructure)
        - for elastic superstructures also `"deformation"` [m]
        - for an elastic `ShearBuilding` also `"drift"` [m] and `"floor acceleration"` [m/s²]

    - `starts`: number of directions from which searches for design points start, ≥ 1
    - `seed`: seed of the random numbers, ≥ 0; equal seeds give equal results

    Returns the points u on the surface of failure at which |u| has a local minimum, nearest first. If
    `motion` has no pulse, −u is a design point whenever u is one. The surface of failure has edges where the
    number of impacts before overturning changes, so some minima are at edges. With the reliability index β =
    |u| and the standard normal distribution function Φ, Φ(−β) approximates the probability of failure only if
    the surface is nearly plane. In hundreds of dimensions it is not; use [`rockjax.failure_probability`][]
    for probabilities.

    Raises `ValueError` for invalid arguments, if a scene does not finish, if the structure fails without any
    motion, and if the search finds no motion that makes the structure fail.
    """
    owner = "design_points"
    check_arguments(owner, "importance", 0.1, seed, starts, 1000)
    state = limit_state(owner, podium, motion, limit)
    points = find_design_points(owner, state, starting_directions(state, starts, seed))
    _, slope, by_name = state.with_sensitivities(points.u)
    impacts = state.impacts(points.u)
    slope_norm = np.linalg.norm(slope, axis=1)
    return [
        DesignPoint(
            u=points.u[k],
            beta=float(points.beta[k]),
            record=motion.record(points.u[k]),
            mode=-1 if np.isnan(impacts[k]) else int(impacts[k]),
            smooth=bool(points.aligned[k]),
            sensitivities={name: float(y[k] / slope_norm[k]) for name, y in by_name.items()},
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
    """Return the probability that a Gaussian ground motion makes a structure fail.

    - `podium`, `motion`, `limit`, `starts`, `seed`: as for [`rockjax.design_points`][]
    - `method`: name of the estimator. `"subset"` and `"monte-carlo"` need neither design points nor
      derivatives. `"importance"` and `"line"` sample around the design points
    - `cov`: coefficient of variation to reach, in (0, 1)
    - `max_scenes`: number of scenes after which no further round begins, ≥ 100
    - `progress`: `True` for a progress bar, or any object with a method `update(number_of_scenes)`

    Scenes (the structure under one motion each) are solved in batches on all cores. A rocking structure fails
    under many moderate motions of no particular shape, far from any design point. Methods that sample around
    design points may miss these motions, and then underestimate the probability. If the estimate has not
    converged, a `RuntimeWarning` is issued, and the result has a confidence interval only with the method
    `"monte-carlo"`. Ctrl-C during sampling raises [`rockjax.Interrupted`][] with the estimate from the rounds
    so far, or None before the end of the first round.

    With `"line"` the result has `sensitivities`, dP/dy with standard errors for every parameter y of
    structure and ground motion. They need one reverse pass for each crossing of a line with the surface of
    failure. Across some parts of this surface, the limit-state function G (which is ≤ 0 at failure) jumps.
    The sensitivities leave these parts out; the field `jumps` of the result is their share of the surface,
    weighted by the density of u.

    Raises `ValueError` for invalid arguments, if a scene does not finish and, if the method needs design
    points, in the same cases as `design_points`.
    """
    owner = "failure_probability"
    check_arguments(owner, method, cov, seed, starts, max_scenes)
    state = limit_state(owner, podium, motion, limit)
    directions = starting_directions(state, starts, seed)
    return estimate_probability(owner, state, directions, method, cov, seed, max_scenes, progress)


def limit_state(owner: str, podium: Podium, motion: GaussianMotion, limit: Any) -> StructureLimitState:
    """Return the limit state of a podium under a Gaussian motion; the arguments are as for
    [`rockjax.design_points`][]. Raises `ValueError` for invalid arguments."""
    if not isinstance(podium, Podium):
        raise ValueError(f"{owner}: podium must be a rockjax.Podium, got {type(podium).__name__}")
    if not isinstance(motion, GaussianMotion):
        raise ValueError(f"{owner}: motion must be a rockjax.GaussianMotion, got {type(motion).__name__}")
    check_single(owner, podium)
    return StructureLimitState(podium, motion, parse_limit(owner, limit, podium))
