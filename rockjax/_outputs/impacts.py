"""Impacts: their number to the end, and the sum over energetic ones with which errors are estimated."""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from rockjax import _results as results
from rockjax._engine.bounds import Bounds
from rockjax._types import Flag, Value

from .base import AbstractWithoutAnswer
from .views import Ended, Start, StepEnd


@dataclasses.dataclass(frozen=True)
class Impacts(AbstractWithoutAnswer):
    """All impacts until rest: every scene counts those that it follows, but only this output follows all."""

    name = "impacts"
    follows_impacts = True

    def is_final(self, bounds: Bounds, record: Any) -> Flag | bool:
        del record
        return bounds.rests


class Energetic(NamedTuple):
    """Sums over impacts by their speed. Each counts y⁸, y = |θ̇⁻|/(pα), so that only impacts count after
    which columns can overturn; faster ones count 1 + 8(y − 1)."""

    total: Value  # of all so far …
    last: Value  # … and of the last one


@dataclasses.dataclass(frozen=True)
class EnergeticImpacts(AbstractWithoutAnswer):
    """The sum over energetic impacts, in which two solutions of a chaotic scene differ. It belongs to the
    request "errors"."""

    name = "errors"
    needs_flat = True

    def start(self, start: Start) -> tuple[None, Energetic]:
        return None, Energetic(jnp.zeros_like(start.t), jnp.zeros_like(start.t))

    def update(self, end: StepEnd, record: None, note: Energetic, largest: Any) -> tuple[None, Energetic]:
        del largest
        c = end.step.c
        ratio = jax.lax.stop_gradient(end.impact.speed / (c.p * c.alpha))
        # Faster impacts continue along the tangent, so that differences of their speeds still count.
        one = jnp.where(end.hit, jnp.minimum(ratio * ratio, 1.0) ** 4 + 8 * jnp.maximum(ratio - 1, 0.0), 0.0)
        return record, Energetic(note.total + one, jnp.where(end.hit, one, note.last))

    def is_final(self, bounds: Bounds, record: None) -> bool:
        del bounds, record
        return True

    def answer(self, ended: Ended, record: None, note: Energetic) -> dict[str, Any]:
        # Excess energy at the overturning angle, over half the inertia.
        overturned = ended.code == results.OVERTURNED
        return {
            "energetic": note.total,
            "last_energetic": note.last,
            "fall": jnp.where(overturned, ended.v[0] ** 2, jnp.nan),
            "fall_time": ended.scene.c.p * ended.overturn_time,
        }
