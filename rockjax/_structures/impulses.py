"""Impulses in the joints at an impact, divided by the mass m_c of a column and by the impact speed.

J_T is the horizontal and J_N the vertical (axial) impulse. The impact speed is |θ̇| before the impact [rad/s].
The impulses of the mean column are the means of the impulses of all N columns. Equations with an F are in
docs/forces.md and docs/equations.md.
"""

from __future__ import annotations

from typing import NamedTuple

from rockjax._types import Number

LARGEST_ECCENTRICITY = 1 + 1e-9  # largest ξ_J of impacts between rigid faces, 1, with rounding errors [–]


class Impulses(NamedTuple):
    """Impulses of the mean column if θ > 0 (σ = +1) before the impact, divided by m_c and the impact speed,
    (F12) [m].

    - `horizontal`, `axial`: J_T and J_N at the bottom and the top joint
    - `sway`, `rise`: changes Δu̇_b and Δv̇_b of the velocity of the beam, divided by the impact speed
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

    - `gamma`, `eta`: mass that moves with the beam, and vibrating mass, divided by N m_c [–]
    - `inertances`: inertances μ_b and μ_t that act on the bottom and the top joint, divided by m_c [–]
    - `two_R`: 2R [m]; `e`: velocity factor of the impact, ≥ 0 [–]
    """
    mu_bottom, mu_top = inertances
    sway, rise = two_R * cos_alpha * (1 - e), two_R * sin_alpha * (1 + e)
    top = (gamma + eta + mu_top) * rise
    bottom = top + (0.5 + mu_bottom - mu_top) * rise
    return Impulses(((gamma + 0.5) * sway, gamma * sway), (bottom, top), sway, rise)


def impulse_eccentricity(
    sin2: Number, gamma: Number, eta: Number, lam: Number, mu: Number, e: Number
) -> Number:
    """Return ξ_J, the distance of the resultant of the impulses from the centre line of a column, divided by
    half the width of the column, (F13) [–].

    - `sin2`: sin²α; `gamma`, `eta`, `e`: as for `impulses`
    - `lam`, `mu`: inertia factor λ of a column, and sum μ of its inertances divided by m_c [–]
    """
    numerator = (1 - e) * (lam + (1 + 4 * gamma) * (1 - sin2))
    return numerator / ((1 + e) * sin2 * (1 + 4 * gamma + 4 * eta + 4 * mu))
