"""Energies of a podium, Eqs. (16) to (19), and a bound on the later energy, (C19).

Equations without a letter are those of docs/model.md; (C8) is in docs/control.md, and the other equations
(C…) are in docs/equations.md.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from rockjax._sincos import sincos
from rockjax._types import Value, Vector

from .coefficients import Coefficients, summed
from .model import elongation


def rotational_inertia(c: Coefficients, sigma: Value, theta: Value) -> Value:
    """Return I of (C21), the inertia of a podium whose superstructure is fixed to the beam [–].

    I is the factor of θ̈ in the equation of motion, Eq. (24) or with inerters (C8), but with 3η in place of
    3η sin²ψ."""
    total, mass = c.inertia + c.centrifugal, _apparent_mass(c)
    if mass is None:
        return total
    return total + 0.75 * mass * elongation(c, sigma, theta).lever ** 2


def spin_with_inerters(c: Coefficients, sigma: Value, theta: Value) -> Value:
    """Return the factor of ½θ̇² in the kinetic energy of columns, beam and inerters, Eq. (18) and (C17),
    divided by the mass N m_c of all columns [m²]."""
    mass = _apparent_mass(c)
    if mass is None:
        return c.spin
    return c.spin + mass * (0.5 * c.two_R * elongation(c, sigma, theta).lever) ** 2


def _apparent_mass(c: Coefficients) -> Value | None:
    return None if c.restraint is None else c.restraint.apparent_mass


def potential(c: Coefficients, sigma: Value, theta: Value) -> Value:
    """Return the potential energy of gravity, Eq. (19), and of restrainers, (C3), divided by the mass N m_c
    of all columns [m²/s²]. The potential energy is zero in full contact."""
    s, cos = sincos(0.5 * theta)
    # cos ψ − cos α is computed as 2 sin(|θ|/2) sin(α − |θ|/2), which has no cancellation at small rotations.
    stored = c.weight * 2 * sigma * s * (c.sin_alpha * cos - c.cos_alpha * sigma * s)
    if c.restraint is None:
        return stored
    stretch = elongation(c, sigma, theta).stretch
    in_devices = sum(
        (each.potential(stretch) for each in c.restraint.restrainers if each.has_static_force), 0.0 * s
    )
    return stored + 0.5 * c.two_R * c.g * in_devices


def potential_slope(c: Coefficients, theta: Value) -> Value:
    """Return the derivative V' of `potential` with respect to |θ|, at |θ| = `theta` [rad], (C5) [m²/s²]."""
    one = jnp.ones_like(theta)
    return jax.jvp(lambda angle: potential(c, one, angle), (theta,), (one,))[1]


def energy(c: Coefficients, sigma: Value, x: Vector, v: Vector) -> Value:
    """Return the mechanical energy of the motion relative to the ground, divided by N m_c [m²/s²]: Eqs. (16)
    to (19) without the terms of the ground motion, (C17).

    - `c`: constants of the podium
    - `sigma`: contact mode σ ∈ {−1, 0, 1}
    - `x`, `v`: positions (θ [rad], u_t [m]) and velocities
    """
    total = 0.5 * spin_with_inerters(c, sigma, x[0]) * v[0] ** 2 + potential(c, sigma, x[0])
    if c.vibration is None:
        return total
    s, _ = sincos(sigma * c.alpha - x[0])
    deformation = x[1] - c.two_R * (sigma * c.sin_alpha - s)
    speed2 = v[1] ** 2 + (c.two_R * v[0] * s) ** 2  # u̇_t² + v̇_t², where v̇_t = v̇_b, Eqs. (15), (17)
    return total + summed(0.5 * c.etas * (speed2 + c.vibration.omega2 * deformation**2))


def vertical_impulse_weight(c: Coefficients, max_sin_psi: Value) -> Value:
    """Return C_v/C of (C19), the weight of ∫|v̈_g| dt relative to ∫|ü_g| dt [–]. `max_sin_psi` is an upper
    bound on |sin ψ|."""
    spin, weight = c.spin / (0.5 * c.two_R) ** 2, c.gravity / c.p**2
    return weight * max_sin_psi / jnp.sqrt(2 * (spin + 4 * c.eta * max_sin_psi**2)) / c.impulse_factor


def energy_after(c: Coefficients, now: Value, impulse: Value) -> Value:
    """Return an upper bound on the energy E at all later times, divided by N m_c [m²/s²].

    - `now`: present energy divided by N m_c [m²/s²]
    - `impulse`: ∫|ü_g| dt over all later times [m/s]; with vertical motion, plus C_v/C times ∫|v̈_g| dt

    The ground does work at the rate −ü_g[(½+γ)u̇_b + η u̇_t], divided by N m_c. By the Cauchy–Schwarz
    inequality, this rate is at most 2C|ü_g|√T with the kinetic energy T and C² = (1+2γ)²/(2(1+λ+4γ)) + η/2.
    Where the potential energy is not negative (without restrainers, for |θ| ≤ 2α), T ≤ E. Therefore √E grows
    at most at the rate C|ü_g|. Damping and impacts only dissipate energy. docs/numerics.md has the
    derivation.
    """
    return (jnp.sqrt(jnp.maximum(now, 0.0)) + c.impulse_factor * impulse) ** 2
