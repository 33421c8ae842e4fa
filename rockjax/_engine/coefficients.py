"""What the equations need of a podium, worked out once per scene."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from rockjax._restrainers.base import AbstractRestrainer
from rockjax._restrainers.together import apparent_mass, stiffness
from rockjax._structures import Elastic, Podium
from rockjax._types import Value, Vector


class Mode(NamedTuple):
    """What the equations need of one mode."""

    eta: Value
    coupling: Value
    demand: Value
    omega2: Value
    damping: Value


class Coefficients(NamedTuple):
    """What the equations need of a podium, computed once per scene. Numbers per N m_c where they carry
    mass."""

    alpha: Value
    sin_alpha: Value
    cos_alpha: Value
    p: Value
    restitution: Value  # e of Eq. (27) or its alternatives
    uplift: Value  # q_up, Eq. (9)
    two_R: Value
    inertia: Value  # 3γ + ¾(1+λ), Eq. (24)
    centrifugal: Value  # 3η
    gravity: Value  # p² (2η+2γ+1)
    ground: Value  # p² (2γ+1)/g
    weight: Value  # 2Rg (η+γ+½), Eq. (19)
    spin: Value  # (1+λ+4γ) R², Eq. (18)
    impulse: Value  # C of the energy bound, see `energy_after`
    g: Value
    eta: Value
    # None, and never looked at, where nothing is elastic; else for each mode:
    coupling: Vector  # 3η_i/(2R)
    demand: Vector  # 2η_i/(1+2γ), Eq. (9), (C10)
    omega2: Vector  # ω_i²
    damping: Vector  # 2ζ_iω_i
    uplifted_frequency: Value  # Eq. (31), the largest of (C15)
    # Likewise where nothing restrains:
    restrainers: tuple[AbstractRestrainer, ...]
    slip: Value  # rate of the elongation over Rp below which forces without a slope are rounded
    well: Value  # θ_w: |θ| at the top of the potential well
    apparent_mass: Value  # μ, None where there is no inerter
    restrained_frequency: Value  # of rocking against the stiffness of tendons alone, None where there is none
    # Likewise where the ground moves horizontally alone:
    tilt: Value  # K = tan α (1+2γ+2η)/(1+2γ), (C10)
    # Likewise with less than two modes, of all mass in one:
    etas: Vector | None = None  # η_i
    shares: Vector | None = None  # η_i over the mass of the superstructure
    # Likewise where no mode is left out:
    residual: Value | None = None  # η_r, a part of γ
    # Likewise where there are no floors:
    floors: tuple[Vector, ...] | None = None  # Γ_iφ_ji

    @property
    def elastic(self) -> bool:
        return self.omega2 is not None

    @property
    def modes(self) -> tuple[Mode, ...]:
        """One after the other, as the degrees of freedom after the rotation."""
        if not self.elastic:
            return ()
        etas = (self.eta,) if self.etas is None else self.etas
        return tuple(map(Mode, etas, self.coupling, self.demand, self.omega2, self.damping))

    @property
    def steep(self) -> bool:
        """Whether a force has no slope where θ̇ = 0."""
        return any(each.steep for each in self.restrainers)


SLIP = 1e-8  # the tolerance that forces without a slope are rounded for, unless it is said
ROUNDED = 10.0  # times the tolerance, over pα: the rate of rotation below which they are


def coefficients(podium: Podium, slip: Value | float = SLIP, vertical: bool = False) -> Coefficients:
    """The constants of Eqs. (9), (19), (22), (24), (27) for one podium (scalars; batches go through `vmap`).

    `slip` is the tolerance; ten times it is the rate |θ̇|/(pα) below which dampers with ν < 1 are rounded.
    `vertical` says whether the ground moves vertically as well.
    """
    podium = podium.resolved()
    modes = () if podium.superstructure is None else podium.superstructure.oscillators
    gamma, moving = podium.apart
    lam, R, g, p = podium.lam, podium.R, podium.g, podium.p
    spin = 1 + lam + 4 * gamma
    absent: Any = None
    return Coefficients(
        alpha=podium.alpha,
        sin_alpha=jnp.sin(podium.alpha),
        cos_alpha=jnp.cos(podium.alpha),
        p=p,
        restitution=podium.restitution_factor,
        # Touching it is not uplift, and rounding may not decide about it.
        uplift=podium.uplift_acceleration * (1 + 64 * jnp.finfo(R.dtype).eps),
        two_R=2 * R,
        inertia=3 * gamma + 0.75 * (1 + lam),
        centrifugal=3 * moving,
        gravity=p**2 * (2 * moving + 2 * gamma + 1),
        ground=p**2 * (2 * gamma + 1) / g,
        weight=2 * R * g * (moving + gamma + 0.5),
        spin=spin * R**2,
        impulse=jnp.sqrt((1 + 2 * gamma) ** 2 / (2 * spin) + moving / 2),
        g=g,
        eta=moving,
        coupling=tuple(1.5 * mode.eta / R for mode in modes) or absent,
        demand=tuple(2 * mode.eta / (1 + 2 * gamma) for mode in modes) or absent,
        omega2=tuple(mode.omega_s**2 for mode in modes) or absent,
        damping=tuple(2 * mode.zeta * mode.omega_s for mode in modes) or absent,
        uplifted_frequency=_uplifted_frequency(podium) if modes else absent,
        **_of_restrainers(podium, slip),
        tilt=jnp.tan(podium.alpha) * (1 + 2 * (gamma + moving)) / (1 + 2 * gamma) if vertical else absent,
        **_of_modes(podium),
    )


def _uplifted_frequency(podium: Podium) -> Value:
    """Of several modes without derivatives: it is for the lengths of steps."""
    one = isinstance(podium.superstructure, Elastic)
    return (podium if one else jax.lax.stop_gradient(podium)).uplifted_frequency


def _of_modes(podium: Podium) -> dict[str, Any]:
    """The constants of several modes, of what they leave out and of floors; nothing where there are none."""
    top = podium.superstructure
    if top is None or not top.several:
        return {}
    etas, whole = tuple(mode.eta for mode in top.oscillators), podium.eta
    alone = len(etas) == 1
    # Of no mass at all, the mean of the modes.
    weighs = whole > 0
    shares = tuple(jnp.where(weighs, eta, 1 / len(etas)) / jnp.where(weighs, whole, 1.0) for eta in etas)
    return {
        "etas": None if alone else etas,
        "shares": None if alone and top.carried is None else shares,
        "residual": top.carried,
        "floors": top.floors,
    }


def _of_restrainers(podium: Podium, slip: Value | float) -> dict[str, Any]:
    """The constants of the restrainers; nothing where there are none."""
    restrainers = podium.restrainers
    names = ("slip", "well", "apparent_mass", "restrained_frequency")
    if not restrainers:
        return {"restrainers": ()} | dict.fromkeys(names)
    sin_alpha, kappa = jnp.sin(podium.alpha), stiffness(restrainers)
    gamma, _ = podium.apart
    k = None if kappa is None else 4 * kappa * sin_alpha**2 / (3 * gamma + 0.75 * (1 + podium.lam))
    return {
        "restrainers": restrainers,
        "slip": jax.lax.stop_gradient(2 * sin_alpha * ROUNDED * slip * podium.alpha),
        "well": jax.lax.stop_gradient(jnp.minimum(podium.stability_angle, 0.5 * math.pi)),
        "apparent_mass": apparent_mass(restrainers),
        "restrained_frequency": None if k is None else jax.lax.stop_gradient(podium.p * jnp.sqrt(k)),
    }
