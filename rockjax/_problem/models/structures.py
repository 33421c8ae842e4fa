"""Models of the tables of a problem file for structures, and for blocks and oscillators on their floors.

The keys and ranges of parameters are taken from the entries of `_parameters/registry.py`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag, create_model, model_validator

from rockjax._parameters import registry

from .fields import (
    STRUCTURE,
    Count,
    DampingRatios,
    Heights,
    Index,
    Keys,
    NotNegative,
    NotNegatives,
    Number,
    Numbers,
    Positive,
    Positives,
    Text,
    described_as,
    key,
    require_one,
)


def type_of(entry: registry.Parameter) -> Any:
    """Return the type of the key for a parameter. The type includes the range of valid values."""
    if entry.is_integer:
        return Count
    closed, (low, high) = entry.range.closed, entry.range[:2]
    ends = {"ge" if closed[0] else "gt": low, "le" if closed[1] else "lt": high}
    limits: dict[str, Any] = {name: end for name, end in ends.items() if math.isfinite(end)}
    number = Annotated[float, Field(**limits)]
    if entry.name == "restitution":
        return Annotated[Literal["paper", "compatible"] | number, described_as(_LAW)]
    accepted = f"a number {entry.range.text}".rstrip()
    return Annotated[number, described_as(f"{accepted}; {entry.note}" if entry.note else accepted)]


_LAW = "'paper', 'compatible' or a factor in [0, 1]"
# Texts that follow the heading of a parameter in the description of its key.
_NOTES = {
    "alpha": ", instead of tan_alpha",
    "restitution": ": paper, Eq. (27); compatible, with Eq. (26); or a number",
    "columns": "; by default the number of positions, or 2",
}


def make_field(name: str, entry: registry.Parameter, needed: bool = False) -> Any:
    """Return the type and the pydantic field of the key for a parameter.

    - `name`: name of the parameter
    - `entry`: its entry in the registry
    - `needed`: whether the key is required
    """
    # `damping` has no option of its own. The option --zeta sets `zeta` in a structure by ratios, and
    # `damping` in a structure by dimensions.
    panel = "" if name == "damping" or entry.attribute_path.count(".") > 1 else STRUCTURE
    note = _NOTES.get(name) or (f"; {entry.note}" if entry.note else "")
    key_type, meaning = type_of(entry), f"{entry.heading}{note}."
    return (key_type, key(..., meaning, panel)) if needed else (key_type | None, key(None, meaning, panel))


def make_model(entries: Mapping[str, registry.Parameter], *needed: str) -> Any:
    """Return a model with a key for each parameter in `entries`. The keys in `needed` are required."""
    fields: Any = {name: make_field(name, entry, name in needed) for name, entry in entries.items()}
    return create_model("Parameters", __base__=Keys, **fields)


def _stored_in(*parts: str) -> dict[str, registry.Parameter]:
    """Return the structural parameters with an attribute path, such as `superstructure.T_s`, that begins with
    one of `parts`. Width and height are left out."""
    entries = {
        name: entry for name, entry in registry.STRUCTURE.items() if name not in registry.WIDTH_AND_HEIGHT
    }
    return {name: entry for name, entry in entries.items() if entry.attribute_path.partition(".")[0] in parts}


class Superstructure(make_model(_stored_in("superstructure") | registry.BUILDING, "eta")):
    """A superstructure with the mass ratio eta. Without the period T_s, it is rigid. With T_s and `stories`,
    it is a building with equal stories."""

    @model_validator(mode="after")
    def _check(self) -> Superstructure:
        for name in ("zeta", "stories"):
            if getattr(self, name) is not None and self.T_s is None:
                raise ValueError(f"{name} needs T_s; without it the superstructure is rigid")
        return self


class ModesOfSuperstructure(Keys):
    """A superstructure that is defined by its modes."""

    eta: NotNegatives = key(..., "Mass ratios of the modes [–].")
    T: Positives = key(..., "Periods of the modes [s].")
    zeta: DampingRatios | None = key(None, "Damping ratios, or one for all modes [–].")
    residual: NotNegative | None = key(
        None, "Mass ratio of the residual mass, which moves with the beam [–]."
    )


class Building(Keys):
    """A building that is defined floor by floor, from the bottom."""

    masses: Positives = key(..., "Mass ratios of the floors [–].")
    stiffnesses: Positives = key(..., "Stiffnesses of the stories divided by the mass of all columns [1/s²].")
    damping: DampingRatios | None = key(None, "Damping ratios of the modes, or one for all modes [–].")
    modes: Index | None = key(None, "Number of modes in the analysis; by default all.")
    heights: Positives | None = key(None, "Heights of the stories [m].")


_COLUMNS = "Positions of the columns along the motion [m]; columns in a line across the motion: equal values."
_DEPTH = "Depth of the beam [m]."
_HEIGHTS = "Height of the superstructure above the beam [m]; a list for several modes or floors."
_RESIDUAL = "Height of the residual mass of modes above the beam [m]."


class Elevation(Keys):
    """Positions of the columns and heights of the masses, as in `rockjax.Elevation`."""

    columns: Numbers = key(..., _COLUMNS)
    beam_depth: NotNegative | None = key(None, _DEPTH)
    top_height: Heights | None = key(None, _HEIGHTS)
    residual_height: Number | None = key(None, _RESIDUAL)


def _superstructure_tag(given: Any) -> str:
    """Return the tag of the model that reads the table of a superstructure."""
    # Errors of pydantic state the path to a value in keys and tags. Messages omit the tags; to tell them from
    # keys, no tag may equal a key.
    tags = {"masses": "Building", "T": "Modes"}
    return next((tags[name] for name in tags if isinstance(given, dict) and name in given), "one")


class ByRatios(
    make_model(_stored_in("alpha", "", "R", "gamma", "lam", "restitution", "g", "restrainers"), "R")
):
    """A structure that is defined by ratios."""

    superstructure: (
        Annotated[
            Annotated[Superstructure, Tag("one")]
            | Annotated[ModesOfSuperstructure, Tag("Modes")]
            | Annotated[Building, Tag("Building")],
            Discriminator(_superstructure_tag),
        ]
        | None
    ) = key(None, "Superstructure on the beam; by default none.")
    elevation: Elevation | None = key(None, "Positions of columns and masses, for forces in the joints.")

    @model_validator(mode="after")
    def _check(self) -> ByRatios:
        require_one(self.as_arguments(), "alpha", "tan_alpha")
        return self


class ByDimensions(make_model(registry.DIMENSIONS | registry.BUILDING, "width", "height", "column_mass")):
    """A structure that is defined by dimensions, as in `rockjax.Podium.from_dimensions`."""

    story_masses: Positives | None = key(None, "Masses of the floors of a building from the bottom [kg].")
    story_stiffnesses: Positives | None = key(None, "Stiffnesses of the stories [N/m].")
    story_heights: Positives | None = key(None, "Heights of the stories [m].")
    modes: Index | None = key(None, "Number of modes in the analysis; by default all.")
    # The options of these keys also set the keys of `[structure.elevation]` in a structure by ratios.
    positions: Numbers | None = key(None, _COLUMNS, STRUCTURE)
    top_height: Heights | None = key(None, _HEIGHTS, STRUCTURE)


def _structure_tag(given: Any) -> str:
    """Return the tag of the model that reads the table of a structure."""
    has_dimensions = isinstance(given, dict) and any(
        name in given for name in (*registry.WIDTH_AND_HEIGHT, "column_mass")
    )
    return "dimensions" if has_dimensions and "R" not in given else "ratios"


Structure = Annotated[
    Annotated[ByRatios, Tag("ratios")] | Annotated[ByDimensions, Tag("dimensions")],
    Discriminator(_structure_tag),
]


Level = Annotated[Literal["deck"] | Count, described_as("'deck' or the number of a story ≥ 1")]
_LEVEL = "Floor: deck, or the number of a story from the bottom."
_NAME = "Name in tables and reports; by default the name of the table and a number."


class Contents(Keys):
    """A light block on a floor, as in `rockjax.Contents`. Either alpha and R, or width and height, define
    it."""

    name: Text | None = key(None, _NAME)
    alpha: Annotated[float, Field(gt=0, lt=math.pi / 2)] | None = key(None, "Slenderness α_c [rad].")
    R: Positive | None = key(None, "Half diagonal R_c [m].")
    width: Positive | None = key(None, "Full width [m], instead of alpha and R.")
    height: Positive | None = key(None, "Full height [m], with the width.")
    lam: NotNegative | None = key(None, "Inertia factor λ_c [–]; by default 1/3, a uniform block.")
    restitution: (
        Annotated[
            Literal["paper"] | Annotated[float, Field(ge=0, le=1)],
            described_as("'paper' or a factor in [0, 1]"),
        ]
        | None
    ) = key(None, "Law of the block's impacts: paper, or a velocity factor [–].")
    level: Level = key("deck", _LEVEL)
    vertical: bool | None = key(None, "Whether the vertical motion of the floor is applied; by default true.")
    overturn_ratio: Positive | None = key(None, "|φ|/α_c that counts as overturning [–]; by default 1.")

    @model_validator(mode="after")
    def _check(self) -> Contents:
        first = require_one(self.as_arguments(), "alpha", "width")
        pair = first, {"alpha": "R", "width": "height"}[first]
        other = [name for name in ("R", "height") if name not in pair and getattr(self, name) is not None]
        if getattr(self, pair[1]) is None or other:
            raise ValueError("needs alpha and R, or width and height")
        return self


class Oscillator(Keys):
    """A light linear oscillator on a floor, as in `rockjax.Oscillator`."""

    name: Text | None = key(None, _NAME)
    period: Positive = key(..., "Natural period T_e [s].")
    damping: Annotated[float, Field(ge=0, lt=1), described_as("a number in [0, 1)")] = key(
        0.05, "Damping ratio ζ [–]."
    )
    level: Level = key("deck", _LEVEL)
    direction: Literal["horizontal", "vertical"] = key("horizontal", "Direction of the motion.")
