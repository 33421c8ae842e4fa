"""Rocking of unanchored bodies by ASCE/SEI 43-05, in the form derived from the energy balance.

Equation (P5) is in docs/practice.md. The equivalent block (`block.py`) has the half height ĥ and the
slenderness α; θ is its rotation.
"""

from __future__ import annotations

import math

import numpy as np

from rockjax._motions.motion import Motion

from .base import AbstractMethod, Case, Outcome, Quantity, damping_obstacles
from .block import Block
from .roots import Roots, find_roots
from .spectra import spectrum


def rise(theta, tan_alpha: float):
    """Return B(θ) = cos θ + tan α sin θ − 1, the rise of the centre of mass divided by ĥ, (P5) [–].

    - `theta`: rotation > 0, a number or an array of any shape [rad]
    - `tan_alpha`: tan α [–]
    """
    return np.sin(theta) * (tan_alpha - np.tan(0.5 * theta))


def inertia_factor(tan_alpha: float) -> float:
    """Return the inertia factor C_3 = 4/3 (1+tan²α), (P5) [–]."""
    return 4 / 3 * (1 + tan_alpha**2)


def capacity(theta, tan_alpha: float):
    """Return S_a,cap/g = 2B(θ)/θ, (P5) [–].

    S_a,cap is the spectral acceleration that causes the rotation θ. The factor F_v of vertical motion is
    taken as 1.

    - `theta`: rotation > 0, a number or an array of any shape [rad]
    - `tan_alpha`: tan α [–]
    """
    return 2 * rise(theta, tan_alpha) / theta


def frequency(theta, tan_alpha: float, g_over_height: float):
    """Return the effective frequency f_e = √(2gB(θ)/(C_3θ²ĥ))/(2π), with B of `rise`, (P5) [Hz].

    - `theta`: rotation > 0, a number or an array of any shape [rad]
    - `tan_alpha`: tan α [–]
    - `g_over_height`: g/ĥ [1/s²]
    """
    squared = capacity(theta, tan_alpha) * g_over_height / (inertia_factor(tan_alpha) * theta)
    return np.sqrt(squared) / (2 * math.pi)


def damping(restitution: float) -> float:
    """Return the equivalent damping ratio β_e = G/√(4π²+G²), G = −2 ln e, (P5) [–]; inf for e ≤ 0.

    - `restitution`: velocity factor e of an impact [–]
    """
    if restitution <= 0:
        return math.inf
    decrement = -2 * math.log(restitution)
    return decrement / math.hypot(2 * math.pi, decrement)


def rotations(block: Block, motion: Motion) -> Roots:
    """Return the solutions φ = θ/α of S_a(f_e, β_e) = S_a,cap, (P5).

    S_a is the absolute spectral acceleration of the motion at the frequency f_e and the damping ratio β_e.

    - `block`: the block
    - `motion`: ground motion
    """
    beta, tan_alpha = damping(block.restitution), block.tan_alpha

    def excess(phi: np.ndarray) -> np.ndarray:
        theta = block.alpha * phi
        periods = 1 / frequency(theta, tan_alpha, block.g / block.half_height)
        return spectrum(motion, periods, beta, "acceleration") / block.g - capacity(theta, tan_alpha)

    return find_roots(excess)


class AsceRocking(AbstractMethod):
    """Best estimate of the rotation by ASCE/SEI 43-05, (P5)."""

    name = "asce_43_05_rocking"
    title = "ASCE 43-05, rocking"
    source = "ASCE/SEI 43-05, Appendix A.2, in the energy form"
    equation = "(P5)"
    formula = "S_a(f_e, β_e) = 2gB(θ)/θ, f_e = √(2gB/(C_3θ²ĥ))/2π, C_3 = 4/3 (1+tan²α), β_e of G = −2 ln e"
    quantity = "rotation θ/α"
    unit = "1"
    conservative = "depends"
    reliability = (
        "A best estimate, not a bound. Its capacity at small rotations is 2g tan α, twice the true threshold "
        "of uplift. In a survey of a million scenes of rigid blocks (November 2026) its rotation was too "
        "small in 24 %, and it missed 19 % of the overturnings."
    )
    missing = (
        "F_v (vertical motion) is taken as 1: rockjax does not implement its formula",
        "factors of safety are not applied; the rotation is the best estimate",
    )

    def obstacles(self, case: Case) -> tuple[str, ...]:
        return damping_obstacles(damping(case.block.restitution))

    def outcome(self, case: Case) -> Outcome:
        block = case.block
        roots = tuple(rotations(block, motion) for motion in case.motions)
        values = {
            "beta_e": Quantity(damping(block.restitution), "1", "β_e, equivalent damping ratio"),
            "C_3": Quantity(inertia_factor(block.tan_alpha), "1", "C_3, inertia factor"),
            "h_hat": Quantity(block.half_height, "m", "ĥ, half height of the equivalent block"),
        }
        return Outcome(1.0, np.array([y.answer for y in roots]), roots, values)
