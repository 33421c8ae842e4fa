"""Tables of parameters of structures and ground motions: name, symbol, unit, range, meaning and location.

Grids, sweeps, sensitivities, design variables, sliders, problem files, options of the command line and the
documentation use these tables. To add a parameter, add an entry here. This module does not import JAX.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, NamedTuple

from rockjax._units import displayed


class Range(NamedTuple):
    """Interval of valid values of a parameter.

    - `low`, `high`: ends of the interval; `closed`: whether each end belongs to the interval
    - `unit`: unit of the ends, for the property `text`
    """

    low: float = -math.inf
    high: float = math.inf
    closed: tuple[bool, bool] = (False, False)
    unit: str = ""

    def holds(self, value: Any) -> Any:
        """Return whether a value is inside the range, elementwise for an array."""
        above = value >= self.low if self.closed[0] else value > self.low
        below = value <= self.high if self.closed[1] else value < self.high
        return above & below

    @property
    def text(self) -> str:
        """The range as text, such as `> 0` or `in [0, 1]`; empty if every number is valid."""
        low, high = (_SYMBOLS.get(end, f"{end:g}") for end in (self.low, self.high))
        if math.isinf(self.high):
            return "" if math.isinf(self.low) else f"{'>=' if self.closed[0] else '>'} {low}"
        opening, closing = "(["[self.closed[0]], ")]"[self.closed[1]]
        return f"in {opening}{low}, {high}{closing} {self.unit}".rstrip()


_SYMBOLS = {math.pi / 2: "π/2"}
ANY = Range()
POSITIVE = Range(0.0)
NOT_NEGATIVE = Range(0.0, closed=(True, False))
FACTOR = Range(0.0, 1.0, (True, True))
ANGLE = Range(0.0, math.pi / 2, unit="rad")
POWER = Range(0.0, 1.0, (False, True))


class Parameter(NamedTuple):
    """A scalar parameter of a structure or ground motion.

    - `name`: name of the axis, option, variable or key of a problem file; `symbol`: mathematical symbol
    - `unit`: unit as in datasets, "1" for a ratio; `range`: range of valid values; `meaning`: description
    - `attribute_path`: attributes that lead to the value in the structure, such as `superstructure.T_s`.
      Members of a tuple are named by their class, as in `restrainers.Tendon.stiffness`. Empty for derived
      parameters
    - `formula`: definition of the symbol; `note`: further text, such as the meaning of a missing value
    - `instead_of`: parameters that cannot be given together with this parameter, because both determine the
      same quantity
    - `is_integer`: whether the parameter is a whole number, which cannot vary in a batch or be differentiated
    """

    name: str
    symbol: str
    unit: str
    range: Range
    meaning: str
    attribute_path: str = ""
    formula: str = ""
    note: str = ""
    instead_of: tuple[str, ...] = ()
    is_integer: bool = False

    @property
    def heading(self) -> str:
        """Meaning, symbol and unit as text."""
        symbol = f"{self.symbol} = {self.formula}" if self.formula else self.symbol
        return f"{self.meaning[:1].upper()}{self.meaning[1:]} {symbol} [{displayed(self.unit)}]"

    @property
    def variable_attributes(self) -> dict[str, str]:
        """Attributes of a variable in a dataset."""
        return {"units": self.unit, "long_name": f"{self.meaning} {self.symbol}"}


def _by_name(*entries: Parameter) -> dict[str, Parameter]:
    return {entry.name: entry for entry in entries}


def _ratio(name: str, symbol: str, meaning: str, path: str, formula: str = "", note: str = "") -> Parameter:
    """Return a dimensionless parameter ≥ 0."""
    return Parameter(name, symbol, "1", NOT_NEGATIVE, meaning, path, formula, note)


WIDTH_AND_HEIGHT = ("width", "height")  # dimensions of a column, which together determine alpha and R
_SLENDERNESS = "slenderness of the columns"
_COLUMN_NAMES = ("alpha", "tan_alpha", "R")
_PERIOD, _RIGID_NOTE = "period of the superstructure", "without it the superstructure is rigid"
_TENDON, _DAMPER, _INERTER = "restrainers.Tendon.", "restrainers.Damper.", "restrainers.Inerter."
_STORIES_MEANING, _STORIES_PATH = (
    "number of stories of a building whose stories are alike",
    "superstructure.stories",
)
_HEIGHT = "height of the superstructure above the beam"
_RESIDUAL_HEIGHT = "height of the residual mass above the beam"
_LINEAR_NOTE = "1 is a linear damper"
_SPAN_NOTE = "spans both joints of the column"
_ENDS_NOTE = "less than H; not with restrainers"

# Parameters of a podium. The podium stores those with an `attribute_path`; variants.py computes the others.
STRUCTURE = _by_name(
    Parameter("alpha", "α", "rad", ANGLE, _SLENDERNESS, "alpha"),
    Parameter("tan_alpha", "tan α", "1", POSITIVE, _SLENDERNESS, formula="B/H", instead_of=("alpha",)),
    Parameter("R", "R", "m", POSITIVE, "half diagonal of a column", "R"),
    Parameter("width", "2B", "m", POSITIVE, "full width of a column", instead_of=_COLUMN_NAMES),
    Parameter("height", "2H", "m", POSITIVE, "full height of a column", instead_of=_COLUMN_NAMES),
    _ratio("gamma", "γ", "mass ratio of the beam", "gamma", "m_b/(N m_c)", "0 is a solitary block"),
    _ratio("eta", "η", "mass ratio of the superstructure", "superstructure.eta", "m_t/(N m_c)"),
    Parameter("T_s", "T_s", "s", POSITIVE, _PERIOD, "superstructure.T_s", note=_RIGID_NOTE),
    _ratio("zeta", "ζ", "damping ratio of the superstructure", "superstructure.zeta"),
    _ratio("lam", "λ", "inertia factor of a column", "lam", "I_c/(m_c R²)"),
    Parameter("restitution", "e", "1", FACTOR, "velocity factor of an impact", "restitution.e"),
    Parameter("g", "g", "m s-2", POSITIVE, "acceleration of gravity", "g"),
    _ratio("prestress", "τ", "initial force of a tendon", _TENDON + "prestress", "P₀/(m_c g)"),
    _ratio("stiffness", "κ", "stiffness of a tendon", _TENDON + "stiffness", "K R/(m_c g)"),
    _ratio("coefficient", "δ", "damper coefficient", _DAMPER + "coefficient", "C(Rp)^ν/(m_c g)"),
    Parameter("exponent", "ν", "1", POWER, "damper exponent", _DAMPER + "exponent", note=_LINEAR_NOTE),
    _ratio("inertance_ratio", "μ", "inertance", _INERTER + "inertance", "b/m_c"),
    Parameter("beam_depth", "D", "m", NOT_NEGATIVE, "depth of the beam", "elevation.beam_depth"),
    Parameter("top_height", "h", "m", ANY, _HEIGHT, "elevation.top_height"),
    Parameter("residual_height", "h_r", "m", ANY, _RESIDUAL_HEIGHT, "elevation.residual_height"),
)

# Parameters with one value for each mode, story or column. Names are numbered from 1, such as `T_2`.
ROWS = _by_name(
    _ratio("eta", "η", "mass ratio of the mode", "superstructure.eta"),
    Parameter("T", "T", "s", POSITIVE, "period of the mode", "superstructure.T"),
    _ratio("zeta", "ζ", "damping ratio of the mode", "superstructure.zeta"),
    Parameter("story_mass", "m", "1", POSITIVE, "mass ratio of the floor", "superstructure.masses"),
    Parameter(
        "story_stiffness", "k", "s-2", POSITIVE, "stiffness of the story", "superstructure.stiffnesses"
    ),
    _ratio("story_damping", "ζ", "damping ratio of the mode", "superstructure.damping"),
    Parameter("story_height", "h", "m", POSITIVE, "height of the story", "superstructure.heights"),
    Parameter("position", "x", "m", ANY, "position of the column", "elevation.columns"),
    Parameter("top_height", "h", "m", ANY, "height of the mode or floor", "elevation.top_height"),
)
# Names of rows that sensitivities multiply by a single factor, and the rows.
WHOLE_ROWS = {"positions": "position", "story_heights": "story_height", "top_height": "top_height"}
# Scalar parameters of superstructures with several modes: one value for the whole superstructure.
MULTI_MODE_SCALARS = _by_name(
    _ratio("residual", "η_r", "mass ratio of the residual mass", "superstructure.residual"),
    _ratio("story_damping", "ζ", "damping ratio of all modes", "superstructure.damping"),
)


# Parameters of a building with equal stories.
BUILDING = _by_name(
    Parameter(
        "stories",
        "n",
        "1",
        Range(1.0, closed=(True, False)),
        _STORIES_MEANING,
        _STORIES_PATH,
        is_integer=True,
    )
)


def numbered_parameter(entry: Parameter, number: int) -> Parameter:
    """Return the parameter of one mode, story or column, counted from 1."""
    return entry._replace(
        name=f"{entry.name}_{number}",
        symbol=f"{entry.symbol}_{number}",
        meaning=f"{entry.meaning} {number}",
        attribute_path=f"{entry.attribute_path}.{number}",
    )


def common_factor(name: str) -> Parameter:
    """Return the parameter that multiplies all values of a list, such as `superstructure.masses`."""
    return Parameter(name, name, "1", POSITIVE, "factor on all values of", attribute_path=name)


# Arguments of `Podium.from_dimensions`.
DIMENSIONS = _by_name(
    STRUCTURE["width"],
    STRUCTURE["height"],
    Parameter("column_mass", "m_c", "kg", POSITIVE, "mass of one column"),
    Parameter("beam_mass", "m_b", "kg", NOT_NEGATIVE, "mass of the beam"),
    Parameter("columns", "N", "1", Range(1.0, closed=(True, False)), "number of columns", is_integer=True),
    Parameter("top_mass", "m_t", "kg", NOT_NEGATIVE, "mass of the superstructure"),
    Parameter("period", "T_s", "s", POSITIVE, _PERIOD, note=_RIGID_NOTE),
    _ratio("damping", "ζ", "damping ratio of the superstructure", ""),
    STRUCTURE["lam"],
    STRUCTURE["restitution"],
    STRUCTURE["g"],
    Parameter(
        "tendon_force", "P₀", "N", NOT_NEGATIVE, "initial force of the tendon of a column", note=_SPAN_NOTE
    ),
    Parameter(
        "tendon_stiffness", "K", "N m-1", NOT_NEGATIVE, "stiffness of the tendon of a column", note=_SPAN_NOTE
    ),
    Parameter(
        "damper_coefficient",
        "C",
        "N (s/m)^ν",
        NOT_NEGATIVE,
        "coefficient of the damper of a column",
        note=_SPAN_NOTE,
    ),
    Parameter("damper_exponent", "ν", "1", POWER, "exponent of the damper of a column", note=_LINEAR_NOTE),
    Parameter("inertance", "b", "kg", NOT_NEGATIVE, "inertance of the inerter of a column", note=_SPAN_NOTE),
    Parameter("end_radius", "r_c", "m", NOT_NEGATIVE, "radius of round ends of a column", note=_ENDS_NOTE),
    *(
        STRUCTURE[name]._replace(attribute_path="")
        for name in ("beam_depth", "top_height", "residual_height")
    ),
)
# Arguments with one value for each story or column. Names are numbered from 1, such as `story_mass_2`.
ROWS_OF_DIMENSIONS = _by_name(
    Parameter("story_mass", "m", "kg", POSITIVE, "mass of the floor", "story_masses"),
    Parameter("story_stiffness", "k", "N m-1", POSITIVE, "stiffness of the story", "story_stiffnesses"),
    Parameter("story_height", "h", "m", POSITIVE, "height of the story", "story_heights"),
    Parameter("position", "x", "m", ANY, "position of the column", "positions"),
    Parameter("top_height", "h", "m", ANY, "height of the mode or floor", "top_height"),
)

# Parameters of ground motions: fields of their classes, and ratios of pulses, which variants.py computes.
MOTION = _by_name(
    Parameter("a_p", "a_p", "m s-2", ANY, "amplitude of the pulse"),
    Parameter("acceleration_ratio", "a_p/(g tan α)", "1", ANY, "amplitude of the pulse", instead_of=("a_p",)),
    Parameter("T_p", "T_p", "s", POSITIVE, "period of the pulse"),
    Parameter("frequency_ratio", "ω_p/p", "1", POSITIVE, "frequency of the pulse", instead_of=("T_p",)),
    Parameter("A", "A", "m s-1", ANY, "velocity amplitude of the pulse"),
    Parameter("f_p", "f_p", "Hz", POSITIVE, "frequency of the pulse"),
    Parameter("gamma", "γ", "1", POSITIVE, "number of oscillations of the pulse"),
    Parameter("nu", "ν", "rad", ANY, "phase of the pulse"),
    Parameter("phi", "φ", "rad", ANY, "phase of the pulse"),
    Parameter("scale", "f", "1", ANY, "factor on the motion"),
    Parameter("vertical_ratio", "v̈_g/ü_g", "1", ANY, "ratio of vertical to horizontal ground acceleration"),
    Parameter("dt", "Δt", "s", POSITIVE, "sampling interval"),
    Parameter("t_start", "t_0", "s", ANY, "time of the first sample"),
)

# Parameters of the state at the start of a scene, fields of `rockjax.State`; names begin with `initial.`.
INITIAL = _by_name(
    Parameter("initial.theta", "θ_0", "rad", ANY, "initial rotation of the columns", "theta"),
    Parameter("initial.theta_dot", "θ̇_0", "rad s-1", ANY, "initial rate of the rotation", "theta_dot"),
    Parameter("initial.u_t", "u_0", "m", ANY, "initial displacement of the superstructure", "u_t"),
    Parameter("initial.u_t_dot", "u̇_0", "m s-1", ANY, "initial velocity of the superstructure", "u_t_dot"),
)


def attribute_name(parameter: Parameter) -> str:
    """Return the name of a parameter as an attribute of a file: its name and unit, such as `R_m`."""
    name = {"lam": "lambda"}.get(parameter.name, parameter.name)
    return name if parameter.unit == "1" else f"{name}_{parameter.unit.replace(' ', '_').replace('-', '')}"


def motion_parameter(name: str) -> Parameter:
    """Return the parameter of a ground motion. For an unknown name, return a parameter with this name and
    symbol, without unit and meaning."""
    return MOTION.get(name, Parameter(name, name, "", ANY, ""))


def find_entry(name: str) -> Parameter | None:
    """Return the parameter with a name; None for a name that is not in `STRUCTURE` or `MOTION`. The name may
    have a prefix. A name with the prefix `excitation.`, such as `excitation.gamma`, is looked up only in
    `MOTION`."""
    path, _, short = name.rpartition(".")
    table = STRUCTURE if short in STRUCTURE and not path.startswith("excitation") else MOTION
    return table.get(short)


def variable_attributes(name: str) -> dict[str, str]:
    """Return the attributes of a variable or axis in a dataset; empty for a name that is not a parameter."""
    entry = find_entry(name)
    return {} if entry is None else entry.variable_attributes


def as_variable(
    dims: str | tuple[str, ...], values: Any, units: str, long_name: str, **attributes: Any
) -> tuple[Any, Any, dict[str, Any]]:
    """Return a variable of a dataset with its unit and description, and with further attributes."""
    return dims, values, {"units": units, "long_name": long_name, **attributes}


def find_clash(names: Iterable[str]) -> tuple[str, str] | None:
    """Return the first two names that cannot be given together, see `Parameter.instead_of`; None if there is
    no such pair."""
    names = tuple(names)
    for table in (STRUCTURE, MOTION):
        for name in names:
            for other in table[name].instead_of if name in table else ():
                if other in names:
                    return other, name
    return None
