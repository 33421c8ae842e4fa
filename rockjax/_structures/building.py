"""A building of several stories with rigid floors, as a superstructure."""

from __future__ import annotations

import math
import warnings
from typing import Any, ClassVar, NamedTuple, Self

import equinox as eqx
import numpy as np

from rockjax._checks import (
    array_module,
    as_float,
    require,
    require_not_negative,
    require_positive,
    require_whole,
)
from rockjax._types import Array, Number

from .modes import Modes, Row, as_many, joined, members, parts, row, with_fields
from .superstructures import AbstractSuperstructure, Elastic, Oscillators, Rigid, eigh


class ModalAnalysis(NamedTuple):
    """All modes of a building, the lowest first along the last axis, retained or not."""

    omega: Array  # ω_i [rad/s]
    eta: Array  # η_i = Γ_i² M_i
    shapes: Array  # Γ_i φ_ji, floors j from the bottom along the axis before


def modal_analysis(masses: Array, stiffnesses: Array) -> ModalAnalysis:
    """Return the modes of a chain of masses and springs from the beam upwards, K φ_i = ω_i² M φ_i, (C11).

    The periods of such a chain are distinct, so the modes have derivatives.
    """
    xp: Any = array_module(masses, stiffnesses)
    masses, stiffnesses = xp.broadcast_arrays(masses, stiffnesses)
    above = xp.concatenate([stiffnesses[..., 1:], xp.zeros_like(stiffnesses[..., :1])], axis=-1)
    size, root = masses.shape[-1], xp.sqrt(masses)
    diagonal = ((stiffnesses + above) / masses)[..., None] * np.eye(size)
    link = (-above / (root * xp.roll(root, -1, axis=-1)))[..., None] * np.eye(size, k=1)
    _, vectors = eigh(diagonal + link + xp.swapaxes(link, -1, -2))
    shapes = vectors / root[..., None]  # of modes with M_i = 1
    # ω² as a sum of story energies has no cancellation: the lowest are as accurate as the highest.
    drifts = xp.concatenate([shapes[..., :1, :], shapes[..., 1:, :] - shapes[..., :-1, :]], axis=-2)
    squares = xp.sum(stiffnesses[..., None] * drifts**2, axis=-2)
    shares = xp.sum(masses[..., None] * shapes, axis=-2)  # Γ_i
    return ModalAnalysis(xp.sqrt(squares), shares**2, shares[..., None, :] * shapes)


class ShearBuilding(AbstractSuperstructure):
    """A building of n stories as a superstructure: rigid floors, and stories between them that shear.

    - `masses`: mass ratios of the floors m_j/(N m_c), > 0 [–], from the bottom along the last axis
    - `stiffnesses`: of the stories below them k_j/(N m_c), > 0 [1/s²]
    - `damping`: damping ratios of the modes, ≥ 0 [–]; one number for all modes, or one for each
    - `modes`: number of modes to retain, the lowest first; the remaining modal mass moves with the beam. By
      default all. With fewer, `peak_shear` and `peak_floor_acceleration` omit the contribution of the other
      modes to the impulses at impacts
    - `heights`: of the stories [m], > 0, for drift ratios and for pictures; None if unknown

    Its modes are [`rockjax.ShearBuilding.modes`][]. Peaks and histories also hold drifts of the stories and
    accelerations of the floors. Raises `ValueError` for unequal lengths and for concrete numbers outside
    these ranges.
    """

    rows: ClassVar[tuple[str, ...]] = ("masses", "stiffnesses", "damping", "heights")

    masses: Row
    stiffnesses: Row
    damping: Row
    heights: Row | None
    retained: int = eqx.field(static=True)

    def __init__(
        self,
        masses: Any,
        stiffnesses: Any,
        damping: Any = 0.05,
        modes: int | None = None,
        *,
        heights: Any = None,
        retained: int | None = None,
    ):
        owner = "ShearBuilding"
        self.masses = row(owner, "masses", masses, "story")
        self.stiffnesses = row(owner, "stiffnesses", stiffnesses, "story")
        self.damping = as_float(damping, f"{owner}: damping")
        self.heights = None if heights is None else row(owner, "heights", heights, "story")
        count = self.masses.shape[-1]
        requested = modes if modes is not None else count if retained is None else retained
        self.retained = require_whole(owner, "modes", requested, 0)
        if self.retained > count:
            raise ValueError(f"{owner}: modes must be in 0 … {count}, the number of stories, got {requested}")

    def __check_init__(self):
        owner, count = "ShearBuilding", self.stories
        rows = {"stiffnesses": self.stiffnesses} | ({} if self.heights is None else {"heights": self.heights})
        for name, values in rows.items():
            if len(parts(values)) != count:
                raise ValueError(
                    f"{owner}: {name} must be as long as masses, which has {count} stories, got "
                    f"{len(parts(values))}"
                )
        if as_many(self.damping, 1) is self.damping and len(parts(self.damping)) != self.retained:
            raise ValueError(
                f"{owner}: damping must be one number or one for each of the {self.retained} modes that are "
                f"kept, got {len(parts(self.damping))}"
            )
        require_positive(owner, masses=self.masses, **rows)
        require_not_negative(owner, damping=self.damping)

    @classmethod
    def uniform(cls, stories: int, eta, T, damping: Any = 0.05, modes=None, *, height=None) -> Self:
        """Return a building with equal stories.

        - `stories`: number of stories n ≥ 1
        - `eta`: mass ratio of all of them, m_t/(N m_c), > 0 [–]
        - `T`: longest fixed-base period, > 0 [s]
        - `damping`, `modes`: as for [`rockjax.ShearBuilding`][]
        - `height`: height of each story [m]; None if unknown
        """
        count = require_whole("ShearBuilding.uniform", "stories", stories, 1)
        require_positive("ShearBuilding.uniform", eta=eta, T=T)
        eta, T = as_float(eta, "ShearBuilding.uniform: eta"), as_float(T, "ShearBuilding.uniform: T")
        lowest = 2 * math.sin(math.pi / (4 * count + 2))  # ω_1 √(m/k)
        mass = eta / count
        each = np.ones(count)
        heights = None if height is None else as_float(height)[..., None] * each
        stiffness = mass * (2 * math.pi / (lowest * T)) ** 2
        return cls(mass[..., None] * each, stiffness[..., None] * each, damping, modes, heights=heights)

    @property
    def stories(self) -> int:
        """The number of stories."""
        return len(parts(self.masses))

    @property
    def modes(self) -> Modes:
        """The retained modes, with the mass ratio of the others as the residual."""
        found, retained = self._analysis(), self.retained
        residual = found.eta[..., retained:].sum(axis=-1) if retained < self.stories else 0.0
        return Modes(
            found.eta[..., :retained], 2 * math.pi / found.omega[..., :retained], self.damping, residual
        )

    @property
    def frequencies(self) -> Array:
        """Fixed-base circular frequencies ω_i of the retained modes [rad/s]."""
        return self._analysis().omega[..., : self.retained]

    @property
    def shapes(self) -> Array:
        """Γ_i φ_ji of the floors j and, along the last axis, the retained modes i [–], (C11): a floor moves
        by Σ Γ_i φ_ji (u_i − u_b) relative to the beam."""
        return self._analysis().shapes[..., : self.retained]

    def _analysis(self) -> ModalAnalysis:
        return modal_analysis(joined(self.masses), joined(self.stiffnesses))

    @property
    def count(self) -> int:
        return self.retained

    @property
    def oscillators(self) -> Elastic | Oscillators | None:
        return self.resolved().oscillators

    @property
    def carried(self) -> Number | None:
        return self.resolved().carried

    @property
    def mass_ratio(self) -> Number:
        return joined(self.masses).sum(axis=-1)

    @property
    def elastic(self) -> bool:
        return self.retained > 0

    @property
    def kept(self) -> int:
        """Former name of `retained`."""
        warnings.warn("ShearBuilding.kept is called retained now", DeprecationWarning, stacklevel=2)
        return self.retained

    @property
    def has_mode_axis(self) -> bool:
        return self.retained > 0

    @property
    def floors(self) -> Array:
        return self.shapes

    @property
    def height_count(self) -> int:
        return self.stories

    @property
    def own_heights(self) -> Array | None:
        return None if self.heights is None else joined(self.heights).cumsum(axis=-1)

    def check_heights(self, owner: str, heights: Number) -> None:
        ascending = lambda v: np.diff(v, axis=-1, prepend=-np.inf) > 0
        require(owner, "elevation.top_height", heights, ascending, "ascending from floor to floor")

    def first_moments(self, heights: Number, residual_height: Number) -> tuple[Number | None, Number | None]:
        del residual_height
        of_floors = joined(self.masses) * heights
        total = of_floors.sum(axis=-1)
        if not self.retained:
            return None, total
        of_modes = (of_floors[..., None] * self.shapes).sum(axis=-2)
        return of_modes, None if self.retained == self.stories else total - of_modes.sum(axis=-1)

    def split(self) -> Self:
        values: dict[str, Any] = {name: parts(getattr(self, name)) for name in ("masses", "stiffnesses")}
        values["damping"] = members(self.damping)
        values["heights"] = None  # for pictures only
        return with_fields(self, values)

    def resolved(self) -> AbstractSuperstructure:
        if not self.retained:
            return Rigid(self.mass_ratio)
        found, retained = self._analysis(), self.retained
        residual = None if retained == self.stories else found.eta[..., retained:].sum(axis=-1)
        return Oscillators(
            found.eta[..., :retained],
            2 * math.pi / found.omega[..., :retained],
            joined(self.damping),
            residual,
            found.shapes[..., :retained],
        )


def superstructure_of(eta: Any, T_s: Any = None, zeta: Any = 0.05, stories: int | None = None):
    """Return a superstructure of given mass ratio.

    - `eta`: mass ratio m_t/(N m_c) [–]
    - `T_s`: longest fixed-base period [s]; None for a rigid superstructure
    - `zeta`: damping ratio [–]
    - `stories`: number of equal stories of a building; None for a single oscillator
    """
    if T_s is None:
        return Rigid(eta)
    return Elastic(eta, T_s, zeta) if stories is None else ShearBuilding.uniform(stories, eta, T_s, zeta)
