"""The outputs "impacts" and "errors" of a scene (one podium under one excitation): the number of impacts
until rest, and a weighted sum over impacts."""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from rockjax import _results as results
from rockjax._engine.bounds import Bounds
from rockjax._types import Flag, Value

from .base import AbstractInternalOutput
from .views import Ended, Start, StepEnd


@dataclasses.dataclass(frozen=True)
class Impacts(AbstractInternalOutput):
    """The output "impacts". With this output, a scene continues and counts impacts until the columns rest for
    good or overturn, or until the end time. Without this output, a scene ends as soon as all other outputs
    are final."""

    name = "impacts"
    follows_impacts = True

    def is_final(self, bounds: Bounds, accumulator: Any) -> Flag | bool:
        del accumulator
        return bounds.rests


class Energetic(NamedTuple):
    """Weighted sum over impacts. With y = |θ̇⁻|/(pα), the dimensionless angular speed before an impact, the
    impact contributes y⁸ for y ≤ 1 and 1 + 8(y − 1) for y > 1. Slow impacts contribute very little."""

    total: Value  # sum over all impacts up to the present time
    last: Value  # contribution of the last impact; 0 before the first


@dataclasses.dataclass(frozen=True)
class EnergeticImpacts(AbstractInternalOutput):
    """The output "errors": the weighted sum `Energetic` over impacts. Errors are estimated from two solutions
    of a scene with different tolerances. In a chaotic scene the sums of the two solutions differ, and the
    scene is reported as undecided."""

    name = "errors"
    needs_flat = True

    def start(self, start: Start) -> tuple[None, Energetic]:
        return None, Energetic(jnp.zeros_like(start.t), jnp.zeros_like(start.t))

    def update(
        self, end: StepEnd, accumulator: None, note: Energetic, largest: Any
    ) -> tuple[None, Energetic]:
        del largest
        c = end.step.c
        ratio = jax.lax.stop_gradient(end.impact.speed / (c.p * c.alpha))
        # For y > 1 the tangent at y = 1 replaces y⁸.
        contribution = jnp.where(
            end.hit, jnp.minimum(ratio * ratio, 1.0) ** 4 + 8 * jnp.maximum(ratio - 1, 0.0), 0.0
        )
        return accumulator, Energetic(note.total + contribution, jnp.where(end.hit, contribution, note.last))

    def is_final(self, bounds: Bounds, accumulator: None) -> bool:
        del bounds, accumulator
        return True

    def answer(self, ended: Ended, accumulator: None, note: Energetic) -> dict[str, Any]:
        # `fall` is θ̇² at the overturning angle [rad²/s²], a measure of the kinetic energy there. `fall_time`
        # is the time of overturning multiplied by p [–].
        overturned = ended.code == results.OVERTURNED
        return {
            "energetic": note.total,
            "last_energetic": note.last,
            "fall": jnp.where(overturned, ended.v[0] ** 2, jnp.nan),
            "fall_time": ended.scene.c.p * ended.overturn_time,
        }
