"""Upper bound of the uplift demand, Eq. (9), from the response spectrum: (P2) of docs/practice.md."""

from __future__ import annotations

import numpy as np

from rockjax._motions.motion import Motion
from rockjax._structures import Podium

from .base import AbstractMethod, Case, Outcome, Quantity
from .spectra import spectrum


def effective_acceleration(podium: Podium, motion: Motion) -> float:
    """Return a_eff = [(1+2γ) PGA + 2Σ η_i S_a(T_i, ζ_i)]/(1+2γ+2η), (P2) [m/s²].

    S_a is the absolute spectral acceleration at the fixed-base periods T_i and damping ratios ζ_i of the
    modes. γ includes all masses that move with the beam; η = Σ η_i includes only the masses that vibrate. By
    Eq. (9) of docs/model.md and the triangle inequality, the columns cannot lift if a_eff ≤ g tan α.

    - `podium`: single podium without tendons, dampers and inerters, with damping ratios below 1
    - `motion`: ground motion
    """
    gamma, eta = map(float, podium.mass_ratios)
    eta_i, T_i, zeta_i = modes_of(podium)
    vibrating = 0.0
    if T_i.size:
        vibrating = 2 * float(eta_i @ spectrum(motion, T_i, zeta_i, "acceleration"))
    return ((1 + 2 * gamma) * motion.pga + vibrating) / (1 + 2 * gamma + 2 * eta)


def modes_of(podium: Podium) -> np.ndarray:
    """Return η_i [–], T_i [s] and ζ_i [–] of the fixed-base modes, shape (3, modes)."""
    superstructure = podium.superstructure
    oscillators = None if superstructure is None else superstructure.oscillators
    if oscillators is None:
        return np.empty((3, 0))
    rows = (np.asarray(y, float) for y in (oscillators.eta, oscillators.T_s, oscillators.zeta))
    return np.array(np.broadcast_arrays(*map(np.atleast_1d, rows)))


class SpectralUplift(AbstractMethod):
    """Uplift check with the response spectrum at the fixed-base periods of the building, (P2)."""

    name = "spectral_uplift"
    title = "Spectral uplift"
    source = "triangle inequality on Eq. (9)"
    equation = "(P2)"
    formula = "a_eff = [(1+2γ) PGA + 2Σ η_i S_a(T_i, ζ_i)]/(1+2γ+2η) ≤ g tan α, S_a absolute"
    quantity = "effective acceleration a_eff"
    unit = "m/s2"
    conservative = "yes"
    reliability = (
        "Safe against uplift by horizontal motion: a bound by the triangle inequality. In a survey of "
        "5 000 elastic buildings (November 2026) the PGA of uplift was 1.00 to 2.61 times that of this "
        "method. With SRSS instead of the sum, a_eff is not a bound: the ratio was 0.66 to 1.79."
    )

    def obstacles(self, case: Case) -> tuple[str, ...]:
        if np.any(modes_of(case.podium)[2] >= 1):
            return ("response spectra need damping ratios of the superstructure below 1",)
        return ()

    def outcome(self, case: Case) -> Outcome:
        demand = case.for_each_motion(lambda motion: effective_acceleration(case.podium, motion))
        values = {"pga": Quantity(case.pga, "m/s2", "PGA of each motion")}
        return Outcome(case.block.threshold, demand, values=values)
