"""The elevation of a podium: positions of its columns, and heights of the masses on them.

A row is an array with one value for each column, mode or floor along its last axis.
"""

from __future__ import annotations

from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np

from rockjax._checks import as_float, concrete, require_finite, require_not_negative
from rockjax._text.representations import PrintedModule
from rockjax._tree import Module
from rockjax._types import Array, Number

from .modes import (
    Row,
    as_row,
    repeat_scalar,
    split_row,
    split_unless_scalar,
    stack_row,
    with_fields,
)
from .superstructures import AbstractSuperstructure

SAME_LINE = 1e-9  # largest distance of columns in one line, divided by the total span


class Elevation(PrintedModule):
    """Positions of the columns of a podium, and heights of the masses on them.

    - `columns`: positions x_i of the N ≥ 2 columns in the direction of motion [m]; the last axis has length
      N. Columns in one line across the plane of motion have equal positions. The centres of all masses are
      assumed to be above the mean position of the columns
    - `beam_depth`: depth D of the beam, ≥ 0 [m]; the mass of the beam is at D/2
    - `top_height`: height of the superstructure above the top of the beam [m]. For [`rockjax.Elastic`][] and
      [`rockjax.Rigid`][], give the height of their mass. For [`rockjax.Modes`][], give one height for each
      mode; heights of higher modes may be negative. For [`rockjax.ShearBuilding`][], give one height for each
      floor, ascending, or 0 if the building has its own `heights`
    - `residual_height`: height of the residual mass of [`rockjax.Modes`][] above the top of the beam [m]

    `top_height` has no effect without a superstructure, and `residual_height` none unless the superstructure
    is a [`rockjax.Modes`][] with a residual mass. An elevation affects only forces in the joints, not the
    motion. Raises `ValueError` for values outside these ranges, for fewer than two columns, or if all columns
    have the same position; traced values are not checked.
    """

    rows: ClassVar[tuple[str, ...]] = ("columns", "top_height")

    columns: Row
    beam_depth: Number
    top_height: Any  # a scalar, or a row over modes or floors
    residual_height: Number
    # Distance by which the tops of the columns of the model are higher than in reality [m]: taller columns
    # with flat ends replace columns with round ends. None if the real columns have flat ends.
    _raised: Number | None = None

    def __init__(
        self,
        columns: Any,
        beam_depth: Any = 0.0,
        top_height: Any = 0.0,
        residual_height: Any = 0.0,
        _raised: Any = None,
    ):
        self.columns = as_row("Elevation", "columns", columns, "column")
        self.beam_depth = as_float(beam_depth, "Elevation: beam_depth")
        self.top_height = as_float(top_height, "Elevation: top_height")
        self.residual_height = as_float(residual_height, "Elevation: residual_height")
        self._raised = None if _raised is None else as_float(_raised, "Elevation: _raised")

    def __check_init__(self):
        owner = "Elevation"
        if len(split_row(self.columns)) < 2:
            raise ValueError(f"{owner}: columns must hold the positions of 2 columns or more, got one")
        require_finite(owner, columns=self.columns, residual_height=self.residual_height)
        require_finite(owner, top_height=self.top_height)
        require_not_negative(owner, beam_depth=self.beam_depth)
        positions = concrete(self.columns)
        if positions is not None and np.any(np.ptp(positions, axis=-1) <= 0):
            raise ValueError(
                f"{owner}: columns must stand in two lines or more, got all of them at "
                f"{float(positions.reshape(-1)[0]):g} m"
            )

    @property
    def count(self) -> int:
        """The number N of columns."""
        return len(split_row(self.columns))

    @property
    def offsets(self) -> Array:
        """Positions of the columns from their mean [m]."""
        positions = stack_row(self.columns)
        return positions - positions.mean(axis=-1, keepdims=True)

    @property
    def core_distance(self) -> Number:
        """Core distance ℓ_p = Σx_i²/(N max|x_i|) of the columns [m]. All columns are in compression if the
        resultant of their axial forces is within ±ℓ_p of their mean position."""
        return _core_distance(self.offsets)

    def check(self, superstructure: AbstractSuperstructure | None, width: Number) -> None:
        """Raise `ValueError` for heights that do not fit the superstructure, and for columns that overlap.

        - `superstructure`: superstructure of the podium
        - `width`: width of a column [m]
        """
        _check_overlap(concrete(stack_row(self.columns)), concrete(width))
        count = None if superstructure is None else superstructure.height_count
        if superstructure is None or count is None:
            return
        class_name, height = type(superstructure).__name__, self.top_height
        if superstructure.own_heights is not None:
            given = concrete(height)  # None inside jit, after a check outside
            if given is not None and np.any(given):
                raise ValueError(
                    f"Podium: the {class_name} has its own heights; give either these or elevation.top_height"
                )
            return
        height_count = len(split_row(repeat_scalar(height, 1)))
        if height_count != count:
            raise ValueError(
                f"Podium: elevation.top_height must hold {count} heights, one for each mode or floor of the "
                f"{class_name} (or give a building its own heights), got {height_count}"
            )
        superstructure.check_heights("Podium", height)

    def split_rows(self, superstructure: AbstractSuperstructure | None) -> Elevation:
        """Return the elevation with each row, such as `columns`, as a tuple of its elements, so that every
        leaf has one value per podium of a batch."""
        if isinstance(self.columns, tuple):
            return self
        height = self.top_height
        if superstructure is not None and superstructure.height_count is not None:
            height = split_unless_scalar(height)
        return with_fields(self, {"columns": split_row(self.columns), "top_height": height})

    def resolved(self, gamma: Number, superstructure: AbstractSuperstructure | None) -> Arms:
        """Return the elevation in the form that the engine uses.

        - `gamma`: mass ratio of the beam
        - `superstructure`: superstructure of the podium
        """
        depth, offsets, raised = self.beam_depth, self.offsets, self._raised
        beam_moment, carried_height = 0.5 * gamma * depth, self.residual_height + depth
        if superstructure is None:
            return Arms(offsets, beam_moment, None, raised)
        height = self.top_height if superstructure.own_heights is None else superstructure.own_heights
        if superstructure.height_count is not None:
            height, depth = stack_row(repeat_scalar(height, superstructure.height_count)), depth[..., None]
        modal_moments, carried = superstructure.first_moments(height + depth, carried_height)
        beam_moment = beam_moment if carried is None else beam_moment + carried
        return Arms(offsets, beam_moment, modal_moments, raised)


class Arms(Module):
    """An elevation in the form that the engine uses. Heights are above the real columns.

    - `offsets`: positions of the columns from their mean, shape (N,) [m]
    - `beam`: γ_b h_b + η_r h_r [m], the mass ratio times the height above the columns, summed over the beam
      and the other masses that move with the beam
    - `modes`: η_i h_i [m], the mass ratio times the height above the columns, for each mode; None if nothing
      vibrates
    - `raised`: distance d by which the tops of the columns of the model are higher than the tops of the real
      columns with round ends [m]; None for flat ends
    """

    offsets: Array
    beam: Number
    modes: Number | None
    raised: Number | None = None

    @property
    def mean_square(self) -> Number:
        """r_x² = Σx_i²/N [m²]."""
        return _mean_square(self.offsets)

    @property
    def core_distance(self) -> Number:
        """Core distance ℓ_p of the columns [m]."""
        return _core_distance(self.offsets)

    def lever(self, flat: Number, lean: Number) -> Number:
        """Return the lever of the axial force in a top joint about the centre line of a column [m]. It
        replaces χB in (F8), and is positive against the direction of motion.

        For round ends, (R5) replaces the columns by taller columns with flat ends. The result belongs to the
        real columns: to first order it is σB + r_cθ of (R4) while rocking, and exactly ξB in full contact.

        - `flat`: the lever for columns with flat ends, χB [m]
        - `lean`: as in `MeanForces`, tan ψ while rocking and ξ tan α in full contact [–]
        """
        return flat if self.raised is None else flat - self.raised * lean


def _mean_square(offsets: Array) -> Number:
    return jnp.mean(offsets**2, axis=-1)


def _core_distance(offsets: Array) -> Number:
    return _mean_square(offsets) / jnp.max(jnp.abs(offsets), axis=-1)


def _check_overlap(positions: np.ndarray | None, width: np.ndarray | None) -> None:
    """Raise `ValueError` for two lines of columns closer than the width of a column."""
    if positions is None or width is None:
        return
    ordered = np.sort(positions, axis=-1)
    gaps, span = np.diff(ordered, axis=-1), np.ptp(ordered, axis=-1)[..., None]
    is_other_line = gaps > SAME_LINE * span
    overlaps = is_other_line & (gaps < np.asarray(width)[..., None] * (1 - SAME_LINE))
    if np.any(overlaps):
        least = float(np.min(np.where(overlaps, gaps, np.inf)))
        raise ValueError(
            f"Podium: elevation.columns must be at least the width of a column apart, or equal for columns "
            f"of the same line; got {least:g} m between two lines of columns {float(np.max(width)):g} m wide"
        )
