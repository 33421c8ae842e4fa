"""Impulses in the joints at an impact, as ratios that do not depend on its speed."""

from __future__ import annotations

from typing import NamedTuple

from rockjax._types import Number


class Impulses(NamedTuple):
    """Impulses of the mean column over m_c and the speed Ω = |θ̇| before the impact [m], for a column that
    rocks to the side σ = +1 before it; (F12).

    - `horizontal`, `axial`: J_T and J_N at the bottom and the top joint
    - `sway`, `rise`: changes Δu̇ and Δv̇ of the velocity of the beam
    """

    horizontal: tuple[Number, Number]
    axial: tuple[Number, Number]
    sway: Number
    rise: Number


def impulses(
    two_R: Number,
    sin_alpha: Number,
    cos_alpha: Number,
    gamma: Number,
    eta: Number,
    inertances: tuple[Number, Number],
    e: Number,
) -> Impulses:
    """Return the impulses in the joints of the mean column, (F12).

    - `two_R`: 2R [m]; `sin_alpha`, `cos_alpha`: of the slenderness
    - `gamma`, `eta`: mass ratios that move with the beam, and that vibrate
    - `inertances`: μ_b and μ_t of the inerters that press on the bottom and the top joint, over m_c
    - `e`: velocity factor of the impact, not negative
    """
    of_bottom, of_top = inertances
    sway, rise = two_R * cos_alpha * (1 - e), two_R * sin_alpha * (1 + e)
    top = (gamma + eta + of_top) * rise
    bottom = top + (0.5 + of_bottom - of_top) * rise
    return Impulses(((gamma + 0.5) * sway, gamma * sway), (bottom, top), sway, rise)


def impulse_eccentricity(
    sin2: Number, gamma: Number, eta: Number, lam: Number, mu: Number, e: Number
) -> Number:
    """Return ξ_J of (F13): where the resultants of the impulses act, over half the width of a column.

    - `sin2`: sin²α
    - `gamma`, `eta`, `lam`, `mu`: mass ratios, inertia factor λ, and μ of all inerters
    - `e`: velocity factor of the impact, not negative
    """
    taken = (1 - e) * (lam + (1 + 4 * gamma) * (1 - sin2))
    return taken / ((1 + e) * sin2 * (1 + 4 * gamma + 4 * eta + 4 * mu))
