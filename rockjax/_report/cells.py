"""Cells for numbers that may be words, and names of tables."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, Any

from rockjax import _results as results

from .tables import Quantity, Word

if TYPE_CHECKING:
    import xarray


def number(value: Any, kind: str, error: Any = None, word: str = "none", note: str = "") -> Quantity | Word:
    """Return a number as a cell; where it is not finite, a word in its place."""
    value = float(value)
    if not math.isfinite(value):
        return Word(word, "none", note=note)
    error = None if error is None or not math.isfinite(float(error)) else float(error)
    return Quantity(value, kind, error, note=note)


def of_scene(data: xarray.Dataset, k: int, value: Any, kind: str, error: Any = None) -> Quantity | Word:
    """Return a peak of a scene as a cell. Peaks of a scene that overturned are those until then."""
    code = int(data["result"].values[k])
    if code > results.OVERTURNED:
        return Word(results.NAMES[code].replace("_", " "), "unanswered")
    if bool(data["overturned"].values[k]):
        until = f"until {float(data['overturn_time'].values[k]):.2f} s"
        return number(value, kind, error, "joint opens", until)
    return number(value, kind, error, "joint opens")


def slug(name: str) -> str:
    """Return a name for a table or picture from the name of a set of motions."""
    return re.sub(r"[^a-z0-9-]", "-", name.lower())
