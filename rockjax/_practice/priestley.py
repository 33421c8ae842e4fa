"""Rocking as a linear oscillator with a rotation-dependent period, by Priestley, Evison & Carr (1978).

Eqs. (P3) and (P4) are in docs/practice.md. p̂ and ĥ are the frequency parameter and the half height of the
equivalent block (`block.py`).
"""

from __future__ import annotations

import math

import numpy as np

from rockjax._motions.motion import Motion

from .base import AbstractMethod, Case, Outcome, Quantity, damping_obstacles
from .block import Block
from .roots import Roots, find_roots
from .spectra import spectrum


def period(phi: np.ndarray, p: float) -> np.ndarray:
    """Return the period of free rocking T = (4/p̂) cosh⁻¹[1/(1−φ)], (P3) [s].

    - `phi`: amplitude φ = θ/α, in [0, 1) [–]
    - `p`: frequency parameter p̂ > 0 [rad/s]
    """
    return 4 / p * np.arccosh(1 / (1 - phi))


def damping(restitution: float) -> float:
    """Return the equivalent damping ratio β = −0.34 ln e², (P3) [–]; inf for e ≤ 0.

    - `restitution`: velocity factor e of an impact [–]
    """
    return -0.68 * math.log(restitution) if restitution > 0 else math.inf


def rotations(block: Block, motion: Motion, damping_ratio: float) -> Roots:
    """Return the solutions φ of φ = S_d(T(φ), β)/(ĥα), (P3) and (P4), with the displacement spectrum S_d.

    - `block`: the block
    - `motion`: ground motion
    - `damping_ratio`: β in [0, 1) [–]
    """
    overturning_displacement = block.half_height * block.alpha  # spectral displacement at θ = α
    return find_roots(
        lambda phi: (
            spectrum(motion, period(phi, block.p), damping_ratio, "displacement") / overturning_displacement
            - phi
        )
    )


class Priestley(AbstractMethod):
    """Largest rotation from the displacement spectrum of an equivalent oscillator, (P3)."""

    name = "priestley"
    title = "Priestley et al. 1978"
    source = "Makris & Konstantinidis 2003, EESD 32:265, Eqs. (2), (9)–(11)"
    equation = "(P3)"
    formula = "φ = S_d(T, β)/(ĥ α), T = (4/p̂) cosh⁻¹[1/(1−φ)], β = −0.34 ln e²"
    quantity = "rotation θ/α"
    unit = "1"
    conservative = "no"
    reliability = (
        'Not reliable either way: "fundamentally flawed and should be abandoned" (Makris & Konstantinidis '
        "2003). In a survey of a million scenes of rigid blocks (November 2026) its rotation was too small "
        "in 14 %, it missed 16 % of the overturnings, and it had several answers, of which the largest is "
        "used, in 15 %."
    )

    def damping(self, restitution: float) -> float:
        """Return the equivalent damping ratio for a velocity factor e [–]."""
        return damping(restitution)

    def obstacles(self, case: Case) -> tuple[str, ...]:
        return damping_obstacles(self.damping(case.block.restitution))

    def outcome(self, case: Case) -> Outcome:
        block = case.block
        beta = self.damping(block.restitution)
        roots = tuple(rotations(block, motion, beta) for motion in case.motions)
        values = {
            "beta": Quantity(beta, "1", "β, equivalent damping ratio"),
            "p_hat": Quantity(block.p, "rad/s", "p̂, frequency parameter of the equivalent block"),
            "h_hat": Quantity(block.half_height, "m", "ĥ, half height of the equivalent block"),
        }
        return Outcome(1.0, np.array([y.answer for y in roots]), roots, values)
