"""Constants of the equations of a podium, computed once per scene (one podium under one excitation).

Equations without a letter are those of docs/model.md. (C10) is in docs/control.md, (F12) in docs/forces.md,
and the other lettered ones are in docs/equations.md.
"""

from __future__ import annotations

import math
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp

from rockjax._programs.barrier import barrier
from rockjax._restrainers.base import AbstractRestrainer
from rockjax._restrainers.combined import apparent_mass, stiffness
from rockjax._structures import Podium
from rockjax._structures.elevation import Arms
from rockjax._structures.impulses import Impulses, impulse_eccentricity, impulses
from rockjax._structures.superstructures import Oscillators
from rockjax._types import Value, Values

T = TypeVar("T")


class ModalConstants(NamedTuple):
    """Constants of a superstructure with several vibration modes, a residual mass or floors. The residual
    mass belongs to no mode and moves with the beam. Mass ratios are masses divided by the mass N m_c of all
    columns."""

    eta: Values  # mass ratios η_i of the modes
    # η_i divided by the mass ratio of the whole superstructure; equal shares if the superstructure has no
    # mass.
    shares: Values
    residual: Value | None  # mass ratio η_r of the residual mass, a part of γ; None without residual mass
    # Γ_iφ_ji, participation factor Γ_i of mode i times its shape φ_ji at floor j, shape (floors, modes) [–];
    # None without floors.
    floors: Values | None


class Vibration(NamedTuple):
    """Constants of the vibrating superstructure: scalars for one mode, arrays for several."""

    coupling: Values  # 3η_i/(2R), Eq. (24) [1/m]
    demand: Values  # factor of the spring forces in the uplift demand, 2η_i/(1+2γ), Eq. (9)
    omega2: Values  # ω_i² [rad²/s²]
    damping: Values  # 2ζ_iω_i [rad/s]
    # Highest frequency of the superstructure on lifted columns, Eq. (31) or (C15) [rad/s].
    uplifted_frequency: Value
    modal: ModalConstants | None  # None for a single mode that is the whole superstructure


class Restraint(NamedTuple):
    """Constants of the restrainers (tendons, dampers, inerters)."""

    restrainers: tuple[AbstractRestrainer, ...]
    slip: Value  # |elongation rate|/(Rp) below which forces whose slope is infinite at rate 0 are smoothed
    # θ_w, at most π/2 [rad]: as long as |θ| < θ_w, gravity and restrainers pull the columns back.
    well: Value
    apparent_mass: Value | None  # inertance divided by m_c, μ [–]; None without inerters
    # Frequency of rocking on the stiffness of tendons alone, without gravity [rad/s]; None without tendons.
    restrained_frequency: Value | None

    @property
    def steep(self) -> bool:
        """True if a restrainer's force, as a function of θ̇, has an infinite slope at θ̇ = 0."""
        return any(restrainer.steep for restrainer in self.restrainers)


class Joints(NamedTuple):
    """Constants of the joint forces.

    - `gamma`: mass ratio γ of the beam and everything that moves with it; `lam`: inertia factor λ of a column
    - `dead_load`: axial force at rest, averaged over the columns and divided by m_c g, at the bottom and the
      top joint, shape (2,) [–]
    - `impulses`: impulses of an impact divided by m_c and by the impact speed |θ̇⁻|, (F12) [m]
    - `impulse_eccentricity`: eccentricity of the impulses divided by half the width of a column, ξ_J, (F13)
      [–]
    - `arms`: positions of the columns, and mass ratios times heights; None if the podium has no elevation
    """

    gamma: Value
    lam: Value
    dead_load: Values
    impulses: Impulses
    impulse_eccentricity: Value
    arms: Arms | None


class Coefficients(NamedTuple):
    """Constants of a podium's equations, which are divided by the mass N m_c of all columns. None stands for
    parts that the podium does not have."""

    alpha: Value  # slenderness α [rad]
    sin_alpha: Value
    cos_alpha: Value
    p: Value  # frequency parameter [rad/s]
    restitution: Value  # restitution factor e, Eq. (27) or another law
    uplift: Value  # uplift threshold q_up, Eq. (9) [m/s²]
    two_R: Value  # 2R [m]
    inertia: Value  # 3γ + ¾(1+λ), Eq. (24) [–]
    centrifugal: Value  # 3η, Eq. (24) [–]
    gravity: Value  # p² (2η+2γ+1), Eq. (24) [1/s²]
    ground: Value  # p² (2γ+1)/g, Eq. (24) [1/m]
    weight: Value  # 2Rg (η+γ+½), Eq. (19) [m²/s²]
    spin: Value  # (1+λ+4γ) R², Eq. (18) [m²]
    impulse_factor: Value  # C of the energy bound, see `energy_after` in energy.py [–]
    g: Value  # acceleration of gravity [m/s²]
    eta: Value  # η, mass ratio of the vibrating mass
    vibration: Vibration | None
    restraint: Restraint | None
    # tan α (1+2γ+2η)/(1+2γ), the factor of the vertical ground acceleration v̈_g in the uplift threshold,
    # (C10) [–]; None without v̈_g.
    uplift_slope: Value | None
    joints: Joints | None  # None unless joint forces are requested

    @property
    def modal(self) -> ModalConstants | None:
        return None if self.vibration is None else self.vibration.modal

    @property
    def etas(self) -> Values:
        """Mass ratios η_i of the modes."""
        return self.eta if self.modal is None else self.modal.eta


def divided_by_inertia(c: Coefficients) -> Coefficients:
    """Return constants for use in `acceleration` only. If nothing vibrates and there are no restrainers, the
    inertia is constant; then `gravity` and `ground` are divided by it, which saves a division in each stage
    of a step. Otherwise the constants stay as they are."""
    if c.vibration is not None or c.restraint is not None:
        return c
    gravity, ground = barrier((c.gravity / c.inertia, c.ground / c.inertia))
    return c._replace(gravity=gravity, ground=ground, inertia=1.0)


def not_none(value: T | None) -> T:
    """Return the value, for the type checker: its type allows None, but it is never None."""
    assert value is not None
    return value


def summed(values: Values) -> Value:
    """Return the sum over the modes. The scalar of a single mode stays as it is."""
    return jnp.sum(values, axis=-1) if jnp.ndim(values) else values


def weighted(weights: Values, values: Values) -> Value:
    """Return Σ w_i y_i over the modes i, with the weights w_i and the values y_i."""
    return summed(weights * values)


SLIP = 1e-8  # default of the argument `slip` of `coefficients`
SMOOTHED_BELOW = 10.0  # steep forces are smoothed where |θ̇|/(pα) is below this multiple of `slip`


def coefficients(
    podium: Podium, slip: Value | float = SLIP, vertical: bool = False, joints: bool = False
) -> Coefficients:
    """Return the constants of Eqs. (9), (19), (22), (24), (27) for one podium; use `vmap` for batches.

    - `podium`: the podium, with scalar parameters
    - `slip`: tolerance of the smoothing [–]. Forces of restrainers whose slope is infinite at θ̇ = 0, such as
      those of dampers with an exponent ν < 1, are smoothed where |θ̇|/(pα) < 10 `slip`
    - `vertical`: whether the ground moves vertically as well
    - `joints`: whether joint forces are requested
    """
    podium = podium.resolved()
    gamma, vibrating = podium.mass_ratios
    lam, R, g, p = podium.lam, podium.R, podium.g, podium.p
    spin = 1 + lam + 4 * gamma
    return Coefficients(
        alpha=podium.alpha,
        sin_alpha=jnp.sin(podium.alpha),
        cos_alpha=jnp.cos(podium.alpha),
        p=p,
        restitution=podium.restitution_factor,
        # A demand equal to the threshold causes no uplift. The factor, slightly above 1, prevents uplift due
        # to rounding.
        uplift=podium.uplift_acceleration * (1 + 64 * jnp.finfo(R.dtype).eps),
        two_R=2 * R,
        inertia=3 * gamma + 0.75 * (1 + lam),
        centrifugal=3 * vibrating,
        gravity=p**2 * (2 * vibrating + 2 * gamma + 1),
        ground=p**2 * (2 * gamma + 1) / g,
        weight=2 * R * g * (vibrating + gamma + 0.5),
        spin=spin * R**2,
        impulse_factor=jnp.sqrt((1 + 2 * gamma) ** 2 / (2 * spin) + vibrating / 2),
        g=g,
        eta=vibrating,
        vibration=_vibration(podium),
        restraint=_restraint(podium, slip),
        uplift_slope=jnp.tan(podium.alpha) * (1 + 2 * (gamma + vibrating)) / (1 + 2 * gamma)
        if vertical
        else None,
        joints=_joints(podium) if joints else None,
    )


def _joints(podium: Podium) -> Joints:
    gamma, eta = podium.mass_ratios
    bottom, top = podium.inertances
    arms = podium.elevation
    assert arms is None or isinstance(arms, Arms)
    sin, cos = jnp.sin(podium.alpha), jnp.cos(podium.alpha)
    e = jnp.maximum(podium.restitution_factor, 0.0)
    impulses_per_speed = impulses(2 * podium.R, sin, cos, gamma, eta, (bottom, top), e)
    # Let μ_2 be the inertance of inerters across both joints. Let inerters in the bottom joint only be
    # equivalent to an inertance μ_1 across both joints. The inertances at the bottom and the top joint are
    # then μ_2 + 2μ_1 and μ_2. The eccentricity needs their mean, μ_2 + μ_1.
    eccentricity = impulse_eccentricity(sin**2, gamma, eta, podium.lam, 0.5 * (bottom + top), e)
    return Joints(gamma, podium.lam, podium.dead_load, impulses_per_speed, eccentricity, arms)


def _vibration(podium: Podium) -> Vibration | None:
    modes = None if podium.superstructure is None else podium.superstructure.oscillators
    if modes is None:
        return None
    gamma, _ = podium.mass_ratios
    return Vibration(
        coupling=1.5 * modes.eta / podium.R,
        demand=2 * modes.eta / (1 + 2 * gamma),
        omega2=modes.omega_s**2,
        damping=2 * modes.zeta * modes.omega_s,
        uplifted_frequency=podium.fastest_frequency(),
        modal=_modal(modes) if isinstance(modes, Oscillators) else None,
    )


def _modal(modes: Oscillators) -> ModalConstants:
    mass = modes.mass_ratio
    # If the superstructure has no mass, all modes have the same share.
    has_mass = mass > 0
    shares = jnp.where(has_mass, modes.eta, 1 / modes.count) / jnp.where(has_mass, mass, 1.0)
    return ModalConstants(modes.eta, shares, modes.residual, modes.shapes)


def _restraint(podium: Podium, slip: Value | float) -> Restraint | None:
    restrainers = podium.restrainers
    if not restrainers:
        return None
    sin_alpha, kappa = jnp.sin(podium.alpha), stiffness(restrainers)
    gamma, _ = podium.mass_ratios
    k = None if kappa is None else 4 * kappa * sin_alpha**2 / (3 * gamma + 0.75 * (1 + podium.lam))
    return Restraint(
        restrainers=restrainers,
        slip=jax.lax.stop_gradient(2 * sin_alpha * SMOOTHED_BELOW * slip * podium.alpha),
        well=jax.lax.stop_gradient(jnp.minimum(podium.stability_angle, 0.5 * math.pi)),
        apparent_mass=apparent_mass(restrainers),
        restrained_frequency=None if k is None else jax.lax.stop_gradient(podium.p * jnp.sqrt(k)),
    )
