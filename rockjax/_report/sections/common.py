"""Functions for several sections: sets of motions, governing scene, pictures and tables.

A scene is the structure under one motion.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from rockjax import _results as results
from rockjax._report.blocks import Figure
from rockjax._report.store import fingerprint

if TYPE_CHECKING:
    from rockjax._report.evaluation import Evaluation
    from rockjax._report.scenes import Scenes
    from rockjax._report.tables import Table


def sets_with_scenes(evaluation: Evaluation) -> tuple[str, ...]:
    """Return the names of the sets of motions for which at least one check has values."""
    return tuple(evaluation.assumptions)


def governing_scene(scenes: Scenes, names: Iterable[str]) -> tuple[str, int] | None:
    """Return (set, index of the motion) of the scene with the largest rotation among the scenes that finished
    without overturning; None if there are no such scenes.

    - `scenes`: the scenes of the problem; `names`: names of the sets
    """
    governing: tuple[float, str, int] | None = None
    for name in names:
        data = scenes.peaks(name)
        is_left_out = data["overturned"].values | results.did_not_finish(data["result"].values)
        rotation = np.where(is_left_out, -1.0, data["peak_rotation"].values)
        k = int(np.argmax(rotation))
        if rotation[k] >= 0 and (governing is None or rotation[k] > governing[0]):
            governing = float(rotation[k]), name, k
    return None if governing is None else governing[1:]


def stored_figure(evaluation: Evaluation, name: str, inputs: Any, draw: Callable[[], Figure]) -> Figure:
    """Return a picture from the store. If it is missing or was drawn from other inputs, draw and store it.

    - `evaluation`: the evaluated problem, whose store is used
    - `name`: name in the store; `inputs`: pytree of all data that the picture depends on
    - `draw`: function that returns the picture, whose caption must be a string
    """
    store = evaluation.scenes.store
    text = store.text(f"figures.{name}", fingerprint(inputs), lambda: json.dumps(dataclasses.asdict(draw())))
    return Figure(**json.loads(text))


def details(evaluation: Evaluation, section: int) -> list[Table]:
    """Return the tables with the details of the checks that belong to a section. If tables have the same
    name, return only the first of them."""
    tables: dict[str, Table] = {}
    for check in evaluation.checks:
        if check.values is not None and check.kind.section == section:
            for table in check.kind.tables(check.entry, check.values, evaluation.scenes):
                tables.setdefault(table.name, table)
    return list(tables.values())
