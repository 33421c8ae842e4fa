"""The friction demand of the joints: the largest |T|/N in a scene (one podium under one excitation).

T and N are the horizontal and the vertical force in a joint, per column and divided by the mass m_c of a
column [m/s²]; compression is positive. The "steeper" of two forces is the one with the larger angle from the
vertical, atan2(|T|, N). (F9) and (F11) are in docs/equations.md.
"""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any

import jax
import jax.numpy as jnp

from rockjax._engine.coefficients import not_none
from rockjax._engine.hermite import derivative
from rockjax._engine.ratio import safe_ratio
from rockjax._outputs.maxima import (
    CLOSE,
    END_ZONE_ACCELERATIONS,
    NEAR_MAXIMUM,
    ROUNDING,
    Cubic,
    Maximum,
    Quartic,
    curvatures_at_ends,
)
from rockjax._programs.barrier import barrier
from rockjax._types import Flag, Value

from .base import AbstractOutput
from .joint_bounds import JointBounds
from .joint_samples import SampleForces
from .joints import NO_FORCE, AbstractJointOutput, Force, all_of, over_rest, over_step
from .views import Course, Ended, Rest, Sample, Span, Start, Step, StepEnd

Accumulator = tuple[Value, ...]
Forces = tuple[Force, Force]


def _difference(tangential: Quartic, axial: Quartic, reference: Force) -> Quartic:
    """Return T·N_0 − T_0·N over a step. (T_0, N_0) is the force `reference`. Where the difference is
    positive, (T, N) is steeper than (T_0, N_0)."""
    size, n_0 = reference
    return Quartic(*[n_0 * t - size * n for t, n in zip(tangential, axial, strict=True)])


def _interior_maximum(cubic: Cubic) -> tuple[Value, Flag]:
    """Return the position z ∈ (0, 1) of the maximum of a cubic, and whether there is one."""
    a, b, c = derivative(cubic)
    squared = b * b - 4 * a * c
    root = jnp.sqrt(jnp.maximum(squared, 0.0))
    falls = b < 0
    numerator, denominator = jnp.where(falls, 2 * a, -b - root), jnp.where(falls, root - b, 2 * c)
    z = numerator / jnp.where(denominator == 0, 1.0, denominator)
    return z, (squared > 0) & (denominator != 0) & (z > 0) & (z < 1)


@jax.jit
def steepest(tangential: Course, axial: Course, span: Span, accumulator: Force) -> tuple[Force, Value]:
    """Return the steepest force in a step, and the `retry_fraction` of a `Maximum`.

    - `tangential`, `axial`: T and N over the step
    - `span`: times of the step
    - `accumulator`: steepest force so far

    The reference force (T_0, N_0) is the steepest of three forces: the forces at both ends of the step, and
    `accumulator` with |T| reduced by 1 %. A force inside the step is steeper where T·N_0 − T_0·N is
    positive. The function finds the maximum of this difference, takes the force there as the new (T_0, N_0),
    and finds the maximum again. Such searches converge quadratically to the steepest force (Dinkelbach's
    method), so two suffice. The next trial ends at the maximum, unless the maximum is close to an end of the
    step. If no force inside the step is steeper than the reference force, the result is the steeper one of
    the forces at the ends.
    """
    constant, h = jax.lax.stop_gradient, span.h
    courses = tangential, axial
    curvatures = [curvatures_at_ends(y.path, h, span.long, (y.start[1], y.end[1])) for y in courses]

    def end(k: int) -> tuple[Value, Value]:
        """Return T and N at the event or breakpoint at the start (`k` = 0) or the end (`k` = 1) of the step.
        If the angle of the force has an extremum here up to rounding, return T and N at the extremum."""
        jets = [(*course[1 + k], both[k]) for course, both in zip(courses, curvatures, strict=True)]
        # Let T_0 and N_0 be T and N at this end. Close to this end, the angle has an extremum where
        # T·N_0 − T_0·N has one. A small error in the time of the extremum hardly changes the angle, but
        # changes the derivative of the angle with respect to parameters.
        (t, *t_jet), (n, *n_jet) = constant(jets)
        rate, curvature = (a * n - t * b for a, b in zip(t_jet, n_jet, strict=True))
        to_extremum = -safe_ratio(rate, curvature, curvature != 0)
        is_close = jnp.abs(rate * to_extremum) < CLOSE * jnp.finfo(h.dtype).eps * jnp.abs(t * n)
        past = (span.before, span.after)[k] + jnp.where(is_close, to_extremum, 0.0)
        values = [value + past * (rate + 0.5 * past * curvature) for value, rate, curvature in jets]
        return values[0], values[1]

    ends = barrier([end(0), end(1)])
    forces = [Force(jnp.abs(t), n) for t, n in ends]
    largest_end = forces[1].steeper(forces[0])
    # Sign of T at the maximum: if the angle atan2(T, N) has an extremum in the step, the sign of the rate of
    # the angle at the start; otherwise the sign of T at the steeper end.
    rises = [
        constant(n_value * t_rate - t_value * n_rate)
        for (t_value, t_rate), (n_value, n_rate) in zip(tangential[1:], axial[1:], strict=True)
    ]
    at_end = jnp.where(forces[1].is_steeper(forces[0]), ends[1][0], ends[0][0])
    side = constant(jnp.where(jnp.where(rises[0] * rises[1] < 0, rises[0], at_end) < 0, -1.0, 1.0))
    paths = barrier((Quartic(*[side * y for y in tangential.path]), axial.path))
    fixed = constant(paths)
    so_far = Force((1 - NEAR_MAXIMUM) * accumulator.size, accumulator.axial)
    reference = barrier(constant(so_far.steeper(largest_end)))

    def force_at(z: Value, paths: tuple[Quartic, Quartic]) -> Force:
        return Force(*[path.value(z) for path in paths])

    z, exists = barrier(_interior_maximum(_difference(*fixed, reference).cubic))
    difference = barrier(_difference(*fixed, force_at(z, fixed)))
    z = difference.extremum_near(z, exists)
    # If T changes its sign in the step, T at z may have the sign opposite to `side`. The angle from the
    # vertical is then smaller than expected, so the force is compared with the reference force once more.
    found = barrier(force_at(z, paths))
    found = found._replace(size=jnp.abs(found.size))
    left, right = found.size * reference.axial, reference.size * found.axial
    rounding = ROUNDING * jnp.finfo(h.dtype).eps * (jnp.abs(left) + jnp.abs(right))
    exceeds = constant(exists & (left - right > rounding))
    force = largest_end.replaced(exceeds, found)
    shortens = exceeds & (z > END_ZONE_ACCELERATIONS) & (z < 1 - END_ZONE_ACCELERATIONS)
    return barrier(force), jnp.where(shortens, z, jnp.inf)


@dataclasses.dataclass(frozen=True)
class PeakFriction(AbstractJointOutput):
    """The largest friction demand max(|T|/N) at the bottom and the top joint, over time and over all columns,
    (F9), (F11) [–]; inf if a joint is in tension.

    The accumulator (the value so far) is the steepest force at each joint, not the largest |T|/N, because the
    angle of a force from the vertical is smooth at N = 0.
    """

    name = "peak_friction"
    unit = "1"
    description = "largest friction demand max|T|/N of the joints"
    symbol = "max |T|/N"

    def for_limit(self, limit: float) -> tuple[AbstractOutput, float]:
        return FrictionUse(limit=limit), 1.0

    def start(self, start: Start) -> tuple[Forces, None]:
        zero = jnp.zeros((), start.t.dtype)
        no_force = Force(zero, zero + 1)
        return (no_force, no_force), None

    def over_step(self, step: Step, accumulator: Forces) -> Maximum:
        tangential, axial, _ = over_step(step)
        values, fraction = [], jnp.full_like(step.span.h, jnp.inf)
        for joint, so_far in enumerate(accumulator):
            worst = None
            for courses in zip(tangential[joint], axial[joint], strict=True):
                force, retry_fraction = steepest(*courses, step.span, so_far)
                worst = force if worst is None else force.steeper(worst)
                fraction = jnp.minimum(fraction, retry_fraction)
            values.append(worst)
        return Maximum(tuple(values), fraction)

    def over_rest(self, rest: Rest, accumulator: Forces) -> Forces:
        # Without restrainers, |T|/N = |ü_g|/g in full contact if N > 0, and N is linear in ü_g. The force is
        # therefore steepest at the least or at the largest ü_g.
        for forces in over_rest(rest):
            worst = []
            for force, *joint in zip(accumulator, forces.tangential, forces.axial, strict=True):
                for tangential, axial in zip(*joint, strict=True):
                    new = Force(jnp.abs(tangential), axial)
                    force = force.replaced(rest.lasts & new.is_steeper(force), new)
                worst.append(force)
            accumulator = worst[0], worst[1]
        return accumulator

    def over_sample(self, sample: Sample, accumulator: Forces) -> Flag:
        forces = SampleForces.from_sample(sample)
        return all_of(forces.stays_below(k, jax.lax.stop_gradient(accumulator[k])) for k in range(2))

    def update(self, end: StepEnd, accumulator: Forces, note: None, largest: Forces) -> tuple[Forces, None]:
        bottom, top = (new.steeper(old) for new, old in zip(largest, accumulator, strict=True))
        return (bottom, top), note

    def is_unchanged(self, bounds: JointBounds, accumulator: Forces) -> Flag:
        return all_of(
            bound <= force.demand
            for bound, force in zip(bounds.friction, jax.lax.stop_gradient(accumulator), strict=True)
        )

    def answer(self, ended: Ended, accumulator: Forces, note: Any) -> dict[str, Any]:
        demands = jnp.stack([force.demand for force in accumulator])
        return {self.name: self.nan_if_unknown(ended, demands)}


@dataclasses.dataclass(frozen=True)
class FrictionUse(AbstractJointOutput):
    """The largest use of friction 1 − (μN − |T|)/(μN_0) at the bottom and the top joint, over time and over
    all columns [–]. N_0 is the axial force of the mean column under dead load. If the use exceeds 1, the
    joint would slide. At a joint with N_0 = 0, the answer is 0 if the joint does not slide, and otherwise
    computed with N_0 = m_c g. Design targets use this output instead of |T|/N, because the use of friction is
    smooth at N = 0.

    The accumulator (the value so far) is the largest |T| − μN of each joint [m/s²].

    - `limit`: friction coefficient μ [–]
    """

    name = "friction_use"
    description = "largest use of friction 1 − (μN − |T|)/(μN_0)"
    symbol = "max 1 − (μN − |T|)/(μN_0)"

    limit: float = 1.0

    def start(self, start: Start) -> tuple[Accumulator, None]:
        return (jnp.full((), -jnp.inf, start.t.dtype),) * 2, None

    def over_step(self, step: Step, accumulator: Accumulator) -> Maximum:
        tangential, axial, _ = over_step(step)
        groups = [
            [
                jax.tree.map(lambda t, n, side=side: side * t - self.limit * n, *pair)
                for side in (1, -1)
                for pair in zip(*joint, strict=True)
            ]
            for joint in zip(tangential, axial, strict=True)
        ]
        return step.largest_forces(groups, accumulator, jnp.ones_like(step.c.g), sizes="signed")

    def is_unchanged(self, bounds: JointBounds, accumulator: Accumulator) -> Flag:
        def holds(friction: Value, least: Value, most: Value, worst: Value) -> Flag:
            beyond = friction - self.limit
            return beyond * jnp.where(beyond < 0, least, most) <= worst

        worst = jax.lax.stop_gradient(accumulator)
        pairs = bounds.friction, bounds.least_axial, bounds.most_axial, worst
        return all_of(itertools.starmap(holds, zip(*pairs, strict=True)))

    def answer(self, ended: Ended, accumulator: Accumulator, note: Any) -> dict[str, Any]:
        load, excess = not_none(ended.scene.c.joints).dead_load, jnp.stack(accumulator)
        excess = excess / (self.limit * ended.scene.c.g)
        use = 1 + excess / jnp.where(load > 0, load, 1.0)
        return {self.name: self.nan_if_unknown(ended, jnp.where((load > 0) | (excess > NO_FORCE), use, 0.0))}
