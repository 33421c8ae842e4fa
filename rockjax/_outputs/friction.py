"""The friction demand of the joints: the largest |T|/N over a scene."""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from rockjax._engine.coefficients import present
from rockjax._engine.hermite import turning_point_of_slope
from rockjax._outputs.maxima import Cubic, Maximum
from rockjax._types import Flag, Flags, Value, Values

from .base import AbstractOutput
from .joint_bounds import JointBounds
from .joints import AbstractJointOutput, all_of, end_forces, friction_of, halves, quarter_tangent
from .views import Course, Ended, Start, Step

Accumulator = tuple[Value, ...]


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


def _angle(tangential: Course, axial: Course) -> Course:
    """Return tan(φ/4) over a step from the courses of T and N."""

    def at_end(t: tuple[Values, Values], n: tuple[Values, Values]) -> tuple[Values, Values]:
        return jax.jvp(quarter_tangent, (t[0], n[0]), (t[1], n[1]))

    path = AnglePath(tangential.path, axial.path)
    return Course(path, at_end(tangential.start, axial.start), at_end(tangential.end, axial.end))


@dataclasses.dataclass(frozen=True)
class PeakFriction(AbstractJointOutput):
    """The largest friction demand max|T|/N at the bottom and the top joint of the worst column, (F9), (F11).

    The accumulator is the angle φ of the force from the vertical, as tan(φ/4), which is smooth at N = 0.
    """

    name = "peak_friction"
    unit = "1"
    description = "largest friction demand max|T|/N of the joints"
    symbol = "max |T|/N"

    def for_limit(self, limit: float) -> tuple[AbstractOutput, float]:
        return FrictionUse(limit=limit), 1.0

    def start(self, start: Start) -> tuple[Accumulator, None]:
        return self.filled(start, 0.0), None

    def over_step(self, step: Step, accumulator: Accumulator) -> Maximum:
        angles = [_angle(*forces) for forces in zip(*halves(step.courses(end_forces)), strict=True)]
        maximum = step.largest_forces(angles, accumulator)
        return maximum._replace(value=tuple(jnp.minimum(y, 1.0) for y in maximum.value))

    def is_unchanged(self, bounds: JointBounds, accumulator: Accumulator) -> Flag:
        demands = map(friction_of, jax.lax.stop_gradient(self.worst(accumulator)))
        return all_of(bound <= demand for bound, demand in zip(bounds.friction, demands, strict=True))

    def answer(self, ended: Ended, accumulator: Accumulator, note: Any) -> dict[str, Any]:
        return {self.name: self.nan_if_weightless(ended, friction_of(jnp.stack(self.worst(accumulator))))}


@dataclasses.dataclass(frozen=True)
class FrictionUse(AbstractJointOutput):
    """The largest use of friction 1 − (μN − |T|)/(μN_0) at a joint [–], with the dead load N_0 of the mean
    column. If it exceeds 1, the joint would slide. The answer is 0 at a joint without dead load. Targets use
    this output because it is smooth where a joint would open, unlike |T|/N.

    The accumulator contains the largest T − μN of every column and joint, then the largest −T − μN [m/s²].

    - `limit`: friction coefficient μ [–]
    """

    name = "friction_use"
    description = "largest use of friction 1 − (μN − |T|)/(μN_0)"
    symbol = "max 1 − (μN − |T|)/(μN_0)"

    limit: float = 1.0

    def start(self, start: Start) -> tuple[Accumulator, None]:
        return 2 * self.filled(start, -jnp.inf), None

    def over_step(self, step: Step, accumulator: Accumulator) -> Maximum:
        forces = list(zip(*halves(step.courses(end_forces)), strict=True))
        excesses = [
            jax.tree.map(lambda t, n, side=side: side * t - self.limit * n, *pair)
            for side in (1, -1)
            for pair in forces
        ]
        return step.largest_forces(excesses, accumulator, sizes="signed")

    def is_unchanged(self, bounds: JointBounds, accumulator: Accumulator) -> Flag:
        def holds(friction: Value, least: Value, most: Value, worst: Value) -> Flag:
            beyond = friction - self.limit
            return beyond * jnp.where(beyond < 0, least, most) <= worst

        worst = jax.lax.stop_gradient(self._worst_excess(accumulator))
        pairs = bounds.friction, bounds.least_axial, bounds.most_axial, worst
        return all_of(itertools.starmap(holds, zip(*pairs, strict=True)))

    def _worst_excess(self, accumulator: Accumulator) -> list[Value]:
        one_side, other_side = map(self.worst, halves(accumulator))
        return [jnp.maximum(*pair) for pair in zip(one_side, other_side, strict=True)]

    def answer(self, ended: Ended, accumulator: Accumulator, note: Any) -> dict[str, Any]:
        capacity = self.limit * ended.scene.c.g * present(ended.scene.c.joints).dead_load
        use = 1 + jnp.stack(self._worst_excess(accumulator)) / jnp.where(capacity > 0, capacity, 1.0)
        return {self.name: self.nan_if_weightless(ended, jnp.where(capacity > 0, use, 0.0))}
