"""The largest shear at the base of the superstructure."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from rockjax._engine.bounds import Bounds
from rockjax._engine.coefficients import Coefficients, ModalConstants
from rockjax._engine.model import shear
from rockjax._outputs.maxima import WELL_INSIDE_CUBIC, WELL_INSIDE_QUINTIC, Maximum
from rockjax._structures import Podium
from rockjax._types import Flag, Value

from .base import AbstractOutput, larger
from .views import Bounces, Ended, Moment, Rest, Sample, Start, Step


@dataclasses.dataclass(frozen=True)
class PeakShear(AbstractOutput):
    """The peak shear of the superstructure over its weight max|V_s|/(m_t g), Eq. (7)."""

    name = "peak_shear"
    unit = "1"
    description = "peak shear of the superstructure over its weight max|V_s|/(m_t g)"
    symbol = "|V_s|/(m_t g)"
    by_default = True

    superstructure: bool = True

    def applies(self, podium: Podium) -> bool:
        return podium.superstructure is not None

    def of(self, podium: Podium) -> PeakShear:
        return PeakShear(podium.superstructure is not None)

    def quantity(self, moment: Moment) -> Value:
        return shear(moment.c, moment.sigma, moment.ground, moment.x, moment.v, moment.a)

    def start(self, start: Start) -> tuple[Value, None]:
        return jnp.zeros((), start.t.dtype), None

    def over_step(self, step: Step, record: Value) -> Maximum:
        if step.c.vibration is None:
            return step.largest(step.course(self.quantity), record, WELL_INSIDE_CUBIC)
        # Forces use a derivative of the polynomial, so they are landed on for methods of any order.
        modal: ModalConstants | None = step.c.modal
        if modal is None:
            course, inside = step.spring_forces, WELL_INSIDE_QUINTIC
        else:
            course, inside = step.carrier()(modal.shares), step.inside_of_forces
        force = step.largest(course, record * step.c.g, inside)
        return force._replace(value=force.value / step.c.g)

    def over_rest(self, rest: Rest, record: Value) -> Value:
        return larger(rest.largest_ground_acceleration / rest.scene.c.g, record)

    def over_sample(self, sample: Sample, record: Value) -> Flag:
        return _stays_under(sample, record)

    def over_bounces(self, bounces: Bounces, record: Value) -> Flag:
        return _beam_at_most(bounces) < record * bounces.c.g

    def is_final(self, bounds: Bounds, record: Value) -> Flag:
        modal = bounds.c.modal
        if modal is not None:
            return bounds.carried(modal.shares) < record * bounds.c.g
        return bounds.force() < record * bounds.c.g

    def absent(self, ended: Ended) -> dict[str, Any]:
        absent = jnp.full_like(ended.t, jnp.nan) if self.superstructure else jnp.zeros_like(ended.t)
        return {self.name: absent}


def _stays_under(sample: Sample, record: Value) -> Flag:
    """Return whether the shear stays below its record up to the next sample.

    If its second derivative is at most C, it lies at most C z(1 − z) h²/2 above the straight line between its
    ends.
    """
    c, sigma = sample.c, sample.sigma
    first, last = jax.lax.stop_gradient([jnp.abs(shear(c, sigma, *y)) for y in (sample.first, sample.last)])
    record = jax.lax.stop_gradient(record)
    over = jax.lax.stop_gradient(_bend(sample)) / c.g
    # Either it falls from the first end on, or the most that it can rise stays below the record.
    falls = (first <= record) & (last + 0.5 * over <= first)
    return falls | (jnp.maximum(first, last) + 0.125 * over <= record)


def _bend(sample: Sample) -> Value:
    """Bound h² times the second derivative in time of the beam's absolute acceleration over a sample, Eq.
    (14). The ground acceleration is linear in between and does not contribute itself."""
    c: Coefficients = sample.c
    h = sample.h
    grounds = sample.first[0], sample.last[0]
    speeds = sample.first[2][0], sample.last[2][0]
    changes = sample.first[3][0], sample.last[3][0]
    speed, change = (jnp.maximum(*map(jnp.abs, pair)) for pair in (speeds, changes))
    w, wh = h * h * change, h * (speed + h * change)  # θ̈ h² and θ̇ h at most
    jerk = h * h * jnp.abs(changes[1] - changes[0])  # θ⃛ h³
    most = jnp.maximum(*map(jnp.abs, grounds))
    # θ⁗ h⁴, Eq. (24): by the rotation itself, and by the change of ü_g while columns turn.
    by_angle = h * h * (c.gravity + c.ground * most) / c.inertia * (w + wh * wh)
    by_ground = 2 * h * h * c.ground / c.inertia * jnp.abs(grounds[1] - grounds[0]) * wh
    turns = c.sin_alpha * (4 * wh * jerk + 3 * w * w + wh**4) + 6 * wh * wh * w
    return c.two_R * (by_angle + by_ground + turns) / (h * h)


def _beam_at_most(bounces: Bounces) -> Value:
    """Bound the absolute acceleration of the beam over bounces [m/s²].

    The bound is the acceleration at uplift, Eqs. (14), (24), plus the contributions of rotation and its rate.
    """
    c, ground = bounces.c, bounces.ground
    per_moment = c.two_R / c.inertia
    lifting = per_moment * c.cos_alpha
    at_foot = lifting * c.gravity * c.sin_alpha + jnp.abs(1 - lifting * c.ground * c.cos_alpha) * ground
    # The rotation changes ψ, and thereby 2Rθ̈ cos ψ by less than 2R(p² + |θ̈|) θ.
    turned = 2 * per_moment * (c.gravity + c.ground * ground) * bounces.height
    return at_foot + turned + c.two_R * bounces.speed**2
