"""Sampled targets of a design: their margins and slopes at a point."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import rockjax as rj
from rockjax.internal import parameters_of, read, with_values

from ._answer import SampleEstimates
from ._failure import FailureProbability, RayTarget
from ._quadratic import Vector
from ._targets import AbstractTarget
from ._variables import Variables

SMALLEST = 1e-9  # replaces zeros, which have no logarithm


class MarginSlope(NamedTuple):
    """A margin and its derivatives (n,) with respect to the scaled variables."""

    margin: float
    slope: Vector


class _StructureNumbers:
    """The numbers of the podium at scaled variables x, and their derivatives."""

    def __init__(self, variables: Variables):
        self.variables = variables
        podium = variables.podium(variables.start())
        self.names = tuple(name for name, entry in parameters_of(podium).items() if entry.place)

        def numbers(x):
            podium = variables.podium(x)
            return jnp.stack([jnp.asarray(read(podium, name), float) for name in self.names])

        self._at = jax.jit(lambda x: (numbers(x), jax.jacfwd(numbers)(x)))

    def __call__(self, x: Vector) -> tuple[rj.Podium, dict[str, Vector]]:
        """Return the podium, and d ln y/dx (n,) of every number y that depends on x."""
        y, slope = (np.asarray(part) for part in self._at(jnp.asarray(x)))
        depends = slope.any(axis=1)
        podium = self.variables.podium(jnp.asarray(x))
        zero = [name for name, value, m in zip(self.names, y, depends, strict=True) if m and value == 0]
        podium = with_values(podium, dict.fromkeys(zero, SMALLEST)) if zero else podium
        y = np.where(y == 0, SMALLEST, y)
        rows = zip(self.names, slope / y[:, None], depends, strict=True)
        return podium, {name: row for name, row, m in rows if m}


class SampledTargets:
    """The sampled targets of a design, by their index among all targets (host)."""

    def __init__(self, variables: Variables, targets: Sequence[AbstractTarget]):
        self.targets = {k: t for k, t in enumerate(targets) if isinstance(t, FailureProbability)}
        self._numbers = _StructureNumbers(variables) if self.targets else None
        self._first = variables.podium(variables.start()) if self.targets else None
        self._by_index: dict[int, RayTarget] = {}
        self._cache: dict[bytes, dict[int, MarginSlope]] = {}

    @property
    def scenes(self) -> int:
        return sum(ray_target.scenes for ray_target in self._by_index.values())

    def use_accurate(self) -> None:
        """Switch to the margins of the independent samples."""
        for ray_target in self._by_index.values():
            ray_target.is_verified = True
        self._cache.clear()

    def at(self, x: Vector) -> Mapping[int, MarginSlope]:
        """Return the margins and slopes at scaled variables (n,)."""
        if self._numbers is None:
            return {}
        key = np.asarray(x, float).tobytes()
        if key not in self._cache:
            podium, slopes = self._numbers(x)
            no_slope = np.zeros(np.size(x))
            self._cache[key] = {
                k: self._row(ray_target, podium, slopes, no_slope)
                for k, ray_target in self._ray_targets().items()
            }
        return self._cache[key]

    def _ray_targets(self) -> dict[int, RayTarget]:
        """Return the sampled targets, with rays through failing samples of the first structure."""
        for k, target in self.targets.items():
            if k not in self._by_index:
                assert self._first is not None
                self._by_index[k] = RayTarget(target, self._first)
        return self._by_index

    @staticmethod
    def _row(
        ray_target: RayTarget, podium: rj.Podium, slopes: dict[str, Vector], no_slope: Vector
    ) -> MarginSlope:
        found = ray_target.at(podium, tuple(slopes))
        return MarginSlope(
            found.margin, sum((found.slopes[name] * row for name, row in slopes.items()), no_slope)
        )

    def check(self, x: Vector) -> tuple[bool, bool]:
        """Take independent samples at a point.

        Returns whether any sample is new, and whether one differs from the expected value by more than the
        scatter of two samples.
        """
        if self._numbers is None:
            return False, False
        podium, _ = self._numbers(x)
        new = False, False
        for ray_target in self._ray_targets().values():
            change = ray_target.check(podium)
            if change is not None:
                new = True, new[1] or abs(change) > ray_target.spread
                self._cache.clear()
        return new

    def probabilities(self, x: Vector) -> SampleEstimates:
        """Return the estimates of independent samples at a point."""
        if self._numbers is None:
            return SampleEstimates({})
        podium, _ = self._numbers(x)
        found = {k: ray_target.checked_estimate(podium) for k, ray_target in self._by_index.items()}
        return SampleEstimates(
            {k: probability for k, probability in found.items() if probability is not None}
        )
