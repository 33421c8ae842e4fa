"""Models of problem files: type, range and description of each key.

Keys for parameters are generated from `_parameters/table.py`. Error messages, the JSON schema, the page on
problem files and the options of the command line are generated from these models. This module does not import
JAX.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    Strict,
    Tag,
    ValidationError,
    WrapValidator,
    create_model,
    model_validator,
)
from pydantic_core import PydanticCustomError

from rockjax._excitations.names import PULSE_CLASSES
from rockjax._parameters import table
from rockjax._units import RecordUnit

STRUCTURE, MOTION, GRID, ACCURACY, OUTPUT = "Structure", "Ground motion", "Grid", "Accuracy", "Output"
STATISTICS, CURVE, HAZARD, MACHINES = "Statistics", "Fragility", "Hazard", "Machines"


class Flag(NamedTuple):
    """A command-line option for a key: its panel in the help, and its name if it differs from the key.

    It is stored as `json_schema_extra` of the field, which pydantic calls with the schema; the call leaves
    the schema unchanged.
    """

    panel: str
    name: str = ""

    def __call__(self, schema: Any) -> None:
        """Leave the schema unchanged."""


def key(default: Any, meaning: str, panel: str = "", name: str = "") -> Any:
    """Return the field of a key; with a panel, the key is also an option of the command line.

    - `default`: default value, `...` for a required key; `meaning`: description of the key, with the unit
    - `panel`: panel of the option in the help; `name`: name of the option if it differs from the key
    """
    return Field(default, description=meaning, json_schema_extra=Flag(panel, name) if panel else None)


def described_as(words: str) -> WrapValidator:
    """Return a validator whose errors read "must be {words}"."""

    def check(value: Any, handler: Any) -> Any:
        try:
            return handler(value)
        except ValidationError:
            raise PydanticCustomError("words", "must be {words}", {"words": words}) from None

    return WrapValidator(check)


def satisfying(holds: Callable[[Any], bool]) -> AfterValidator:
    """Return a validator that rejects values for which `holds` is false."""

    def check(value: Any) -> Any:
        if not holds(value):
            raise ValueError
        return value

    return AfterValidator(check)


Number = Annotated[float, described_as("a number")]
Positive = Annotated[float, Field(gt=0), described_as("a number > 0")]
NotNegative = Annotated[float, Field(ge=0), described_as("a number >= 0")]
Count = Annotated[int, Field(ge=1), described_as("a whole number ≥ 1")]
Index = Annotated[int, Field(ge=0), described_as("a whole number ≥ 0")]
Points = Annotated[int, Field(ge=2), described_as("a whole number ≥ 2")]
Label = Annotated[int | str, described_as("a whole number or text")]
Numbers = Annotated[list[Number], Field(min_length=1), described_as("a list of numbers")]
Positives = Annotated[list[Positive], Field(min_length=1), described_as("a list of numbers > 0")]
NotNegatives = Annotated[list[NotNegative], Field(min_length=1), described_as("a list of numbers >= 0")]
OneOrMore = Annotated[float | Numbers, described_as("a number or a list of numbers")]
Periods = Annotated[Positive | Positives, described_as("a number > 0 or a list of such numbers")]
Shares = Annotated[NotNegative | NotNegatives, described_as("a number >= 0 or a list of such numbers")]
Share = Annotated[float, Field(gt=0, lt=1), described_as("a number in (0, 1)")]
_ENDS = "two numbers [lowest, highest] with"
Ends = Annotated[tuple[float, float], Strict(False)]
Bounds = Annotated[Ends, described_as("two numbers [lowest, highest]")]
Frequencies = Annotated[
    Ends, satisfying(lambda y: 0 < y[0] < y[1]), described_as(f"{_ENDS} 0 < lowest < highest")
]
Amplitudes = Annotated[
    Ends, satisfying(lambda y: 0 <= y[0] < y[1]), described_as(f"{_ENDS} 0 <= lowest < highest")
]
Levels = Annotated[
    Ends, satisfying(lambda y: 0 < y[0] <= y[1]), described_as(f"{_ENDS} 0 < lowest <= highest")
]
if TYPE_CHECKING:
    PulseName = str
else:
    PulseName = Literal[tuple(PULSE_CLASSES)]


class Keys(BaseModel):
    """A table of a problem file; unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True, defer_build=True)

    @model_validator(mode="before")
    @classmethod
    def _check_names(cls, given: Any) -> Any:
        valid = [field.alias or name for name, field in cls.model_fields.items()]
        for name in given if isinstance(given, dict) else ():
            if name not in valid:
                near = difflib.get_close_matches(str(name), valid, 1)
                hint = f"did you mean {near[0]}?" if near else f"valid keys are {', '.join(valid)}"
                raise PydanticCustomError("unknown", "unknown key; {hint}", {"hint": hint, "key": str(name)})
        return given

    def as_arguments(self, *without: str) -> dict[str, Any]:
        """Return the keys and values that the table has, except the keys in `without`."""
        names = [name for name in type(self).model_fields if name in self.model_fields_set - set(without)]
        return {name: getattr(self, name) for name in names if getattr(self, name) is not None}


def require_one(given: Mapping[str, Any], *names: str) -> str:
    """Return which of the keys `names` is given. Raises `ValueError` unless exactly one is given."""
    present = [name for name in names if given.get(name) is not None]
    if len(present) != 1:
        raise ValueError(f"needs {' or '.join(names)}" + (", not both" if present else ""))
    return present[0]


def type_of(entry: table.Parameter) -> Any:
    """Return the type of the key of a parameter, with its range."""
    if entry.is_integer:
        return Count
    closed, (low, high) = entry.range.closed, entry.range[:2]
    ends = {"ge" if closed[0] else "gt": low, "le" if closed[1] else "lt": high}
    limits: dict[str, Any] = {name: end for name, end in ends.items() if math.isfinite(end)}
    kind = Annotated[float, Field(**limits)]
    if entry.name == "restitution":
        return Annotated[Literal["paper", "compatible"] | kind, described_as(_LAW)]
    words = f"a number {entry.range.words}".rstrip()
    return Annotated[kind, described_as(f"{words}; {entry.note}" if entry.note else words)]


_LAW = "'paper', 'compatible' or a factor in [0, 1]"
_NOTES = {
    "alpha": ", instead of tan_alpha",
    "restitution": ": paper, Eq. (27); compatible, with Eq. (26); or a number",
    "columns": "; by default the number of positions, or 2",
}


def make_field(name: str, entry: table.Parameter, needed: bool = False) -> Any:
    """Return the type and the field of a parameter; `needed`: whether the key is required."""
    # `damping` has no option, because --zeta sets both damping ratios.
    panel = "" if name == "damping" or entry.place.count(".") > 1 else STRUCTURE
    note = _NOTES.get(name) or (f"; {entry.note}" if entry.note else "")
    kind, meaning = type_of(entry), f"{entry.heading}{note}."
    return (kind, key(..., meaning, panel)) if needed else (kind | None, key(None, meaning, panel))


def make_model(entries: Mapping[str, table.Parameter], *needed: str) -> Any:
    """Return a model with a key for each parameter, of which those in `needed` are required."""
    fields: Any = {name: make_field(name, entry, name in needed) for name, entry in entries.items()}
    return create_model("Parameters", __base__=Keys, **fields)


def _stored_in(*places: str) -> dict[str, table.Parameter]:
    """Return the parameters of a structure that are stored in these attributes of a podium or of its parts,
    except width and height."""
    entries = {name: entry for name, entry in table.STRUCTURE.items() if name not in table.WIDTH_AND_HEIGHT}
    return {name: entry for name, entry in entries.items() if entry.place.partition(".")[0] in places}


class Superstructure(make_model(_stored_in("superstructure") | table.BUILDING, "eta")):
    """A superstructure. Without T_s it is rigid; with `stories` its stories are equal."""

    @model_validator(mode="after")
    def _check(self) -> Superstructure:
        for name in ("zeta", "stories"):
            if getattr(self, name) is not None and self.T_s is None:
                raise ValueError(f"{name} needs T_s; without it the superstructure is rigid")
        return self


class ModesOfSuperstructure(Keys):
    """A superstructure by its modes."""

    eta: NotNegatives = key(..., "Mass ratios of the modes [–].")
    T: Positives = key(..., "Periods of the modes [s].")
    zeta: Shares | None = key(None, "Damping ratios, or one for all modes [–].")
    residual: NotNegative | None = key(None, "Ratio of the residual mass, which moves with the beam [–].")


class Building(Keys):
    """A building, floor by floor from the bottom."""

    masses: Positives = key(..., "Mass ratios of the floors [–].")
    stiffnesses: Positives = key(..., "Stiffnesses of the stories divided by the mass of all columns [1/s²].")
    damping: Shares | None = key(None, "Damping ratios of the modes, or one for all modes [–].")
    modes: Index | None = key(None, "Number of modes in the analysis; by default all.")
    heights: Positives | None = key(None, "Heights of the stories [m].")


_COLUMNS = "Positions of the columns along the motion [m]; columns in a line across it have equal positions."
_HEIGHTS = "Height of the superstructure above the beam [m]; a list for several modes or floors."
_RESIDUAL = "Height of the residual mass of modes above the beam [m]."


class Elevation(Keys):
    """Positions of the columns and heights of the masses, as `rockjax.Elevation`."""

    columns: Numbers = key(..., _COLUMNS)
    beam_depth: NotNegative | None = key(None, "Depth of the beam [m].")
    top_height: OneOrMore | None = key(None, _HEIGHTS)
    residual_height: Number | None = key(None, _RESIDUAL)


def _top(given: Any) -> str:
    tags = {"masses": "Building", "T": "Modes"}  # tags differ from keys, so that messages omit them
    return next((tags[name] for name in tags if isinstance(given, dict) and name in given), "one")


class ByRatios(
    make_model(_stored_in("alpha", "", "R", "gamma", "lam", "restitution", "g", "restrainers"), "R")
):
    """A structure by ratios."""

    superstructure: (
        Annotated[
            Annotated[Superstructure, Tag("one")]
            | Annotated[ModesOfSuperstructure, Tag("Modes")]
            | Annotated[Building, Tag("Building")],
            Discriminator(_top),
        ]
        | None
    ) = key(None, "Superstructure on the beam; by default none.")
    elevation: Elevation | None = key(None, "Positions of columns and masses, for forces in the joints.")

    @model_validator(mode="after")
    def _check(self) -> ByRatios:
        require_one(self.as_arguments(), "alpha", "tan_alpha")
        return self


class ByDimensions(make_model(table.DIMENSIONS | table.BUILDING, "width", "height", "column_mass")):
    """A structure by dimensions, as `rockjax.Podium.from_dimensions`."""

    story_masses: Positives | None = key(None, "Masses of the floors of a building from the bottom [kg].")
    story_stiffnesses: Positives | None = key(None, "Stiffnesses of the stories [N/m].")
    story_heights: Positives | None = key(None, "Heights of the stories [m].")
    modes: Index | None = key(None, "Number of modes in the analysis; by default all.")
    positions: Numbers | None = key(None, _COLUMNS)
    beam_depth: NotNegative | None = key(None, "Depth of the beam, with positions [m].")
    top_height: OneOrMore | None = key(None, _HEIGHTS)
    residual_height: Number | None = key(None, _RESIDUAL)


def _structure(given: Any) -> str:
    """Return the tag of the model of a structure."""
    has_dimensions = isinstance(given, dict) and any(
        name in given for name in (*table.WIDTH_AND_HEIGHT, "column_mass")
    )
    return "dimensions" if has_dimensions and "R" not in given else "ratios"


Structure = Annotated[
    Annotated[ByRatios, Tag("ratios")] | Annotated[ByDimensions, Tag("dimensions")], Discriminator(_structure)
]


Level = Annotated[Literal["deck"] | Count, described_as("'deck' or the number of a story ≥ 1")]
_LEVEL = "Floor: deck, or the number of a story from the bottom."
_NAME = "Name in tables and reports; by default its kind and its number."


class Contents(Keys):
    """A light block on a floor, by alpha and R or by width and height, as `rockjax.Contents`."""

    name: str | None = key(None, _NAME)
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
    ) = key(None, "Law of its impacts: paper, or a factor [–].")
    level: Level = key("deck", _LEVEL)
    vertical: bool | None = key(None, "Whether the vertical motion of the floor acts; by default true.")
    overturn_ratio: Positive | None = key(None, "|φ|/α_c that counts as overturning [–]; by default 1.")

    @model_validator(mode="after")
    def _check(self) -> Contents:
        pair = ("alpha", "R") if require_one(self.as_arguments(), "alpha", "width") == "alpha" else _SIZES
        other = [name for name in ("R", "height") if name not in pair and getattr(self, name) is not None]
        if getattr(self, pair[1]) is None or other:
            raise ValueError("needs alpha and R, or width and height")
        return self


_SIZES = "width", "height"


class Oscillator(Keys):
    """A light linear oscillator on a floor, as `rockjax.Oscillator`."""

    name: str | None = key(None, _NAME)
    period: Positive = key(..., "Natural period T_e [s].")
    damping: Annotated[float, Field(ge=0, lt=1), described_as("a number in [0, 1)")] = key(
        0.05, "Damping ratio ζ [–]."
    )
    level: Level = key("deck", _LEVEL)
    direction: Literal["horizontal", "vertical"] = key("horizontal", "Direction of the motion.")


class Pulses(Keys):
    """Pulses. Lists of amplitudes and periods must have equal lengths; a single value applies to all."""

    kind: PulseName = key("ricker", "Kind of the pulse.", MOTION, "--pulse")
    acceleration_ratio: OneOrMore | None = key(None, "Amplitude of the pulse a_p/(g tan α) [–].", MOTION)
    a_p: OneOrMore | None = key(None, "Amplitude of the pulse a_p [m/s²], instead of the ratio.", MOTION)
    T_p: Periods | None = key(None, "Period of the pulse T_p [s].", MOTION)
    frequency_ratio: Periods | None = key(None, "Frequency ω_p/p [–], instead of the period.", MOTION)
    vertical_ratio: Number | None = key(
        None, "Ratio of vertical to horizontal ground acceleration [–].", MOTION
    )

    @model_validator(mode="after")
    def _check(self) -> Pulses:
        given = self.as_arguments()
        pair = require_one(given, "a_p", "acceleration_ratio"), require_one(given, "T_p", "frequency_ratio")
        a_p, T_p = (len(y) if isinstance(y, list) else 1 for y in (given[name] for name in pair))
        if a_p > 1 and T_p > 1 and a_p != T_p:
            raise ValueError(
                f"has {a_p} amplitudes and {T_p} periods; give lists of equal length, or a single value "
                "of one"
            )
        return self


class _Recorded(Keys):
    """Keys for reading files of records."""

    units: RecordUnit | None = key(None, "Unit of the samples, if the file does not state it.", MOTION)
    dt: Positive | None = key(None, "Sampling interval [s], if the file does not state it.", MOTION)
    component: Label | None = key(None, "Number or name of the channel, if there are several.", MOTION)
    scale: Number | None = key(None, "Factor on the record [–]; by default 1.", MOTION)
    vertical_ratio: Number | None = key(None, "Ratio of vertical to horizontal ground acceleration [–].")


class Record(_Recorded):
    """One record from a file."""

    file: str = key(..., "File of a record: .AT2, .V2, text, .npy …", MOTION, "--record")
    vertical: str | None = key(None, "File of the record's vertical component.", MOTION)
    vertical_component: Label | None = key(None, "Number or name of the channel of the vertical component.")

    @model_validator(mode="after")
    def _check(self) -> Record:
        if self.vertical is None and self.vertical_component is not None:
            raise ValueError("vertical_component needs vertical, the file of the vertical record")
        if self.vertical is not None and self.vertical_ratio is not None:
            raise ValueError("has both vertical_ratio and a vertical record; give one of them")
        return self


class Suite(_Recorded):
    """All records of a folder or of a table."""

    suite: str = key(..., "Folder or table (suite.csv) of records, relative to the problem file.")
    pattern: str | None = key(None, "Pattern of the files in a folder, such as '*.AT2'.", MOTION)
    paired: bool | None = key(None, "Combine horizontal and vertical records of each station.", MOTION)

    @model_validator(mode="after")
    def _check(self) -> Suite:
        if self.paired and self.vertical_ratio is not None:
            raise ValueError("has both vertical_ratio and a vertical record; give one of them")
        return self


class Synthetic(Keys):
    """Synthetic motions: filtered noise under an envelope."""

    synthetic: Count = key(20, "Number of motions.", MOTION, "--count")
    seed: Index = key(0, "Seed of the random numbers; the same seed gives the same motions.", MOTION)
    dt: Positive = key(0.01, "Sampling interval [s].", MOTION)
    duration: Positive = key(20.0, "Duration [s].", MOTION)
    pga: Positive = key(2.94, "Peak acceleration of the noise [m/s²].", MOTION)
    omega_g: Positive = key(15.0, "Frequency of the soil ω_g [rad/s].", MOTION)
    zeta_g: Positive = key(0.6, "Damping ratio of the soil ζ_g [–].", MOTION)
    vertical_ratio: Number | None = key(None, "Ratio of vertical to horizontal ground acceleration [–].")


class Measures(Keys):
    """Options of `rockjax motions`, which has no table."""

    periods: Positives = key([0.2, 0.5, 1.0, 2.0], "Periods of Sa(T) [s], separated by commas.", GRID)
    damping: NotNegative = key(0.05, "Damping ratio of Sa(T) [–].", GRID)


SOURCES = ("kind", "file", "suite", "synthetic")


def _source(given: Any) -> str | None:
    found = [name for name in SOURCES if isinstance(given, dict) and name in given]
    return found[0].title() if len(found) == 1 else None


Entry = Annotated[
    Annotated[Pulses, Tag("Kind")]
    | Annotated[Record, Tag("File")]
    | Annotated[Suite, Tag("Suite")]
    | Annotated[Synthetic, Tag("Synthetic")],
    Discriminator(
        _source,
        "source",
        "needs one of kind (for a pulse), file (for a record), suite (for records) and synthetic (a number)",
    ),
]
MotionSet = Annotated[
    Annotated[Entry, Tag("one")] | Annotated[list[Entry], Field(min_length=1), Tag("several")],
    Discriminator(lambda given: "several" if isinstance(given, list) else "one"),
]


class Options(Keys):
    """Accuracy, as `rockjax.Options`."""

    rtol: Positive | None = key(None, "Relative tolerance of the step-size control [–].", ACCURACY)
    atol: Positive | None = key(None, "Absolute tolerance [–]; by default 0.01 rtol.")
    method: str | None = key(None, "Runge–Kutta method: dopri8, tsit5, dopri5, bosh3 …", ACCURACY)
    engine: str | None = key(None, "Integration loop: flat or segments.")
    overturn_ratio: Positive | None = key(None, "Limit state max|θ|/α [–].", ACCURACY, "--limit")
    rest_velocity: Positive | None = key(None, "Speed at which impacts end [–].")
    max_steps: Count | None = key(None, "Maximum number of trial steps of a scene.")
    outputs: list[str] | None = key(None, "Requested outputs.")
    history: Count | None = key(None, "Steps that a history can hold under jit.")
    throw: bool | None = key(None, "Raise an error if a scene does not finish.")


class _OneMotion(Keys):
    """Keys that select a motion."""

    motion: str | None = key(None, "Name of the set of motions, if there are several.", MOTION)
    number: Count | None = key(None, "Number of the motion in the set, if there are several.", MOTION)


_FRICTION = "Friction coefficient μ of the joints, for a warning [–]."


class Response(_OneMotion):
    """Table of `rockjax response`."""

    t_end: Number | None = key(None, "End [s]; by default 30/p after the motion, or 10 T_s.", GRID)
    friction: Positive | None = key(None, _FRICTION, STRUCTURE)


class Floors(_OneMotion):
    """Table of `rockjax floors`. Without `number`, all motions of a set are used, as a suite."""

    levels: list[Label] | None = key(
        None, "Levels: deck, or numbers of stories; by default the deck and all stories.", GRID
    )
    periods: Frequencies = key((0.05, 5.0), "Range of the periods of the oscillators T_e [s].", GRID)
    points: Points = key(100, "Number of periods, at equal ratios.", GRID)
    oscillator_damping: NotNegatives = key([0.05], "Damping ratios of the oscillators [–].", GRID)
    direction: Literal["horizontal", "vertical"] = key("horizontal", "Direction of the motion.", GRID)
    t_end: Number | None = key(None, "End [s]; by default also 5 T_e after the motion.", GRID)
    sensitivities: list[str] = key([], "Parameters y for y ∂/∂y of the spectra.", GRID)


class _Panels(Keys):
    """Structures with different superstructures, under one kind of pulse."""

    pulse: PulseName = key("ricker", "Kind of the pulse.", MOTION)
    vertical_ratio: Number | None = key(
        None, "Ratio of vertical to horizontal ground acceleration [–].", MOTION
    )
    frequency_ratio: Frequencies = key((1.0, 8.0), "Range of ω_p/p [–].", GRID, "--frequency")
    eta_over_gamma: NotNegatives = key([1.0, 5.0, 10.0], "Mass ratios η/γ [–]: a panel for each.", STRUCTURE)
    T_s: NotNegatives = key([0.0, 0.1, 0.5, 1.0], "Periods [s]: a panel for each; 0 is rigid.", STRUCTURE)


class Spectrum(_Panels):
    """Table of `rockjax spectrum`. If the file has a structure, it is the only panel by default."""

    acceleration_ratio: Amplitudes = key((1.0, 12.0), "Range of a_p/(g tan α) [–].", GRID, "--acceleration")
    points: Points = key(100, "Points along each axis.", GRID)
    sensitivities: list[str] = key([], "Parameters y of ∂(max|θ|/α)/∂ ln y.", GRID)


class Overturning(_Panels):
    """Table of `rockjax overturning`."""

    max_acceleration_ratio: Positive = key(12.0, "Largest a_p/(g tan α) [–].", GRID, "--max-acceleration")
    points: Points = key(141, "Number of frequencies.", GRID)
    sensitivities: list[str] = key(["alpha", "gamma"], "Parameters y of d a_ov/d ln y.", GRID)


class Fragility(Keys):
    """Table of `rockjax fragility`."""

    motions: str | None = key(None, "Name of the set of motions, if the file has several.", MOTION)
    measure: Literal["PGA", "PGV", "Sa", "scale"] = key(
        "PGA", "Intensity: PGA, PGV, Sa at --measure-period, or the factor on the records.", GRID
    )
    measure_period: Positive | None = key(None, "Period of Sa [s].", GRID)
    intensity: Levels | None = key(
        None,
        "Lowest and highest level, in units of the measure: [m/s²], [m/s], [–]. By default up to the level "
        "at which the median PGA of the suite is 6 g tan α.",
        GRID,
    )
    levels: Count = key(20, "Number of levels.", GRID)
    method: Literal["capacities", "stripes"] = key(
        "capacities",
        "Fit of the lowest overturning intensities, or of the numbers of overturned records at the levels.",
        STATISTICS,
    )
    confidence: Share = key(0.9, "Confidence level of intervals and bands, in (0, 1) [–].", STATISTICS)
    seed: Index = key(0, "Seed of --synthetic motions.", STATISTICS)
    damage_states: NotNegatives = key(
        [0.0, 0.5, 1.0], "Damage states of the contents: thresholds of max|φ|/α_c [–].", STATISTICS
    )
    overturned: Literal["drop", "exceed"] = key(
        "drop", "Leave scenes out in which the podium overturns, or count them as damage of the contents."
    )
    sensitivities: list[str] = key([], "Parameters y of d ln(median)/d ln y.", STATISTICS)
    friction: Positive | None = key(None, _FRICTION, STRUCTURE)


class Risk(Keys):
    """Table of `rockjax risk`."""

    fragility: str | None = key(None, "File of `rockjax fragility` (.nc) or OpenQuake's (.xml).", CURVE)
    structure: str | None = key(None, "Name of the structure in a model (.xml), if it has several.", CURVE)
    median: Positive | None = key(None, "Median of the curve, in SI units, instead of a file.", CURVE)
    dispersion: Positive | None = key(None, "Logarithmic standard deviation, with the median [–].", CURVE)
    hazard: str | None = key(None, "Hazard curve: a CSV file with two columns, or one of OpenQuake.", HAZARD)
    site: Index | None = key(None, "Row of an OpenQuake file, from 0, if it has several.", HAZARD)
    years: NotNegative = key(50.0, "Period of the reported probability of failure [years].", OUTPUT)


class Span(Keys):
    """Values of an axis at equal distances or at equal ratios."""

    low: Number = Field(alias="from", description="First value.")
    high: Number = Field(alias="to", description="Last value.")
    points: Points = key(..., "Number of values.")
    log: bool = key(False, "Whether neighbouring values have equal ratios instead of equal distances.")

    @model_validator(mode="after")
    def _check(self) -> Span:
        if self.log and not (self.low > 0 and self.high > 0):
            raise ValueError(f"equal ratios need from and to > 0, got {self.low:g} and {self.high:g}")
        return self


Axis = Annotated[
    Annotated[Numbers, Tag("list")] | Annotated[Span, Tag("span")],
    Discriminator(lambda given: "span" if isinstance(given, dict) else "list"),
]


class Sweep(_OneMotion):
    """Table of `rockjax sweep`. Without `number`, the motions of a set are an axis."""

    outputs: list[str] = key(
        ["peak_rotation"], "Requested outputs: peak_rotation, peak_shear, margin …", GRID
    )
    chunk: Count | None = key(None, "Scenes in a chunk; by default as many as take some seconds.", MACHINES)
    axes: dict[str, Axis] = key({}, "Axes of the grid: name of a parameter → values, as in `rockjax.grid`.")


class Normal(Keys):
    """A normal distribution, truncated where low or high are given."""

    kind: Literal["normal"] = key(..., "Kind of the distribution.")
    mean: Number = key(..., "Mean before truncation.")
    std: Positive | None = key(None, "Standard deviation before truncation.")
    cov: Positive | None = key(None, "Coefficient of variation, instead of the standard deviation [–].")
    low: Number | None = key(None, "Lower end.")
    high: Number | None = key(None, "Upper end.")

    @model_validator(mode="after")
    def _check(self) -> Normal:
        if require_one(self.as_arguments(), "std", "cov") == "cov" and self.mean == 0:
            raise ValueError("cov needs a mean other than 0; give std")
        if self.low is not None and self.high is not None and self.low >= self.high:
            raise ValueError(f"low must be less than high, got {self.low:g} and {self.high:g}")
        return self


class LognormalSpread(Keys):
    """A lognormal distribution."""

    kind: Literal["lognormal"] = key(..., "Kind of the distribution.")
    median: Positive = key(..., "Median.")
    dispersion: Positive | None = key(None, "Standard deviation of the logarithm [–].")
    cov: Positive | None = key(None, "Coefficient of variation, instead of the dispersion [–].")

    @model_validator(mode="after")
    def _check(self) -> LognormalSpread:
        require_one(self.as_arguments(), "dispersion", "cov")
        return self


class Uniform(Keys):
    """A uniform distribution."""

    kind: Literal["uniform"] = key(..., "Kind of the distribution.")
    low: Number = key(..., "Lower end.")
    high: Number = key(..., "Upper end.")

    @model_validator(mode="after")
    def _check(self) -> Uniform:
        if self.low >= self.high:
            raise ValueError(f"low must be less than high, got {self.low:g} and {self.high:g}")
        return self


Spread = Annotated[
    Annotated[Number, Tag("number")]
    | Annotated[
        Annotated[Normal, Tag("normal")]
        | Annotated[LognormalSpread, Tag("lognormal")]
        | Annotated[Uniform, Tag("uniform")],
        Field(discriminator="kind"),
        Tag("table"),
    ],
    Discriminator(lambda given: "table" if isinstance(given, dict | Keys) else "number"),
]


class Ensemble(_OneMotion):
    """Table of `rockjax ensemble`; without a number, every scene draws one of the motions of a set."""

    n: Count = key(1000, "Number of scenes.", GRID)
    seed: Index = key(0, "Seed of the random numbers; equal seeds give equal draws.", GRID)
    outputs: list[str] = key(
        ["peak_rotation"], "Requested outputs: peak_rotation, peak_shear, errors …", GRID
    )
    spread: dict[str, Spread] = key(
        {}, "Distributions: name of a parameter → number or distribution, as in `rockjax.ensemble`."
    )


class EnvelopeKeys(Keys):
    """The envelope of a random motion."""

    t_1: Positive | None = key(None, "End of the rise [s].")
    t_2: Positive | None = key(None, "Start of the decay [s].")
    c: Positive | None = key(None, "Rate of the decay [1/s].")


class GaussianKeys(Keys):
    """A random motion, as `rockjax.GaussianMotion`."""

    n: Points = key(..., "Number of samples.")
    dt: Positive = key(..., "Sampling interval [s].")
    S_0: Positive = key(..., "Spectral density of the noise [m²/s³].")
    omega_g: Positive | None = key(None, "Frequency of the soil [rad/s].")
    zeta_g: Positive | None = key(None, "Damping ratio of the soil [–].")
    omega_f: Positive | None = key(None, "Frequency of the high-pass filter [rad/s].")
    zeta_f: Positive | None = key(None, "Damping ratio of the high-pass filter [–].")
    envelope: EnvelopeKeys | None = key(None, "Envelope of the motion.")


class Project(Keys):
    """Texts of `rockjax report`, which change no number."""

    title: str | None = key(None, "Title of the report; by default the name of the file.")
    subject: str | None = key(None, "Subject of the report.")
    number: str | None = key(None, "Number of the project.")
    revision: str | None = key(None, "Revision of the report.")
    author: str | None = key(None, "Author of the report.")
    organisation: str | None = key(None, "Organisation of the author.")
    date: str | None = key(None, "Date of the report; by default SOURCE_DATE_EPOCH, else today.")


class JointKeys(Keys):
    """Properties of the joints that checks of `rockjax report` need."""

    friction: Positive | None = key(None, "Friction coefficient μ of the joints [–].")
    contact_width: Positive | None = key(None, "Width of the strip that bears at an edge, in the plane [m].")
    contact_depth: Positive | None = key(None, "Depth of a column across the plane [m].")


class ReportKeys(Keys):
    """Settings of `rockjax report`."""

    units: list[str] | None = key(None, "Units of the page, one of a kind: kN, m, deg, g, mm.")
    spread: Annotated[float, Field(gt=0, lt=1), described_as("a number in (0, 1)")] = key(
        0.05, "Relative change of each parameter for the range of the utilisations [–]."
    )
    laws: list[Literal["paper", "compatible"]] = key(
        ["paper", "compatible"], "Laws of impact, besides that of the structure."
    )
    motions: dict[str, str] = key({}, "Labels of the sets of motions, such as '475 years'.")


class Problem(Keys):
    """A problem file: tables for several commands, and one for each command."""

    structure: Structure | None = key(None, "The structure, by ratios or by dimensions.")
    motions: dict[str, MotionSet] = key({}, "Sets of motions, by names that you choose.")
    contents: list[Contents] = key([], "Blocks on the floors, for response, fragility and design.")
    oscillators: list[Oscillator] = key([], "Oscillators on the floors, for response and design.")
    options: Options = Field(default_factory=Options)
    response: Response = Field(default_factory=Response)
    floors: Floors = Field(default_factory=Floors)
    spectrum: Spectrum = Field(default_factory=Spectrum)
    overturning: Overturning = Field(default_factory=Overturning)
    fragility: Fragility = Field(default_factory=Fragility)
    risk: Risk = Field(default_factory=Risk)
    sweep: Sweep = Field(default_factory=Sweep)
    ensemble: Ensemble = Field(default_factory=Ensemble)

    project: Project = Field(default_factory=Project)
    joints: JointKeys = Field(default_factory=JointKeys)
    report: ReportKeys = Field(default_factory=ReportKeys)
    sources: dict[str, str] = key({}, "Where inputs come from: key of this file → source, for the report.")
    checks: Any = key(None, "Checks of the report.")
    # Keys of `rockjax design`, whose full models are in `optimise`.
    starts: Count | None = key(None, "Number of starting points; by default 1.", ACCURACY)
    seed: Index | None = key(None, "Seed of the starting points; by default 0.", ACCURACY)
    tolerance: Positive | None = key(None, "Tolerance of the optimality conditions [–].")
    max_iterations: Count | None = key(None, "Maximum number of iterations of a start.")
    friction: Positive | None = key(None, _FRICTION, STRUCTURE)
    vary: Any = key(None, "Design variables.")
    minimise: Any = key(None, "Objective.")
    targets: Any = key(None, "Conditions that the design must satisfy.")
