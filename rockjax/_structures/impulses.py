"""Impulses in the joints at an impact, divided by the mass of a column and the impact speed.

Equations with an F are in docs/forces.md and docs/equations.md. The impulses of the mean column are the means
of the impulses of all columns.
"""

from __future__ import annotations

from typing import NamedTuple

from rockjax._types import Number


class Impulses(NamedTuple):
    """Impulses of the mean column for θ > 0 (σ = +1) before the impact, divided by m_c and by the speed |θ̇|
    before the impact, (F12) [m].

    - `horizontal`, `axial`: J_T and J_N at the bottom and the top joint
    - `sway`, `rise`: changes Δu̇_b and Δv̇_b of the velocity of the beam, divided by |θ̇|
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

    - `two_R`: 2R [m]; `sin_alpha`, `cos_alpha`: sine and cosine of the slenderness α
    - `gamma`, `eta`: mass that moves with the beam, and vibrating mass, divided by N m_c [–]
    - `inertances`: μ_b and μ_t of the inerters that act on the bottom and the top joint [–]
    - `e`: velocity factor of the impact, ≥ 0 [–]
    """
    mu_bottom, mu_top = inertances
    sway, rise = two_R * cos_alpha * (1 - e), two_R * sin_alpha * (1 + e)
    top = (gamma + eta + mu_top) * rise
    bottom = top + (0.5 + mu_bottom - mu_top) * rise
    return Impulses(((gamma + 0.5) * sway, gamma * sway), (bottom, top), sway, rise)


def impulse_eccentricity(
    sin2: Number, gamma: Number, eta: Number, lam: Number, mu: Number, e: Number
) -> Number:
    """Return ξ_J, the position of the resultant of the impulses divided by half the width of a column, (F13).

    - `sin2`: sin²α
    - `gamma`, `eta`: mass that moves with the beam, and vibrating mass, divided by N m_c [–]
    - `lam`, `mu`: inertia factor λ of a column, and μ of all inerters [–]
    - `e`: velocity factor of the impact, ≥ 0 [–]
    """
    numerator = (1 - e) * (lam + (1 + 4 * gamma) * (1 - sin2))
    return numerator / ((1 + e) * sin2 * (1 + 4 * gamma + 4 * eta + 4 * mu))
