"""Targets on floors: rotations of contents, and pseudo-accelerations of oscillators."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp

import rockjax as rj
from rockjax._checks import require
from rockjax.internal import format_value

from ._peak_targets import limited_by_overturning
from ._suite import Suite, Values, has_answer
from ._targets import AbstractTarget, Name, require_limit


class AbstractFloorTarget(AbstractTarget):
    """Base class of targets on contents or oscillators on floors, under all motions of a suite.

    - `limit`: limit of the responses; `suite`: the motions; `systems`: the contents or oscillators

    The margin of a system whose simulation did not finish is NaN.
    """

    limit: eqx.AbstractVar[Any]
    suite: eqx.AbstractVar[Suite]
    systems: eqx.AbstractVar[tuple[Any, ...]]
    outputs: ClassVar[tuple[str, ...]] = ("margin",)

    def margins(self, podium: rj.Podium, options: rj.Options) -> Values:
        options = options.replace(outputs=self.outputs, throw=False)
        solve = lambda motion: rj.peak_response(podium, motion, options=options, on_floors=self.systems)
        peaks = self.suite.map_motions(solve)
        # The values of a motion are consecutive, as `limited_by_overturning` requires.
        finished_values = [
            jnp.where(has_answer(peaks) & has_answer(answer), self.limited_value(answer), jnp.nan)
            for answer in peaks.on_floors
        ]
        values = jnp.ravel(jnp.stack(finished_values, axis=-1))
        return limited_by_overturning((self.limit - values) / self.limit, peaks)

    def limited_value(self, answer: Any) -> Values:
        """Return the responses (k,) of one system to k motions; `limit` bounds these responses."""
        raise NotImplementedError

    @property
    def scenes(self) -> int:
        return len(self.suite)


def _as_tuple(owner: str, name: str, required: type, value: Any) -> tuple[Any, ...]:
    """Return one instance of `required`, or a sequence of instances, as a tuple. Raises `ValueError` for any
    other value."""
    members = (value,) if isinstance(value, required) else value
    if not isinstance(members, Sequence) or not members or not all(isinstance(y, required) for y in members):
        raise ValueError(
            f"{owner}: {name} must be one or several rockjax.{required.__name__}, got {format_value(value)}"
        )
    return tuple(members)


class ContentsRotation(AbstractFloorTarget):
    """Contents of floors (blocks that may rock) rotate by at most `limit`·α_c under every motion.

    - `limit`: 0 < limit < 1 [–]; `excitations`: a motion or a list of motions
    - `contents`: one or several [`rockjax.Contents`][] with `overturn_ratio` ≤ 1; `name`: name in reports;
      None for a description

    A block with rotation φ and slenderness α_c [rad] has the margin (limit − s)/limit with s = max|φ|/α_c. If
    the block overturns, s = 1 − M, where M < 0 is the overturning margin of the block. If the columns
    overturn, margins are at most the overturning margin of the columns, which is negative. Raises
    `ValueError` for invalid arguments.
    """

    limit: Any
    suite: Suite
    systems: tuple[Any, ...]
    name: Name = eqx.field(static=True)

    def __init__(self, limit, excitations, contents, name: Name = None):
        owner = type(self).__name__
        self.limit = require_limit(owner, "limit", limit, below=1)
        self.suite, self.name = Suite.of(excitations, owner), name
        self.systems = _as_tuple(owner, "contents", rj.Contents, contents)
        for block in self.systems:
            accepted = "<= 1, because blocks have no margin beyond α_c"
            require(owner, "overturn_ratio of contents", block.overturn_ratio, lambda v: v <= 1, accepted)

    def limited_value(self, answer: rj.ContentsAnswer) -> Values:
        return jnp.where(answer.overturned, 1 - answer.margin, answer.peak_rotation)

    def describe(self) -> str:
        return f"rotation of contents ≤ {self.limit:g} α_c"


class FloorSpectrum(AbstractFloorTarget):
    """Oscillators on floors reach at most the pseudo-acceleration `limit` under every motion: PSA ≤ limit.

    - `limit`: > 0 [m/s²]; `excitations`: a motion or a list of motions
    - `oscillators`: one or several [`rockjax.Oscillator`][]; `name`: name in reports; None for a description

    The margin of each oscillator with the pseudo-acceleration PSA is (limit − PSA)/limit. If the columns
    overturn, margins are at most the overturning margin of the columns, which is negative. Raises
    `ValueError` for invalid arguments.
    """

    limit: Any
    suite: Suite
    systems: tuple[Any, ...]
    name: Name = eqx.field(static=True)

    def __init__(self, limit, excitations, oscillators, name: Name = None):
        owner = type(self).__name__
        self.limit = require_limit(owner, "limit", limit)
        self.suite, self.name = Suite.of(excitations, owner), name
        self.systems = _as_tuple(owner, "oscillators", rj.Oscillator, oscillators)

    def limited_value(self, answer: rj.OscillatorAnswer) -> Values:
        return answer.pseudo_acceleration

    def describe(self) -> str:
        return f"floor spectrum ≤ {self.limit:g} m/s²"
