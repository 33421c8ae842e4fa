"""Base class of restrainers: devices along the centre line of a column that resist its rocking.

A rocking column turns by θ about a corner in its bottom joint (on the ground) and in its top joint (under
the beam). On the centre line, half a width R sin α away from the corner, each joint opens by
2R sin α sin(|θ|/2). A device from the ground to the beam spans both joints and lengthens by

    ℓ = 4R sin α sin(|θ|/2)
    (C1)

and a device that spans only the bottom joint lengthens by ℓ/2. In dimensionless form, lengths are divided by
the half diagonal R of a column, times by 1/p with the frequency parameter p, and forces by the weight m_c g
of a column. Forces are functions of the stretch s = ℓ/R and the stretch rate r = ℓ̇/(Rp), except the force of
an inerter, which is proportional to ℓ̈.

Equations with a C are in docs/control.md and docs/equations.md.
"""

import abc
from typing import ClassVar, Self

import jax.numpy as jnp

from rockjax._checks import concrete
from rockjax._text.representations import PrintedModule
from rockjax._types import Number, Value


class AbstractRestrainer(PrintedModule):
    """A device on each column.

    A subclass overrides the private methods of its effects, such as `_force`. In private methods, stretch and
    stretch rate are those of the device. In public methods, stretch and stretch rate are those of both joints
    together, even if the device spans only one joint.
    """

    # Names of the fields that are strengths. If all of them are zero, the device does nothing.
    strength_fields: ClassVar[tuple[str, ...]] = ()

    @property
    @abc.abstractmethod
    def joints(self) -> int:
        """Number of joints that the device spans: 2 (from ground to beam) or 1 (only the bottom joint)."""

    def __check_init__(self):
        owner = type(self).__name__
        if isinstance(self.joints, bool) or self.joints not in (1, 2):
            raise ValueError(f"{owner}: joints must be 1 or 2, got joints = {self.joints!r}")
        self._check(owner)

    @abc.abstractmethod
    def _check(self, owner: str) -> None:
        """Raise `ValueError` for invalid parameters; the message begins with `owner`."""

    def _force(self, stretch: Value, rate: Value, slip: Value) -> Value | float:
        """Return the force in the device divided by m_c g, positive in tension. Below the dimensionless rate
        `slip`, a force with an infinite slope at zero rate is smoothed."""
        del stretch, rate, slip
        return 0.0

    def _potential(self, stretch: Value) -> Value | float:
        """Return the stored energy divided by m_c g R, relative to the energy at zero stretch."""
        del stretch
        return 0.0

    def _power(self, rate: Value, slip: Value) -> Value | float:
        """Return the dissipated power divided by m_c g R p, ≥ 0."""
        del rate, slip
        return 0.0

    @property
    def _apparent_mass(self) -> Number | None:
        """Inertance divided by m_c; None if the device has no inertance. A device with inertance transmits an
        impulse at impacts."""
        return None

    @property
    def _stiffness(self) -> Number | None:
        """Slope of the static force at zero stretch, K R/(m_c g); None if the device has no stiffness."""
        return None

    @abc.abstractmethod
    def for_equivalent_block(self, weight_ratio: Number, inertia_ratio: Number, p_ratio: Number) -> Self:
        """Return the device for the solitary block that is equivalent to a frame with this device, see
        [`rockjax.Podium.equivalent_block`][].

        - `weight_ratio`: restoring moment of the frame divided by the moment of the block, 1+2γ
        - `inertia_ratio`: inertia of the frame divided by the inertia of the block, 3γ+¾(1+λ). In both
          ratios, γ includes a rigid superstructure
        - `p_ratio`: frequency parameter p of the block divided by p of the frame
        """

    @property
    def elongation_ratio(self) -> float:
        """Elongation of the device divided by the elongation of both joints."""
        return 0.5 if self.joints == 1 else 1.0

    def force(self, stretch: Value, rate: Value, slip: Value) -> Value | float:
        """Return the force of the equivalent device, divided by m_c g. The equivalent device spans both
        joints and does the same work; `stretch`, `rate` and `slip` refer to both joints."""
        return self.elongation_ratio * self._force(
            self.elongation_ratio * stretch, self.elongation_ratio * rate, self.elongation_ratio * slip
        )

    def potential(self, stretch: Value) -> Value | float:
        """Return the stored energy divided by m_c g R; `stretch` refers to both joints."""
        return self._potential(self.elongation_ratio * stretch)

    def power(self, rate: Value, slip: Value) -> Value | float:
        """Return the dissipated power divided by m_c g R p; `rate` and `slip` refer to both joints."""
        return self._power(self.elongation_ratio * rate, self.elongation_ratio * slip)

    def static_force(self, stretch: Value) -> Value | float:
        """Return `force` at zero rate."""
        return self.force(stretch, jnp.zeros_like(stretch), jnp.ones_like(stretch))

    @property
    def has_static_force(self) -> bool:
        """True if the class defines `_potential`, and thus a static force, even if the strengths are zero."""
        return type(self)._potential is not AbstractRestrainer._potential

    @property
    def has_no_strength(self) -> bool:
        """True if all strengths are scalars, not traced, and equal to zero. The device then does nothing."""
        values = [concrete(getattr(self, name)) for name in self.strength_fields]
        return bool(values) and all(y is not None and y.ndim == 0 and y == 0 for y in values)

    @property
    def steep(self) -> bool:
        """True if the force may have an infinite slope at zero rate. Steps are then shortened near θ̇ = 0."""
        return False

    @property
    def apparent_mass(self) -> Number | None:
        """Inertance of the equivalent device that spans both joints, divided by m_c; None if the device has
        no inertance."""
        inertance = self._apparent_mass
        return None if inertance is None else self.elongation_ratio**2 * inertance

    @property
    def equivalent_stiffness(self) -> Number | None:
        """Stiffness K R/(m_c g) of the equivalent device that spans both joints; None if the device has no
        stiffness."""
        stiffness = self._stiffness
        return None if stiffness is None else self.elongation_ratio**2 * stiffness
