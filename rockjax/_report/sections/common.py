"""Functions for several sections: sets of motions, governing scene, pictures and tables.

A scene is the structure under one motion.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from rockjax import _results as results
from rockjax._report.blocks import Figure, Pair, Paragraph
from rockjax._report.cells import slug
from rockjax._report.evaluation import describe_error
from rockjax._report.store import fingerprint
from rockjax._report.tables import Code, Column, Quantity, Table, TextCell
from rockjax._report.units import Units, kind_of_unit
from rockjax._structures.elevation import Elevation

if TYPE_CHECKING:
    import xarray

    from rockjax._report.evaluation import Check, Evaluation
    from rockjax._report.scenes import Scenes
    from rockjax._structures import Podium

NO_SCENE = TextCell("no scene survives", "overturned")  # in place of a number of the surviving scenes


def sets_with_scenes(evaluation: Evaluation) -> tuple[str, ...]:
    """Return the names of the sets of motions for which at least one check has values."""
    return tuple(evaluation.assumptions)


def unused_sets(evaluation: Evaluation) -> list[str]:
    """Return the names of the sets of motions that no check names."""
    used = {check.motions for check in evaluation.checks}
    return [name for name in evaluation.problem.motions if name not in used]


def surviving_scenes(data: xarray.Dataset) -> np.ndarray:
    """Return for each scene of a dataset whether it finished without overturning, (motions,)."""
    return results.outcomes(data).values == 0


def drifts_of(data: xarray.Dataset) -> np.ndarray | None:
    """Return the peak drifts of scenes, (scenes, storeys). The drift of a single oscillator is its
    deformation. Return None if the scenes have no drifts."""
    if "peak_drift" in data:
        return data["peak_drift"].values
    deformation = data["peak_deformation"].values if "peak_deformation" in data else None
    return deformation[:, None] if deformation is not None and deformation.ndim == 1 else None


def omitted_scenes(data: xarray.Dataset) -> str:
    """Return a note on the number of scenes that overturned or did not finish; "" if there are none."""
    survives = surviving_scenes(data)
    count = int((~survives).sum())
    return f"{count} of {survives.size} scenes left out: overturned or did not finish" if count else ""


def governing_motion(data: xarray.Dataset, name: str) -> int | None:
    """Return the index of the scene with the largest value of the variable `name` among the scenes that
    finished without overturning; None if there are no such scenes."""
    survivors = np.flatnonzero(surviving_scenes(data))
    return int(survivors[np.argmax(data[name].values[survivors])]) if survivors.size else None


def governing_scene(scenes: Scenes, names: Iterable[str]) -> tuple[str, int] | None:
    """Return (set, index of the motion) of the scene with the largest rotation among the scenes that finished
    without overturning; None if there are no such scenes.

    - `scenes`: the scenes of the problem; `names`: names of the sets
    """
    governing: tuple[float, str, int] | None = None
    for name in names:
        data = scenes.peaks(name)
        k = governing_motion(data, "peak_rotation")
        rotation = -1.0 if k is None else float(data["peak_rotation"][k])
        if k is not None and (governing is None or rotation > governing[0]):
            governing = rotation, name, k
    return None if governing is None else governing[1:]


def stored_figure(
    evaluation: Evaluation, name: str, inputs: Any, draw: Callable[[], Figure]
) -> Figure | Paragraph:
    """Return a picture from the store. If it is missing or was drawn from other inputs, draw and store it. If
    drawing raises an error, return a note with the error.

    - `evaluation`: the evaluated problem, whose store is used
    - `name`: name in the store; `inputs`: pytree of all data that the picture depends on
    - `draw`: function that returns the picture. Its caption must be a string, and its description may contain
      strings and quantities
    """
    store = evaluation.scenes.store
    try:
        text = store.text(
            f"figures.{name}", fingerprint(inputs), lambda: json.dumps(dataclasses.asdict(draw()))
        )
    except Exception as error:
        return Paragraph(("The picture ", Code(name), f" is missing: {describe_error(error)}"), is_note=True)
    values = json.loads(text)
    if not isinstance(values["description"], str):
        values["description"] = tuple(
            part if isinstance(part, str) else Quantity(**part) for part in values["description"]
        )
    return Figure(**values)


def in_pairs(pictures: Sequence[Figure | Paragraph]) -> list[Figure | Paragraph | Pair]:
    """Return pictures two by two beside each other. Notes, and a last picture without a partner, remain as
    they are."""
    blocks: list[Figure | Paragraph | Pair] = []
    for picture in pictures:
        last = blocks[-1] if blocks else None
        if isinstance(last, Figure) and isinstance(picture, Figure):
            blocks[-1] = Pair(last, picture)
        else:
            blocks.append(picture)
    return blocks


def plot_label(text: str) -> str:
    """Return a name of the problem file as a label in a picture: at most 32 characters, without formulas."""
    return (text if len(text) <= 32 else f"{text[:31]}…").replace("$", r"\$")


def in_page_units(data: xarray.Dataset, units: Units) -> xarray.Dataset:
    """Return a dataset whose variables and coordinates with the unit of an intensity measure, such as
    "m s-2", are converted to the unit of the page.

    - `data`: dataset of a fragility curve, an incremental dynamic analysis or a disaggregation. Its attribute
      `median`, if present, is an intensity
    """
    unit = data["at" if "at" in data else "intensity"].attrs["units"]
    kind = kind_of_unit(unit)
    converted = {
        name: (y.dims, y.values / units.factor(kind), y.attrs | {"units": units.symbol(kind)})
        for name, y in data.variables.items()
        if y.attrs.get("units") == unit and unit != "1"
    }
    attrs = {"median": data.attrs["median"] / units.factor(kind)} if "median" in data.attrs else {}
    coords = {name: y for name, y in converted.items() if name in data.coords}
    others = {name: y for name, y in converted.items() if name not in data.coords}
    return data.assign_coords(coords).assign(others).assign_attrs(attrs)


def details(evaluation: Evaluation, section: int) -> list[Table]:
    """Return the tables with the details of the checks that belong to a section. If tables have the same
    name, return only the first of them."""
    tables: dict[str, Table] = {}
    for check in evaluation.checks:
        if check.values is not None and check.kind.section == section:
            for table in _tables(check, evaluation.scenes):
                tables.setdefault(table.name, table)
    return list(tables.values())


def _tables(check: Check, scenes: Scenes) -> list[Table]:
    """Return the tables with the details of a check, or a table with the error that prevents them."""
    assert check.values is not None
    try:
        return check.kind.tables(check.entry, check.values, scenes)
    except Exception as error:
        caption, rows = f"Details of check {check.id}", ((TextCell(describe_error(error), "unanswered"),),)
        return [Table(f"details-{slug(check.id)}", caption, (Column("Error"),), rows)]


def column_offsets(podium: Podium) -> np.ndarray:
    """Return the positions of the columns from their mean [m], (N,). NumPy computes them, because outside jit
    every operation of JAX compiles separately. `podium`: a structure with positions of the columns."""
    assert isinstance(podium.elevation, Elevation)
    positions = np.asarray(podium.elevation.columns, float)
    return positions - positions.mean()
