"""Combined effect of all restrainers of a podium.

Equations with a C are in docs/control.md and docs/equations.md.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from rockjax._checks import format_value
from rockjax._roots import newton
from rockjax._types import Number

from . import KINDS
from .base import AbstractRestrainer

NEWTON_STEPS = 40  # number of steps in the search for the stability angle, more than needed


def as_restrainers(value) -> tuple[AbstractRestrainer, ...]:
    """Convert the argument `Podium.restrainers` to a tuple. Raises `ValueError` unless it is a tuple or list
    of restrainers."""
    accepted = f"Podium: restrainers must be a tuple of {', '.join(KINDS)}, such as (Tendon(0.5),), got"
    if not isinstance(value, tuple | list):
        raise ValueError(f"{accepted} {format_value(value)}")
    for element in value:
        if not isinstance(element, AbstractRestrainer):
            raise ValueError(f"{accepted} a tuple with the element {format_value(element)}")
    return tuple(value)


def devices_by_joints(
    restrainers: Sequence[AbstractRestrainer],
) -> tuple[list[AbstractRestrainer], list[AbstractRestrainer]]:
    """Return two lists: the devices that span both joints of a column, and those that span only the bottom
    joint."""
    return [y for y in restrainers if y.joints == 2], [y for y in restrainers if y.joints == 1]


def prestress(restrainers: Sequence[AbstractRestrainer], like: Number) -> Number:
    """Return τ, the sum of all static forces at uplift divided by m_c g, with the shape and type of
    `like`."""
    zero = jnp.zeros_like(like)
    return zero + sum(device.static_force(zero) for device in restrainers if device.has_static_force)


def apparent_mass(restrainers: Sequence[AbstractRestrainer]) -> Number | None:
    """Return μ, the sum of all inertances divided by m_c; None if no device has an inertance."""
    return _sum([device.apparent_mass for device in restrainers])


def stiffness(restrainers: Sequence[AbstractRestrainer]) -> Number | None:
    """Return κ, the sum of all stiffnesses K R/(m_c g); None if no device has a stiffness."""
    return _sum([device.equivalent_stiffness for device in restrainers])


def _sum(terms: Sequence[Number | None]) -> Number | None:
    present = [term for term in terms if term is not None]
    return sum(present[1:], present[0]) if present else None


def stability_angle(alpha: Number, weight: Number, restrainers: Sequence[AbstractRestrainer]) -> Number:
    """Return θ_s of (C7) [rad], the smallest |θ| in (0, π/2] at which gravity and restrainers together no
    longer turn the column back; inf if they always do. `weight` is w = γ+η+½, with the mass ratios γ of the
    beam and η of the superstructure [–].

    Up to α, both gravity and restrainers turn the column back, so θ_s ≥ α. Between α and π/2, the restoring
    moment V' of (C5) decreases through zero at most once.
    """
    with_static_force = [device for device in restrainers if device.has_static_force]
    if not with_static_force:
        return alpha
    return _find_stability_angle(alpha, weight, with_static_force)


@jax.jit
def _find_stability_angle(
    alpha: Number, weight: Number, with_static_force: Sequence[AbstractRestrainer]
) -> Number:
    def moment(angle):
        """Return the restoring moment at an angle, divided by N m_c g R, V'/(Rg) of (C5)."""
        lever, stretch = 2 * jnp.sin(alpha) * jnp.cos(0.5 * angle), 4 * jnp.sin(alpha) * jnp.sin(0.5 * angle)
        return 2 * weight * jnp.sin(alpha - angle) + lever * sum(
            device.static_force(stretch) for device in with_static_force
        )

    right_angle = jnp.full_like(moment(alpha), math.pi / 2)
    lower_end = jnp.broadcast_to(alpha, right_angle.shape)
    root = jax.lax.stop_gradient(newton(moment, lower_end, right_angle, NEWTON_STEPS)[2])
    # One more Newton step gives the derivative, by the implicit function theorem.
    value, slope = jax.jvp(moment, (root,), (jnp.ones_like(root),))
    root = root - value / jnp.where(slope < 0, slope, -1.0)
    # A moment at π/2 that is zero up to rounding counts as a root.
    has_root = moment(right_angle) <= 8 * np.finfo(np.asarray(0.0).dtype).eps * weight
    return jnp.where(has_root, jnp.minimum(root, right_angle), jnp.inf)
