"""Section 11: numerical accuracy. A scene is the structure under one motion."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from rockjax import _results as results
from rockjax._outputs.registry import VARIABLES
from rockjax._report.blocks import Paragraph, Section
from rockjax._report.cells import number_cell
from rockjax._report.tables import Column, Quantity, Table, TextCell
from rockjax._report.units import Units, kind_of_unit

from .common import governing_scene, sets_with_scenes

if TYPE_CHECKING:
    import xarray

    from rockjax._report.evaluation import Evaluation


def section(evaluation: Evaluation, units: Units) -> Section:
    """Return section 11 of the page."""
    del units
    options = evaluation.problem.options
    text = (
        "Relative tolerance ",
        Quantity(float(options.rtol), "number", is_input=True),
        ", absolute tolerance ",
        Quantity(float(options.atol), "number", is_input=True),
        "; overturning is |θ| = ",
        Quantity(float(options.overturn_ratio), "number", is_input=True),
        " α. Scenes with the inputs and motions of the problem file are solved a second time with a tenth of "
        "the tolerance, or ten times the tolerance if a tenth is close to rounding. The difference is the "
        "estimated error.",
    )
    blocks: list[Any] = [Paragraph(text)]
    outputs: dict[str, dict[str, Quantity | TextCell]] = {}  # variable → set → cell
    counts = []
    for name in sets_with_scenes(evaluation):
        data = evaluation.scenes.peaks(name)
        codes, undecided = data["result"].values, data["undecided"].values
        unfinished = results.did_not_finish(codes)
        for variable, (entry, _) in VARIABLES.items():
            if f"{variable}_error" not in data:
                continue
            error, value = (data[y].values[~unfinished] for y in (f"{variable}_error", variable))
            errors, values = error[np.isfinite(error)], value[np.isfinite(value)]
            cell: Quantity | TextCell = TextCell("no finite value", "none")
            if values.size:
                worst = values.min() if variable.startswith("least") else np.abs(values).max()
                cell = number_cell(worst, kind_of_unit(entry.unit), errors.max() if errors.size else None)
            outputs.setdefault(variable, {})[name] = cell
        counts.append(
            (
                TextCell(name),
                Quantity(len(codes), "count"),
                Quantity(int(data["overturned"].values.sum()), "count"),
                Quantity(int(undecided.sum()), "count"),
                Quantity(int(unfinished.sum()), "count"),
                Quantity(int(data["steps"].values.sum()), "count"),
            )
        )
    if counts:
        headings = ("Set", "Scenes", "Overturned", "Undecided", "Without an answer", "Trial steps")
        kinds = [None, *["count"] * 5]
        count_columns = tuple(Column(y, kind) for y, kind in zip(headings, kinds, strict=True))
        blocks.append(Table("scenes", "Scenes of each set", count_columns, tuple(counts)))
    balance = _energy_balance(evaluation)
    if balance is not None:
        blocks.append(balance)
    if outputs:
        blocks.append(_errors(outputs))
    return Section(11, "Numerical accuracy", tuple(blocks))


def _errors(outputs: dict[str, dict[str, Quantity | TextCell]]) -> Table:
    """Return the table of the worst value of each output in each set, with the largest estimated error.

    `outputs`: variable → set → cell
    """
    names = list(dict.fromkeys(name for cells in outputs.values() for name in cells))
    rows = []
    for variable, cells in outputs.items():
        description = VARIABLES[variable][0].description
        heading = TextCell(f"{description[:1].upper()}{description[1:]}")
        rows.append((heading, *(cells.get(name, TextCell("not computed", "none")) for name in names)))
    columns = Column("Output"), *(Column(f"Set {name}") for name in names)
    return Table("errors", "Worst values and largest estimated errors", columns, tuple(rows))


def _energy_balance(evaluation: Evaluation) -> Paragraph | None:
    """Return a paragraph on the end and the energy balance of the history of the governing scene, which the
    page draws; None if there is no such scene."""
    scene = governing_scene(evaluation.scenes, sets_with_scenes(evaluation))
    if scene is None:
        return None
    name, k = scene
    data = evaluation.scenes.history(name, k)
    label = evaluation.problem.motions[name].names[k]
    left, largest = open_energy(data)
    share = float(f"{left / largest if largest else 0.0:.1e}")
    text = (
        f"The history under {label} of the set {name} ends at ",
        Quantity(float(data["time"].values[-1]), "time"),
        f" ({results.NAMES[int(data['result'])].replace('_', ' ')}). "
        "The error of its energy balance is at most ",
        Quantity(share, "number", is_input=True),
        " of the largest input energy.",
    )
    return Paragraph(text)


def open_energy(data: xarray.Dataset) -> tuple[float, float]:
    """Return the largest absolute error of the energy balance in a history, and the largest input energy,
    both divided by N m_c [m²/s²].

    `data`: dataset of a history. Exactly, the energy at the start plus the input equals the mechanical energy
    plus the losses.
    """
    losses = [y for y in ("impact_energy", "damping_energy", "damper_energy") if y in data]
    left = data["initial_energy"].values + data["input_energy"].values - data["mechanical_energy"].values
    for name in losses:
        left = left - data[name].values
    return float(np.nanmax(np.abs(left))), float(np.nanmax(np.abs(data["input_energy"].values)))
