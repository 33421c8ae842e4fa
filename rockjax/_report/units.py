"""Units in which reports show numbers. All other values are in SI.

A kind is what a number measures, such as "force". `KINDS` lists the units of each kind.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
import re
from collections.abc import Sequence
from typing import NamedTuple

from rockjax._units import DEGREE, STANDARD_GRAVITY

NO_UNIT = "–"  # the unit of pure numbers


class Kind(NamedTuple):
    """A kind of quantity, with its units."""

    units: dict[str, float]  # name of a unit → its size in SI; the first is the SI unit
    usual: str  # unit on pages, unless the user chooses another one
    article: str = "a"  # article before the name of the kind, for messages
    digits: int | None = 4  # significant digits on a page; None for whole numbers


_LENGTHS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2}
# The size of "g" in this table is not used. `size_of` returns its argument `g` instead.
KINDS = {
    "force": Kind({"N": 1.0, "kN": 1e3, "MN": 1e6}, "kN"),
    "length": Kind(_LENGTHS, "m"),
    "displacement": Kind(_LENGTHS, "mm"),
    "angle": Kind({"rad": 1.0, "deg": DEGREE}, "deg", "an"),
    "acceleration": Kind({"m/s²": 1.0, "g": STANDARD_GRAVITY}, "g", "an"),
    "velocity": Kind({"m/s": 1.0}, "m/s"),
    "time": Kind({"s": 1.0}, "s"),
    "frequency": Kind({"Hz": 1.0}, "Hz"),
    "angular frequency": Kind({"rad/s": 1.0}, "rad/s", "an"),
    "mass": Kind({"kg": 1.0, "t": 1e3}, "t"),
    "density": Kind({"kg/m³": 1.0, "t/m³": 1e3}, "kg/m³"),
    "stress": Kind({"Pa": 1.0, "kPa": 1e3, "MPa": 1e6}, "MPa"),
    "moment": Kind({"Nm": 1.0, "kNm": 1e3, "MNm": 1e6}, "kNm"),
    "impulse": Kind({"Ns": 1.0, "kNs": 1e3, "MNs": 1e6}, "kNs", "an"),
    "stiffness": Kind({"N/m": 1.0, "kN/m": 1e3, "MN/m": 1e6}, "MN/m"),
    "rate": Kind({"1/year": 1.0}, "1/year"),
    "return period": Kind({"years": 1.0}, "years"),
    "ratio": Kind({NO_UNIT: 1.0, "%": 1e-2}, "%"),
    "number": Kind({NO_UNIT: 1.0}, NO_UNIT),
    "count": Kind({NO_UNIT: 1.0}, NO_UNIT, digits=None),
    "utilisation": Kind({NO_UNIT: 1.0}, NO_UNIT),
    "derivative": Kind({NO_UNIT: 1.0}, NO_UNIT),  # with a sign and two significant digits
}
# Unit of an output of scenes, or of a variable in a dataset → kind.
_KIND_OF_UNIT = {
    "1": "number",
    "m": "displacement",
    "m s-2": "acceleration",
    "m/s2": "acceleration",
    "m s-1": "velocity",
    "rad": "angle",
    "s": "time",
    "kg": "mass",
    "N": "force",
    "N m-1": "stiffness",
}
_SYMBOLS = {"deg": "°"}
_ALIASES = {
    alias: unit
    for unit, aliases in {
        "deg": "° degree degrees",
        NO_UNIT: "- 1 —",
        "m/s²": "m/s2",
        "kg/m³": "kg/m3",
        "t/m³": "t/m3",
        "1/year": "1/a 1/yr",
        "years": "year",
        "%": "percent",
    }.items()
    for alias in aliases.split()
}
# Units of the kinds that have more than one unit.
_CHOOSABLE = sorted({unit for kind in KINDS.values() if len(kind.units) > 1 for unit in kind.units})


@dataclasses.dataclass(frozen=True)
class Units:
    """The unit of every kind on a page.

    - `names`: names of units, at most one for each kind. Other kinds keep their usual unit. There are two
      kinds of lengths: dimensions ("length"), and drifts and other movements ("displacement"). A single unit
      of length applies to both kinds. Of two units, the larger applies to dimensions and the smaller to
      displacements, whatever their order. With ("kN", "m", "deg", "g", "mm"), for example, a column is 3 m
      high and its top is displaced by 325 mm
    - `g`: gravity [m/s²], the size of the unit "g"

    Raises `ValueError` for an unknown unit, for two units of one kind, for more than two units of length or
    two equal ones, and for a gravity that is not positive and finite.
    """

    names: tuple[str, ...] = ()
    g: float = STANDARD_GRAVITY
    _chosen: dict[str, str] = dataclasses.field(default_factory=dict, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "names", tuple(_name(name, "units") for name in self.names))
        if not (math.isfinite(self.g) and self.g > 0):
            raise ValueError(f"units: g must be positive and finite, got g = {self.g}")
        chosen = self._chosen
        lengths = [name for name in self.names if name in _LENGTHS]
        if len(set(lengths)) < len(lengths) or len(lengths) > 2:
            raise ValueError(
                f"units: at most two different units of length are possible, got {', '.join(lengths)}"
            )
        if lengths:
            chosen["length"] = max(lengths, key=_LENGTHS.__getitem__)
            chosen["displacement"] = min(lengths, key=_LENGTHS.__getitem__)
        for name in self.names:
            if name in lengths:
                continue
            kind = next(kind for kind, entry in KINDS.items() if name in entry.units)
            if kind in chosen:
                raise ValueError(f"units: {kind} has two units, {chosen[kind]} and {name}; give one of them")
            chosen[kind] = name

    @classmethod
    def parse(cls, text: str | Sequence[str], g: float = STANDARD_GRAVITY) -> Units:
        """Parse a string such as "kN,m,deg,g,mm", or a list of names.

        Raises `ValueError` as the constructor does.
        """
        names = text.split(",") if isinstance(text, str) else text
        return cls(tuple(name.strip() for name in names if name.strip()), g)

    @classmethod
    def si(cls, g: float = STANDARD_GRAVITY) -> Units:
        """Return the units with the SI unit for every kind, as in JSON files."""
        firsts = {kind: next(iter(entry.units)) for kind, entry in KINDS.items() if len(entry.units) > 1}
        return cls(tuple(unit for kind, unit in firsts.items() if kind != "displacement"), g)

    def unit(self, kind: str) -> str:
        """Return the name of the unit of a kind. Raises `KeyError` for an unknown kind."""
        return self._chosen.get(kind, KINDS[kind].usual)

    def symbol(self, kind: str) -> str:
        """Return the symbol for the unit of a kind, such as "°" for "deg"."""
        return _SYMBOLS.get(self.unit(kind), self.unit(kind))

    def factor(self, kind: str) -> float:
        """Return the SI value of the unit of a kind, such as 1000 N for 1 kN."""
        return size_of(self.unit(kind), kind, self.g)

    def show(self, value: float, kind: str) -> float:
        """Convert a value of a kind from SI to the chosen unit."""
        return in_unit(value, self.unit(kind), kind, self.g)


def in_unit(value: float, unit: str, kind: str, g: float = STANDARD_GRAVITY) -> float:
    """Convert a value from SI to a unit.

    - `value`, `kind`: the value [SI], and what it measures, one of `KINDS`
    - `unit`: name of a unit of this kind
    - `g`: gravity [m/s²], the size of the unit "g"
    """
    size = size_of(unit, kind, g)
    # 0.01 and 0.001 are not exact in binary, so a division by them has two rounding errors. The
    # multiplication by 100 or 1000 has one.
    return value * round(1 / size) if size in (1e-2, 1e-3) else value / size


def size_of(unit: str, kind: str, g: float = STANDARD_GRAVITY) -> float:
    """Return the SI value of a unit of a kind. `g`: gravity [m/s²]."""
    return g if unit == "g" else KINDS[kind].units[unit]


def kind_of_unit(unit: str) -> str:
    """Return the kind of a number from its unit in outputs and datasets: "displacement" for "m", and "number"
    for an unknown unit."""
    return _KIND_OF_UNIT.get(unit, "number")


def si_unit(kind: str) -> str:
    """Return the SI unit of a kind."""
    return next(iter(KINDS[kind].units))


def to_si(
    value: float, unit: str, kind: str, *, g: float = STANDARD_GRAVITY, owner: str = "unit", subject: str = ""
) -> float:
    """Convert a value from a unit to SI.

    - `value`: the number, in `unit`
    - `unit`: unit of the value, as the user has written it
    - `kind`: what the value measures, one of `KINDS`
    - `g`: gravity [m/s²]
    - `owner`: key of the unit, for messages, such as "checks[5].unit"
    - `subject`: name of the quantity, for messages, such as "peak-drift-ratio"; "the value" by default

    Raises `ValueError` if the unit is unknown or of another kind.
    """
    return value * size_of(unit_of_kind(unit, kind, owner=owner, subject=subject), kind, g)


def unit_of_kind(unit: str, kind: str, *, owner: str = "unit", subject: str = "") -> str:
    """Return the name in `KINDS` of a unit that a user has written, if it is a unit of `kind`.

    - `unit`, `kind`, `owner`, `subject`: as for `to_si`

    Raises `ValueError` if the unit is unknown or of another kind.
    """
    entry = KINDS[kind]
    name = _alias(unit)
    if name not in entry.units:
        choices = " or ".join(repr(choice) for choice in reversed(entry.units))
        claim = f"{subject or 'the value'} is {entry.article} {kind}"
        raise ValueError(f"{owner}: {claim}, got {unit!r}; use {choices}")
    return name


def _alias(text: str) -> str:
    """Return the name in `KINDS` for a spelling of a unit. If the spelling is unknown, return it without
    spaces, ·, * and ^."""
    plain = re.sub(r"[\s·*^]", "", text)
    return _ALIASES.get(plain, plain)


def _name(text: str, owner: str) -> str:
    """Return the name in `KINDS` for a spelling of a unit. Raises `ValueError` for an unknown unit; the
    message starts with `owner`."""
    name = _alias(text)
    valid_units = {unit for kind in KINDS.values() for unit in kind.units}
    if name in valid_units:
        return name
    folded = {unit.casefold(): unit for unit in sorted(valid_units)}
    nearest = difflib.get_close_matches(name.casefold(), folded, 1, 0.5)
    hint = (
        f"did you mean {folded[nearest[0]]!r}?" if nearest else f"known units include {', '.join(_CHOOSABLE)}"
    )
    raise ValueError(f"{owner}: {text!r} is not a known unit; {hint}")
