"""Targets on a probability under random ground motions, which is sampled: they are evaluated outside of
traced code, one structure at a time."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import rockjax as rj
from rockjax.internal import (
    concrete,
    factor_of,
    limit_of,
    limit_state,
    of_kind,
    probability_at,
    rays_at,
    single,
    whole,
)

from ._suite import Margins
from ._targets import AbstractTarget, Name, check_limit

SAFE = 1.645  # standard errors of ln P by which a search stays inside: 95 % of independent samples agree
MAX_SCENES = 10_000_000  # of an independent sample
CLOSE = 1e-3  # relative change of numbers of a structure that a check need not be repeated for


class FailureProbability(AbstractTarget):
    """A random ground motion makes the structure fail with a probability of at most `at_most`.

    - `at_most`: 1e-9 ≤ at_most ≤ 0.3 [–]; `motion`: a [`rockjax.GaussianMotion`][]
    - `limit`: what is failure, as for [`rockjax.failure_probability`][]
    - `cov`: coefficient of variation of the estimates, in [0.02, 0.5]; `rays`: directions in which the
      surface of failure is followed, ≥ 8; `seed`: the same gives the same
    - `name`: in reports

    The margin is ln k, with k the factor on u (on the motions, where they have no pulse) with which the
    probability is `at_most`. While searching, k comes from rays through failing samples of the first
    structure, the same ones for all, with derivatives by the implicit function theorem; it stays inside by
    what two samples may differ. An answer is verified by subset simulation from another seed: its margin is
    that of the second sample, which is in `Design.probabilities`. Where that has not converged in 10 million
    scenes, the margin is NaN, and the design is `unverified` and not satisfied.
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
        check_limit(owner, "at_most", at_most)
        self.at_most = float(single(owner, "at_most", at_most, lambda v: 1e-9 <= v <= 0.3, "in [1e-9, 0.3]"))
        of_kind(owner, "motion", motion, rj.GaussianMotion, "a rockjax.GaussianMotion")
        self.cov = float(single(owner, "cov", cov, lambda v: 0.02 <= v <= 0.5, "in [0.02, 0.5]"))
        whole(owner, "rays", rays, 8)
        whole(owner, "seed", seed, 0)
        limit_of(owner, limit)
        self.motion, self.limit, self.rays, self.seed, self.name = motion, limit, rays, seed, name

    def probability(self, podium: rj.Podium, seed: int = 0) -> rj.FailureProbability:
        """The probability of failure of a structure, by subset simulation (host)."""
        return rj.failure_probability(
            podium, self.motion, limit=self.limit, cov=self.cov, seed=seed, max_scenes=MAX_SCENES
        )

    def margins(self, podium: rj.Podium, options: rj.Options) -> Margins:
        """Of a structure by a sample of its own (host)."""
        if any(concrete(y) is None for y in jax.tree.leaves(podium)):
            raise ValueError(
                "FailureProbability is sampled: it has no margins in traced code; see optimise.design"
            )
        return jnp.asarray([Sampled(self, podium).at(podium, ()).margin])

    def describe(self) -> str:
        return f"P(failure) ≤ {self.at_most:g}"


class Margin(NamedTuple):
    """A margin and its derivatives by the logarithms of numbers of a structure, by name."""

    margin: float
    slopes: Mapping[str, float]


class _Check(NamedTuple):
    """An independent sample at a structure: what it says, and by how much the rays are off there, as far as
    is known."""

    numbers: np.ndarray
    found: rj.FailureProbability
    ratio: float


class Sampled:
    """A target with the rays that a design goes by (host).

    `scenes` counts what it simulates.
    """

    def __init__(self, target: FailureProbability, podium: rj.Podium):
        self.target, self.scenes = target, 0
        self.checks: list[_Check] = []
        self.verified = False
        limit = self._limit(podium)
        try:
            self.rays = rays_at(limit, target.at_most, target.rays, target.cov, target.seed)
        except ValueError as error:
            raise ValueError(f"FailureProbability: {error}") from None
        self.scenes += limit.scenes
        self.factor = 1.0

    def _limit(self, podium: rj.Podium):
        return limit_state("FailureProbability", podium, self.target.motion, self.target.limit)

    def at(self, podium: rj.Podium, names: tuple[str, ...]) -> Margin:
        """The margin of a structure."""
        limit = self._limit(podium)
        cut = factor_of(limit, self.rays, self._wanted(podium), names, self.factor)
        self.factor = min(max(cut.factor, 0.1), 10.0)  # where the next search begins
        self.scenes += limit.scenes
        return Margin(math.log(cut.factor), dict(zip(names, cut.sensitivities.tolist(), strict=True)))

    def _wanted(self, podium: rj.Podium) -> float:
        """The probability that is asked of the rays."""
        inside = 0.0 if self.verified else self.spread
        return min(self.target.at_most / self._ratio(podium) * math.exp(-inside), 0.9)

    @property
    def spread(self) -> float:
        """What two samples of ln P may differ by."""
        return SAFE * math.sqrt(2) * self.target.cov

    def _ratio(self, podium: rj.Podium) -> float:
        """What the nearest independent sample says over what the rays say, 1 where there is none."""
        if not self.checks:
            return 1.0
        return min(self.checks, key=lambda check: _apart(check.numbers, _numbers(podium))).ratio

    def check(self, podium: rj.Podium) -> float | None:
        """Take an independent sample at a structure: the change that it makes to ln P; None where there is
        one already."""
        if self.checked(podium) is not None:
            return None
        before = self._ratio(podium)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # the design says it
            found = self.target.probability(podium, seed=self.target.seed + 1 + len(self.checks))
        self.scenes += found.scenes
        ratio = before
        if found.converged:
            limit = self._limit(podium)
            ratio = found.probability / max(probability_at(limit, self.rays, 1.0), 1e-300)
            self.scenes += limit.scenes
        self.checks.append(_Check(_numbers(podium), found, ratio))
        return math.log(ratio / before)

    def checked(self, podium: rj.Podium) -> rj.FailureProbability | None:
        """What an independent sample at this structure says, None where there is none."""
        near = [c for c in self.checks if _apart(c.numbers, _numbers(podium)) <= CLOSE]
        return near[-1].found if near else None


def _numbers(podium: rj.Podium) -> np.ndarray:
    return np.array([float(y) for y in jax.tree.leaves(podium)])


def _apart(a: np.ndarray, b: np.ndarray) -> float:
    """The largest relative difference of numbers."""
    return float(np.max(np.abs(a - b) / np.maximum(np.maximum(np.abs(a), np.abs(b)), 1e-12)))
