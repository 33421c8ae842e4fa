"""Light blocks and oscillators on the floors of a structure. They do not affect the structure's motion."""

from __future__ import annotations

from typing import Literal, Self

import equinox as eqx
import numpy as np

from rockjax._checks import as_number, as_numpy_unless_traced, require, require_not_negative, require_positive
from rockjax._text.representations import PrintedModule
from rockjax._types import Number

from .column import slenderness_and_size
from .podium import Podium
from .restitution import Restitution, as_restitution

DECK = "deck"  # the level of the cap beam
DIRECTIONS = "horizontal", "vertical"
Level = int | Literal["deck"]


def as_level(level) -> Level:
    """Return a level: `"deck"`, or the number of a story ≥ 1, counted from the bottom. Raises `ValueError`
    for anything else."""
    if level == DECK:
        return DECK
    if isinstance(level, bool) or not isinstance(level, int | np.integer) or level < 1:
        raise ValueError(f"level must be 'deck' or the number of a story ≥ 1, got {level!r}")
    return int(level)


def _convert_restitution(value) -> Restitution:
    """Convert the argument `restitution`; the error message names `Contents`."""
    try:
        return as_restitution(value)
    except ValueError as error:
        raise ValueError(str(error).replace("Podium", "Contents")) from None


class Contents(PrintedModule):
    """A light free-standing block on a floor, such as a cabinet. It rocks; it does not slide or leave the
    floor.

    - `alpha`: slenderness α_c = atan(width/height), 0 < α_c < π/2 [rad]
    - `R`: half diagonal R_c, > 0 [m]
    - `lam`: inertia factor λ_c = I/(m R_c²), with the mass m and the moment of inertia I about the centre,
      ≥ 0 [–]; 1/3 for a uniform block
    - `restitution`: velocity factor e_c, the angular speed after an impact divided by that before it, from 0
      to 1 [–]. `"paper"` gives e_c = 1 − 2 sin²α_c/(1+λ_c); for a block, `"compatible"` is the same
    - `level`: the floor, `"deck"` for the cap beam or the number of a story from the bottom
    - `vertical`: whether the floor's vertical motion acts on the block; practice usually neglects this motion
    - `overturn_ratio`: the block counts as overturned if its rotation |φ| reaches this multiple of α_c; > 0
      and at most π/(2α_c) [–]

    Raises `ValueError` for values outside these ranges; traced values are not checked.
    """

    alpha: Number = eqx.field(converter=as_number("Contents: alpha"))
    R: Number = eqx.field(converter=as_number("Contents: R"))
    lam: Number = eqx.field(converter=as_number("Contents: lam"), default=1 / 3)
    restitution: Restitution = eqx.field(converter=_convert_restitution, default="paper")
    level: Level = eqx.field(static=True, converter=as_level, default=DECK)
    vertical: bool = eqx.field(static=True, default=True)
    overturn_ratio: Number = eqx.field(converter=as_number("Contents: overturn_ratio"), default=1.0)

    def __check_init__(self):
        owner, right_angle = "Contents", np.pi / 2
        require(owner, "alpha", self.alpha, lambda v: (v > 0) & (v < right_angle), "in (0, π/2) rad")
        require_positive(owner, R=self.R)
        require_not_negative(owner, lam=self.lam)
        if not isinstance(self.vertical, bool):
            raise ValueError(f"Contents: vertical must be True or False, got {self.vertical!r}")
        angle = self.overturn_ratio * self.alpha
        in_range = lambda v: (v > 0) & (v <= right_angle * (1 + 1e-12))
        require(owner, "overturn_ratio times alpha", angle, in_range, "in (0, π/2] rad")

    @classmethod
    def from_dimensions(cls, width, height, **fields) -> Self:
        """Return a block from its dimensions.

        - `width`, `height`: full width and full height, > 0 [m]
        - `fields`: `lam`, `restitution`, `level`, `vertical` and `overturn_ratio` of [`rockjax.Contents`][]

        Raises `ValueError` for values out of range.
        """
        require_positive("Contents.from_dimensions", width=width, height=height)
        alpha, R = slenderness_and_size(*map(as_numpy_unless_traced, (width, height)))
        return cls(alpha, R, **fields)

    def block(self, g: Number) -> Podium:
        """Return the podium of a single column, without a beam, that rocks like this block under gravity g
        [m/s²]."""
        return Podium(self.alpha, self.R, lam=self.lam, restitution=self.restitution, g=g)


class Oscillator(PrintedModule):
    """A light linear oscillator on a floor: a pipe, a ceiling, a rack.

    - `period`: natural period T_e, > 0 [s]
    - `damping`: damping ratio ζ, 0 ≤ ζ < 1 [–]
    - `level`: the floor, `"deck"` for the cap beam or the number of a story from the bottom
    - `direction`: `"horizontal"` or `"vertical"`

    Raises `ValueError` for values outside these ranges; traced values are not checked.
    """

    period: Number = eqx.field(converter=as_number("Oscillator: period"))
    damping: Number = eqx.field(converter=as_number("Oscillator: damping"), default=0.05)
    level: Level = eqx.field(static=True, converter=as_level, default=DECK)
    direction: Literal["horizontal", "vertical"] = eqx.field(static=True, default="horizontal")

    def __check_init__(self):
        require_positive("Oscillator", period=self.period)
        require("Oscillator", "damping", self.damping, lambda v: (v >= 0) & (v < 1), "in [0, 1)")
        if self.direction not in DIRECTIONS:
            raise ValueError(
                f"Oscillator: direction must be 'horizontal' or 'vertical', got {self.direction!r}"
            )
