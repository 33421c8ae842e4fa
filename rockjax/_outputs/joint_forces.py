"""Forces in the joints of the columns, and impulses at impacts, (F1) to (F14) of docs/equations.md
and docs/forces.md.

A force (T, N) acts at a joint on the body above the joint: T horizontally in the direction of motion, N
upwards, so that N > 0 is compression. Forces are per column and divided by m_c [m/s²]. The forces follow from
the motion and do not affect it. The forces of the mean column are the means of the forces of all columns. In
the mass N m_c of all columns, N is the number of columns.

Positions x are θ [rad] and, if the superstructure vibrates, its displacement relative to the ground [m], an
array over the modes if there are several. Velocities v and accelerations a are the derivatives in time of x.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax.numpy as jnp

from rockjax._engine.coefficients import Coefficients, Vibration, not_none, weighted
from rockjax._engine.model import BeamMotion, beam, beam_motion, elongation, horizontal
from rockjax._engine.ratio import safe_ratio
from rockjax._excitations.base import Shaking
from rockjax._programs.barrier import barrier
from rockjax._sincos import sincos
from rockjax._structures.elevation import Arms
from rockjax._types import Value, Values, Vector


class DeviceForces(NamedTuple):
    """Compressive forces of restrainers at the bottom and the top joint, divided by m_c, (F2) [m/s²]."""

    bottom: Value | float
    top: Value | float


class MeanForces(NamedTuple):
    """Forces of the mean column divided by m_c [m/s²].

    - `bottom`, `top`: (T, N) at the joints, (F3)
    - `foundation`: (V, W), horizontal and vertical force on the foundation, (F5)
    - `eccentricity`: position of the joint forces relative to the centre line of a column, divided by half
      its width: ξ in full contact, (F10), and σ while rocking
    - `lean`: −ΔT_i/ΔN_i, where ΔT_i and ΔN_i are the forces of column i minus those of the mean column. This
      ratio is the same for all columns: ξ tan α in full contact, (F11), and tan ψ while rocking, (F9)
    - `moment`: overturning moment on the columns divided by N m_c, clockwise, (F6) [m²/s²]; None without an
      elevation
    """

    bottom: tuple[Value, Value]
    top: tuple[Value, Value]
    foundation: tuple[Value, Value]
    eccentricity: Value
    lean: Value
    moment: Value | None


def device_forces(c: Coefficients, sigma: Value, x: Vector, v: Vector, a: Vector) -> DeviceForces:
    """Return the forces of the restrainers at the joints, (F2).

    - `c`: constants of the podium; `sigma`: contact mode σ ∈ {−1, 0, 1}
    - `x`, `v`, `a`: positions, velocities and accelerations
    """
    if c.restraint is None:
        return DeviceForces(0.0, 0.0)
    stretch, lever = elongation(c, sigma, x[0])
    rate, slip = lever * v[0] / c.p, c.restraint.slip
    lengthening = lever * a[0] - 0.25 * stretch * v[0] ** 2  # ℓ̈/R
    over_both = over_one = jnp.zeros_like(stretch)
    for restrainer in c.restraint.restrainers:
        force = c.g * restrainer.force(stretch, rate, slip)
        if restrainer.apparent_mass is not None:
            force = force + 0.5 * c.two_R * restrainer.apparent_mass * lengthening
        if restrainer.joints == 2:
            over_both = over_both + force
        else:
            over_one = over_one + force
    return DeviceForces(over_both + 2 * over_one, over_both)


def total_weight(c: Coefficients) -> Value:
    """Return the total weight W_0 divided by N m_c [m/s²]."""
    return (1 + not_none(c.joints).gamma + c.eta) * c.g


def mean_forces(
    c: Coefficients, sigma: Value, ground: Value | Shaking, x: Vector, v: Vector, a: Vector
) -> MeanForces:
    """Return the forces of the mean column, (F1) to (F6), (F9) to (F11).

    - `c`: constants of the podium, including the joints; `sigma`: contact mode σ ∈ {−1, 0, 1}
    - `ground`: ü_g, or ü_g and v̈_g [m/s²]
    - `x`, `v`, `a`: positions, velocities and accelerations
    """
    joints = not_none(c.joints)
    gamma, eta = joints.gamma, c.eta
    beam = beam_motion(c, sigma, x[0], v[0], a[0])
    ground_horizontal, weight = horizontal(ground), c.g + _vertical(ground)
    springs = None if c.vibration is None else barrier(_spring_forces(c.vibration, beam, x, v))
    v_top = gamma * (ground_horizontal + beam.acceleration)
    if springs is not None:
        v_top = v_top - weighted(c.etas, springs)
    w_top = (gamma + eta) * (weight + beam.rise)
    v_bottom = v_top + ground_horizontal + 0.5 * beam.acceleration
    w_bottom = w_top + weight + 0.5 * beam.rise
    bottom, top = (v_bottom, w_bottom), (v_top, w_top)
    if c.restraint is not None:
        half, cos_half = sincos(0.5 * x[0])
        bottom, top = (
            (shear + force * half, axial + force * cos_half)
            for (shear, axial), force in zip((bottom, top), device_forces(c, sigma, x, v, a), strict=True)
        )
    tan_alpha = c.sin_alpha / c.cos_alpha
    in_contact = -safe_ratio(bottom[0] + top[0], tan_alpha * (bottom[1] + top[1]), bottom[1] + top[1] != 0)
    contact = sigma == 0
    return MeanForces(
        bottom,
        top,
        (v_bottom, w_bottom),
        jnp.where(contact, in_contact, sigma),
        jnp.where(contact, in_contact * tan_alpha, beam.sin_psi / jnp.where(contact, 1.0, beam.cos_psi)),
        None if joints.arms is None else _overturning_moment(c, joints.arms, ground, beam, springs, x),
    )


def _spring_forces(modes: Vibration, beam: BeamMotion, x: Vector, v: Vector) -> Values:
    """Return the spring forces F_i = ω_i²(u_i−u_b) + 2ζ_iω_i(u̇_i−u̇_b) of the modes, Eq. (7) [m/s²]."""
    return modes.omega2 * (x[1] - beam.sway) + modes.damping * (v[1] - beam.velocity)


def _overturning_moment(
    c: Coefficients, arms: Arms, ground: Value | Shaking, beam: BeamMotion, springs: Values | None, x: Vector
) -> Value:
    """Return the overturning moment on the columns divided by N m_c, clockwise, (F6) [m²/s²].

    - `c`: constants of the podium; `arms`: first moments of the masses of beam and modes
    - `ground`: ü_g, or ü_g and v̈_g [m/s²]
    - `beam`: motion of the beam; `springs`: spring forces of the modes, None if nothing vibrates [m/s²]
    - `x`: positions
    """
    beam_moment = -arms.beam * (beam.acceleration + horizontal(ground))
    if springs is None:
        return beam_moment
    weight = c.g + _vertical(ground) + beam.rise
    return beam_moment + weighted(not_none(arms.modes), springs) + weight * weighted(c.etas, x[1] - beam.sway)


def transfer(
    c: Coefficients, moment: Value, eccentricity: Value, lean: Value, axial: Value, offsets: Values
) -> Values:
    """Return the axial forces of columns minus the axial force of the mean column, (F8) [m/s²].

    - `c`: constants of the podium
    - `moment`: overturning moment M divided by N m_c [m²/s²]
    - `eccentricity`, `lean`: χ and the inclination of the forces, as in `MeanForces` [–]
    - `axial`: N_t of the mean column [m/s²]
    - `offsets`: positions of the columns from their mean [m]
    """
    arms = not_none(not_none(c.joints).arms)
    lever = arms.lever(eccentricity * (0.5 * c.two_R * c.sin_alpha), lean)
    return offsets * ((moment + lever * axial) / arms.mean_square)


def column_forces(
    c: Coefficients, mean: MeanForces, offsets: Sequence[Values] | None
) -> tuple[list[Values], list[Values]]:
    """Return two lists, T and N at the joints of columns, (F8) to (F11) [m/s²]. Each list has the values at
    the bottom joint for every element of `offsets`, then those at the top joint.

    - `c`: constants of the podium, including the joints; `mean`: forces of the mean column
    - `offsets`: positions of the columns from their mean [m]; None for the mean column
    """
    joints = mean.bottom, mean.top
    if offsets is None:
        return [y[0] for y in joints], [y[1] for y in joints]
    moment = not_none(mean.moment)
    axial = mean.top[1]
    transferred = barrier([transfer(c, moment, mean.eccentricity, mean.lean, axial, y) for y in offsets])
    tangential = [y[0] - change * mean.lean for y in joints for change in transferred]
    return tangential, [y[1] + change for y in joints for change in transferred]


def impulses_of_columns(
    c: Coefficients, sigma: Value, speed: Value, sway: Value | float, offsets: Sequence[Values] | None
) -> tuple[list[Values], list[Values]]:
    """Return two lists, the impulses J_T and J_N of an impact at the joints of columns, divided by m_c, (F12)
    to (F14) [m/s]. Each list has the values at the bottom joint for every element of `offsets`, then those at
    the top joint.

    - `c`: constants of the podium, including the joints; `sigma`: contact mode before the impact
    - `speed`: |θ̇| before the impact [rad/s]
    - `sway`: result of `sway_of_modes` [m]
    - `offsets`: positions of the columns from their mean [m]; None for the mean column
    """
    joints = not_none(c.joints)
    mean = joints.impulses
    tangential, axial = [sigma * speed * y for y in mean.horizontal], [speed * y for y in mean.axial]
    if offsets is None:
        return tangential, axial
    eccentricity = -sigma * joints.impulse_eccentricity
    moment = mean.rise * sway - not_none(joints.arms).beam * mean.sway * sigma
    lean = eccentricity * (c.sin_alpha / c.cos_alpha)
    transferred = [transfer(c, speed * moment, eccentricity, lean, axial[1], y) for y in offsets]
    return (
        [y - lean * change for y in tangential for change in transferred],
        [y + change for y in axial for change in transferred],
    )


def of_all_columns(
    function: Callable[..., tuple[list[Values], list[Values]]], *state, arms: Arms | None
) -> tuple[Values, Values]:
    """Return forces or impulses, horizontal and axial, as two arrays of shape (2, columns), the bottom joint
    first. Without an elevation, the arrays have one column, the mean column.

    - `function`: `column_forces` or `impulses_of_columns`; `state`: its arguments before the offsets
    - `arms`: positions of the columns, None without an elevation
    """
    found = function(*state, None if arms is None else [arms.offsets])
    tangential, axial = (jnp.stack(jnp.broadcast_arrays(*map(jnp.atleast_1d, y))) for y in found)
    return tangential, axial


def sway_of_modes(c: Coefficients, sigma: Value, x: Vector) -> Value | float:
    """Return Σ η_id_i over the modes i with their mass ratios η_i and deformations d_i [m]; 0.0 if there are
    no modes.

    - `c`: constants of the podium; `sigma`: contact mode σ ∈ {−1, 0, 1}; `x`: positions
    """
    if c.vibration is None:
        return 0.0
    return weighted(c.etas, x[1] - beam(c, sigma, x[0], jnp.zeros_like(x[0]))[0])


def _vertical(ground: Value | Shaking) -> Value | float:
    return ground.vertical if isinstance(ground, Shaking) else 0.0
