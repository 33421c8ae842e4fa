"""Constants and units: conversions to SI, texts that mean a unit, and units for display.

Numbers are in SI everywhere else; a factor of another unit comes from `UNITS`.
"""

from __future__ import annotations

import math
import re
from typing import Literal, NamedTuple, get_args

STANDARD_GRAVITY = 9.80665  # m/s²
DEGREE = math.pi / 180  # rad
MM_PER_M = 1e3  # for axes in mm


class Unit(NamedTuple):
    """A unit: the dimension of its quantity, and its size in SI (a year for rates and return periods)."""

    dimension: str
    factor: float


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
    "g's": "g", "gs": "g", "gn": "g", "g0": "g", "milli-g": "mg", "gals": "gal",
    "kine": "cm/s", "msec": "ms", "millis": "ms", "µs": "us", "μs": "us", "usec": "us",
    "minute": "min", "minutes": "min", "1/yr": "1/year", "1/a": "1/year", "/year": "1/year", "/yr": "1/year",
    "yr-1": "1/year", "year-1": "1/year", "peryear": "1/year", "peryr": "1/year", "perannum": "1/year",
    "a": "year", "yr": "year", "yrs": "year", "years": "year", "percent": "%", "-": "1", "–": "1",
    "count": "counts", "cts": "counts", "digit": "counts", "digits": "counts",
}  # fmt: skip
_SUPERSCRIPTS = str.maketrans("²³⁻¹", "23-1")
# Names of SI units in datasets, and their display.
_SI = {"acceleration": "m s-2", "velocity": "m s-1", "displacement": "m", "ratio": "1"}
_DISPLAYED = {"m s-2": "m/s²", "s-2": "1/s²", "m s-1": "m/s", "rad s-1": "rad/s", "N m-1": "N/m", "1": "–"}

# Factors to m/s² of the units that users may give for records, and of all that headers of files may contain.
RecordUnit = Literal["g", "m/s2", "cm/s2", "gal", "mm/s2"]
RECORD_UNITS: dict[str, float] = {name: UNITS[name].factor for name in get_args(RecordUnit)}
ACCELERATIONS = {name: unit.factor for name, unit in UNITS.items() if unit.dimension == "acceleration"}
INTENSITY_UNITS = [name for name, unit in UNITS.items() if unit.dimension in _SI]


def unit_of(text: str | None) -> str | None:
    """Return the key of `UNITS` for a text, in any case and with `^2`, `²`, `**2`, `/s/s` or `s-2`; None for
    any other text."""
    plain = re.sub(r"[\s^*·]|\.(?=\D|$)", "", (text or "").strip(" []()").translate(_SUPERSCRIPTS)).casefold()
    plain = re.sub(r"milliseconds?", "ms", plain)
    plain = re.sub(r"seconds?|secs?(?![a-z])", "s", plain).replace("/s/s", "/s2")
    plain = re.sub(r"^(m|cm|mm)s-([12])$", r"\1/s\2", plain).replace("/s1", "/s")
    plain = _ALIASES.get(plain, plain)
    return plain if plain in UNITS else None


def in_si(units: str) -> tuple[float, str] | None:
    """Return the factor to the SI unit of an intensity, and that unit; None for other units."""
    unit = UNITS.get(unit_of(units) or "")
    return None if unit is None or unit.dimension not in _SI else (unit.factor, _SI[unit.dimension])


def displayed(unit: str) -> str:
    """Return the unit of a dataset for display, "–" for ratios."""
    return _DISPLAYED.get(unit, unit)


def displayed_or_empty(unit: str) -> str:
    """Return the unit of a dataset for display, empty for ratios."""
    return "" if unit == "1" else displayed(unit)
