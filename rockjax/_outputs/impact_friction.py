"""Friction demand and lift-off of the joints at impacts."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp

from rockjax._engine.bounds import Bounds
from rockjax._engine.coefficients import Coefficients, present
from rockjax._engine.ratio import safe_ratio
from rockjax._outputs.joint_forces import impulses_of_columns, sway_of_modes
from rockjax._types import Flag, Value

from .base import AbstractEventOutput, Variable
from .joints import JOINTS, AbstractJointOutput, all_of, end_offsets, friction_of, halves, quarter_tangent
from .views import Bounces, Ended, Impact, Start, Step

Accumulator = tuple[Value, ...]


def _angles_and_ratios(
    c: Coefficients, sigma: Value, sway: Value | float, offsets: Sequence[Value] | None
) -> Accumulator:
    """Return |tan(φ/4)| for the angles φ of the impulses from the vertical, then −J_N divided by the mean J_N
    of all columns. Both are for the columns at the bottom joint, then for the columns at the top joint."""
    tangential, axial = impulses_of_columns(c, sigma, jnp.ones_like(sigma), sway, offsets)
    means = [y for y in present(c.joints).impulses.axial for _ in offsets or (0,)]
    angles = [jnp.abs(quarter_tangent(*pair)) for pair in zip(tangential, axial, strict=True)]
    ratios = [
        jnp.where(mean > 0, -safe_ratio(n, mean, mean > 0), -1.0)
        for n, mean in zip(axial, means, strict=True)
    ]
    return (*angles, *ratios)


@dataclasses.dataclass(frozen=True)
class ImpactFriction(AbstractJointOutput, AbstractEventOutput):
    """The largest friction demand max|J_T|/J_N at impacts, and the least J_N divided by the mean J_N of all
    columns, at the bottom and the top joint of the worst column, (F12), (F14).

    The accumulator contains the largest value so far of each element of `_angles_and_ratios`. If the
    superstructure does not vibrate, all impacts have the same angles and ratios.
    """

    name = "impact_friction"
    estimated = False

    @property
    def variables(self) -> tuple[Variable, ...]:
        return (
            Variable(
                "peak_impact_friction",
                "1",
                "largest friction demand max|J_T|/J_N of the joints at impacts",
                "max |J_T|/J_N",
                JOINTS,
            ),
            Variable(
                "least_impulse_share",
                "1",
                "least axial impulse of a column divided by the mean of all columns",
                "min J_N/mean",
                JOINTS,
            ),
        )

    def start(self, start: Start) -> tuple[Accumulator, None]:
        return self.filled(start, 0.0) + self.filled(start, -1.0), None

    def over_step(self, step: Step, accumulator: Accumulator) -> None:
        del step, accumulator

    def at_impact(self, impact: Impact) -> Accumulator:
        c = impact.c
        return _angles_and_ratios(c, impact.sigma, sway_of_modes(c, impact.sigma, impact.x), end_offsets(c))

    def over_bounces(self, bounces: Bounces, accumulator: Accumulator) -> bool:
        del (
            bounces,
            accumulator,
        )  # bounces are skipped only for rigid podiums, whose impacts have equal ratios
        return True

    def is_final(self, bounds: Bounds, accumulator: Accumulator) -> Flag:
        if bounds.c.vibration is None:  # all impacts have the same ratios
            return bounds.rests | functools.reduce(jnp.logical_or, [y > 0 for y in halves(accumulator)[0]])
        c, arms = bounds.c, present(bounds.c.joints).arms
        offsets, sways = None, [0.0]
        if arms is not None:
            # The worst case is at an end column, with the largest Σ η_id_i to either side.
            end_offset = arms.mean_square / arms.core_distance
            largest_sway = bounds.modal_sum(c.etas / jnp.sqrt(present(c.vibration).omega2))
            offsets, sways = (-end_offset, end_offset), [largest_sway, -largest_sway]
        accumulators = [self.worst(y) for y in halves(jax.lax.stop_gradient(accumulator))]
        worst = [_angles_and_ratios(c, jnp.ones_like(c.alpha), sway, offsets) for sway in sways]
        return bounds.rests | all_of(
            self.worst(found)[joint] <= accumulated[joint]
            for bound in worst
            for found, accumulated in zip(halves(bound), accumulators, strict=True)
            for joint in range(self.joints)
        )

    def answer(self, ended: Ended, accumulator: Accumulator, note: Any) -> dict[str, Any]:
        angles, negative_ratios = (self.nan_if_weightless(ended, self.worst(y)) for y in halves(accumulator))
        return {"peak_impact_friction": friction_of(angles), "least_impulse_share": -negative_ratios}
