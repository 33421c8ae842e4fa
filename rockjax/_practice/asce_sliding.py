"""Sliding of unanchored bodies by ASCE/SEI 43-05, Eqs. (A-1) and (A-2); (P6) of docs/practice.md."""

from __future__ import annotations

import math

import numpy as np

from rockjax._motions.motion import Motion

from .base import AbstractMethod, Case, Outcome, Quantity
from .spectra import period_grid, refined_maximum, spectrum

DAMPING = 0.10  # damping ratio of the spectrum [–]
LONGEST_PERIOD = 10.0  # longest period of the spectrum [s]
REFINEMENTS = 2  # number of refinements of the frequency f_es
REFINEMENT_POINTS = 64  # number of periods in each refinement


def effective_friction(friction: float, vertical: float, g: float) -> float:
    """Return the effective friction μ_e = μ(1 − 0.4A_v/g) ≥ 0, Eq. (A-1) of ASCE 43-05 [–].

    - `friction`: coefficient of friction μ ≥ 0 [–]
    - `vertical`: largest vertical ground acceleration A_v ≥ 0 [m/s²]
    - `g`: acceleration of gravity > 0 [m/s²]
    """
    return friction * max(1 - 0.4 * vertical / g, 0.0)


def sliding_demand(motion: Motion, capacity: float) -> tuple[float, float]:
    """Return the largest spectral acceleration with 10 % damping [m/s²], and the frequency f_es [Hz].

    The spectrum is searched at periods from 2 dt to 10 s, with the sampling interval dt of the motion. f_es
    is the lowest frequency at which the spectrum reaches `capacity`, or nan if the spectrum is below
    `capacity` everywhere.

    - `motion`: ground motion
    - `capacity`: capacity c_s for sliding [m/s²]
    """
    values_at = lambda periods: spectrum(motion, periods, DAMPING, "acceleration")
    periods = period_grid(2 * motion.dt, LONGEST_PERIOD)
    values = values_at(periods)
    largest = max(refined_maximum(values_at, periods, values), motion.pga)  # PGA is the limit for T → 0
    longest = next_period = math.nan
    for k in range(1 + REFINEMENTS):
        if k > 0:
            periods = np.linspace(longest, next_period, REFINEMENT_POINTS)
            values = values_at(periods)
        indices = np.flatnonzero(values >= capacity)
        if not indices.size:
            break
        longest, next_period = periods[indices[-1]], periods[min(indices[-1] + 1, periods.size - 1)]
    return largest, float(1 / longest)


class AsceSliding(AbstractMethod):
    """Capacity c_s for sliding by ASCE/SEI 43-05, Eqs. (A-1) and (A-2), without the sliding distance."""

    name = "asce_43_05_sliding"
    title = "ASCE 43-05, sliding"
    source = "ASCE/SEI 43-05, Appendix A.1, Eqs. (A-1), (A-2)"
    equation = "(P6)"
    formula = "c_s = 2μ_e g, μ_e = μ(1 − 0.4A_v/g)"
    quantity = "largest spectral acceleration, 10 % damping"
    unit = "m/s2"
    conservative = "depends"
    reliability = (
        "No verdict, because the sliding distance is not computed. c_s is twice the acceleration at which a "
        "rigid body begins to slide, so a spectrum below c_s does not exclude sliding."
    )
    missing = ("the sliding distance is not computed: rockjax does not implement its formula",)

    def obstacles(self, case: Case) -> tuple[str, ...]:
        reasons = []
        if case.friction is None:
            reasons.append("the method needs friction, the coefficient of friction μ")
        if case.vertical is None:
            reasons.append("the method needs vertical, the largest vertical ground acceleration A_v")
        return tuple(reasons)

    def outcome(self, case: Case) -> Outcome:
        if case.friction is None or case.vertical is None:  # `obstacles` excludes this; for type checkers
            return Outcome(is_complete=False)
        g = case.block.g
        mu_e = effective_friction(case.friction, case.vertical, g)
        values = {
            "mu_e": Quantity(mu_e, "1", "μ_e, effective coefficient of friction"),
            "A_v": Quantity(case.vertical, "m/s2", "A_v, largest vertical ground acceleration"),
        }
        capacity = 2 * mu_e * g
        demand, frequencies = np.array([sliding_demand(motion, capacity) for motion in case.motions]).T
        values["f_es"] = Quantity(frequencies, "Hz", "f_es for each motion, nan if the spectrum is below c_s")
        return Outcome(capacity, demand, values=values, is_complete=False)
