"""Options that several commands share."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from ._run import Flags, argument, option

EXAMPLES = ("column", "fragility", "response", "risk", "spectrum", "sweep")
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
    argument("Problem file (TOML) with structure, motions and options; options given here override it.", show_default=False),
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
        help="Prefix of the files to write; or a folder for them; or a name with the format of the pictures, as x.pdf.",
    ),
]
Resume = Annotated[bool, option("--resume", panel=OUTPUT, help="Go on where Ctrl-C stopped the same command.")]
Pulse = Annotated[PulseName, option("--pulse", panel=MOTION, help="Kind of the pulse.")]
Rtol = Annotated[float, option("--rtol", panel=ACCURACY, help="Relative tolerance of the step-size control [–].")]
Units = Annotated[
    UnitName | None, option("--units", panel=MOTION, help="Unit of the samples, where the file does not say it.")
]
SamplingInterval = Annotated[
    float | None, option("--dt", panel=MOTION, help="Sampling interval [s], where the file does not say it.")
]
Component = Annotated[
    str | None, option("--component", panel=MOTION, help="Number or name of the channel, where files have several.")
]
Frequencies = Annotated[tuple[float, float], option("--frequency", panel=GRID, help="Range of ω_p/p [–].")]
MassRatios = Annotated[
    str,
    option("--eta-over-gamma", panel=STRUCTURE, help="Mass ratios η/γ [–], separated by commas: a panel for each."),
]
Periods = Annotated[
    str,
    option(
        "--T-s", panel=STRUCTURE, help="Superstructure periods T_s [s], separated by commas: a panel for each; 0 is rigid."
    ),
]


def _laws() -> list[str]:
    return ["paper", "compatible"]


TanAlpha = Annotated[
    float | None, option("--tan-alpha", panel=STRUCTURE, help="Slenderness of the columns tan α = B/H [–].")
]
Alpha = Annotated[
    float | None, option("--alpha", panel=STRUCTURE, help="The slenderness as an angle α [rad], instead of --tan-alpha.")
]
Radius = Annotated[float | None, option("--R", panel=STRUCTURE, help="Half diagonal of a column R [m].")]
Gamma = Annotated[
    float | None,
    option("--gamma", panel=STRUCTURE, help="Mass ratio of the beam γ = m_b/(N m_c) [–]; 0 is a solitary block."),
]
Eta = Annotated[
    float | None, option("--eta", panel=STRUCTURE, help="Mass ratio of the superstructure η = m_t/(N m_c) [–]; 0 is none.")
]
Period = Annotated[float | None, option("--T-s", panel=STRUCTURE, help="Period of the superstructure T_s [s]; 0 is rigid.")]
Zeta = Annotated[float | None, option("--zeta", panel=STRUCTURE, help="Damping ratio of the superstructure ζ [–].")]
Law = Annotated[
    str | None,
    option(
        "--restitution",
        panel=STRUCTURE,
        metavar="LAW",
        help="Velocity factor of an impact: paper, Eq. (27); compatible, with Eq. (26); or a number in 0…1 [–].",
        autocompletion=_laws,
    ),
]


@dataclass
class Column(Flags):
    """The columns and what they carry, by ratios or by dimensions."""

    tan_alpha: TanAlpha = None
    alpha: Alpha = None
    R: Radius = None
    gamma: Gamma = None
    eta: Eta = None
    T_s: Any = None
    zeta: Zeta = None
    restitution: Law = None
    width: Annotated[float | None, option("--width", panel=STRUCTURE, help="Full width of a column 2B [m].")] = None
    height: Annotated[float | None, option("--height", panel=STRUCTURE, help="Full height of a column 2H [m].")] = None
    column_mass: Annotated[float | None, option("--column-mass", panel=STRUCTURE, help="Mass of one column m_c [kg].")] = (
        None
    )
    beam_mass: Annotated[float | None, option("--beam-mass", panel=STRUCTURE, help="Mass of the beam m_b [kg].")] = None
    columns: Annotated[int | None, option("--columns", panel=STRUCTURE, help="Number of columns N; 2 where not given.")] = (
        None
    )
    top_mass: Annotated[float | None, option("--top-mass", panel=STRUCTURE, help="Mass of the superstructure m_t [kg].")] = (
        None
    )
    period: Annotated[
        float | None,
        option("--period", panel=STRUCTURE, help="Period of the superstructure T_s [s]; without it a top mass is rigid."),
    ] = None


@dataclass
class Changes(Column):
    """Changes of the structure of a file."""

    T_s: Period = None


@dataclass
class Structure(Column):
    """One structure."""

    tan_alpha: TanAlpha = 0.15
    R: Radius = 1.5
    gamma: Gamma = 10.0
    eta: Eta = 100.0
    T_s: Period = 0.5
    zeta: Zeta = 0.05
    restitution: Law = "paper"


@dataclass
class Panels(Column):
    """Structures that differ in what stands on them."""

    tan_alpha: TanAlpha = 0.15
    R: Radius = 1.5
    gamma: Gamma = 10.0
    eta: Annotated[
        float | None,
        option("--eta", panel=STRUCTURE, help="One mass ratio η = m_t/(N m_c) [–] instead of --eta-over-gamma; 0 is none."),
    ] = None
    T_s: Periods = "0,0.1,0.5,1"
    zeta: Zeta = 0.05
    restitution: Law = "paper"
    eta_over_gamma: MassRatios = "1,5,10"


@dataclass
class Motion(Flags):
    """One pulse or one record."""

    pulse: Pulse = PulseName.ricker
    acceleration_ratio: Annotated[
        float, option("--acceleration-ratio", panel=MOTION, help="Amplitude of the pulse a_p/(g tan α) [–].")
    ] = 2.5
    a_p: Annotated[
        float | None, option("--a-p", panel=MOTION, help="Amplitude of the pulse a_p [m/s²], instead of the ratio.")
    ] = None
    T_p: Annotated[float, option("--T-p", panel=MOTION, help="Period of the pulse T_p [s].")] = 1.0
    frequency_ratio: Annotated[
        float | None, option("--frequency-ratio", panel=MOTION, help="ω_p/p of the pulse [–], instead of its period.")
    ] = None
    record: Annotated[
        Path | None, option("--record", panel=MOTION, help="File of a record, instead of a pulse: .AT2, .V2, text, .npy …")
    ] = None
    units: Units = None
    dt: SamplingInterval = None
    component: Component = None
    scale: Annotated[float | None, option("--scale", panel=MOTION, help="Factor on the record [–]; 1 where not given.")] = (
        None
    )
    motion: Annotated[
        str | None, option("--motion", panel=MOTION, help="Which set of motions of the problem file, where it has several.")
    ] = None
    number: Annotated[
        int | None, option("--number", panel=MOTION, min=1, help="Which motion of the set, where it has several.")
    ] = None


@dataclass
class Accuracy(Flags):
    """How scenes are solved."""

    method: Annotated[MethodName, option("--method", panel=ACCURACY, help="Runge–Kutta method.")] = MethodName.dopri8
    rtol: Rtol = 1e-8
