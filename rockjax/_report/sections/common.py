"""Sets and scenes that sections share."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from rockjax._report.blocks import Figure
from rockjax._report.store import fingerprint

if TYPE_CHECKING:
    from rockjax._report.evaluation import Evaluation
    from rockjax._report.tables import Table


def sets_with_scenes(evaluation: Evaluation) -> tuple[str, ...]:
    """Return the names of the sets whose scenes a check uses."""
    return tuple(evaluation.assumptions)


def governing_scene(evaluation: Evaluation) -> tuple[str, int] | None:
    """Return the set and the index of the surviving scene that rotates most; None if there is none."""
    largest: tuple[float, str, int] | None = None
    for name in sets_with_scenes(evaluation):
        data = evaluation.scenes.peaks(name)
        rotation = np.where(data["overturned"].values, -1.0, data["peak_rotation"].values)
        k = int(np.argmax(rotation))
        if rotation[k] >= 0 and (largest is None or rotation[k] > largest[0]):
            largest = float(rotation[k]), name, k
    return None if largest is None else largest[1:]


def drawn(evaluation: Evaluation, name: str, inputs: Any, draw: Callable[[], Figure]) -> Figure:
    """Return a picture; draw it if it is not stored with the same inputs.

    - `name`: of the picture; `inputs`: everything that it shows
    - `draw`: draws it, with a caption that is one string
    """
    store = evaluation.scenes.store
    text = store.text(f"figures.{name}", fingerprint(inputs), lambda: json.dumps(dataclasses.asdict(draw())))
    return Figure(**json.loads(text))


def details(evaluation: Evaluation, section: int) -> list[Table]:
    """Return the tables of checks whose details belong to a section; a table of several checks once."""
    tables: dict[str, Table] = {}
    for check in evaluation.checks:
        if check.values is not None and check.kind.section == section:
            for table in check.kind.tables(check.entry, check.values, evaluation.scenes):
                tables.setdefault(table.name, table)
    return list(tables.values())
