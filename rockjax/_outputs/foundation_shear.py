"""The largest horizontal force V on the foundation in a scene (one podium under one excitation). (F5) is in
docs/equations.md."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from rockjax._outputs.joint_forces import total_weight
from rockjax._outputs.maxima import Maximum
from rockjax._types import Flag, Value

from .joint_bounds import JointBounds
from .joint_samples import SampleForces
from .joints import AbstractForceOutput, over_rest, over_step
from .shear import exceeds_nowhere
from .views import Ended, Rest, Sample, Start, Step


@dataclasses.dataclass(frozen=True)
class PeakFoundationShear(AbstractForceOutput):
    """The peak shear on the foundation divided by the total weight W_0 of the structure, max|V|/W_0, (F5)
    [–]."""

    name = "peak_foundation_shear"
    unit = "1"
    description = "peak shear on the foundation divided by the total weight max|V|/W_0"
    symbol = "max |V|/W_0"

    def start(self, start: Start) -> tuple[Value, None]:
        return jnp.zeros((), start.t.dtype), None

    def over_step(self, step: Step, accumulator: Value) -> Maximum:
        shear = over_step(step).foundation
        maximum = step.largest_forces([[shear]], (accumulator,), total_weight(step.c))
        return maximum._replace(value=maximum.value[0])

    def over_rest(self, rest: Rest, accumulator: Value) -> Value:
        weight = total_weight(rest.scene.c)
        return rest.raised(accumulator, [jnp.abs(forces.foundation) / weight for forces in over_rest(rest)])

    def over_sample(self, sample: Sample, accumulator: Value) -> Flag:
        start, end, curvature = (forces.foundation for forces in SampleForces.from_sample(sample))
        level = jax.lax.stop_gradient(accumulator) * total_weight(sample.c)
        return exceeds_nowhere(jnp.abs(start), jnp.abs(end), curvature, level)

    def is_unchanged(self, bounds: JointBounds, accumulator: Value) -> Flag:
        return bounds.foundation_shear <= accumulator * total_weight(bounds.c)

    def answer(self, ended: Ended, accumulator: Value, note: Any) -> dict[str, Any]:
        return {self.name: self.nan_if_unknown(ended, accumulator)}
