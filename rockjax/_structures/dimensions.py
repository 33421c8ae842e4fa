"""A podium given by dimensions and masses instead of ratios."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import equinox as eqx
import numpy as np

from rockjax._checks import as_float
from rockjax._restrainers.damper import as_exponent
from rockjax._text.representations import PrintedModule
from rockjax._units import STANDARD_GRAVITY

from .podium import Podium


def _row(values: Any, name: str) -> Any:
    """Return dimensions of all stories or columns (a row) as an array (n,); None stays None, and a single
    height `top_height` stays a number."""
    is_unchanged = values is None or (name == "top_height" and np.ndim(values) == 0)
    return values if is_unchanged else as_float(values, f"Dimensions: {name}")


class Dimensions(PrintedModule):
    """A podium given by dimensions and masses, as for `rockjax.Podium.from_dimensions`.

    - `width`, `height`: full column width 2B and height 2H [m]
    - `column_mass`: mass m_c of one column [kg]; `beam_mass`: mass m_b of the beam [kg]; `top_mass`: mass m_t
      of the superstructure [kg]
    - `columns`: number of columns N, by default the number of `positions`, or 2 without positions
    - `period`, `damping`: period T_s [s] and damping ratio ζ [–] of the superstructure; a superstructure
      given by `top_mass` is rigid if `period` is None
    - `lam`, `restitution`, `g`: as in `rockjax.Podium`
    - `tendon_force`: initial force P₀ of the tendon of each column [N]; `tendon_stiffness`: stiffness K of
      the tendon [N/m]
    - `damper_coefficient`: coefficient C of the damper of each column [N(s/m)^ν]; `damper_exponent`: exponent
      ν of the damper [–]
    - `inertance`: inertance b of the inerter of each column [kg]. Tendon, damper and inerter span both joints
      of the column, from the ground to the beam
    - `stories`: number of stories of a building with equal stories; None for other structures
    - `story_masses`: masses of the floors, from the bottom [kg]; `story_stiffnesses`: stiffnesses of the
      stories [N/m]; `story_heights`: heights of the stories [m]
    - `modes`: number of modes of the building in the model; None for all
    - `positions`: positions of the columns along the motion [m]; `beam_depth`, `top_height`,
      `residual_height`: as in `rockjax.Podium.from_dimensions` [m]
    - `end_radius`: radius of round ends of the columns [m]

    The fields are names of design variables, and of axes and spreads of `rockjax.grid` and
    `rockjax.ensemble`. Names for one story end with the number of the story, counted from the bottom, such as
    `story_mass_1` [kg] and `story_stiffness_2` [N/m]. The first of `positions` is `position_1`,
    and the first of several values of `top_height` is `top_height_1`.

    Raises `ValueError` for values that do not define a podium.
    """

    width: Any
    height: Any
    column_mass: Any
    beam_mass: Any = 0.0
    columns: int | None = eqx.field(static=True, default=None)
    top_mass: Any = 0.0
    period: Any = None
    damping: Any = 0.05
    lam: Any = 1 / 3
    restitution: Any = "paper"
    g: Any = STANDARD_GRAVITY
    tendon_force: Any = 0.0
    tendon_stiffness: Any = 0.0
    damper_coefficient: Any = 0.0
    damper_exponent: Any = eqx.field(
        converter=functools.partial(as_exponent, label="Dimensions: damper_exponent"), default=1.0
    )
    inertance: Any = 0.0
    stories: int | None = eqx.field(static=True, default=None)
    story_masses: Any = eqx.field(converter=functools.partial(_row, name="story_masses"), default=None)
    story_stiffnesses: Any = eqx.field(
        converter=functools.partial(_row, name="story_stiffnesses"), default=None
    )
    story_heights: Any = eqx.field(converter=functools.partial(_row, name="story_heights"), default=None)
    modes: int | None = eqx.field(static=True, default=None)
    positions: Any = eqx.field(converter=functools.partial(_row, name="positions"), default=None)
    beam_depth: Any = 0.0
    top_height: Any = eqx.field(converter=functools.partial(_row, name="top_height"), default=0.0)
    residual_height: Any = 0.0
    end_radius: Any = 0.0

    def __check_init__(self):
        self.podium()

    def podium(self) -> Podium:
        """Return the podium of these dimensions."""
        return Podium.from_dimensions(
            **{field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        )

    def replace(self, **changes) -> Dimensions:
        """Return a variant with some fields changed, like `dataclasses.replace`."""
        return dataclasses.replace(self, **changes)
