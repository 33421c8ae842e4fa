"""Inerters, whose force is proportional to the acceleration of their elongation."""

from __future__ import annotations

import equinox as eqx

from rockjax._checks import as_number, require_not_negative
from rockjax._types import Number

from .base import AbstractRestrainer


class Inerter(AbstractRestrainer):
    """An inerter of every column, with the force b ℓ̈ against the acceleration ℓ̈ of the elongation ℓ.

    - `inertance`: μ = b/m_c, ≥ 0 [–], with the mass m_c of a column
    - `joints`: number of joints that the inerter spans: 2 (from ground to beam) or 1 (only the bottom joint)

    An inerter acts in both directions, without play or clutch. At impacts an inerter transmits an impulse,
    which lowers the velocity factor of the laws `"paper"` and `"compatible"`
    ([`rockjax.Podium.restitution_factor`][]). Raises `ValueError` for values outside this range; traced
    values are not checked.
    """

    inertance: Number = eqx.field(converter=as_number("Inerter: inertance"))
    joints: int = eqx.field(static=True, default=2)  # pyright: ignore[reportIncompatibleMethodOverride]

    strength_fields = ("inertance",)

    def _check(self, owner: str) -> None:
        require_not_negative(owner, inertance=self.inertance)

    @property
    def _apparent_mass(self) -> Number:
        return self.inertance

    def for_equivalent_block(self, weight_ratio: Number, inertia_ratio: Number, p_ratio: Number) -> Inerter:
        del weight_ratio, p_ratio
        return Inerter(self.inertance / inertia_ratio, self.joints)
