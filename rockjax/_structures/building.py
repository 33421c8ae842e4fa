"""A building of several stories with rigid floors, as a superstructure.

Masses and stiffnesses are divided by N m_c, the mass of all N columns; these are the mass ratios and
stiffness ratios. Equations with a C are in docs/modes.md.
"""

from __future__ import annotations

import math
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

from .modes import Modes, Row, as_row, repeat_scalar, split_row, split_unless_scalar, stack_row, with_fields
from .superstructures import AbstractSuperstructure, Elastic, Oscillators, Rigid, eigh


class ModalAnalysis(NamedTuple):
    """All modes of a building, including those that the model does not retain, the lowest first along the
    last axis."""

    omega: Array  # ω_i [rad/s]
    eta: Array  # mass ratios η_i = Γ_i² M_i, with participation factors Γ_i and modal masses M_i
    shapes: Array  # Γ_i φ_ji, with the mode shapes φ_ji; floors j along the last axis but one


def modal_analysis(masses: Array, stiffnesses: Array) -> ModalAnalysis:
    """Return the modes of a building on a fixed beam, K φ_i = ω_i² M φ_i, with its stiffness matrix K and its
    mass matrix M, (C11). `masses` [–] and `stiffnesses` [1/s²] are the ratios of the floors and of the
    stories below them, from the bottom along the last axis. No two periods of a shear building are equal, so
    the modes are differentiable."""
    xp: Any = array_module(masses, stiffnesses)
    masses, stiffnesses = xp.broadcast_arrays(masses, stiffnesses)
    stiffness_above = xp.concatenate([stiffnesses[..., 1:], xp.zeros_like(stiffnesses[..., :1])], axis=-1)
    size, root_masses = masses.shape[-1], xp.sqrt(masses)
    diagonal = ((stiffnesses + stiffness_above) / masses)[..., None] * np.eye(size)
    neighbour_masses = root_masses * xp.roll(root_masses, -1, axis=-1)  # √(m_j m_{j+1})
    coupling = (-stiffness_above / neighbour_masses)[..., None] * np.eye(size, k=1)
    _, vectors = eigh(diagonal + coupling + xp.swapaxes(coupling, -1, -2))
    shapes = vectors / root_masses[..., None]  # normalised to modal masses M_i = 1
    # ω² is computed as a sum over stories, without cancellation, so the lowest ω² is as accurate as the
    # highest.
    drifts = xp.concatenate([shapes[..., :1, :], shapes[..., 1:, :] - shapes[..., :-1, :]], axis=-2)
    squares = xp.sum(stiffnesses[..., None] * drifts**2, axis=-2)
    participation = xp.sum(masses[..., None] * shapes, axis=-2)  # Γ_i
    return ModalAnalysis(xp.sqrt(squares), participation**2, participation[..., None, :] * shapes)


class ShearBuilding(AbstractSuperstructure):
    """A building of n stories as a superstructure: rigid floors, and stories that deform in shear.

    - `masses`: mass ratios m_j/(N m_c) of the floors, > 0 [–], from the bottom along the last axis
    - `stiffnesses`: stiffness ratios k_j/(N m_c) of the stories below the floors, > 0 [1/s²]
    - `damping`: damping ratios of the modes, ≥ 0 [–]; one value for all modes, or one for each retained mode
    - `modes`: number of modes to retain, the lowest first, 0 … n, by default n. The mass of the other modes
      moves with the beam; `peak_shear` and `peak_floor_acceleration` omit the impulses that act on this mass
      at impacts
    - `heights`: heights of the stories, > 0 [m], for forces in the joints, drift ratios and pictures; None if
      unknown
    - `retained`: second name of the argument `modes`, for `dataclasses.replace`, which uses the names of the
      fields; ignored if `modes` is given

    The property [`rockjax.ShearBuilding.modes`][] holds the retained modes. A [`rockjax.Peak`][] includes
    story drifts and floor accelerations; a history includes them if at least one mode is retained. Raises
    `ValueError` for unequal lengths and for values outside these ranges; traced values are not checked.
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
        self.masses = as_row(owner, "masses", masses, "story")
        self.stiffnesses = as_row(owner, "stiffnesses", stiffnesses, "story")
        self.damping = as_float(damping, f"{owner}: damping")
        self.heights = None if heights is None else as_row(owner, "heights", heights, "story")
        count = self.masses.shape[-1]
        requested = modes if modes is not None else count if retained is None else retained
        self.retained = require_whole(owner, "modes", requested, 0)
        if self.retained > count:
            raise ValueError(f"{owner}: modes must be in 0 … {count}, the number of stories, got {requested}")

    def __check_init__(self):
        owner, count = "ShearBuilding", self.stories
        rows = {"stiffnesses": self.stiffnesses} | ({} if self.heights is None else {"heights": self.heights})
        for name, values in rows.items():
            if len(split_row(values)) != count:
                raise ValueError(
                    f"{owner}: {name} must be as long as masses, which has {count} stories, got "
                    f"{len(split_row(values))}"
                )
        if repeat_scalar(self.damping, 1) is self.damping and len(split_row(self.damping)) != self.retained:
            raise ValueError(
                f"{owner}: damping must be one number or one for each of the {self.retained} retained "
                f"modes, got {len(split_row(self.damping))}"
            )
        require_positive(owner, masses=self.masses, **rows)
        require_not_negative(owner, damping=self.damping)

    @classmethod
    def uniform(cls, stories: int, eta, T, damping: Any = 0.05, modes=None, *, height=None) -> Self:
        """Return a building with equal stories.

        - `stories`: number of stories n ≥ 1
        - `eta`: mass ratio of the building, m_t/(N m_c), > 0 [–]
        - `T`: longest fixed-base period, > 0 [s]
        - `damping`, `modes`: as for [`rockjax.ShearBuilding`][]
        - `height`: height of each story, > 0 [m]; None if unknown

        Raises `ValueError` for values outside these ranges; traced values are not checked.
        """
        count = require_whole("ShearBuilding.uniform", "stories", stories, 1)
        require_positive("ShearBuilding.uniform", eta=eta, T=T)
        eta, T = as_float(eta, "ShearBuilding.uniform: eta"), as_float(T, "ShearBuilding.uniform: T")
        frequency_factor = 2 * math.sin(math.pi / (4 * count + 2))  # ω_1 √(m/k) of equal stories
        mass = eta / count
        ones = np.ones(count)
        heights = None if height is None else as_float(height)[..., None] * ones
        stiffness = mass * (2 * math.pi / (frequency_factor * T)) ** 2
        return cls(mass[..., None] * ones, stiffness[..., None] * ones, damping, modes, heights=heights)

    @property
    def stories(self) -> int:
        """The number of stories."""
        return len(split_row(self.masses))

    @property
    def modes(self) -> Modes:
        """The retained modes. Their `residual` is the mass ratio of the other modes. Raises `ValueError` if
        no mode is retained."""
        analysis, retained = self._analysis(), self.retained
        residual = analysis.eta[..., retained:].sum(axis=-1) if retained < self.stories else 0.0
        return Modes(
            analysis.eta[..., :retained], 2 * math.pi / analysis.omega[..., :retained], self.damping, residual
        )

    @property
    def frequencies(self) -> Array:
        """Fixed-base circular frequencies ω_i of the retained modes [rad/s]."""
        return self._analysis().omega[..., : self.retained]

    @property
    def shapes(self) -> Array:
        """Γ_i φ_ji of the floors j and the retained modes i, (n, modes) [–], (C11). Floor j moves by
        Σ_i Γ_i φ_ji (u_i − u_b) relative to the beam."""
        return self._analysis().shapes[..., : self.retained]

    def _analysis(self) -> ModalAnalysis:
        return modal_analysis(stack_row(self.masses), stack_row(self.stiffnesses))

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
        return stack_row(self.masses).sum(axis=-1)

    @property
    def elastic(self) -> bool:
        return self.retained > 0

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
        return None if self.heights is None else stack_row(self.heights).cumsum(axis=-1)

    def check_heights(self, owner: str, heights: Number) -> None:
        ascending = lambda v: np.diff(v, axis=-1, prepend=-np.inf) > 0
        require(owner, "elevation.top_height", heights, ascending, "ascending from floor to floor")

    def first_moments(self, heights: Number, residual_height: Number) -> tuple[Number | None, Number | None]:
        del residual_height
        floor_moments = stack_row(self.masses) * heights
        total = floor_moments.sum(axis=-1)
        if not self.retained:
            return None, total
        modal_moments = (floor_moments[..., None] * self.shapes).sum(axis=-2)
        return modal_moments, None if self.retained == self.stories else total - modal_moments.sum(axis=-1)

    def split_rows(self) -> Self:
        values: dict[str, Any] = {name: split_row(getattr(self, name)) for name in ("masses", "stiffnesses")}
        values["damping"] = split_unless_scalar(self.damping)
        values["heights"] = None if self.heights is None else split_row(self.heights)
        return with_fields(self, values)

    def without_heights(self) -> Self:
        return self if self.heights is None else with_fields(self, {"heights": None})

    def resolved(self) -> AbstractSuperstructure:
        if not self.retained:
            return Rigid(self.mass_ratio)
        analysis, retained = self._analysis(), self.retained
        residual = None if retained == self.stories else analysis.eta[..., retained:].sum(axis=-1)
        return Oscillators(
            analysis.eta[..., :retained],
            2 * math.pi / analysis.omega[..., :retained],
            stack_row(self.damping),
            residual,
            analysis.shapes[..., :retained],
        )


def superstructure_of(
    eta: Any, T_s: Any = None, zeta: Any = 0.05, stories: int | None = None, modes: int | None = None
):
    """Return a rigid or elastic superstructure, or a building of equal stories.

    - `eta`: mass ratio m_t/(N m_c) [–]
    - `T_s`: longest fixed-base period [s]; None for a rigid superstructure
    - `zeta`: damping ratio [–]; not used if rigid
    - `stories`: number of stories of a building; None for a single oscillator; not used if rigid
    - `modes`: number of modes of a building; None for all; not used without `stories`
    """
    if T_s is None:
        return Rigid(eta)
    if stories is None:
        return Elastic(eta, T_s, zeta)
    return ShearBuilding.uniform(stories, eta, T_s, zeta, modes)
