"""Target on a probability of failure under random ground motions.

The probability P of failure is estimated by sampling, outside jit, for one structure at a time. A vector u of
standard normal numbers determines the ground motion. During a search for a design, P is estimated from rays:
half-lines from u = 0 through samples u for which the first structure of the search fails. The positions at
which a ray enters and leaves the region of failure give P (`rockjax/_risk/rays.py`). An independent sample,
with another seed, verifies the design.
"""

from __future__ import annotations

import math
import warnings
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import rockjax as rj
from rockjax._risk.rays import probability_at, sample_rays, solve_factor
from rockjax._risk.rocking import limit_state
from rockjax._risk.structure import parse_limit
from rockjax.internal import concrete, require_instance, require_number, require_whole

from ._suite import Values
from ._targets import AbstractTarget, Name, require_limit

SAFETY_FACTOR = 1.645  # in 95 % of independent samples, the error of ln P is below this many standard errors
MAX_SCENES = 10_000_000  # largest number of scenes (simulations) of an independent sample
# A structure uses the independent sample of another one if all relative differences of their parameters are
# at most this.
SAME_STRUCTURE = 1e-3


class FailureProbability(AbstractTarget):
    """A random ground motion makes the structure fail with a probability of at most `at_most`.

    - `at_most`: probability, 1e-9 ≤ at_most ≤ 0.3 [–]; `motion`: a [`rockjax.GaussianMotion`][]
    - `limit`: limit state, as for [`rockjax.failure_probability`][]. A limit on forces in the joints excludes
      design variables that change the height or the end radius of round columns
    - `cov`: coefficient of variation of the estimates, in [0.02, 0.5]; `seed`: seed of the random numbers,
      ≥ 0
    - `rays`: largest number of rays (see below) from which the search computes the probability, ≥ 8
    - `name`: name in reports; None for a description

    A vector u of standard normal numbers determines the motion. Let k be the factor on u with which the
    probability of failure equals `at_most`. The margin is ln k. For motions without a pulse, k is a factor on
    the motion. During the search, k is computed along rays: half-lines from u = 0 through samples with which
    the first structure of the search fails. The same rays are used for all structures. The derivatives of k
    with respect to the design variables follow from the implicit function theorem. The search aims at a
    probability below `at_most`, to allow for the scatter between two samples.

    A design is verified by subset simulation with another seed. The probability along the rays is multiplied
    by a factor so that it agrees with this independent sample, and the margin is computed again.
    `Design.probabilities` contains the estimate from the sample. If the sample has not converged in 10
    million scenes (simulations), the margin is NaN, and the design is not satisfied. Its result is then
    `unverified`, unless another target is violated. Raises `ValueError` for invalid arguments.
    """

    at_most: float = eqx.field(static=True)
    motion: rj.GaussianMotion
    limit: Any = eqx.field(static=True)
    cov: float = eqx.field(static=True)
    rays: int = eqx.field(static=True)
    seed: int = eqx.field(static=True)
    name: Name = eqx.field(static=True)

    def __init__(
        self,
        at_most: float,
        motion: rj.GaussianMotion,
        *,
        limit: Any = "overturning",
        cov: float = 0.1,
        rays: int = 64,
        seed: int = 0,
        name: Name = None,
    ):
        owner = type(self).__name__
        at_most = require_limit(owner, "at_most", at_most)
        self.at_most = require_number(owner, "at_most", at_most, lambda v: 1e-9 <= v <= 0.3, "in [1e-9, 0.3]")
        require_instance(owner, "motion", motion, rj.GaussianMotion, "a rockjax.GaussianMotion")
        self.cov = require_number(owner, "cov", cov, lambda v: 0.02 <= v <= 0.5, "in [0.02, 0.5]")
        require_whole(owner, "rays", rays, 8)
        require_whole(owner, "seed", seed, 0)
        parse_limit(owner, limit)
        self.motion, self.limit, self.rays, self.seed, self.name = motion, limit, rays, seed, name

    def probability(self, podium: rj.Podium, seed: int = 0) -> rj.FailureProbability:
        """Estimate the probability of failure of a structure by subset simulation; outside jit."""
        return rj.failure_probability(
            podium, self.motion, limit=self.limit, cov=self.cov, seed=seed, max_scenes=MAX_SCENES
        )

    def margins(self, podium: rj.Podium, options: rj.Options) -> Values:
        """Return the margin (1,) of a structure, from rays sampled for this structure; outside jit and grad.

        As in a search, the margin is computed for a probability below `at_most`, to allow for the scatter
        between two samples. `options` has no effect.
        """
        if any(concrete(y) is None for y in jax.tree.leaves(podium)):
            raise ValueError(
                "FailureProbability: margins cannot be traced, because they are sampled; use the target in "
                "optimise.design, or call margins outside jit and grad"
            )
        return jnp.asarray([RayTarget(self, podium).at(podium, ())[0]])

    def describe(self) -> str:
        return f"P(failure) ≤ {self.at_most:g}"


class _IndependentSample(NamedTuple):
    """An independent sample at a structure.

    - `parameters`: all parameters (n,) of the structure; `estimate`: the estimate of its probability of
      failure
    - `ratio`: this probability divided by the estimate along the rays. If the sample has not converged, the
      ratio of the earlier sample with the most similar structure, or 1 without an earlier sample
    """

    parameters: np.ndarray
    estimate: rj.FailureProbability
    ratio: float


class RayTarget:
    """A target with its rays, which are sampled for one structure; outside jit.

    - `target`: the target; `podium`: the structure for which rays are sampled, the first one of a search

    Attributes: `scenes` is the number of simulated scenes, and `samples` contains the independent samples.
    `is_verifying` is True while a design is verified. Margins then include no allowance for the scatter
    between two samples. Raises `ValueError` if rays cannot be sampled.
    """

    def __init__(self, target: FailureProbability, podium: rj.Podium):
        self.target, self.scenes = target, 0
        self.samples: list[_IndependentSample] = []
        self.is_verifying = False
        limit = self._limit_state(podium)
        try:
            self.rays = sample_rays(limit, target.at_most, target.rays, target.cov, target.seed)
        except ValueError as error:
            raise ValueError(f"FailureProbability: {error}") from None
        self.scenes += limit.scenes
        self.initial_factor = 1.0  # first value of the factor k in the next search for k

    def _limit_state(self, podium: rj.Podium):
        return limit_state("FailureProbability", podium, self.target.motion, self.target.limit)

    def at(self, podium: rj.Podium, names: tuple[str, ...]) -> tuple[float, np.ndarray]:
        """Return the margin of a structure, and its derivatives (names,) with respect to the logarithms of
        the parameters `names`."""
        limit = self._limit_state(podium)
        probability = self._target_probability(podium)
        solution = solve_factor(limit, self.rays, probability, names, self.initial_factor)
        self.initial_factor = min(max(solution.factor, 0.1), 10.0)
        self.scenes += limit.scenes
        return math.log(solution.factor), solution.sensitivities

    def _target_probability(self, podium: rj.Podium) -> float:
        """Return the probability, at most 0.9, that the rays must give with the factor k: `at_most` divided
        by `_ratio` and, during a search, reduced by an allowance for scatter."""
        safety = 0.0 if self.is_verifying else self.spread
        return min(self.target.at_most / self._ratio(podium) * math.exp(-safety), 0.9)

    @property
    def spread(self) -> float:
        """Allowance for scatter in ln P. In 5 % of all pairs of independent samples, ln P of the first sample
        exceeds ln P of the second by more than this."""
        return SAFETY_FACTOR * math.sqrt(2) * self.target.cov

    def _ratio(self, podium: rj.Podium) -> float:
        """Return `ratio` of the independent sample at the most similar structure; 1 without a sample."""
        if not self.samples:
            return 1.0
        parameters = _parameters(podium)
        return min(self.samples, key=lambda sample: _largest_difference(sample.parameters, parameters)).ratio

    def check(self, podium: rj.Podium) -> float | None:
        """Take an independent sample at a structure, and return the change of the estimate of ln P there,
        which is 0 if the sample has not converged. Return None, without sampling, if `checked_estimate`
        returns an estimate for the structure."""
        if self.checked_estimate(podium) is not None:
            return None
        old_ratio = self._ratio(podium)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # the design reports missing convergence
            estimate = self.target.probability(podium, seed=self.target.seed + 1 + len(self.samples))
        self.scenes += estimate.scenes
        ratio = old_ratio
        if estimate.converged:
            limit = self._limit_state(podium)
            ratio = estimate.probability / max(probability_at(limit, self.rays, 1.0), 1e-300)
            self.scenes += limit.scenes
        self.samples.append(_IndependentSample(_parameters(podium), estimate, ratio))
        return math.log(ratio / old_ratio)

    def checked_estimate(self, podium: rj.Podium) -> rj.FailureProbability | None:
        """Return the estimate from the latest independent sample at this structure, or at a structure that
        differs by at most `SAME_STRUCTURE`; None without such a sample."""
        parameters = _parameters(podium)
        nearby = [s for s in self.samples if _largest_difference(s.parameters, parameters) <= SAME_STRUCTURE]
        return nearby[-1].estimate if nearby else None


def _parameters(podium: rj.Podium) -> np.ndarray:
    """Return all parameters (n,) of a podium, the leaves of its pytree."""
    return np.array([float(y) for y in jax.tree.leaves(podium)])


def _largest_difference(a: np.ndarray, b: np.ndarray) -> float:
    """Return the largest relative difference between the entries of two vectors; inf if their lengths
    differ."""
    if a.shape != b.shape:
        return math.inf
    return float(np.max(np.abs(a - b) / np.maximum(np.maximum(np.abs(a), np.abs(b)), 1e-12)))
