"""The friction demand of the joints: the largest |T|/N over a scene."""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from rockjax._engine.bounds import all_true
from rockjax._engine.coefficients import present
from rockjax._engine.hermite import turning_point_of_slope
from rockjax._outputs.maxima import END_ZONE_CUBIC, Cubic, Maximum
from rockjax._types import Flag, Flags, Values

from .base import AbstractOutput
from .joints import AbstractJointOutput, JointBounds, end_forces, friction_of, halves, quarter_tangent
from .views import Course, Ended, Start, Step


class AnglePath(NamedTuple):
    """The angle φ of a force from the vertical over a step, as tan(φ/4), from cubics of T and N.

    A cubic of the angle itself would not be accurate, because the angle changes within a fraction of a step
    where N is close to zero.
    """

    tangential: Cubic
    axial: Cubic

    def value(self, z: Values | float) -> Values:
        return quarter_tangent(self.tangential.value(z), self.axial.value(z))

    def slope(self, z: Values | float) -> Values:
        (tangential, tangential_slope), (axial, axial_slope) = ((y.value(z), y.slope(z)) for y in self)
        return jax.jvp(quarter_tangent, (tangential, axial), (tangential_slope, axial_slope))[1]

    def curvature(self, z: Values) -> Values:
        return jax.jvp(self.slope, (z,), (jnp.ones_like(z),))[1]

    def turning_point_or_dip(self, turned: Flags, rising: Flags) -> tuple[Values, Flags]:
        # φ' has the sign of N T' − T N', a polynomial.
        t, n = self.tangential, self.axial
        slope = [
            n.c0 * t.c1 - t.c0 * n.c1,
            2 * (n.c0 * t.c2 - t.c0 * n.c2),
            3 * (n.c0 * t.c3 - t.c0 * n.c3) + n.c1 * t.c2 - t.c1 * n.c2,
            2 * (n.c1 * t.c3 - t.c1 * n.c3),
            n.c2 * t.c3 - t.c2 * n.c3,
        ]
        return turning_point_of_slope(slope, t.c0**2 + n.c0**2, turned, rising)


@dataclasses.dataclass(frozen=True)
class PeakFriction(AbstractJointOutput):
    """The largest friction demand max|T|/N at the bottom and the top joint of the worst column, (F9), (F11).

    The record is the angle φ of the force from the vertical, as tan(φ/4), which is smooth at N = 0.
    """

    name = "peak_friction"
    unit = "1"
    description = "largest friction demand max|T|/N of the joints"
    symbol = "max |T|/N"

    def for_limit(self, limit: float) -> tuple[AbstractOutput, float]:
        return FrictionUse(limit=limit), 1.0

    def start(self, start: Start) -> tuple[Values, None]:
        return self.zeros(start), None

    def over_step(self, step: Step, record: Values) -> Maximum:
        forces = step.course(end_forces)
        angle = lambda row: quarter_tangent(*halves(row))
        start, end = (jax.jvp(angle, jet[:1], jet[1:]) for jet in (forces.start, forces.end))
        tangential, axial = zip(*map(halves, forces.path), strict=True)
        angles = Course(AnglePath(Cubic(*tangential), Cubic(*axial)), start, end)
        maximum = step.largest(angles, record, END_ZONE_CUBIC)
        return maximum._replace(value=jnp.minimum(maximum.value, 1.0))

    def is_unchanged(self, bounds: JointBounds, record: Values) -> Flag:
        return all_true(bounds.friction <= friction_of(jax.lax.stop_gradient(self.worst(record))))

    def answer(self, ended: Ended, record: Values, note: Any) -> dict[str, Any]:
        return {self.name: self.nan_if_weightless(ended, friction_of(self.worst(record)))}


@dataclasses.dataclass(frozen=True)
class FrictionUse(AbstractJointOutput):
    """The largest use of friction 1 − (μN − |T|)/(μN_0) at a joint [–], with the dead load N_0 of the mean
    column. If it exceeds 1, the joint would slide. The answer is 0 at a joint without dead load. Targets use
    this output because it is smooth where a joint would open, unlike |T|/N.

    The record contains the largest T − μN, then the largest −T − μN [m/s²].

    - `limit`: friction coefficient μ [–]
    """

    name = "friction_use"
    description = "largest use of friction 1 − (μN − |T|)/(μN_0)"
    symbol = "max 1 − (μN − |T|)/(μN_0)"

    limit: float = 1.0

    def start(self, start: Start) -> tuple[Values, None]:
        return self.zeros(start, 2) - jnp.inf, None

    def over_step(self, step: Step, record: Values) -> Maximum:
        def excess(forces: Values) -> Values:
            tangential, axial = halves(forces)
            return jnp.concatenate([tangential, -tangential]) - self.limit * jnp.concatenate([axial, axial])

        return step.largest(jax.tree.map(excess, step.course(end_forces)), record, sizes="signed")

    def is_unchanged(self, bounds: JointBounds, record: Values) -> Flag:
        ratio_excess = bounds.friction - self.limit
        excess = ratio_excess * jnp.where(ratio_excess < 0, bounds.least_axial, bounds.most_axial)
        return all_true(excess <= self._worst_excess(jax.lax.stop_gradient(record)))

    def _worst_excess(self, record: Values) -> Values:
        return jnp.maximum(*map(self.worst, halves(record)))

    def answer(self, ended: Ended, record: Values, note: Any) -> dict[str, Any]:
        capacity = self.limit * ended.scene.c.g * present(ended.scene.c.joints).dead_load
        use = 1 + self._worst_excess(record) / jnp.where(capacity > 0, capacity, 1.0)
        return {self.name: self.nan_if_weightless(ended, jnp.where(capacity > 0, use, 0.0))}
