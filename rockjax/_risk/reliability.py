"""Probabilities of failure, and design points, of functions of standard normal variables.

A limit state is a function G(u) of a vector u of independent standard normal numbers; failure is G ≤ 0. A
design point is a local minimum of |u| among failing points. The surface of failure separates failing from
surviving points.
"""

from __future__ import annotations

import dataclasses
import math
import warnings
from collections.abc import Callable, Mapping
from numbers import Real
from typing import Any

import jax
import numpy as np
import scipy

from rockjax._checks import as_float, require_whole
from rockjax._progress import bar
from rockjax._results import Interrupted

from ._estimators import ESTIMATORS, AbstractEstimator, ProbabilityEstimate, ProbabilitySlopes
from .limit_state import AbstractLimitState, FunctionLimitState
from .search import MAX_BETA, DesignPoints, design_points

CANDIDATES = 16  # number of random directions drawn for each starting direction
DISAGREEMENT = 1.5  # ratio of the first-order and the sampled probability beyond which they disagree


@dataclasses.dataclass(frozen=True)
class FailureProbability:
    """A sampled probability of failure with its accuracy, and a first-order approximation.

    - `probability`: estimated probability of failure [–]
    - `standard_error`: standard error of `probability` [–]
    - `interval`: 95 % confidence interval. (NaN, NaN) if the estimate has not converged, except for
      `"monte-carlo"`, whose interval is exact for any number of scenes
    - `method`: name of the estimator
    - `scenes`: number of evaluations of the limit state, including the search for design points
    - `effective_sample_size`: effective number of failures; this number of independent failures of equal
      weight would give about the same accuracy
    - `first_order`: probability of the union of the half-spaces α_i·u ≥ β_i, with the directions α_i and the
      distances β_i of the design points. For three or more design points, it is a lower bound of this
      probability. NaN for methods without design points
    - `beta`: distances of the design points from the origin, nearest first; empty for methods without design
      points
    - `disagrees`: True if `first_order` is outside the confidence interval and differs from `probability` by
      a factor of 1.5 or more. Then the limit state is far from plane, or a design point was not found
    - `converged`: True if the estimate reached the requested coefficient of variation in at least two rounds,
      has at least 20 effective failures, and is not dominated by a few samples. If False, the probability may
      be wrong by a large factor
    - `sensitivities`: (dP/dy, standard error) by the name of the parameter y, for the limit state of a
      structure and the method `"line"`; otherwise empty
    - `jumps`: share of the surface of failure across which the limit-state function G jumps, weighted by the
      density of u. The sensitivities leave this part out. NaN without sensitivities
    """

    probability: float
    standard_error: float
    interval: tuple[float, float]
    method: str
    scenes: int
    effective_sample_size: float
    first_order: float
    beta: np.ndarray
    disagrees: bool
    converged: bool
    sensitivities: Mapping[str, tuple[float, float]] = dataclasses.field(default_factory=dict)
    jumps: float = math.nan

    def __repr__(self):
        text = f"FailureProbability: {self.probability:.4g} ({self.described_interval}) "
        text += f"from {self.scenes} scenes, {self.method}"
        if math.isfinite(self.first_order):
            text += f"; first order {self.first_order:.3g}" + (", which disagrees" if self.disagrees else "")
        return text + ("" if self.converged else "; not converged")

    @property
    def described_interval(self) -> str:
        """The confidence interval as text."""
        low, high = self.interval
        return "no interval" if math.isnan(low) else f"95 %: {low:.3g} to {high:.3g}"


def reliability(
    G: Callable[[Any], Any],
    dimension: int,
    *,
    method: str = "subset",
    cov: float = 0.1,
    seed: int = 0,
    starts: int = 16,
    max_scenes: int = 1_000_000,
    progress: Any = False,
) -> FailureProbability:
    """Return the probability of failure P(G(u) ≤ 0) for a vector u of independent standard normal numbers.

    Design points are the local minima of |u| among failing points.

    - `G`: a differentiable JAX function of u, shape (dimension,), that returns a scalar; failure is G ≤ 0
    - `dimension`: length of u, ≥ 1
    - `method`: name of the estimator. `"subset"` and `"monte-carlo"` need neither design points nor
      derivatives. `"importance"` and `"line"` sample around the design points, and suit limit states that are
      nearly plane or have a low dimension
    - `cov`: coefficient of variation to reach, in (0, 1)
    - `seed`: seed of the random numbers, ≥ 0; equal seeds give equal results
    - `starts`: number of directions from which searches for design points start, ≥ 1
    - `max_scenes`: number of evaluations after which no further round begins, ≥ 100
    - `progress`: `True` for a progress bar, or any object with a method `update(number_of_scenes)`

    If the estimate has not converged, a `RuntimeWarning` is issued, and the interval is NaN except with
    `"monte-carlo"`. Ctrl-C during sampling raises [`rockjax.Interrupted`][] with the estimate from the rounds
    so far, or None before the end of the first round. Raises `ValueError` for invalid arguments, if G is NaN
    and, with `"importance"` and `"line"`, if the limit state fails at u = 0 or if no search finds failure.
    """
    check_arguments("reliability", method, cov, seed, starts, max_scenes)
    if not callable(G):
        raise ValueError(f"reliability: G must be a function of u, got {G!r}")
    dimension = require_whole("reliability", "dimension", dimension, 1)
    value = jax.eval_shape(G, as_float(np.zeros(dimension)))
    if getattr(value, "shape", None) != ():
        raise ValueError(f"reliability: G must return a scalar for u of shape ({dimension},), got {value}")
    limit = FunctionLimitState(G, dimension)
    directions = starting_directions(limit, starts, seed)
    return estimate_probability("reliability", limit, directions, method, cov, seed, max_scenes, progress)


def starting_directions(limit: AbstractLimitState, starts: int, seed: int) -> np.ndarray:
    """Return unit vectors in the directions from which searches start, shape (starts, dimension). The first
    half are random directions that lie far apart. The second half are their opposites, which the search does
    not need if G(−u) = G(u)."""
    count = (starts + 1) // 2
    candidates = np.random.default_rng([seed, 1]).standard_normal((CANDIDATES * count, limit.dimension))
    candidates /= np.linalg.norm(candidates, axis=1, keepdims=True)
    chosen, largest_cosine = [0], np.abs(candidates @ candidates[0])
    for _ in range(count - 1):
        chosen.append(int(np.argmin(largest_cosine)))
        largest_cosine = np.maximum(largest_cosine, np.abs(candidates @ candidates[chosen[-1]]))
    directions = candidates[chosen]
    return np.concatenate([directions, -directions])[:starts]


def check_arguments(owner: str, method: str, cov: float, seed: int, starts: int, max_scenes: int) -> None:
    """Raise `ValueError`, with `owner` in the message, for invalid arguments of `reliability`.

    - `method`: must be the name of an estimator; `cov`: must be in (0, 1)
    - `seed`: must be ≥ 0; `starts`: must be ≥ 1; `max_scenes`: must be ≥ 100
    """
    if method not in ESTIMATORS:
        raise ValueError(f"{owner}: method must be one of {', '.join(map(repr, ESTIMATORS))}, got {method!r}")
    if not (isinstance(cov, Real) and 0 < cov < 1):
        raise ValueError(f"{owner}: cov must be in (0, 1), got {cov!r}")
    for name, value, least in (("seed", seed, 0), ("starts", starts, 1), ("max_scenes", max_scenes, 100)):
        require_whole(owner, name, value, least)


def find_design_points(owner: str, limit: AbstractLimitState, directions: np.ndarray) -> DesignPoints:
    """Return the design points of a limit state. `directions` are unit vectors in which searches start, shape
    (s, d). Raises `ValueError` if the limit state fails at the origin, and if the search finds no design
    point."""
    if limit.values(np.zeros((1, limit.dimension)))[0] <= 0:
        raise ValueError(
            f"{owner}: the limit state fails at u = 0, so it has no design point; estimate the probability "
            "with the method 'monte-carlo', which needs none"
        )
    points = design_points(limit, directions)
    if points.beta.size == 0:
        raise ValueError(
            f"{owner}: searches from {len(directions)} directions found no failure within {MAX_BETA:g} "
            "standard deviations; the probability may be below 1e-18; raise starts, or estimate the "
            "probability with the method 'subset', which needs no design point"
        )
    return points


NO_POINTS = DesignPoints(np.zeros((0, 0)), np.zeros((0, 0)), np.zeros(0), np.zeros(0, bool))


def estimate_probability(
    owner: str,
    limit: AbstractLimitState,
    directions: np.ndarray,
    method: str,
    cov: float,
    seed: int,
    max_scenes: int,
    progress: Any,
) -> FailureProbability:
    """Return the probability of failure of a limit state, by one of `ESTIMATORS`.

    - `directions`: unit vectors in which searches for design points start, shape (s, dimension)
    - other arguments: as for `reliability`

    Warns (`RuntimeWarning`) if the estimate has not converged. Ctrl-C during sampling raises `Interrupted`
    with the estimate from the rounds so far, or None before the end of the first round.
    """
    estimator_class = ESTIMATORS[method]
    points = (
        find_design_points(owner, limit, directions) if estimator_class.needs_design_points else NO_POINTS
    )
    estimator = estimator_class(limit, points, np.random.default_rng([seed, 2]))
    latest: list[ProbabilityEstimate] = []
    reported = 0
    try:
        with bar(None, "scenes", progress) as progress_bar:

            def report(estimate: ProbabilityEstimate) -> None:
                nonlocal reported
                progress_bar.update(limit.scenes - reported)
                reported = limit.scenes
                latest[:] = [estimate]

            estimator.run(cov, max_scenes, 500, report)
    except KeyboardInterrupt:
        so_far = _to_result(latest[0], estimator, limit, method, cov, None) if latest else None
        raise Interrupted(f"{owner}: stopped after {limit.scenes} scenes", so_far) from None
    result = _to_result(latest[0], estimator, limit, method, cov, estimator.slopes())
    if not result.converged:
        warnings.warn(f"{owner}: {_explain_nonconvergence(result, cov)}", RuntimeWarning, stacklevel=3)
    return result


def _explain_nonconvergence(result: FailureProbability, cov: float) -> str:
    """Return a sentence with the reason why an estimate has not converged, and the cure."""
    cures = [] if result.method == "subset" else ["method='subset'"]
    if result.probability == 0:
        cause = "no scene fails"
        cures.append("stronger motions or another G, because the probability may be zero")
    elif (achieved := result.standard_error / result.probability) > cov:
        cause = f"the coefficient of variation is {achieved:.2g}, not {cov:g}"
        cures += ["a larger max_scenes", "a larger cov"]
    else:
        cause = "too few scenes fail, or a few with large weights make up most of the sum"
        cures.append("a larger max_scenes")
    return (
        f"the probability {result.probability:.3g} by {result.method!r} has not converged in {result.scenes} "
        f"scenes: {cause}; use {', or '.join(cures)}"
    )


def _to_result(
    estimate: ProbabilityEstimate,
    estimator: AbstractEstimator,
    limit: AbstractLimitState,
    method: str,
    cov: float,
    slopes: ProbabilitySlopes | None,
) -> FailureProbability:
    """Return the result of `estimate_probability` from the last estimate, and from the derivatives of the
    probability, if there are any."""
    points = estimator.points
    first_order = first_order_probability(points)
    low, high = estimate.interval
    converged = estimator.has_converged(estimate, cov) and estimator.has_light_tail()
    ratio = max(first_order, 1e-300) / max(estimate.probability, 1e-300)
    return FailureProbability(
        probability=estimate.probability,
        standard_error=estimate.standard_error,
        interval=estimate.interval if converged or estimator.has_exact_interval else (math.nan, math.nan),
        method=method,
        scenes=limit.scenes,
        effective_sample_size=estimate.effective,
        first_order=first_order,
        beta=points.beta,
        disagrees=bool(
            points.beta.size
            and not low <= first_order <= high
            and not 1 / DISAGREEMENT < ratio < DISAGREEMENT
        ),
        converged=converged,
        sensitivities={} if slopes is None else slopes.by_name,
        jumps=math.nan if slopes is None else slopes.jumps,
    )


def first_order_probability(points: DesignPoints) -> float:
    """Return the probability of the union of half-spaces α_i·u ≥ β_i; NaN if there are no design points.
    Design point i has the direction α_i and the distance β_i from the origin. For one or two half-spaces the
    value is exact; for more it is Ditlevsen's lower bound."""
    if points.beta.size == 0:
        return math.nan
    directions = points.u / points.beta[:, None]
    correlation = np.clip(directions @ directions.T, -1.0, 1.0)
    total = 0.0
    for i, beta in enumerate(points.beta):
        joint = 0.0
        for j in range(i):
            pair = [[1.0, correlation[i, j]], [correlation[i, j], 1.0]]
            joint += scipy.stats.multivariate_normal.cdf(
                [-beta, -points.beta[j]], cov=pair, allow_singular=True
            )
        total += max(float(scipy.stats.norm.sf(beta) - joint), 0.0)
    return total
