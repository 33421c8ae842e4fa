"""What the restrainers of a podium do together."""

from __future__ import annotations

import math
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from rockjax._checks import shown
from rockjax._types import Number

from . import KINDS
from .base import AbstractRestrainer

ROUNDS = 40  # of the search for the stability angle: more than it takes, with bisection as its safeguard


def as_restrainers(value) -> tuple[AbstractRestrainer, ...]:
    """The converter of `Podium.restrainers`."""
    if value is None or isinstance(value, AbstractRestrainer) or not isinstance(value, tuple | list):
        raise ValueError(f"Podium: restrainers must be a tuple of {', '.join(KINDS)}, got {shown(value)}")
    return tuple(value)


def check_restrainers(value: tuple) -> None:
    """Raise `ValueError` for what is no restrainer."""
    for each in value:
        if not isinstance(each, AbstractRestrainer):
            raise ValueError(
                f"Podium: restrainers must be a tuple of {', '.join(KINDS)}, got one that is {shown(each)}"
            )


def prestress(restrainers: Sequence[AbstractRestrainer], like: Number) -> Number:
    """τ: all forces at uplift, over m_c g."""
    zero = jnp.zeros_like(like)
    return zero + sum(each.static_force(zero) for each in restrainers if each.stores)


def apparent_mass(restrainers: Sequence[AbstractRestrainer]) -> Number | None:
    """μ: all inertances over m_c; None where there is none, known before tracing."""
    return _sum([each.apparent_mass for each in restrainers])


def stiffness(restrainers: Sequence[AbstractRestrainer]) -> Number | None:
    """κ: all stiffnesses, K R/(m_c g); None where there is none, known before tracing."""
    return _sum([each.slope for each in restrainers])


def _sum(terms: Sequence[Number | None]) -> Number | None:
    present = [term for term in terms if term is not None]
    return sum(present[1:], present[0]) if present else None


def stability_angle(alpha: Number, weight: Number, restrainers: Sequence[AbstractRestrainer]) -> Number:
    """θ_s of (C7): the smallest |θ| in (0, π/2] where gravity and restrainers hold nothing any more; inf if
    there is none.

    `weight` is w = γ+η+½. Up to α both hold, so that the search is between α and π/2: there V' of (C5) falls
    through zero once at most.
    """
    holding = [each for each in restrainers if each.stores]
    if not holding:
        return alpha
    return _search(alpha, weight, holding)


@jax.jit
def _search(alpha: Number, weight: Number, holding: Sequence[AbstractRestrainer]) -> Number:
    def moment(angle):
        """V'(A)/(Rg)."""
        lever, stretch = 2 * jnp.sin(alpha) * jnp.cos(0.5 * angle), 4 * jnp.sin(alpha) * jnp.sin(0.5 * angle)
        return 2 * weight * jnp.sin(alpha - angle) + lever * sum(
            each.static_force(stretch) for each in holding
        )

    def newton(angle):
        value, slope = jax.jvp(moment, (angle,), (jnp.ones_like(angle),))
        return value, angle - value / jnp.where(slope < 0, slope, -1.0)

    def closer(_, bracket):
        low, high, angle = bracket
        value, onward = newton(angle)
        low, high = jnp.where(value > 0, angle, low), jnp.where(value > 0, high, angle)
        inside = (onward > low) & (onward < high)
        return low, high, jnp.where(inside, onward, 0.5 * (low + high))

    top = jnp.full_like(moment(alpha), math.pi / 2)
    low = jnp.broadcast_to(alpha, top.shape)
    found = jax.lax.fori_loop(0, ROUNDS, closer, (low, top, 0.5 * (low + top)))[2]
    # One more step carries the derivative, by the implicit function theorem.
    found = newton(jax.lax.stop_gradient(found))[1]
    falls = moment(top) <= 8 * np.finfo(np.asarray(0.0).dtype).eps * weight
    return jnp.where(falls, jnp.minimum(found, top), jnp.inf)
