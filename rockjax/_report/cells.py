"""Cells with a number, or with a text in place of a missing number; names of tables."""

from __future__ import annotations

import hashlib
import math
import re
from typing import TYPE_CHECKING, Any

from rockjax import _results as results

from .tables import Quantity, TextCell

if TYPE_CHECKING:
    import xarray

MAX_SLUG = 40  # largest number of characters of a set or check in the name of a table or picture


def number_cell(
    value: Any, kind: str, error: Any = None, text: str = "none", note: str = ""
) -> Quantity | TextCell:
    """Return a cell with a number, or with `text` if the number is not finite.

    - `value`, `kind`: the number [SI], and what it measures, one of `units.KINDS`
    - `error`: estimated error of the number [SI]; None, or not finite, if it is unknown
    - `text`, `note`: text that replaces the number, and a second line in the cell
    """
    value = float(value)
    if not math.isfinite(value):
        return TextCell(text, "none", note=note)
    error = None if error is None or not math.isfinite(float(error)) else float(error)
    return Quantity(value, kind, error, note=note)


def peak_cell(data: xarray.Dataset, k: int, value: Any, kind: str, error: Any = None) -> Quantity | TextCell:
    """Return a cell with a peak of a scene.

    A text replaces the peak if the scene did not finish, or if the peak is not finite. The latter means that
    a joint opens. If the columns overturn, a note states the time of overturning.

    - `data`: dataset of scenes along `motion`; `k`: index of the scene
    - `value`, `kind`, `error`: as for `number_cell`
    """
    code = int(data["result"].values[k])
    if results.did_not_finish(code):
        return TextCell(results.NAMES[code].replace("_", " "), "unanswered")
    if bool(data["overturned"].values[k]):
        until = f"until {float(data['overturn_time'].values[k]):.2f} s"
        return number_cell(value, kind, error, "joint opens", until)
    return number_cell(value, kind, error, "joint opens")


def slug(name: str) -> str:
    """Convert a name to lower-case letters, digits and "-", for the names of tables and pictures.

    A name that is too long or has other characters ends with a part of its hash. So only names that differ
    by nothing but upper and lower case give the same result.
    """
    plain = re.sub(r"[^a-z0-9-]", "-", name.lower())[:MAX_SLUG]
    return plain if plain == name.lower() else f"{plain}-{hashlib.sha256(name.encode()).hexdigest()[:8]}"
