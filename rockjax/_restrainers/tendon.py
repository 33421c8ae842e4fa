"""Vertical elastic tendons."""

from __future__ import annotations

import equinox as eqx

from rockjax._checks import as_number, require_not_negative
from rockjax._types import Number, Value

from .base import AbstractRestrainer


class Tendon(AbstractRestrainer):
    """An unbonded elastic tendon along the centre line of every column, with the force P₀ + K ℓ at the
    elongation ℓ. R is the half diagonal and m_c g the weight of a column.

    - `prestress`: initial force τ = P₀/(m_c g), ≥ 0 [–]. At uplift the initial force acts like an additional
      weight without mass on each column
    - `stiffness`: axial stiffness κ = K R/(m_c g), ≥ 0 [–]. If κ exceeds
      [`rockjax.Podium.critical_stiffness`][], the stiffness of the podium at small rotations is positive
    - `joints`: number of joints that the tendon spans: 2 (from ground to beam) or 1 (only the bottom joint)

    The tendon never becomes slack and does not yield. Raises `ValueError` for values outside these
    ranges; traced values are not checked.
    """

    prestress: Number = eqx.field(converter=as_number("Tendon: prestress"))
    stiffness: Number = eqx.field(converter=as_number("Tendon: stiffness"), default=0.0)
    joints: int = eqx.field(static=True, default=2)  # pyright: ignore[reportIncompatibleMethodOverride]

    strength_fields = "prestress", "stiffness"

    def _check(self, owner: str) -> None:
        require_not_negative(owner, prestress=self.prestress, stiffness=self.stiffness)

    def _force(self, stretch: Value, rate: Value, slip: Value) -> Value:
        del rate, slip
        return self.prestress + self.stiffness * stretch

    def _potential(self, stretch: Value) -> Value:
        return stretch * (self.prestress + 0.5 * self.stiffness * stretch)

    @property
    def _stiffness(self) -> Number:
        return self.stiffness

    def for_equivalent_block(self, weight_ratio: Number, inertia_ratio: Number, p_ratio: Number) -> Tendon:
        del inertia_ratio, p_ratio
        return Tendon(self.prestress / weight_ratio, self.stiffness / weight_ratio, self.joints)
