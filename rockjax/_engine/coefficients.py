"""What the equations need of a podium, worked out once per scene."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from rockjax._restrainers.base import AbstractRestrainer
from rockjax._restrainers.together import apparent_mass, stiffness
from rockjax._structures import Elastic, Podium
from rockjax._types import Value


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
    # None, and never looked at, where nothing is elastic:
    coupling: Value  # 3η/(2R)
    demand: Value  # 2η/(1+2γ), Eq. (9)
    omega2: Value  # ω_s²
    damping: Value  # 2ζω_s
    uplifted_frequency: Value  # Eq. (31)
    # Likewise where nothing restrains:
    restrainers: tuple[AbstractRestrainer, ...]
    slip: Value  # rate of the elongation over Rp below which forces without a slope are rounded
    well: Value  # θ_w: |θ| at the top of the potential well
    apparent_mass: Value  # μ, None where there is no inerter
    restrained_frequency: Value  # of rocking against the stiffness of tendons alone, None where there is none
    # Likewise where the ground moves horizontally alone:
    tilt: Value  # K = tan α (1+2γ+2η)/(1+2γ), (C10)

    @property
    def elastic(self) -> bool:
        return self.omega2 is not None

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
    elastic = podium.superstructure if isinstance(podium.superstructure, Elastic) else None
    eta = podium.eta
    gamma = podium.gamma if elastic else podium.gamma + eta  # a rigid superstructure is part of the beam
    moving = eta if elastic else jnp.zeros_like(eta)
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
        coupling=1.5 * eta / R if elastic else absent,
        demand=2 * eta / (1 + 2 * gamma) if elastic else absent,
        omega2=elastic.omega_s**2 if elastic else absent,
        damping=2 * elastic.zeta * elastic.omega_s if elastic else absent,
        uplifted_frequency=podium.uplifted_frequency if elastic else absent,
        **_of_restrainers(podium, slip),
        tilt=jnp.tan(podium.alpha) * (1 + 2 * (gamma + moving)) / (1 + 2 * gamma) if vertical else absent,
    )


def _of_restrainers(podium: Podium, slip: Value | float) -> dict[str, Any]:
    """The constants of the restrainers; nothing where there are none."""
    restrainers = podium.restrainers
    names = ("slip", "well", "apparent_mass", "restrained_frequency")
    if not restrainers:
        return {"restrainers": ()} | dict.fromkeys(names)
    sin_alpha, kappa = jnp.sin(podium.alpha), stiffness(restrainers)
    gamma = podium.gamma if isinstance(podium.superstructure, Elastic) else podium.gamma + podium.eta
    k = None if kappa is None else 4 * kappa * sin_alpha**2 / (3 * gamma + 0.75 * (1 + podium.lam))
    return {
        "restrainers": restrainers,
        "slip": jax.lax.stop_gradient(2 * sin_alpha * ROUNDED * slip * podium.alpha),
        "well": jax.lax.stop_gradient(jnp.minimum(podium.stability_angle, 0.5 * math.pi)),
        "apparent_mass": apparent_mass(restrainers),
        "restrained_frequency": None if k is None else jax.lax.stop_gradient(podium.p * jnp.sqrt(k)),
    }
