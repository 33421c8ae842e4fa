"""Models of the tables of a problem file that describe ground motions."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Discriminator, Field, Tag, model_validator

from rockjax._units import RecordUnit

from .fields import (
    GRID,
    MOTION,
    Count,
    Index,
    Keys,
    Label,
    NotNegative,
    Number,
    OneOrMore,
    Periods,
    Positive,
    Positives,
    PulseName,
    key,
    require_one,
)


class Pulses(Keys):
    """One or more pulses. A list of amplitudes and a list of periods must have equal lengths. A single
    amplitude or period applies to all pulses."""

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
                f"has {a_p} amplitudes and {T_p} periods; give lists of equal length, or a single "
                "amplitude or period"
            )
        return self


class _Recorded(Keys):
    """Keys of all entries that read records from files."""

    units: RecordUnit | None = key(None, "Unit of the samples, if the file does not state it.", MOTION)
    dt: Positive | None = key(None, "Sampling interval [s], if the file does not state it.", MOTION)
    component: Label | None = key(None, "Number or name of the channel, if the file has several.", MOTION)
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
            raise ValueError(
                "has both vertical_ratio and paired, which uses vertical records; give one of them"
            )
        return self


class Synthetic(Keys):
    """Synthetic motions: filtered noise under an envelope."""

    synthetic: Count = key(20, "Number of motions.", MOTION, "--count")
    seed: Index = key(0, "Seed of the random numbers; the same seed gives the same motions.", MOTION)
    dt: Positive = key(0.01, "Sampling interval [s].", MOTION)
    duration: Positive = key(20.0, "Duration [s].", MOTION)
    pga: Positive = key(2.94, "Peak acceleration of the noise in each motion [m/s²].", MOTION)
    omega_g: Positive = key(15.0, "Frequency of the soil ω_g [rad/s].", MOTION)
    zeta_g: Positive = key(0.6, "Damping ratio of the soil ζ_g [–].", MOTION)
    scale: Number | None = key(None, "Factor on the motions [–]; by default 1.")
    vertical_ratio: Number | None = key(None, "Ratio of vertical to horizontal ground acceleration [–].")


class Measures(Keys):
    """Options of the command `rockjax motions`, which has no table in problem files."""

    periods: Positives = key([0.2, 0.5, 1.0, 2.0], "Periods of Sa(T) [s], separated by commas.", GRID)
    damping: NotNegative = key(0.05, "Damping ratio of Sa(T) [–].", GRID)


# Keys that determine the model of an entry of a set of motions. An entry must have exactly one of them.
SOURCES = ("kind", "file", "suite", "synthetic")


def _source_tag(given: Any) -> str | None:
    """Return the tag of the model for an entry of a set of motions. Unless the entry has exactly one of the
    keys `SOURCES`, return None."""
    found = [name for name in SOURCES if isinstance(given, dict) and name in given]
    return found[0].title() if len(found) == 1 else None


Entry = Annotated[
    Annotated[Pulses, Tag("Kind")]
    | Annotated[Record, Tag("File")]
    | Annotated[Suite, Tag("Suite")]
    | Annotated[Synthetic, Tag("Synthetic")],
    Discriminator(
        _source_tag,
        "source",
        "needs one of kind (for a pulse), file (for a record), suite (for records) and synthetic (a number)",
    ),
]
MotionSet = Annotated[
    Annotated[Entry, Tag("one")] | Annotated[list[Entry], Field(min_length=1), Tag("several")],
    Discriminator(lambda given: "several" if isinstance(given, list) else "one"),
]
