"""The least and the largest axial force N in the joints over a scene (one podium under one excitation). (F8)
is in docs/forces.md."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from rockjax._engine.coefficients import not_none
from rockjax._outputs.maxima import Maximum
from rockjax._types import Flag, Value

from .base import Variable
from .joint_bounds import JointBounds
from .joint_samples import SampleForces
from .joints import JOINTS, NO_FORCE, AbstractJointOutput, all_of, over_rest, over_step
from .views import Ended, Rest, Sample, Start, Step

Pairs = tuple[tuple[Value, Value], ...]  # largest −N/(m_c g) and largest N/(m_c g) of each joint


@dataclasses.dataclass(frozen=True)
class AxialForce(AbstractJointOutput):
    """The least and the largest axial force N/(m_c g) at the bottom and the top joint, over time and over all
    columns, (F8) [–]. m_c is the mass of a column; compression is positive. Without an `elevation` of the
    podium, N is the mean of all columns. If the least force is negative, a joint would open, and the model no
    longer holds.

    The accumulator (the value up to the present time) contains the largest −N/(m_c g) and the largest
    N/(m_c g) of each joint.
    """

    name = "axial_force"

    @property
    def variables(self) -> tuple[Variable, ...]:
        return (
            Variable("least_axial_force", "1", "least axial force min N/(m_c g)", "min N/(m_c g)", JOINTS),
            Variable("peak_axial_force", "1", "largest axial force max N/(m_c g)", "max N/(m_c g)", JOINTS),
        )

    def start(self, start: Start) -> tuple[Pairs, None]:
        unset = jnp.full((), -jnp.inf, start.t.dtype)
        return ((unset, unset),) * 2, None

    def over_step(self, step: Step, accumulator: Pairs) -> Maximum:
        return step.largest_forces(over_step(step).axial, accumulator, step.c.g, sizes="both")

    def over_rest(self, rest: Rest, accumulator: Pairs) -> Pairs:
        for forces in over_rest(rest):
            values = [[y / rest.scene.c.g for y in joint] for joint in forces.axial]
            accumulator = tuple(
                (rest.raised(tension, [-y for y in joint]), rest.raised(compression, joint))
                for joint, (tension, compression) in zip(values, accumulator, strict=True)
            )
        return accumulator

    def over_sample(self, sample: Sample, accumulator: Pairs) -> Flag:
        forces, g = SampleForces.from_sample(sample), sample.c.g
        rows = enumerate(jax.lax.stop_gradient(accumulator))
        return all_of(
            forces.axial_within(k, -tension * g, compression * g) for k, (tension, compression) in rows
        )

    def is_unchanged(self, bounds: JointBounds, accumulator: Pairs) -> Flag:
        g, rows = bounds.c.g, zip(bounds.least_axial, bounds.most_axial, accumulator, strict=True)
        return all_of(
            (least >= -tension * g) & (most <= compression * g)
            for least, most, (tension, compression) in jax.lax.stop_gradient(list(rows))
        )

    def answer(self, ended: Ended, accumulator: Pairs, note: Any) -> dict[str, Any]:
        tension, compression = (self.nan_if_unknown(ended, y) for y in zip(*accumulator, strict=True))
        # `-tension` would be −0 for a force of 0.
        return {"least_axial_force": 0.0 - tension, "peak_axial_force": compression}


@dataclasses.dataclass(frozen=True)
class Unloading(AxialForce):
    """The largest loss of axial force 1 − N/N_0 at the bottom and the top joint, over time and over all
    columns [–]. N_0 is the mean axial force of the columns at rest. If the loss exceeds 1, a joint would
    open. At a joint with N_0 = 0, the answer is 0 if the joint stays closed, and otherwise 1 − N/(m_c g).
    Design targets and limit states use this output.
    """

    name = "unloading"

    @property
    def variables(self) -> tuple[Variable, ...]:
        return (Variable(self.name, "1", "largest loss of axial force 1 − N/N_0", "max 1 − N/N_0", JOINTS),)

    def answer(self, ended: Ended, accumulator: Pairs, note: Any) -> dict[str, Any]:
        least = super().answer(ended, accumulator, note)["least_axial_force"]
        load = not_none(ended.scene.c.joints).dead_load
        unloading = 1 - least / jnp.where(load > 0, load, 1.0)
        return {self.name: jnp.where((load > 0) | ~(least >= -NO_FORCE), unloading, 0.0)}
