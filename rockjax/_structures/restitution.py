"""Laws of restitution: the velocity factor e of an impact, |θ̇| after the impact divided by |θ̇| before it.

In the formulas, γ is the mass that moves with the beam and η the vibrating mass, both divided by N m_c, the
mass of all N columns. λ is the inertia factor of a column, and μ the sum of the inertances of a column
divided by its mass m_c. Plain equation numbers are those of docs/model.md; (C12) is in docs/control.md, (C13)
in docs/equations.md.
"""

from __future__ import annotations

import equinox as eqx

from rockjax._checks import as_number, concrete, require
from rockjax._tree import Module
from rockjax._types import Number


class PaperRestitution(Module):
    """Law of Eq. (27): e = 1 − sin²α (2γ+2η+½) / (¼(1+λ)+γ+η).

    With inerters (C12): e = 1 − 2 sin²α (1+4γ+4η+4μ) / (1+λ+4γ+4η+4μ sin²α).
    """

    def factor(
        self, sin2: Number, gamma: Number, eta: Number, lam: Number, mu: Number | None = None
    ) -> Number:
        """Return the velocity factor e [–], Eq. (27), (C12).

        - `sin2`: sin²α; `lam`: inertia factor λ of a column [–]
        - `gamma`, `eta`: mass that moves with the beam, and vibrating mass, divided by N m_c [–]
        - `mu`: sum μ of the inertances of a column, divided by m_c [–]; None without inerters
        """
        inertance = 0.0 if mu is None else mu
        masses = 2 * gamma + 2 * eta + 0.5 + 2 * inertance
        return 1 - sin2 * masses / (0.25 * (1 + lam) + gamma + eta + inertance * sin2)

    def __repr__(self):
        return "'paper'"


class CompatibleRestitution(Module):
    """Law of conserved angular momentum about the new pivots, (C13). At an impact, an elastic superstructure
    keeps its horizontal velocity, Eq. (26).

    e = 1 − 2 sin²α (1+4γ+4η+4μ) / ((1+λ)+4γ+4(η+μ) sin²α). Without inerters μ is 0.
    """

    def factor(
        self, sin2: Number, gamma: Number, eta: Number, lam: Number, mu: Number | None = None
    ) -> Number:
        """Return the velocity factor e [–].

        - `sin2`, `gamma`, `eta`, `lam`, `mu`: as for `PaperRestitution.factor`
        """
        inertance = 0.0 if mu is None else mu
        masses = 1 + 4 * gamma + 4 * eta + 4 * inertance
        return 1 - 2 * sin2 * masses / (1 + lam + 4 * gamma + 4 * (eta + inertance) * sin2)

    def __repr__(self):
        return "'compatible'"


class GivenRestitution(Module):
    """A velocity factor e = |θ̇⁺/θ̇⁻| chosen by the user, 0 ≤ e ≤ 1 [–]."""

    e: Number = eqx.field(converter=as_number("Podium: restitution"))

    def __check_init__(self):
        require(
            "Podium",
            "restitution",
            self.e,
            lambda v: (v >= 0) & (v <= 1),
            "'paper', 'compatible' or a factor in [0, 1]",
        )

    def factor(
        self, sin2: Number, gamma: Number, eta: Number, lam: Number, mu: Number | None = None
    ) -> Number:
        """Return the velocity factor e [–].

        - `sin2`, `gamma`, `eta`, `lam`, `mu`: ignored; the other laws need these arguments
        """
        del sin2, gamma, eta, lam, mu
        return self.e

    def __repr__(self):
        value = concrete(self.e)
        return (
            "traced"
            if value is None
            else f"{float(value):.6g}"
            if value.ndim == 0
            else f"array(shape {value.shape})"
        )


Restitution = PaperRestitution | CompatibleRestitution | GivenRestitution


def as_restitution(value) -> Restitution:
    """Return a law of restitution from the argument `Podium.restitution`: the name of a law, a law, or a
    factor from 0 to 1."""
    if isinstance(value, Restitution):
        return value
    if isinstance(value, str):
        laws = {"paper": PaperRestitution, "compatible": CompatibleRestitution}
        if value not in laws:
            raise ValueError(
                f"Podium: restitution must be 'paper', 'compatible' or a factor in [0, 1], got {value!r}"
            )
        return laws[value]()
    return GivenRestitution(value)
