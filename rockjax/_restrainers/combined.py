"""Combined effect of all restrainers of a podium."""

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

ROUNDS = 40  # iterations of the search for the stability angle: more than needed; bisection safeguards them


def as_restrainers(value) -> tuple[AbstractRestrainer, ...]:
    """Convert the argument `Podium.restrainers` to a tuple."""
    if value is None or isinstance(value, AbstractRestrainer) or not isinstance(value, tuple | list):
        raise ValueError(
            f"Podium: restrainers must be a tuple of {', '.join(KINDS)}, got {format_value(value)}"
        )
    return tuple(value)


def check_restrainers(value: tuple) -> None:
    """Raise `ValueError` for members that are not restrainers."""
    for each in value:
        if not isinstance(each, AbstractRestrainer):
            raise ValueError(
                f"Podium: restrainers must be a tuple of {', '.join(KINDS)}, got one that is "
                f"{format_value(each)}"
            )


def devices_by_joints(
    restrainers: Sequence[AbstractRestrainer],
) -> tuple[list[AbstractRestrainer], list[AbstractRestrainer]]:
    """Return the devices over both joints of a column, and those over its bottom joint alone."""
    return [y for y in restrainers if y.joints == 2], [y for y in restrainers if y.joints == 1]


def prestress(restrainers: Sequence[AbstractRestrainer], like: Number) -> Number:
    """Return τ, the sum of all forces at uplift over m_c g."""
    zero = jnp.zeros_like(like)
    return zero + sum(each.static_force(zero) for each in restrainers if each.stores)


def apparent_mass(restrainers: Sequence[AbstractRestrainer]) -> Number | None:
    """Return μ, the sum of all inertances over m_c; None if there are none, known before tracing."""
    return _sum([each.apparent_mass for each in restrainers])


def stiffness(restrainers: Sequence[AbstractRestrainer]) -> Number | None:
    """Return κ, the sum of all stiffnesses K R/(m_c g); None if there are none, known before tracing."""
    return _sum([each.slope for each in restrainers])


def _sum(terms: Sequence[Number | None]) -> Number | None:
    present = [term for term in terms if term is not None]
    return sum(present[1:], present[0]) if present else None


def stability_angle(alpha: Number, weight: Number, restrainers: Sequence[AbstractRestrainer]) -> Number:
    """Return θ_s of (C7), the smallest |θ| in (0, π/2] at which gravity and restrainers no longer restore;
    inf if there is none.

    `weight` is w = γ+η+½. Up to α both restore, so the root lies between α and π/2, where V' of (C5) falls
    through zero at most once.
    """
    with_static_force = [each for each in restrainers if each.stores]
    if not with_static_force:
        return alpha
    return _find_stability_angle(alpha, weight, with_static_force)


@jax.jit
def _find_stability_angle(
    alpha: Number, weight: Number, with_static_force: Sequence[AbstractRestrainer]
) -> Number:
    def moment(angle):
        """Return V'(A)/(Rg)."""
        lever, stretch = 2 * jnp.sin(alpha) * jnp.cos(0.5 * angle), 4 * jnp.sin(alpha) * jnp.sin(0.5 * angle)
        return 2 * weight * jnp.sin(alpha - angle) + lever * sum(
            each.static_force(stretch) for each in with_static_force
        )

    top = jnp.full_like(moment(alpha), math.pi / 2)
    found = jax.lax.stop_gradient(newton(moment, jnp.broadcast_to(alpha, top.shape), top, ROUNDS)[2])
    # One more step carries the derivative, by the implicit function theorem.
    value, slope = jax.jvp(moment, (found,), (jnp.ones_like(found),))
    found = found - value / jnp.where(slope < 0, slope, -1.0)
    falls = moment(top) <= 8 * np.finfo(np.asarray(0.0).dtype).eps * weight
    return jnp.where(falls, jnp.minimum(found, top), jnp.inf)
