"""The rigid block to which the simplified methods reduce a podium."""

from __future__ import annotations

import dataclasses
import math
from typing import Self

from rockjax._structures import Podium


@dataclasses.dataclass(frozen=True)
class Block:
    """A solitary rocking block that replaces a podium.

    The block rocks like a podium with a rigid superstructure (`Podium.equivalent_block`). The methods also
    use the block for elastic superstructures, as if they were rigid; only (P2) of docs/practice.md considers
    their vibrations. The fields are parameters of the podium. The properties `equivalent_R`, `p` and
    `half_height` are those of the block.

    - `alpha`: slenderness α, in (0, π/2) [rad]; `g`: acceleration of gravity, > 0 [m/s²]
    - `R`: half diagonal of a column, > 0 [m]; `lam`: inertia factor λ of a column, ≥ 0 [–]
    - `mass_ratio`: Γ = γ + η, the mass of beam and superstructure divided by the mass of the columns, ≥ 0 [–]
    - `restitution`: velocity factor e of an impact, from the restitution law of the podium [–]
    """

    alpha: float
    R: float
    lam: float
    mass_ratio: float
    restitution: float
    g: float

    @classmethod
    def from_podium(cls, podium: Podium) -> Self:
        """Return the block of a single podium, whose parameters are scalars."""
        return cls(
            float(podium.alpha),
            float(podium.R),
            float(podium.lam),
            float(podium.gamma + podium.eta),
            float(podium.restitution_factor),
            float(podium.g),
        )

    @property
    def tan_alpha(self) -> float:
        """Ratio of width to height of a column, tan α [–]."""
        return math.tan(self.alpha)

    @property
    def threshold(self) -> float:
        """Ground acceleration g tan α that lifts columns under a rigid superstructure, Eq. (5) of
        docs/model.md [m/s²]."""
        return self.g * self.tan_alpha

    @property
    def half_width(self) -> float:
        """Half width B of a column, B = R sin α [m]."""
        return self.R * math.sin(self.alpha)

    @property
    def equivalent_R(self) -> float:
        """Half diagonal R̂ of the block, R̂ = R[3Γ+¾(1+λ)]/(1+2Γ) [m]."""
        return self.R * (3 * self.mass_ratio + 0.75 * (1 + self.lam)) / (1 + 2 * self.mass_ratio)

    @property
    def p(self) -> float:
        """Frequency parameter p̂ of the block, p̂ = √(3g/(4R̂)) [rad/s]."""
        return math.sqrt(0.75 * self.g / self.equivalent_R)

    @property
    def half_height(self) -> float:
        """Half height ĥ of the block, ĥ = R̂ cos α [m]."""
        return self.equivalent_R * math.cos(self.alpha)
