"""Targets on what stands on the floors: rotations of contents, and floor response spectra."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp

import rockjax as rj
from rockjax.internal import format_value

from ._peak_targets import limited_by_overturning
from ._suite import Margins, Suite
from ._targets import AbstractTarget, Name, check_limit


class AbstractFloorTarget(AbstractTarget):
    """A target on things on floors under every motion of a suite."""

    limit: eqx.AbstractVar[Any]
    suite: eqx.AbstractVar[Suite]
    things: eqx.AbstractVar[tuple[Any, ...]]

    def margins(self, podium: rj.Podium, options: rj.Options) -> Margins:
        options = options.replace(outputs=("margin",), throw=False)
        solve = lambda motion: rj.peak_response(podium, motion, options=options, on_floors=self.things)
        peaks = self.suite.map_motions(solve)
        sizes = jnp.concatenate([self.size(answer) for answer in peaks.on_floors])
        return limited_by_overturning((self.limit - sizes) / self.limit, peaks)

    def size(self, answer: Any) -> Margins:
        """Return what the limit applies to, for every motion (k,)."""
        raise NotImplementedError

    @property
    def scenes(self) -> int:
        return len(self.suite)


def _things(owner: str, name: str, kind: type, things: Any) -> tuple[Any, ...]:
    """Return things as a tuple. Raises `ValueError` for things of another kind, and for none."""
    found = (things,) if isinstance(things, kind) else things
    if not isinstance(found, Sequence) or not found or not all(isinstance(each, kind) for each in found):
        raise ValueError(
            f"{owner}: {name} must be one or several rockjax.{kind.__name__}, got {format_value(things)}"
        )
    return tuple(found)


class ContentsRotation(AbstractFloorTarget):
    """Contents of floors rotate by at most `limit`·α_c under every motion: max|φ|/α_c ≤ limit.

    - `limit`: 0 < limit < 1 [–]; `excitations`: a motion or a list of them
    - `contents`: a [`rockjax.Contents`][] or several; `name`: in reports

    The margin of each block is (limit − s)/limit, where s is max|φ|/α_c, or 1 − M where the block overturns,
    with its negative overturning margin M. Where the columns overturn, margins are at most their overturning
    margin. Raises `ValueError` for other limits and contents.
    """

    limit: Any
    suite: Suite
    things: tuple[Any, ...]
    name: Name = eqx.field(static=True)

    def __init__(self, limit, excitations, contents, name: Name = None):
        owner = type(self).__name__
        check_limit(owner, "limit", limit, below=1)
        self.limit, self.suite, self.name = float(limit), Suite.of(excitations, owner), name
        self.things = _things(owner, "contents", rj.Contents, contents)

    def size(self, answer: rj.ContentsAnswer) -> Margins:
        return jnp.where(answer.overturned, 1 - answer.margin, answer.peak_rotation)

    def describe(self) -> str:
        return f"rotation of contents ≤ {self.limit:g} α_c"


class FloorSpectrum(AbstractFloorTarget):
    """Oscillators on floors reach at most the pseudo-acceleration `limit` under every motion: PSA ≤ limit.

    - `limit`: > 0 [m/s²]; `excitations`: a motion or a list of them
    - `oscillators`: a [`rockjax.Oscillator`][] or several; `name`: in reports

    The margin of each oscillator is (limit − PSA)/limit. Where the columns overturn, margins are at most
    their overturning margin. Raises `ValueError` for other limits and oscillators.
    """

    limit: Any
    suite: Suite
    things: tuple[Any, ...]
    name: Name = eqx.field(static=True)

    def __init__(self, limit, excitations, oscillators, name: Name = None):
        owner = type(self).__name__
        check_limit(owner, "limit", limit)
        self.limit, self.suite, self.name = float(limit), Suite.of(excitations, owner), name
        self.things = _things(owner, "oscillators", rj.Oscillator, oscillators)

    def size(self, answer: rj.OscillatorAnswer) -> Margins:
        return answer.pseudo_acceleration

    def describe(self) -> str:
        return f"floor spectrum ≤ {self.limit:g} m/s²"
