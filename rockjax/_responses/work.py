"""Power of the ground and of dampers, and the restoring moment of the columns, at one instant of a scene.

Equations with a number alone are in docs/model.md; (C18) and (C22) are in docs/equations.md.
"""

from __future__ import annotations

import jax.numpy as jnp

from rockjax._engine.coefficients import Coefficients, Restraint, summed
from rockjax._engine.model import (
    acceleration,
    beam,
    beam_vertical_acceleration,
    elongation,
    horizontal_demand,
    plus,
)
from rockjax._excitations.base import Shaking
from rockjax._sincos import sincos
from rockjax._types import Value, Vector


def damper_power(c: Coefficients, restraint: Restraint, sigma: Value, x: Vector, v: Vector) -> Value:
    """Return the power that the restrainers dissipate, divided by the mass N m_c of all columns [m²/s³].

    If each of the N columns has a damper with the force C|ℓ̇|^ν at the rate ℓ̇ of elongation, the power of all
    dampers is N C|ℓ̇|^(1+ν), and the result is (C/m_c)|ℓ̇|^(1+ν).

    - `c`, `restraint`: constants of the podium and of its restrainers
    - `sigma`: contact mode σ ∈ {−1, 0, 1}
    - `x`, `v`: positions (θ, then u_i of the modes) and velocities
    """
    rate = elongation(c, sigma, x[0]).lever * v[0] / c.p
    powers = (restrainer.power(rate, restraint.slip) for restrainer in restraint.restrainers)
    return 0.5 * c.two_R * c.g * c.p * sum(powers, jnp.zeros_like(rate))


def power(
    c: Coefficients, sigma: Value, ground: Value | Shaking, x: Vector, v: Vector
) -> tuple[Value, Value]:
    """Return the power of the ground and the power that the superstructure's damper dissipates, both divided
    by N m_c [m²/s³].

    - `c`: constants of the podium
    - `sigma`: contact mode σ ∈ {−1, 0, 1}
    - `ground`: ü_g, or ü_g and v̈_g [m/s²]
    - `x`, `v`: positions (θ, then u_i of the modes) and velocities

    If no restrainers dissipate energy, the mechanical energy changes between impacts at the rate of the first
    power minus the second. The power of the ground is −ü_g[(½+γ)u̇_b + η u̇_t] − v̈_g w v̇_b, (C18). Here γ
    and η are the mass ratios of the beam and the superstructure, w = ½+γ+η, u̇_b and v̇_b are the velocities
    of the beam, and u̇_t is the velocity of the superstructure. The power of the damper of Eq. (22) is
    2ζω_s η (u̇_t − u̇_b)².
    """
    _, beam_rate = beam(c, sigma, x[0], v[0])
    half_and_gamma = 0.5 * c.ground * c.g / c.p**2  # ½+γ
    vertical_power = 0.0
    if isinstance(ground, Shaking):
        sin_psi, _ = sincos(sigma * c.alpha - x[0])
        vertical_power = -ground.vertical * 0.5 * c.gravity / c.p**2 * c.two_R * v[0] * sin_psi
        ground = ground.horizontal
    if c.vibration is None:
        return plus(-ground * half_and_gamma * beam_rate, vertical_power), jnp.zeros_like(beam_rate)
    momentum = half_and_gamma * beam_rate + summed(c.etas * v[1])
    dissipated = summed(c.etas * c.vibration.damping * (v[1] - beam_rate) ** 2)
    return plus(-ground * momentum, vertical_power), dissipated


def restoring_moment(c: Coefficients, sigma: Value, ground: Value | Shaking, x: Vector, v: Vector) -> Value:
    """Return the restoring moment of the columns about their edges, divided by its value at uplift [–].

    - `c`: constants of the podium
    - `sigma`: contact mode σ ∈ {−1, 0, 1}
    - `ground`: ü_g, or ü_g and v̈_g [m/s²]
    - `x`, `v`: positions (θ, then u_i of the modes) and velocities

    In full contact the moment balances the uplift demand q, and the result is −q/q_up, Eq. (9). While
    rocking, the vertical forces of the foundation act at the edges and carry the weights and the vertical
    inertia forces. The result is then (sin ψ/sin α)[1 + (2γ+2η+½)/(2γ+2η+1) v̈_b/g], with ψ = σα − θ, the
    mass ratios γ of the beam and η of the superstructure, and v̈_b of Eq. (15). The ratio in the brackets is
    below 1, because the centres of the columns rise half as fast as the beam. At uplift v̈_b = 0, and both
    formulas give σ. A vertical ground acceleration adds v̈_g/g in the brackets. Restrainers add their forces
    times lever arms, (C22).
    """
    s, _ = sincos(sigma * c.alpha - x[0])
    theta_ddot = acceleration(c, sigma, ground, x, v)[0]
    rise = beam_vertical_acceleration(c, sigma, x[0], v[0], theta_ddot)
    reaction = 1 + (1 - 0.5 * c.p**2 / c.gravity) * rise / c.g  # divided by the weight
    if isinstance(ground, Shaking):
        reaction = reaction + ground.vertical / c.g
    rocking = s / c.sin_alpha * reaction
    if c.restraint is not None:
        rocking = _with_restrainers(c, c.restraint, sigma, x[0], v[0], theta_ddot, rocking)
    return jnp.where(sigma == 0, -horizontal_demand(c, ground, x, v) / c.uplift, rocking)


def _with_restrainers(
    c: Coefficients,
    restraint: Restraint,
    sigma: Value,
    theta: Value,
    theta_dot: Value,
    theta_ddot: Value,
    rocking: Value,
) -> Value:
    """Return the moment of weights and restrainers divided by its value at uplift, (C22).

    `rocking` is the moment of the weights divided by their moment at uplift [–]; for the other arguments see
    `restoring_moment`.
    """
    stretch, lever = elongation(c, sigma, theta)
    rate = lever * theta_dot / c.p
    zero = jnp.zeros_like(stretch)
    restrainers, slip = restraint.restrainers, restraint.slip
    forces = sum((restrainer.force(stretch, rate, slip) for restrainer in restrainers), zero)
    initial = sum((restrainer.force(zero, zero, slip) for restrainer in restrainers), zero)
    if restraint.apparent_mass is not None:
        lengthening = lever * theta_ddot - 0.25 * stretch * theta_dot**2  # ℓ̈/R
        forces = forces + 0.5 * c.two_R / c.g * restraint.apparent_mass * lengthening
    weight = c.weight / (c.two_R * c.g)  # w
    return (weight * rocking + 0.5 * forces * lever / c.sin_alpha) / (weight + initial)
