"""What all restrainers have in common: they feel the elongation between the ground and the beam on a column's
centre line.

Each joint of a rocking column opens by a chord about its contact corner, so that a device over both joints is
longer by

    ℓ = 4R sin α sin(|θ|/2),
    (C1)

one over a single joint by half of it. Here lengths are over R, times over 1/p and forces over the static
weight of a column m_c g: a stretch s = ℓ/R and its rate r = ℓ̇/(Rp). What a device adds to the model is then
a function of these two alone.
"""

import abc
from typing import ClassVar, Self

import jax.numpy as jnp

from rockjax._checks import concrete
from rockjax._module import Module
from rockjax._text.cards import card, readable
from rockjax._types import Number, Value


class AbstractRestrainer(Module):
    """A device of each column. To add a kind, say what it does over its own elongation; what it does not do
    is zero."""

    strengths: ClassVar[tuple[str, ...]] = ()  # fields that leave nothing of it where all are zero

    @property
    @abc.abstractmethod
    def joints(self) -> int:
        """How many of the two joints it spans."""

    def __check_init__(self):
        owner = type(self).__name__
        if isinstance(self.joints, bool) or self.joints not in (1, 2):
            raise ValueError(f"{owner}: joints must be 1 or 2, got joints = {self.joints!r}")
        self._check(owner)

    @abc.abstractmethod
    def _check(self, owner: str) -> None:
        """Raise `ValueError`, in the name of `owner`, for numbers that make no sense."""

    def _force(self, stretch: Value, rate: Value, slip: Value) -> Value | float:
        """Force that pulls beam and ground together, over m_c g; below the rate `slip` a jump may be
        rounded."""
        del stretch, rate, slip
        return 0.0

    def _potential(self, stretch: Value) -> Value | float:
        """What the static part of the force has stored, over m_c g R, from 0 at no stretch."""
        del stretch
        return 0.0

    def _power(self, rate: Value, slip: Value) -> Value | float:
        """What the device takes, over m_c g R p: never negative."""
        del rate, slip
        return 0.0

    @property
    def _apparent_mass(self) -> Number | None:
        """Force over the acceleration of the elongation, over m_c; None where there is none. It passes an
        impulse."""
        return None

    @property
    def _stiffness(self) -> Number | None:
        """Slope of the static force at no stretch, K R/(m_c g); None where there is none."""
        return None

    @abc.abstractmethod
    def of_block(self, weight: Number, inertia: Number, speed: Number) -> Self:
        """The device of the solitary block that rocks as a frame does which has this one.

        The block has the frame's weight of one column over `weight`, its inertia over `inertia`, its p times
        `speed`.
        """

    @property
    def reach(self) -> float:
        """The device's own elongation over that of both joints."""
        return 0.5 if self.joints == 1 else 1.0

    def force(self, stretch: Value, rate: Value, slip: Value) -> Value | float:
        """Force over m_c g that does the device's work along the elongation of both joints."""
        return self.reach * self._force(self.reach * stretch, self.reach * rate, self.reach * slip)

    def potential(self, stretch: Value) -> Value | float:
        """Energy stored over m_c g R, at a stretch of both joints."""
        return self._potential(self.reach * stretch)

    def power(self, rate: Value, slip: Value) -> Value | float:
        """Energy taken per time over m_c g R p, at a rate of both joints."""
        return self._power(self.reach * rate, self.reach * slip)

    def static_force(self, stretch: Value) -> Value | float:
        """Force over m_c g of a device that is held at a stretch of both joints."""
        return self.force(stretch, jnp.zeros_like(stretch), jnp.ones_like(stretch))

    @property
    def stores(self) -> bool:
        """Whether there is a static force, known before tracing."""
        return type(self)._potential is not AbstractRestrainer._potential

    @property
    def idle(self) -> bool:
        """Whether all its strengths are single zeros, known before tracing: it does nothing."""
        values = [concrete(getattr(self, name)) for name in self.strengths]
        return bool(values) and all(y is not None and y.ndim == 0 and y == 0 for y in values)

    @property
    def steep(self) -> bool:
        """Whether the force has no slope where nothing moves, known before tracing: steps then close in on
        such moments."""
        return False

    @property
    def apparent_mass(self) -> Number | None:
        """Inertance over m_c of the equivalent device over both joints, None where there is none."""
        own = self._apparent_mass
        return None if own is None else self.reach**2 * own

    @property
    def slope(self) -> Number | None:
        """Stiffness K R/(m_c g) of the equivalent device over both joints, None where there is none."""
        own = self._stiffness
        return None if own is None else self.reach**2 * own

    def __repr__(self):
        return readable(self)

    def _repr_html_(self):
        return card(self)
