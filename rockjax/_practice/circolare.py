"""Capacities of the kinematic mechanism according to the Italian Circolare 7/2019.

Equation (P7) is in docs/practice.md.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from .block import Block


class LimitState(NamedTuple):
    """A limit state of the Circolare. The symbols d_0 and a(d) are those of `Mechanism`.

    - `name`: SLV (life safety) or SLC (collapse)
    - `share`: displacement d of the limit state, divided by d_0 [–]
    - `period_factor`: period of the limit state, divided by π√(d/a(d)) [–]
    - `damping`: damping ratio ξ of the demand spectrum [–]
    """

    name: str
    share: float
    period_factor: float
    damping: float


SLV = LimitState("SLV", 0.4, 1.68, 0.08)
SLC = LimitState("SLC", 0.6, 1.56, 0.10)


class Mechanism(NamedTuple):
    """Linear capacity curve of the frame, (P7).

    The acceleration that the frame resists at the displacement d is a(d) = a_0* · (1 − d/d_0).

    - `mass_share`: participating mass ratio e* = (1+2Γ)²/[(1+Γ)(1+4Γ)], with Γ = `Block.mass_ratio` [–]
    - `acceleration`: acceleration that starts the mechanism, a_0* = g tan α/(e* FC), with the confidence
      factor FC [m/s²]
    - `displacement`: displacement at which the resistance vanishes, d_0 = B(1+4Γ)/(1+2Γ), with the half width
      B of a column [m]
    """

    mass_share: float
    acceleration: float
    displacement: float

    @classmethod
    def from_block(cls, block: Block, confidence_factor: float) -> Mechanism:
        """Return the mechanism of a block with the confidence factor FC ≥ 1 [–]."""
        ratio = block.mass_ratio
        share = (1 + 2 * ratio) ** 2 / ((1 + ratio) * (1 + 4 * ratio))
        displacement = block.half_width * (1 + 4 * ratio) / (1 + 2 * ratio)
        return cls(share, block.threshold / (share * confidence_factor), displacement)

    def displacement_at(self, state: LimitState) -> float:
        """Return the displacement of a limit state, d_SLV = 0.4d_0 or d_SLC = 0.6d_0 [m]."""
        return state.share * self.displacement

    def period(self, state: LimitState) -> float:
        """Return the period of a limit state, T = 1.68π√(d/a(d)) for SLV or 1.56π√(d/a(d)) for SLC [s]."""
        acceleration = self.acceleration * (1 - state.share)
        return state.period_factor * math.pi * math.sqrt(self.displacement_at(state) / acceleration)
