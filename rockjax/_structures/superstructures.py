"""What stands on the podium: rigid or elastic."""

from __future__ import annotations

import math

import equinox as eqx

from rockjax._checks import as_number, not_negative, require
from rockjax._repr import card, readable
from rockjax._types import Number


class Elastic(eqx.Module):
    """An elastic single-degree-of-freedom superstructure, Eqs. (4), (22).

    - `eta`: mass ratio η = m_t/(N m_c), ≥ 0 [–]. With η = 0 it is driven but does not act back.
    - `T_s`: fixed-base period, > 0 [s]. The paper's "T_s = 0" is [`rockjax.Rigid`][], not a small period.
    - `zeta`: fixed-base damping ratio ζ ≥ 0 [–].
    """

    eta: Number = eqx.field(converter=as_number("Elastic: eta"))
    T_s: Number = eqx.field(converter=as_number("Elastic: T_s"))
    zeta: Number = eqx.field(converter=as_number("Elastic: zeta"), default=0.05)

    def __check_init__(self):
        not_negative("Elastic", eta=self.eta, zeta=self.zeta)
        require(
            "Elastic",
            "T_s",
            self.T_s,
            lambda v: v > 0,
            "finite and > 0 (for a rigid superstructure use Rigid(eta))",
        )

    @property
    def omega_s(self) -> Number:
        """Fixed-base circular frequency ω_s = 2π/T_s [rad/s]."""
        return 2 * math.pi / self.T_s

    def __repr__(self):
        return readable(self)

    def _repr_html_(self):
        return card(self)


class Rigid(eqx.Module):
    """A rigid superstructure: it adds to the beam, γ ← γ + η (the paper's "T_s = 0").

    - `eta`: mass ratio η = m_t/(N m_c), ≥ 0 [–].
    """

    eta: Number = eqx.field(converter=as_number("Rigid: eta"))

    def __check_init__(self):
        not_negative("Rigid", eta=self.eta)

    def __repr__(self):
        return readable(self)

    def _repr_html_(self):
        return card(self)
