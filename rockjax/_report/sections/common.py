"""Parts that sections share: cells for numbers that may be words, and names of scenes."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, Any

import numpy as np

from rockjax import _results as results
from rockjax._report.tables import Quantity, Word

if TYPE_CHECKING:
    import xarray

    from rockjax._report.evaluation import Evaluation


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


def sets_with_scenes(evaluation: Evaluation) -> tuple[str, ...]:
    """Return the names of the sets whose scenes a check uses."""
    return tuple(
        name
        for name in evaluation.scenes.used_sets
        if any(check.motions == name and check.values is not None for check in evaluation.checks)
    )


def governing_scene(evaluation: Evaluation) -> tuple[str, int] | None:
    """Return the set and the index of the motion with the largest rotation that does not overturn; None
    without scenes."""
    largest: tuple[float, str, int] | None = None
    for name in sets_with_scenes(evaluation):
        data = evaluation.scenes.peaks(name)
        rotation = np.where(data["overturned"].values, -1.0, data["peak_rotation"].values)
        k = int(np.argmax(rotation))
        if rotation[k] >= 0 and (largest is None or rotation[k] > largest[0]):
            largest = float(rotation[k]), name, k
    return None if largest is None else largest[1:]


def slug(name: str) -> str:
    """Return a name for a table or picture from the name of a set of motions."""
    return re.sub(r"[^a-z0-9-]", "-", name.lower())
