"""Force check of the Italian Circolare 7/2019 with a behaviour factor, (P7) of docs/practice.md."""

from __future__ import annotations

from .base import AbstractMethod, Case, Outcome, Quantity
from .circolare import Mechanism

BEHAVIOUR_FACTOR = 2.0  # q [–]


class CircolareForce(AbstractMethod):
    """Check of the peak ground acceleration against q a_0*, with the behaviour factor q = 2 and the
    acceleration a_0* that starts the mechanism, (P7)."""

    name = "circolare_force"
    title = "Circolare 7/2019, q = 2"
    source = "Circolare 21 January 2019 n. 7, C8.7.1.2.1.6–9, Eqs. C8.7.1.1–5, C8.7.1.8–11"
    equation = "(P7)"
    formula = "PGA ≤ q a_0*, q = 2, a_0* = α_0g/(e* FC), α_0 = tan α, e* = (1+2Γ)²/[(1+Γ)(1+4Γ)]"
    quantity = "peak ground acceleration"
    unit = "m/s2"
    conservative = "no"
    reliability = (
        "Unsafe for motions with long periods, which PGA does not reflect. In a survey of rigid blocks "
        "(November 2026) 35 % of the scenes at PGA = 2 g tan α exceeded 0.4 α, and 19 % overturned."
    )

    def outcome(self, case: Case) -> Outcome:
        mechanism = Mechanism.from_block(case.block, case.confidence_factor)
        values = {
            "alpha_0": Quantity(case.block.tan_alpha, "1", "α_0 = tan α, multiplier of the mechanism"),
            "e_star": Quantity(mechanism.mass_share, "1", "e*, participating mass ratio"),
            "a_0_star": Quantity(mechanism.acceleration, "m/s2", "a_0*, acceleration of the mechanism"),
        }
        return Outcome(BEHAVIOUR_FACTOR * mechanism.acceleration, case.pga, values=values)
