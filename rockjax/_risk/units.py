"""Units of intensity measures in files."""

from rockjax._structures import STANDARD_GRAVITY

# Units that can stand for another, in SI: factor and the SI unit.
SI = {
    "g": (STANDARD_GRAVITY, "m s-2"),
    "cm s-2": (0.01, "m s-2"),
    "gal": (0.01, "m s-2"),
    "mm s-2": (1e-3, "m s-2"),
    "cm s-1": (0.01, "m s-1"),
    "cm/s": (0.01, "m s-1"),
    "cm/s2": (0.01, "m s-2"),
    "m/s2": (1.0, "m s-2"),
    "m/s": (1.0, "m s-1"),
    "m s-2": (1.0, "m s-2"),
    "m s-1": (1.0, "m s-1"),
    "m": (1.0, "m"),
    "1": (1.0, "1"),
}
