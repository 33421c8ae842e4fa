"""Units of intensity measures."""

from rockjax._motions.headings import UNITS, unit_of

_SI = {"acceleration": "m s-2", "velocity": "m s-1", "displacement": "m", "ratio": "1"}
KNOWN = [name for name, unit in UNITS.items() if unit.dimension in _SI]


def in_si(units: str) -> tuple[float, str] | None:
    """Return the factor to the SI unit of an intensity, and that unit; None for other units."""
    unit = UNITS.get(unit_of(units) or "")
    return None if unit is None or unit.dimension not in _SI else (unit.factor, _SI[unit.dimension])
