"""Rocking as a linear oscillator by FEMA 356, (P4) of docs/practice.md."""

from __future__ import annotations

from .priestley import Priestley


def damping(restitution: float) -> float:
    """Return the equivalent damping ratio β = 0.4(1−e), (P4) [–].

    - `restitution`: velocity factor e of an impact [–]
    """
    return 0.4 * (1 - restitution)


class Fema(Priestley):
    """The method of Priestley et al. with the damping ratio β = 0.4(1−e), (P4)."""

    name = "fema_356"
    title = "FEMA 356"
    source = "Makris & Konstantinidis 2003, EESD 32:265, Eqs. (12)–(14)"
    equation = "(P4)"
    formula = "φ = S_d(T, β)/(ĥ α), T = (4/p̂) cosh⁻¹[1/(1−φ)], β = 0.4(1−e)"
    reliability = (
        "Not reliable: it has the flaws of Priestley et al. (1978), and design spectra S_d = S_a T²/4π² grow "
        "with T and never tend to the ground displacement. In a survey of a million scenes of rigid blocks "
        "(November 2026) its rotation was too small in 11 %, it missed 15 % of the overturnings, and it had "
        "several answers, of which the largest is used, in 16 %."
    )

    def damping(self, restitution: float) -> float:
        return damping(restitution)
