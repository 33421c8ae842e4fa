"""Sampled targets of a design: their margins and slopes at a point."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import rockjax as rj
from rockjax.internal import parameters_of, read, with_values

from ._answer import Sampled as SampledAnswer
from ._failure import FailureProbability, Sampled
from ._quadratic import Vector
from ._targets import AbstractTarget
from ._variables import Variables

SMALLEST = 1e-9  # replaces zeros, which have no logarithm


class Row(NamedTuple):
    """A margin and its derivatives (n,) with respect to the scaled variables."""

    margin: float
    slope: Vector


class _Numbers:
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
        moves = slope.any(axis=1)
        podium = self.variables.podium(jnp.asarray(x))
        zero = [name for name, value, m in zip(self.names, y, moves, strict=True) if m and value == 0]
        podium = with_values(podium, dict.fromkeys(zero, SMALLEST)) if zero else podium
        y = np.where(y == 0, SMALLEST, y)
        rows = zip(self.names, slope / y[:, None], moves, strict=True)
        return podium, {name: row for name, row, m in rows if m}


class SampledTargets:
    """The sampled targets of a design, by their index among all targets (host)."""

    def __init__(self, variables: Variables, targets: Sequence[AbstractTarget]):
        self.targets = {k: t for k, t in enumerate(targets) if isinstance(t, FailureProbability)}
        self._numbers = _Numbers(variables) if self.targets else None
        self._first = variables.podium(variables.start()) if self.targets else None
        self._sampled: dict[int, Sampled] = {}
        self._known: dict[bytes, dict[int, Row]] = {}

    @property
    def scenes(self) -> int:
        return sum(sampled.scenes for sampled in self._sampled.values())

    def verifies(self) -> None:
        """Switch to the margins of the independent samples."""
        for sampled in self._sampled.values():
            sampled.verified = True
        self._known.clear()

    def at(self, x: Vector) -> Mapping[int, Row]:
        """Return the margins and slopes at scaled variables (n,)."""
        if self._numbers is None:
            return {}
        key = np.asarray(x, float).tobytes()
        if key not in self._known:
            podium, slopes = self._numbers(x)
            still = np.zeros(np.size(x))
            self._known[key] = {
                k: self._row(sampled, podium, slopes, still) for k, sampled in self._all().items()
            }
        return self._known[key]

    def _all(self) -> dict[int, Sampled]:
        """Return the sampled targets, with rays through failing samples of the first structure."""
        for k, target in self.targets.items():
            if k not in self._sampled:
                assert self._first is not None
                self._sampled[k] = Sampled(target, self._first)
        return self._sampled

    @staticmethod
    def _row(sampled: Sampled, podium: rj.Podium, slopes: dict[str, Vector], still: Vector) -> Row:
        found = sampled.at(podium, tuple(slopes))
        return Row(found.margin, sum((found.slopes[name] * row for name, row in slopes.items()), still))

    def check(self, x: Vector) -> tuple[bool, bool]:
        """Take independent samples at a point.

        Returns whether any sample is new, and whether one differs from the expected value by more than the
        scatter of two samples.
        """
        if self._numbers is None:
            return False, False
        podium, _ = self._numbers(x)
        new = False, False
        for sampled in self._all().values():
            change = sampled.check(podium)
            if change is not None:
                new = True, new[1] or abs(change) > sampled.spread
                self._known.clear()
        return new

    def probabilities(self, x: Vector) -> SampledAnswer:
        """Return the estimates of independent samples at a point."""
        if self._numbers is None:
            return SampledAnswer({})
        podium, _ = self._numbers(x)
        found = {k: sampled.checked(podium) for k, sampled in self._sampled.items()}
        return SampledAnswer({k: probability for k, probability in found.items() if probability is not None})
