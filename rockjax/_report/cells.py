"""Cells of tables with numbers, or with texts that replace missing numbers. `slug` makes names of tables.

A scene is the structure under one motion.
"""

from __future__ import annotations

import hashlib
import math
import re
from typing import TYPE_CHECKING, Any

from rockjax import _results as results

from .tables import Quantity, Text, TextCell

if TYPE_CHECKING:
    import xarray

MAX_SLUG = 40  # largest number of characters that `slug` takes from a name


def number_cell(
    value: Any, kind: str, error: Any = None, text: Text = "none", note: Text = ""
) -> Quantity | TextCell:
    """Return a cell with a number, or with `text` if the number is not finite.

    - `value`: the number [SI]; `kind`: what it measures, one of `units.KINDS`
    - `error`: estimated error of the number [SI]; an error that is None or not finite is unknown
    - `text`: text that replaces the number; `note`: a second line in the cell
    """
    value = float(value)
    if not math.isfinite(value):
        return TextCell(text, "none", note=note)
    error = None if error is None or not math.isfinite(float(error)) else float(error)
    return Quantity(value, kind, error, note=note)


def unanswered_cell(code: Any) -> TextCell | None:
    """Return a cell with the name of a result, such as "out of steps", if a scene with this result did not
    finish; otherwise None. `code`: code of the result."""
    if not results.did_not_finish(code):
        return None
    return TextCell(results.NAMES[int(code)].replace("_", " "), "unanswered")


def peak_cell(data: xarray.Dataset, k: int, value: Any, kind: str, error: Any = None) -> Quantity | TextCell:
    """Return a cell with a peak of a scene.

    If the scene did not finish, the name of its result, such as "out of steps", replaces the peak. If the
    peak is not finite because a joint opens, the text "joint opens" replaces it. If the columns overturn, a
    note such as "until 5.85 s" states that the peak covers the time until overturning only.

    - `data`: dataset of scenes along `motion`; `k`: index of the scene
    - `value`, `kind`, `error`: as for `number_cell`
    """
    unanswered = unanswered_cell(data["result"].values[k])
    if unanswered is not None:
        return unanswered
    if bool(data["overturned"].values[k]):
        until = "until ", Quantity(float(data["overturn_time"].values[k]), "time")
        return number_cell(value, kind, error, "joint opens", until)
    return number_cell(value, kind, error, "joint opens")


def slug(name: str) -> str:
    """Convert a name to lower-case letters, digits and "-", for the names of tables and pictures.

    If the name is longer than `MAX_SLUG` or has characters other than letters, digits and "-", the result
    ends with a part of the hash of the name. Different names therefore give different results, unless they
    differ only in upper and lower case.
    """
    plain = re.sub(r"[^a-z0-9-]", "-", name.lower())[:MAX_SLUG]
    return plain if plain == name.lower() else f"{plain}-{hashlib.sha256(name.encode()).hexdigest()[:8]}"
