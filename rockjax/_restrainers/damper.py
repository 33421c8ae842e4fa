"""Viscous dampers, linear or with a power law."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from rockjax._checks import as_float, as_number, require, require_not_negative
from rockjax._types import Number, Value

from .base import AbstractRestrainer


class Linear(float):
    """The exponent 1 as a static value, known before tracing, so that programs of linear dampers compute no
    powers."""

    def __new__(cls) -> Linear:
        return super().__new__(cls, 1.0)

    def __reduce__(self):
        return Linear, ()


jax.tree_util.register_pytree_node(Linear, lambda _: ((), None), lambda *_: Linear())


def as_exponent(value, label: str = "Damper: exponent") -> Any:
    """Convert the exponent of a damper. A Python number equal to 1 becomes `Linear`."""
    if isinstance(value, int | float) and not isinstance(value, bool) and value == 1:
        return Linear()
    return as_float(value, label)


class Damper(AbstractRestrainer):
    """A viscous damper of every column, with the force C|ℓ̇|^ν against the rate ℓ̇ of the elongation ℓ.

    - `coefficient`: δ = C (Rp)^ν/(m_c g), ≥ 0 [–], with the half diagonal R and the weight m_c g of a column
      and the frequency parameter p
    - `exponent`: ν, 0 < ν ≤ 1 [–]. The Python number 1 gives a linear damper, which compiles to a simpler
      program; an array with the value 1 gives the general program
    - `joints`: number of joints that the damper spans: 2 (from ground to beam) or 1 (only the bottom joint)

    The force is 0 at zero rate, so a damper never holds the column. For ν < 1 the force has an infinite slope
    at zero rate, and is smoothed below a rate proportional to the tolerance (see docs/control.md). Raises
    `ValueError` for values outside these ranges; traced values are not checked.
    """

    coefficient: Number = eqx.field(converter=as_number("Damper: coefficient"))
    exponent: Number | float = eqx.field(converter=as_exponent, default=1.0)
    joints: int = eqx.field(static=True, default=2)  # pyright: ignore[reportIncompatibleMethodOverride]

    strength_fields = ("coefficient",)

    def _check(self, owner: str) -> None:
        require_not_negative(owner, coefficient=self.coefficient)
        if not self.linear:
            require(owner, "exponent", self.exponent, lambda v: (v > 0) & (v <= 1), "in (0, 1]")

    @property
    def linear(self) -> bool:
        """True if ν is the static value 1."""
        return isinstance(self.exponent, Linear)

    @property
    def steep(self) -> bool:
        return not self.linear

    def _force_per_rate(self, rate: Value, slip: Value) -> Value | float:
        """Return |r|^(ν−1) for the dimensionless rate r, smoothed near r = 0: the force divided by
        coefficient and rate."""
        if self.linear:
            return 1.0
        return jnp.exp(0.5 * (self.exponent - 1) * jnp.log(rate * rate + slip * slip))

    def _force(self, stretch: Value, rate: Value, slip: Value) -> Value:
        del stretch
        return self.coefficient * rate * self._force_per_rate(rate, slip)

    def _power(self, rate: Value, slip: Value) -> Value:
        return self.coefficient * rate * rate * self._force_per_rate(rate, slip)

    def for_equivalent_block(self, weight_ratio: Number, inertia_ratio: Number, p_ratio: Number) -> Damper:
        del inertia_ratio
        return Damper(self.coefficient / weight_ratio * p_ratio**self.exponent, self.exponent, self.joints)
