"""Bounds on forces in the joints over a sampling interval of a record, for podiums without restrainers and
without a superstructure that vibrates.

T is the horizontal and N the vertical force in a joint. Forces are per column and divided by the mass m_c of
a column [m/s²], as in `joint_forces`.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from rockjax._engine.coefficients import Coefficients, not_none
from rockjax._sincos import sincos
from rockjax._types import Flag, Value

from .joint_forces import mean_forces
from .joints import EndForces, Force, all_of, end_forces, end_offsets
from .shear import BeamCurvatures, beam_curvatures, exceeds_nowhere
from .views import Moment, Sample


def _leaning(c: Coefficients, beam: BeamCurvatures, start: Value, end: Value, curvature: Value) -> Value:
    """Bound h²|d²(N tan ψ)/dt²| of an axial force N [m/s²] in a sampling interval of length h.

    - `c`: constants of the podium; `beam`: bounds on the motion
    - `start`, `end`: N at the ends of the interval; `curvature`: bound on h²|d²N/dt²|, all [m/s²]
    """
    # Bounds on |tan ψ|, h|d tan ψ/dt| and h²|d² tan ψ/dt²|.
    sin, cos = sincos(beam.psi)
    cos = jnp.maximum(cos, 1e-9)  # beyond a right angle the bounds are so large that nothing is skipped
    tan, per_angle = sin / cos, 1 / cos**2
    tan_rate = beam.first * per_angle
    tan_curvature = (beam.second + 2 * tan * beam.first**2) * per_angle
    return (
        tan * curvature
        + (2 * jnp.abs(end - start) + curvature) * tan_rate
        + (jnp.maximum(jnp.abs(start), jnp.abs(end)) + 0.125 * curvature) * tan_curvature
    )


class SampleForces(NamedTuple):
    """Forces at both ends of a sampling interval of length h, and bounds on h² times the second derivatives
    of the forces in time [m/s²]. All fields are held constant under differentiation."""

    start: EndForces[Value]
    end: EndForces[Value]
    curvature: EndForces[Value]

    @classmethod
    def from_sample(cls, sample: Sample) -> SampleForces:
        """Return the forces in a sampling interval. Each output calls this function, and the compiler removes
        the repeated operations."""
        sample = jax.lax.stop_gradient(sample)
        c, sigma, zero = sample.c, sample.sigma, jnp.zeros_like(sample.h)
        start, end = (
            EndForces.from_row(end_forces(Moment(c, sigma, zero, *y))) for y in (sample.start, sample.end)
        )
        beam, joints = beam_curvatures(sample), not_none(c.joints)
        swaying = (0.5 + joints.gamma) * beam.horizontal, joints.gamma * beam.horizontal
        mass = joints.gamma + c.eta
        rising = (0.5 + mass) * beam.vertical, mass * beam.vertical
        offsets = end_offsets(c)
        if offsets is None:
            changes = leaning = [zero]
        else:
            arms = not_none(joints.arms)
            half_width = 0.5 * c.two_R * c.sin_alpha
            change = jnp.abs(arms.beam) * beam.horizontal + half_width * rising[1]
            mean = [mean_forces(c, sigma, *y).top[1] for y in (sample.start, sample.end)]
            if arms.raised is not None:
                change = change + arms.raised * _leaning(c, beam, mean[0], mean[1], rising[1])
            change = change / arms.mean_square
            changes = [jnp.abs(x) * change for x in offsets]
            transferred = [
                [n - n_mean for n in forces.axial[1]]
                for forces, n_mean in zip((start, end), mean, strict=True)
            ]
            leaning = [_leaning(c, beam, a, b, y) for a, b, y in zip(*transferred, changes, strict=True)]
        curvature = EndForces(
            (tuple(swaying[0] + y for y in leaning), tuple(swaying[1] + y for y in leaning)),
            (tuple(rising[0] + y for y in changes), tuple(rising[1] + y for y in changes)),
            swaying[0],
        )
        return cls(start, end, curvature)

    def axial_within(self, joint: int, least: Value, most: Value) -> Flag:
        """Return whether N certainly stays between `least` and `most` [m/s²] at the bottom (0) or the top
        joint (1)."""
        rows = zip(*(forces.axial[joint] for forces in self), strict=True)
        return all_of(
            exceeds_nowhere(side * start, side * end, curvature, side * limit)
            for start, end, curvature in rows
            for side, limit in ((-1, least), (1, most))
        )

    def stays_below(self, joint: int, steepest: Force) -> Flag:
        """Return whether the friction demand |T|/N at a joint certainly stays at or below the demand of the
        force `steepest`. If `steepest` is not in compression, its demand is inf, and the result is True.
        `joint` is 0 for the bottom and 1 for the top joint."""
        size, axial = steepest
        rows = zip(
            *(y for forces in self for y in (forces.tangential[joint], forces.axial[joint])), strict=True
        )
        return (axial <= 0) | all_of(
            exceeds_nowhere(
                jnp.abs(t0) * axial - size * n0, jnp.abs(t1) * axial - size * n1, dt * axial + size * dn, 0.0
            )
            for t0, n0, t1, n1, dt, dn in rows
        )
