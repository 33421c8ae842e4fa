"""The largest shear V_s at the base of the superstructure, and bounds on the motion of the beam during
skipped parts of a scene (one podium under one excitation). Equations are those of docs/model.md."""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from rockjax._engine.bounds import Bounds
from rockjax._engine.coefficients import Coefficients, ModalConstants
from rockjax._engine.model import shear
from rockjax._outputs.maxima import END_ZONE_ACCELERATIONS, Maximum
from rockjax._structures import Podium
from rockjax._types import Flag, Value

from .base import AbstractOutput, larger
from .views import Bounces, Ended, Moment, Rest, Sample, Start, Step


@dataclasses.dataclass(frozen=True)
class PeakShear(AbstractOutput):
    """The peak shear V_s at the base of the superstructure divided by its weight, max|V_s|/(m_t g), Eq. (7)
    [–].

    Mass that belongs to no mode moves with the deck (the beam). The shear includes the inertia force of this
    mass, but not the impulses that act on it at impacts.
    """

    name = "peak_shear"
    unit = "1"
    description = "peak shear of the superstructure divided by its weight max|V_s|/(m_t g)"
    symbol = "|V_s|/(m_t g)"
    by_default = True

    superstructure: bool = True  # whether the podium has a superstructure

    def applies(self, podium: Podium) -> bool:
        return podium.superstructure is not None

    def of(self, podium: Podium) -> PeakShear:
        return PeakShear(podium.superstructure is not None)

    def quantity(self, moment: Moment) -> Value:
        return shear(moment.c, moment.sigma, moment.ground, moment.x, moment.v, moment.a)

    def start(self, start: Start) -> tuple[Value, None]:
        return jnp.zeros((), start.t.dtype), None

    def over_step(self, step: Step, accumulator: Value) -> Maximum:
        if step.c.vibration is None:
            return step.largest(step.course(self.quantity), accumulator, END_ZONE_ACCELERATIONS)
        # The polynomial of a force contains the rate of the deformation, because of the damper, and is less
        # accurate than the polynomial of the deformation. Steps therefore end on maxima of forces for methods
        # of any order.
        modal: ModalConstants | None = step.c.modal
        course = step.spring_forces if modal is None else step.inertia_force()(modal.shares)
        force = step.largest(course, accumulator * step.c.g, END_ZONE_ACCELERATIONS)
        return force._replace(value=force.value / step.c.g)

    def over_rest(self, rest: Rest, accumulator: Value) -> Value:
        return larger(rest.largest_ground_acceleration / rest.scene.c.g, accumulator)

    def over_sample(self, sample: Sample, accumulator: Value) -> Flag:
        return stays_below(sample, accumulator)

    def over_bounces(self, bounces: Bounces, accumulator: Value) -> Flag:
        return beam_bound(bounces) < accumulator * bounces.c.g

    def is_final(self, bounds: Bounds, accumulator: Value) -> Flag:
        modal = bounds.c.modal
        if modal is not None:
            return bounds.floor_acceleration(modal.shares) < accumulator * bounds.c.g
        return bounds.base_shear() < accumulator * bounds.c.g

    def absent(self, ended: Ended) -> dict[str, Any]:
        value = jnp.full_like(ended.t, jnp.nan) if self.superstructure else jnp.zeros_like(ended.t)
        return {self.name: value}


def stays_below(sample: Sample, accumulator: Value) -> Flag:
    """Return whether the shear of a rigid superstructure certainly stays at or below the accumulator (the
    largest shear so far) during a sampling interval of length h. The shear is |a_b|/g, where a_b = ü_g + ü_b
    is the absolute acceleration of the beam, Eq. (14).
    """
    c, sigma = sample.c, sample.sigma
    start, end = jax.lax.stop_gradient([jnp.abs(shear(c, sigma, *y)) for y in (sample.start, sample.end)])
    curvature = jax.lax.stop_gradient(beam_curvatures(sample).horizontal) / c.g
    return exceeds_nowhere(start, end, curvature, jax.lax.stop_gradient(accumulator))


def exceeds_nowhere(start: Value, end: Value, curvature: Value, level: Value | float) -> Flag:
    """Return whether a quantity y certainly does not exceed a level in an interval of length h.

    - `start`, `end`: y at both ends
    - `curvature`: bound C on h²|d²y/dt²|
    - `level`: the level, in the unit of y

    At the fraction z ∈ [0, 1] of the interval, y exceeds the linear interpolation between both ends by at
    most ½C z(1 − z), which is at most C/8.
    """
    # Either y never exceeds its value at the start, or its largest possible value does not exceed the level.
    decreases = (start <= level) & (end + 0.5 * curvature <= start)
    return decreases | (jnp.maximum(start, end) + 0.125 * curvature <= level)


class BeamCurvatures(NamedTuple):
    """Bounds on the motion of the beam in a sampling interval of length h.

    - `horizontal`, `vertical`: bounds on h²|d²ü_b/dt²| and h²|d²v̈_b/dt²|, Eqs. (14), (15) [m/s²]
    - `first`, `second`: bounds on h|θ̇| and h²|θ̈| [rad]
    - `psi`: bound on |ψ|, at least α, and above α only if |θ| exceeds 2α [rad]
    """

    horizontal: Value
    vertical: Value
    first: Value
    second: Value
    psi: Value


def beam_curvatures(sample: Sample) -> BeamCurvatures:
    """Return bounds on the motion of the beam in a sampling interval, in which the ground acceleration is
    linear in time, for a rigid podium without restrainers."""
    c: Coefficients = sample.c
    h = sample.h
    grounds = sample.start[0], sample.end[0]
    speeds = sample.start[2][0], sample.end[2][0]
    accelerations = sample.start[3][0], sample.end[3][0]
    speed, acceleration = (jnp.maximum(*map(jnp.abs, pair)) for pair in (speeds, accelerations))
    # Bounds on |θ̇|h, |θ̈|h² and |θ⃛|h³.
    first, second = h * (speed + h * acceleration), h * h * acceleration
    third = h * h * jnp.abs(accelerations[1] - accelerations[0])
    ground = jnp.maximum(*map(jnp.abs, grounds))
    # By Eq. (24), `by_angle` bounds h⁴ times the fourth derivative of θ under a constant ü_g, and `by_ground`
    # bounds the additional effect of the rate of ü_g. The other terms of d²ü_b/dt² are products of lower
    # derivatives of θ: `even` bounds the terms with two or four factors, `odd` those with three.
    by_angle = h * h * (c.gravity + c.ground * ground) / c.inertia * (second + first * first)
    by_ground = 2 * h * h * c.ground / c.inertia * jnp.abs(grounds[1] - grounds[0]) * first
    even, odd = 4 * first * third + 3 * second * second + first**4, 6 * first * first * second
    # θ is monotone in the interval, so |ψ| is largest at an end, or at most α.
    turned = [jnp.abs(sample.sigma * c.alpha - y[1][0]) for y in (sample.start, sample.end)]
    psi = jnp.maximum(c.alpha, jnp.maximum(*turned))
    sin = jnp.where(psi > c.alpha, psi, c.sin_alpha)
    by_rotation = sin * even + odd
    horizontal = c.two_R * (by_angle + by_ground + by_rotation) / (h * h)
    vertical = c.two_R * (even + sin * (by_angle + by_ground + odd)) / (h * h)
    return BeamCurvatures(horizontal, vertical, first, second, psi)


def beam_bound(bounces: Bounces) -> Value:
    """Bound the absolute horizontal acceleration of the beam during bounces [m/s²].

    The bound is the acceleration at θ = θ̇ = 0, Eqs. (14), (24), plus contributions of θ and θ̇.
    """
    c, ground = bounces.c, bounces.ground
    beam_per_moment = c.two_R / c.inertia
    sway_per_moment = beam_per_moment * c.cos_alpha
    at_uplift = (
        sway_per_moment * c.gravity * c.sin_alpha
        + jnp.abs(1 - sway_per_moment * c.ground * c.cos_alpha) * ground
    )
    # By Eq. (24), the derivative of 2Rθ̈ cos ψ with respect to θ is at most
    # 2R(gravity + ground·|ü_g|)/inertia, with the constants of `Coefficients`. The factor 2 is a reserve.
    by_angle = 2 * beam_per_moment * (c.gravity + c.ground * ground) * bounces.height
    return at_uplift + by_angle + c.two_R * bounces.speed**2
