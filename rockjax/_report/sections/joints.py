"""Section 5: forces in the joints."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import numpy as np

from rockjax._outputs.base import JOINT_NAMES
from rockjax._report.blocks import Figure, Paragraph, Section
from rockjax._report.cells import peak_cell, slug
from rockjax._report.pictures import to_svg
from rockjax._report.tables import Cell, Code, Column, Quantity, Table, Text, TextCell
from rockjax._report.units import Units

from .common import (
    NO_SCENE,
    governing_motion,
    governing_scene,
    omitted_scenes,
    sets_with_scenes,
    stored_figure,
)
from .force_equations import Extreme, contact_area, equations, in_weights, total_weight
from .instants import column_text, extremes_of, instants_of, known_instants

if TYPE_CHECKING:
    import xarray

    from rockjax._report.evaluation import Evaluation
    from rockjax._report.problem import Problem

# Output → heading in the table. The outputs of axial forces are divided by m_c g, the weight of a column. The
# table divides them by the dead load instead.
_COLUMNS = {
    "least_axial_force": "Least N / dead load",
    "peak_axial_force": "Largest N / dead load",
    "peak_friction": "Friction demand |T|/N",
    "peak_impact_friction": "Friction demand at impacts |J_T|/J_N",
    "least_impulse_share": "Least share in an impulse",
}


def section(evaluation: Evaluation, units: Units) -> Section:
    """Return section 5 of the page."""
    sets = {name: evaluation.scenes.peaks(name) for name in sets_with_scenes(evaluation)}
    names = [name for name, data in sets.items() if any(y in data for y in _COLUMNS)]
    with_shear = [name for name, data in sets.items() if "peak_foundation_shear" in data]
    if not names and not with_shear:
        reason: Text = "No check was made with ground motions."
        if evaluation.problem.podium.elevation is None:
            reason = (
                "No forces were computed: the structure has no positions of columns. Give ",
                Code("positions"),
                " in [structure], or the table [structure.elevation].",
            )
        return Section(5, "Joint forces", (Paragraph(reason),))
    extremes = {name: _extremes(evaluation, name) for name in names}
    extremes = {name: rows for name, rows in extremes.items() if rows}
    blocks: list[Any] = [*equations(evaluation, [y for rows in extremes.values() for y in rows])]
    for name in names:
        if name in extremes:
            blocks.append(_governing(evaluation, name, extremes[name]))
        blocks.append(_table(evaluation, name))
    if set(with_shear) - extremes.keys():
        blocks.append(_shears(evaluation, with_shear))
    scene = governing_scene(evaluation.scenes, sets_with_scenes(evaluation))
    if scene is not None and scene[0] in names and "least_axial_force" in sets[scene[0]]:
        figure = _picture(evaluation, *scene)
        if figure is not None:
            blocks.append(figure)
    return Section(5, "Joint forces", tuple(blocks))


def _extremes(evaluation: Evaluation, name: str) -> list[Extreme]:
    """Return the least and the largest forces and friction demands of a set, among the scenes that
    survive."""
    data, found = evaluation.scenes.peaks(name), []
    for output, joint, k in extremes_of(data):
        is_located = output != "peak_foundation_shear" and evaluation.problem.podium.elevation is not None
        find = instants_of if is_located else known_instants
        instants = find(evaluation, name, k)
        value = float(np.ravel(data[output].values[k])[max(joint, 0)])
        motion = evaluation.problem.motions[name].names[k]
        found.append(Extreme(output, joint, value, name, motion, instants.get((output, joint))))
    return found


_FORCE_NAMES = {
    "least_axial_force": "Least axial force N",
    "peak_axial_force": "Largest axial force N",
    "peak_friction": "Largest friction demand |T|/N",
    "peak_foundation_shear": "Largest foundation shear |V|",
}


def _governing(evaluation: Evaluation, name: str, extremes: list[Extreme]) -> Table:
    """Return the table of the extreme forces of a set, with the column and the time of each."""
    problem, rows = evaluation.problem, []
    dead_load = np.asarray(problem.podium.dead_load, float)
    for y in extremes:
        where, note, cell = "foundation", "", None
        if y.joint >= 0:
            where = f"{JOINT_NAMES[y.joint]} joint"
        if "axial" in y.output:
            cell, share = TextCell("no dead load", "none"), None
            if dead_load[y.joint] > 0:
                share = Quantity(y.value / dead_load[y.joint], "number")
                cell = TextCell((share, " of the dead load"))
            if problem.column_mass is not None:
                note = "no dead load" if share is None else (share, " of the dead load")
                cell = dataclasses.replace(in_weights(problem, y.value), note=note)
        elif y.output == "peak_foundation_shear":
            cell = Quantity(y.value, "number", note="of the total weight")
            if problem.column_mass is not None:
                note = Quantity(y.value, "number"), " of the total weight"
                cell = dataclasses.replace(in_weights(problem, y.value * total_weight(problem)), note=note)
        elif not np.isfinite(y.value):
            cell = TextCell("joint opens", "joint opens")
        else:
            cell = Quantity(y.value, "number")
        column: Text = "not located" if y.instant is None else column_text(problem, y.instant)
        time = TextCell("not located", "none") if y.instant is None else Quantity(y.instant.time, "time")
        rows.append(
            (TextCell(f"{_FORCE_NAMES[y.output]}, {where}"), cell, TextCell(y.motion), TextCell(column), time)
        )
    rows += _pressure_rows(problem, extremes)
    columns = Column("Quantity"), Column("Value"), Column("Motion"), Column("Column"), Column("Time", "time")
    note = omitted_scenes(evaluation.scenes.peaks(name))
    caption = f"Governing forces, set {name}" + (f" ({note})" if note else "")
    return Table(f"governing-forces-{slug(name)}", caption, columns, tuple(rows))


def _pressure_rows(problem: Problem, extremes: list[Extreme]) -> list[tuple[Cell, ...]]:
    """Return the row of the largest contact pressure, in the form of `_governing`, in a list. The list is
    empty if an input is missing."""
    largest = [y for y in extremes if y.output == "peak_axial_force"]
    area = contact_area(problem)
    if not largest or area is None:
        return []
    y = max(largest, key=lambda extreme: extreme.value)
    pressure = in_weights(problem, y.value).value / area
    column: Text = "not located" if y.instant is None else column_text(problem, y.instant)
    time = TextCell("not located", "none") if y.instant is None else Quantity(y.instant.time, "time")
    name = f"Largest contact pressure, {JOINT_NAMES[y.joint]} joint"
    return [(TextCell(name), Quantity(pressure, "stress"), TextCell(y.motion), TextCell(column), time)]


def _table(evaluation: Evaluation, name: str) -> Table:
    """Return the table of the extreme forces in the bottom and the top joints, under each motion of a set."""
    data, motions = evaluation.scenes.peaks(name), evaluation.problem.motions[name]
    podium = evaluation.problem.podium
    dead_load = np.asarray(podium.dead_load, float)
    column = "worst column" if podium.elevation is not None else "mean column"
    present = {variable: head for variable, head in _COLUMNS.items() if variable in data}
    columns = [Column("Motion"), Column("Joint"), *(Column(head, "number") for head in present.values())]
    rows = []
    for k, label in enumerate(motions.names):
        for joint, joint_name in enumerate(JOINT_NAMES):
            cells = []
            for variable in present:
                value = float(data[variable][k, joint])
                if "axial" in variable and dead_load[joint] > 0:
                    value /= dead_load[joint]
                if "axial" in variable and not dead_load[joint] > 0:
                    cells.append(TextCell("no dead load", "none"))
                elif variable.endswith(("impact_friction", "impulse_share")) and not data["impacts"][k]:
                    cells.append(TextCell("no impact", "none"))
                else:
                    cells.append(peak_cell(data, k, value, "number"))
            rows.append((TextCell(label), TextCell(joint_name), *cells))
    return Table(
        f"joints-{slug(name)}",
        f"Forces in the joints, set {name}, {column}",
        tuple(columns),
        tuple(rows),
    )


def _shears(evaluation: Evaluation, names: list[str]) -> Table:
    """Return the table of the largest foundation shear of each set, among the scenes that survive."""
    rows = []
    for name in names:
        data = evaluation.scenes.peaks(name)
        k = governing_motion(data, "peak_foundation_shear")
        cells: list[Any] = [NO_SCENE] * 2
        if k is not None:
            label = evaluation.problem.motions[name].names[k]
            cells = [TextCell(label), peak_cell(data, k, data["peak_foundation_shear"][k], "number")]
        rows.append((TextCell(name, note=omitted_scenes(data)), *cells))
    columns = (Column("Set"), Column("Motion"), Column("max|V| / total weight", "number"))
    return Table("foundation-shear", "Foundation shear, governing motion of each set", columns, tuple(rows))


def _picture(evaluation: Evaluation, name: str, k: int) -> Figure | Paragraph | None:
    """Return the picture of the axial forces of the end columns under motion k of a set; None if the history
    has no joint forces."""
    data, label = evaluation.scenes.history(name, k), evaluation.problem.motions[name].names[k]
    if "joint_axial_force" not in data:
        return None
    inputs = data.attrs["fingerprint"], name, label
    return stored_figure(
        evaluation, "axial-forces", inputs, lambda: _draw_forces(evaluation, name, k, data, label)
    )


def _draw_forces(evaluation: Evaluation, name: str, k: int, data: xarray.Dataset, label: str) -> Figure:
    import matplotlib.pyplot as plt

    from rockjax import plots
    from rockjax.plots._style import in_style

    with in_style():
        figure, axes = plt.subplots(figsize=(8, 3.4), layout="constrained")
        plots.joint_forces(data, axes)
    least = float(evaluation.scenes.peaks(name)["least_axial_force"][k].min())
    title = f"Axial forces under {label}"
    description = (
        f"Axial forces of the end columns under {label} of the set {name}, with the dead load and zero; the "
        f"least is {least:.4g} m_c g."
    )
    caption = f"Axial forces in the joints of the end columns under {label} of the set {name}."
    return Figure(to_svg(figure, "axial-forces", title, description), caption, title, description)
