"""Base class of restrainers, which respond to the elongation between the ground and the beam on a column's
centre line.

Each joint of a rocking column opens by a chord about its contact corner. A device over both joints therefore
lengthens by

    ℓ = 4R sin α sin(|θ|/2),
    (C1)

and one over a single joint by half of it. Lengths are over R, times over 1/p and forces over the static
weight of a column m_c g. The contribution of a device to the model is then a function of the stretch s = ℓ/R
and its rate r = ℓ̇/(Rp) alone.
"""

import abc
from typing import ClassVar, Self

import jax.numpy as jnp

from rockjax._checks import concrete
from rockjax._text.cards import card, format_call
from rockjax._tree import Module
from rockjax._types import Number, Value


class AbstractRestrainer(Module):
    """A device of each column. A new kind defines its response to its own elongation; responses that it does
    not define are zero."""

    strengths: ClassVar[tuple[str, ...]] = ()  # fields; the device does nothing if all are zero

    @property
    @abc.abstractmethod
    def joints(self) -> int:
        """Number of joints that the device spans, 1 or 2."""

    def __check_init__(self):
        owner = type(self).__name__
        if isinstance(self.joints, bool) or self.joints not in (1, 2):
            raise ValueError(f"{owner}: joints must be 1 or 2, got joints = {self.joints!r}")
        self._check(owner)

    @abc.abstractmethod
    def _check(self, owner: str) -> None:
        """Raise `ValueError`, in the name of `owner`, for invalid numbers."""

    def _force(self, stretch: Value, rate: Value, slip: Value) -> Value | float:
        """Return the force that pulls beam and ground together, over m_c g; a jump may be rounded below the
        rate `slip`."""
        del stretch, rate, slip
        return 0.0

    def _potential(self, stretch: Value) -> Value | float:
        """Return the energy stored by the static force, over m_c g R, zero at no stretch."""
        del stretch
        return 0.0

    def _power(self, rate: Value, slip: Value) -> Value | float:
        """Return the dissipated power, over m_c g R p: never negative."""
        del rate, slip
        return 0.0

    @property
    def _apparent_mass(self) -> Number | None:
        """Force over the acceleration of the elongation, over m_c; None if there is none. Such a device
        transmits an impulse at impacts."""
        return None

    @property
    def _stiffness(self) -> Number | None:
        """Slope of the static force at no stretch, K R/(m_c g); None if there is none."""
        return None

    @abc.abstractmethod
    def of_block(self, weight: Number, inertia: Number, speed: Number) -> Self:
        """Return the device for the equivalent solitary block of a frame with this device.

        - `weight`: weight of one column of the frame over that of the block
        - `inertia`: inertia of the frame over that of the block
        - `speed`: p of the block over p of the frame
        """

    @property
    def elongation_ratio(self) -> float:
        """The device's own elongation over that of both joints."""
        return 0.5 if self.joints == 1 else 1.0

    def force(self, stretch: Value, rate: Value, slip: Value) -> Value | float:
        """Return the force over m_c g that does the device's work along the elongation of both joints."""
        return self.elongation_ratio * self._force(
            self.elongation_ratio * stretch, self.elongation_ratio * rate, self.elongation_ratio * slip
        )

    def potential(self, stretch: Value) -> Value | float:
        """Return the stored energy over m_c g R, at a stretch of both joints."""
        return self._potential(self.elongation_ratio * stretch)

    def power(self, rate: Value, slip: Value) -> Value | float:
        """Return the dissipated power over m_c g R p, at a rate of both joints."""
        return self._power(self.elongation_ratio * rate, self.elongation_ratio * slip)

    def static_force(self, stretch: Value) -> Value | float:
        """Return the force over m_c g of a device that is held at a stretch of both joints."""
        return self.force(stretch, jnp.zeros_like(stretch), jnp.ones_like(stretch))

    @property
    def stores(self) -> bool:
        """True if there is a static force, known before tracing."""
        return type(self)._potential is not AbstractRestrainer._potential

    @property
    def idle(self) -> bool:
        """True if all its strengths are single zeros, known before tracing: the device does nothing."""
        values = [concrete(getattr(self, name)) for name in self.strengths]
        return bool(values) and all(y is not None and y.ndim == 0 and y == 0 for y in values)

    @property
    def steep(self) -> bool:
        """True if the force has an infinite slope at zero rate, known before tracing. Steps are then
        shortened near moments without motion."""
        return False

    @property
    def apparent_mass(self) -> Number | None:
        """Inertance over m_c of the equivalent device over both joints, None if there is none."""
        own = self._apparent_mass
        return None if own is None else self.elongation_ratio**2 * own

    @property
    def slope(self) -> Number | None:
        """Stiffness K R/(m_c g) of the equivalent device over both joints, None if there is none."""
        own = self._stiffness
        return None if own is None else self.elongation_ratio**2 * own

    def __repr__(self):
        return format_call(self)

    def _repr_html_(self):
        return card(self)
