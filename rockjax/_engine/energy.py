"""Energy, power and what holds the frame up: Eqs. (16) to (19), with restrainers (C3) to (C22)."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from rockjax._excitations.base import Shaking
from rockjax._sincos import sincos
from rockjax._types import Value, Vector

from .coefficients import Coefficients, Restraint, summed
from .model import acceleration, beam, elongation, horizontal_demand, plus


def rotational_inertia(c: Coefficients, sigma: Value, theta: Value) -> Value:
    """The inertia of Eq. (24) where the superstructure moves with the beam, with that of inerters, (C21)."""
    total, mass = c.inertia + c.centrifugal, _apparent_mass(c)
    if mass is None:
        return total
    return total + 0.75 * mass * elongation(c, sigma, theta).lever ** 2


def spin_with_inerters(c: Coefficients, sigma: Value, theta: Value) -> Value:
    """What ½θ̇² of the kinetic energy of Eq. (18) is of, with inerters, (C17)."""
    mass = _apparent_mass(c)
    if mass is None:
        return c.spin
    return c.spin + mass * (0.5 * c.two_R * elongation(c, sigma, theta).lever) ** 2


def _apparent_mass(c: Coefficients) -> Value | None:
    return None if c.restraint is None else c.restraint.apparent_mass


def potential(c: Coefficients, sigma: Value, theta: Value) -> Value:
    """Gravity part of Eq. (19) per N m_c with what restrainers store, zero in full contact [m²/s²], (C3)."""
    s, cos = sincos(0.5 * theta)
    # cos ψ − cos α = 2 sin(A/2) sin(α − A/2), A = |θ|: without cancellation at small rotations.
    stored = c.weight * 2 * sigma * s * (c.sin_alpha * cos - c.cos_alpha * sigma * s)
    if c.restraint is None:
        return stored
    stretch = elongation(c, sigma, theta).stretch
    of_devices = sum((each.potential(stretch) for each in c.restraint.restrainers if each.stores), 0.0 * s)
    return stored + 0.5 * c.two_R * c.g * of_devices


def potential_slope(c: Coefficients, theta: Value) -> Value:
    """V' of (C5) at |θ| = `theta`, per N m_c [m²/s²]."""
    one = jnp.ones_like(theta)
    return jax.jvp(lambda angle: potential(c, one, angle), (theta,), (one,))[1]


def energy(c: Coefficients, sigma: Value, x: Vector, v: Vector) -> Value:
    """Mechanical energy relative to the ground per N m_c, Eqs. (16)–(19) without the ground's terms [m²/s²],
    (C17)."""
    total = 0.5 * spin_with_inerters(c, sigma, x[0]) * v[0] ** 2 + potential(c, sigma, x[0])
    if c.vibration is None:
        return total
    s, _ = sincos(sigma * c.alpha - x[0])
    deformation = x[1] - c.two_R * (sigma * c.sin_alpha - s)
    top = v[1] ** 2 + (c.two_R * v[0] * s) ** 2  # v̇_t = v̇_b, Eqs. (15), (17)
    return total + summed(0.5 * c.etas * (top + c.vibration.omega2 * deformation**2))


def damper_power(c: Coefficients, held: Restraint, sigma: Value, x: Vector, v: Vector) -> Value:
    """What restrainers take, (C/m_c)|ℓ̇|^(1+ν) of dampers, per N m_c [m²/s³]."""
    rate = elongation(c, sigma, x[0]).lever * v[0] / c.p
    taken = sum((each.power(rate, held.slip) for each in held.restrainers), jnp.zeros_like(rate))
    return 0.5 * c.two_R * c.g * c.p * taken


def power(
    c: Coefficients, sigma: Value, ground: Value | Shaking, x: Vector, v: Vector
) -> tuple[Value, Value]:
    """What the ground gives and what the damper takes, per N m_c [m²/s³]; between impacts Ė is their
    difference.

    The ground gives −ü_g[(½+γ)u̇_b + η u̇_t], the work of its inertia forces in Eq. (19); the damper of Eq.
    (22) takes 2ζω_s η (u̇_t − u̇_b)². Vertical motion gives −v̈_g w v̇_b, (C18).
    """
    _, beam_rate = beam(c, sigma, x[0], v[0])
    heavy = 0.5 * c.ground * c.g / c.p**2  # ½+γ
    lifted = 0.0
    if isinstance(ground, Shaking):
        rises, _ = sincos(sigma * c.alpha - x[0])
        lifted = -ground.vertical * 0.5 * c.gravity / c.p**2 * c.two_R * v[0] * rises
        ground = ground.horizontal
    if c.vibration is None:
        return plus(-ground * heavy * beam_rate, lifted), jnp.zeros_like(beam_rate)
    rates = heavy * beam_rate + summed(c.etas * v[1])
    taken = summed(c.etas * c.vibration.damping * (v[1] - beam_rate) ** 2)
    return plus(-ground * rates, lifted), taken


def restoring_moment(c: Coefficients, sigma: Value, ground: Value | Shaking, x: Vector, v: Vector) -> Value:
    """The moment about the edges that holds the frame up, over its value at uplift [–].

    Full contact bears what is asked of it, −q/q_up, Eq. (9). While rocking, the vertical forces of the ground
    act at the edges: they bear the weights and what lifts them, (sin ψ/sin α)[1 + (2γ+2η+½)/(2γ+2η+1) v̈_b/g]
    with v̈_b of Eq. (15). The columns' centres rise half as fast as the beam. Both are σ at uplift, where
    v̈_b = 0. Restrainers add their forces times their levers, (C22).
    """
    s, cos = sincos(sigma * c.alpha - x[0])
    theta_ddot = acceleration(c, sigma, ground, x, v)[0]
    rises = c.two_R * (theta_ddot * s - v[0] ** 2 * cos)
    share = 1 + (1 - 0.5 * c.p**2 / c.gravity) * rises / c.g
    if isinstance(ground, Shaking):
        share = share + ground.vertical / c.g
    rocking = s / c.sin_alpha * share
    if c.restraint is not None:
        rocking = _with_restrainers(c, c.restraint, sigma, x[0], v[0], theta_ddot, rocking)
    return jnp.where(sigma == 0, -horizontal_demand(c, ground, x, v) / c.uplift, rocking)


def _with_restrainers(
    c: Coefficients,
    held: Restraint,
    sigma: Value,
    theta: Value,
    theta_dot: Value,
    theta_ddot: Value,
    rocking: Value,
) -> Value:
    """The moment of weights over their own at uplift, with that of restrainers and over that of both."""
    stretch, lever = elongation(c, sigma, theta)
    rate = lever * theta_dot / c.p
    zero = jnp.zeros_like(stretch)
    forces = sum((each.force(stretch, rate, held.slip) for each in held.restrainers), zero)
    pressed = sum((each.force(zero, zero, held.slip) for each in held.restrainers), zero)
    if held.apparent_mass is not None:
        lengthening = lever * theta_ddot - 0.25 * stretch * theta_dot**2  # ℓ̈/R
        forces = forces + 0.5 * c.two_R / c.g * held.apparent_mass * lengthening
    weight = c.weight / (c.two_R * c.g)  # w
    return (weight * rocking + 0.5 * forces * lever / c.sin_alpha) / (weight + pressed)


def vertical_impulse(c: Coefficients, steepest: Value) -> Value:
    """C_v of (C19) over C, with `steepest` the largest |sin ψ|: what ∫|v̈_g| dt counts beside ∫|ü_g| dt."""
    spin, weight = c.spin / (0.5 * c.two_R) ** 2, c.gravity / c.p**2
    return weight * steepest / jnp.sqrt(2 * (spin + 4 * c.eta * steepest**2)) / c.impulse


def energy_after(c: Coefficients, now: Value, impulse: Value) -> Value:
    """The most that the energy can ever be again, when ∫|ü_g| dt = `impulse` is still to come.

    The ground does work at the rate −ü_g[(½+γ)u̇_b + η u̇_t] per N m_c; by Cauchy–Schwarz that is at most
    2C|ü_g|√T with C² = (1+2γ)²/(2(1+λ+4γ)) + η/2, so √E grows at most at the rate C|ü_g|. Damping and impacts
    only take. Valid while the potential cannot be negative, that is within |θ| ≤ 2α without restrainers.
    """
    return (jnp.sqrt(jnp.maximum(now, 0.0)) + c.impulse * impulse) ** 2
