"""Constants and units: conversion to SI, recognition of units in strings, and units for display.

All other modules use SI. `UNITS` contains the units in files of motions and hazard curves. The units in
reports are in `_report/units.py`.
"""

from __future__ import annotations

import math
import re
from typing import Literal, NamedTuple, get_args

STANDARD_GRAVITY = 9.80665  # [m/s²]
DEGREE = math.pi / 180  # [rad]
MM_PER_M = 1e3  # factor for axes in mm


class Unit(NamedTuple):
    """A unit."""

    dimension: str  # name of the physical quantity
    factor: float  # size of the unit in SI units; for rates in 1/year, for return periods in years


UNITS = {
    "g": Unit("acceleration", STANDARD_GRAVITY),
    "m/s2": Unit("acceleration", 1.0),
    "cm/s2": Unit("acceleration", 1e-2),
    "gal": Unit("acceleration", 1e-2),
    "mm/s2": Unit("acceleration", 1e-3),
    "mg": Unit("acceleration", 1e-3 * STANDARD_GRAVITY),
    "%g": Unit("acceleration", 1e-2 * STANDARD_GRAVITY),
    "m/s": Unit("velocity", 1.0),
    "cm/s": Unit("velocity", 1e-2),
    "mm/s": Unit("velocity", 1e-3),
    "m": Unit("displacement", 1.0),
    "cm": Unit("displacement", 1e-2),
    "mm": Unit("displacement", 1e-3),
    "s": Unit("time", 1.0),
    "ms": Unit("time", 1e-3),
    "us": Unit("time", 1e-6),
    "min": Unit("time", 60.0),
    "1/year": Unit("rate", 1.0),
    "year": Unit("return period", 1.0),
    "1": Unit("ratio", 1.0),
    "%": Unit("ratio", 1e-2),
    "counts": Unit("counts", 1.0),
}
_ALIASES = {
    "g's": "g", "gs": "g", "gn": "g", "g0": "g", "milli-g": "mg", "millig": "mg", "gals": "gal",
    "kine": "cm/s", "msec": "ms", "millis": "ms", "µs": "us", "μs": "us", "usec": "us",
    "seg": "s", "minute": "min", "minutes": "min",
    "1/yr": "1/year", "1/a": "1/year", "/year": "1/year", "/yr": "1/year",
    "yr-1": "1/year", "year-1": "1/year", "peryear": "1/year", "peryr": "1/year", "perannum": "1/year",
    "a": "year", "yr": "year", "yrs": "year", "years": "year", "jahre": "year", "ans": "year",
    "anni": "year", "años": "year", "percent": "%", "-": "1", "–": "1",
    "count": "counts", "cts": "counts", "digit": "counts", "digits": "counts",
}  # fmt: skip
_SUPERSCRIPTS = str.maketrans("²³⁻¹", "23-1")
# SI units in datasets by physical quantity, and the display of units in datasets.
_SI = {"acceleration": "m s-2", "velocity": "m s-1", "displacement": "m", "ratio": "1"}
_DISPLAYED = {"m s-2": "m/s²", "s-2": "1/s²", "m s-1": "m/s", "rad s-1": "rad/s", "N m-1": "N/m", "1": "–"}

# `RECORD_UNITS` are the units that users may pass for records, and `ACCELERATIONS` are the units of
# acceleration that headers of files may have, both with their factors to m/s². `INTENSITY_UNITS` are the
# units that intensity measures may have.
RecordUnit = Literal["g", "m/s2", "cm/s2", "gal", "mm/s2"]
RECORD_UNITS: dict[str, float] = {name: UNITS[name].factor for name in get_args(RecordUnit)}
ACCELERATIONS = {name: unit.factor for name, unit in UNITS.items() if unit.dimension == "acceleration"}
INTENSITY_UNITS = [name for name, unit in UNITS.items() if unit.dimension in _SI]


def unit_of(text: str | None) -> str | None:
    """Return the key in `UNITS` of a unit that is written as a string; None if the string is no such unit.

    Upper and lower case are equivalent, and `^2`, `²`, `**2`, `/s/s`, `s-2`, `_s2` and `ps2` are understood.
    """
    plain = re.sub(r"[\s^*·]|\.(?=\D|$)", "", (text or "").strip(" []()").translate(_SUPERSCRIPTS)).casefold()
    plain = re.sub(r"milliseconds?", "ms", plain)
    plain = re.sub(r"seconds?|secs?(?![a-z])", "s", plain).replace("_", "/").replace("/s/s", "/s2")
    plain = re.sub(r"^(m|cm|mm)(?:ps|s-(?=[12]$))", r"\1/s", plain).replace("/s1", "/s")
    plain = _ALIASES.get(plain, plain)
    return plain if plain in UNITS else None


def in_si(units: str) -> tuple[float, str] | None:
    """Return the factor from a unit of an intensity measure to SI, and the SI unit as in datasets. Return
    None for unknown units and for units that no intensity measure has."""
    unit = UNITS.get(unit_of(units) or "")
    return None if unit is None or unit.dimension not in _SI else (unit.factor, _SI[unit.dimension])


def displayed(unit: str) -> str:
    """Return a unit of a dataset as it is displayed, such as "m/s²" for "m s-2"; "–" for ratios."""
    return _DISPLAYED.get(unit, unit)


def displayed_or_empty(unit: str) -> str:
    """Return a unit of a dataset as it is displayed; an empty string for ratios."""
    return "" if unit == "1" else displayed(unit)


def unit_of_measure(measure: str) -> str:
    """Return the SI unit, as in datasets, of an intensity measure. The measure is "PGA", "PGV", "Sa", a label
    such as "Sa(0.5 s)", or "scale" for the factor on a motion."""
    return {"PGV": "m s-1", "scale": "1"}.get(measure, "m s-2")
