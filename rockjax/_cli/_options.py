"""Options that several commands share."""

from __future__ import annotations

import enum
import inspect
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar

from rockjax._parameters import table

from ._run import Flags, argument, flag, option

C = TypeVar("C")

EXAMPLES = ("annual-frequency", "column", "fragility", "response", "risk", "spectrum", "sweep")
STRUCTURE, MOTION, GRID, ACCURACY, OUTPUT = "Structure", "Ground motion", "Grid", "Accuracy", "Output"


class PulseName(enum.StrEnum):
    ricker = "ricker"
    antisymmetric_ricker = "antisymmetric-ricker"
    one_sine = "one-sine"
    one_cosine = "one-cosine"
    half_sine = "half-sine"


class MethodName(enum.StrEnum):
    dopri8 = "dopri8"
    tsit5 = "tsit5"
    dopri5 = "dopri5"
    bosh3 = "bosh3"


class UnitName(enum.StrEnum):
    g = "g"
    m_s2 = "m/s2"
    cm_s2 = "cm/s2"
    gal = "gal"
    mm_s2 = "mm/s2"


ProblemFile = Annotated[
    Path | None,
    argument(
        "Problem file (TOML) with structure, motions and options; options given here override it.",
        show_default=False,
    ),
]
Example = Annotated[
    str | None,
    option(
        "--example",
        metavar="NAME",
        panel=OUTPUT,
        help=f"A problem file that comes with rockjax, instead of one of yours: {', '.join(EXAMPLES)}.",
        autocompletion=lambda: list(EXAMPLES),
    ),
]
Output = Annotated[
    str,  # a slash at its end says something
    option(
        "--output",
        "-o",
        metavar="PATH",
        panel=OUTPUT,
        help="Prefix of the files to write; or a folder for them; or a name with the format of the "
        "pictures, as x.pdf.",
    ),
]
Resume = Annotated[
    bool, option("--resume", panel=OUTPUT, help="Go on where Ctrl-C stopped the same command.")
]
Pulse = Annotated[PulseName, option("--pulse", panel=MOTION, help="Kind of the pulse.")]
Rtol = Annotated[
    float, option("--rtol", panel=ACCURACY, help="Relative tolerance of the step-size control [–].")
]
Units = Annotated[
    UnitName | None,
    option("--units", panel=MOTION, help="Unit of the samples, where the file does not say it."),
]
SamplingInterval = Annotated[
    float | None, option("--dt", panel=MOTION, help="Sampling interval [s], where the file does not say it.")
]
Component = Annotated[
    str | None,
    option("--component", panel=MOTION, help="Number or name of the channel, where files have several."),
]
Frequencies = Annotated[tuple[float, float], option("--frequency", panel=GRID, help="Range of ω_p/p [–].")]
MassRatios = Annotated[
    str,
    option(
        "--eta-over-gamma",
        panel=STRUCTURE,
        help="Mass ratios η/γ [–], separated by commas: a panel for each.",
    ),
]
Periods = Annotated[
    str,
    option(
        "--T-s",
        panel=STRUCTURE,
        help="Superstructure periods T_s [s], separated by commas: a panel for each; 0 is rigid.",
    ),
]


def said(name: str, note: str = "", panel: str = STRUCTURE) -> Any:
    """The option of a parameter, in the words of the tables of parameters."""
    entry = (table.MOTION if panel == MOTION else table.DIMENSIONS | table.STRUCTURE | table.BUILDING)[name]
    note = note or (f"; {entry.note}" if entry.note else "")
    return option(flag(name), panel=panel, help=f"{entry.heading}{note}.")


VerticalRatio = Annotated[
    float | None, said("vertical_ratio", "; no vertical motion where not given", MOTION)
]


def pulse_of(name: str, vertical_ratio: float | None) -> Any:
    """The function (a_p, T_p) → motion of a pulse's name."""
    from rockjax._excitations.ground import GroundMotion
    from rockjax._excitations.pulses import PULSES

    kind = PULSES[name]
    return kind if vertical_ratio is None else GroundMotion.in_proportion(kind, vertical_ratio)


def _laws() -> list[str]:
    return ["paper", "compatible"]


_LAW = option(
    "--restitution",
    panel=STRUCTURE,
    metavar="LAW",
    help="Velocity factor of an impact: paper, Eq. (27); compatible, with Eq. (26); or a number in 0…1 [–].",
    autocompletion=_laws,
)
_NOTES = {
    "alpha": ", instead of --tan-alpha",
    "eta": "; 0 is none",
    "T_s": "; 0 is rigid",
    "columns": "; 2 where not given",
}


def structure_options(**defaults: Any) -> Callable[[type[C]], type[C]]:
    """Gives a group of options one for every parameter of a structure, by ratios or by dimensions, with these
    defaults.

    What a group declares itself stays as it is. A new parameter needs no line here.
    """

    def give(cls: type[C]) -> type[C]:
        own = inspect.get_annotations(cls)
        made: dict[str, Any] = {}
        for name, entry in (table.STRUCTURE | table.BUILDING | table.DIMENSIONS).items():
            if name == "damping" or entry.place.count(".") > 1:  # --zeta serves both; parts have no options
                continue
            made[name] = Annotated[
                int | None if entry.whole else float | None, said(name, _NOTES.get(name, ""))
            ]
            if name == "restitution":
                made[name] = Annotated[str | None, _LAW]
            if name not in own:
                setattr(cls, name, defaults.get(name))
        cls.__annotations__ = made | own
        return cls

    return give


class Column(Flags):
    """The columns and what they carry, by ratios or by dimensions."""


@dataclass
@structure_options()
class Changes(Column):
    """Changes of the structure of a file."""


@dataclass
@structure_options(tan_alpha=0.15, R=1.5, gamma=10.0, eta=100.0, T_s=0.5, zeta=0.05, restitution="paper")
class Structure(Column):
    """One structure."""


@dataclass
@structure_options(tan_alpha=0.15, R=1.5, gamma=10.0, zeta=0.05, restitution="paper")
class Panels(Column):
    """Structures that differ in what stands on them."""

    eta: Annotated[float | None, said("eta", " instead of --eta-over-gamma; 0 is none")] = None
    T_s: Periods = "0,0.1,0.5,1"
    eta_over_gamma: MassRatios = "1,5,10"


@dataclass
class Motion(Flags):
    """One pulse or one record."""

    pulse: Pulse = PulseName.ricker
    acceleration_ratio: Annotated[float, said("acceleration_ratio", panel=MOTION)] = 2.5
    a_p: Annotated[float | None, said("a_p", ", instead of the ratio", MOTION)] = None
    T_p: Annotated[float, said("T_p", panel=MOTION)] = 1.0
    frequency_ratio: Annotated[float | None, said("frequency_ratio", ", instead of its period", MOTION)] = (
        None
    )
    record: Annotated[
        Path | None,
        option(
            "--record", panel=MOTION, help="File of a record, instead of a pulse: .AT2, .V2, text, .npy …"
        ),
    ] = None
    units: Units = None
    dt: SamplingInterval = None
    component: Component = None
    scale: Annotated[
        float | None, option("--scale", panel=MOTION, help="Factor on the record [–]; 1 where not given.")
    ] = None
    vertical: Annotated[
        Path | None, option("--vertical", panel=MOTION, help="File of the record's vertical component.")
    ] = None
    vertical_ratio: VerticalRatio = None
    motion: Annotated[
        str | None,
        option(
            "--motion", panel=MOTION, help="Which set of motions of the problem file, where it has several."
        ),
    ] = None
    number: Annotated[
        int | None,
        option("--number", panel=MOTION, min=1, help="Which motion of the set, where it has several."),
    ] = None


@dataclass
class Accuracy(Flags):
    """How scenes are solved."""

    method: Annotated[MethodName, option("--method", panel=ACCURACY, help="Runge–Kutta method.")] = (
        MethodName.dopri8
    )
    rtol: Rtol = 1e-8
