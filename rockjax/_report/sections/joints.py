"""Section 5: forces in the joints."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from rockjax._outputs.base import JOINT_NAMES
from rockjax._report.blocks import Equation, Equations, Figure, Paragraph, Section
from rockjax._report.cells import peak_cell, slug
from rockjax._report.pictures import to_svg
from rockjax._report.tables import Code, Column, Formula, Table, Text, TextCell
from rockjax._report.units import Units

from .common import (
    NO_SCENE,
    governing_motion,
    governing_scene,
    omitted_scenes,
    sets_with_scenes,
    stored_figure,
)

if TYPE_CHECKING:
    import xarray

    from rockjax._report.evaluation import Evaluation

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
    equations = Equations(
        tuple(
            Equation(Formula(name), label=label)
            for name, label in (
                ("axial_force_mean", "F3"),
                ("axial_force", "F8"),
                ("friction", "F9"),
                ("foundation_shear", "F5"),
                ("impulse_ratio", "F12"),
            )
        )
    )
    blocks: list[Any] = [equations, *(_table(evaluation, name) for name in names)]
    if with_shear:
        blocks.append(_shears(evaluation, with_shear))
    scene = governing_scene(evaluation.scenes, sets_with_scenes(evaluation))
    if scene is not None and scene[0] in names and "least_axial_force" in sets[scene[0]]:
        figure = _picture(evaluation, *scene)
        if figure is not None:
            blocks.append(figure)
    return Section(5, "Joint forces", tuple(blocks))


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


def _picture(evaluation: Evaluation, name: str, k: int) -> Figure | None:
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
    from rockjax import plots

    figure = plots.joint_forces(data).get_figure(root=True)
    assert figure is not None
    least = float(evaluation.scenes.peaks(name)["least_axial_force"][k].min())
    title = f"Axial forces under {label}"
    description = (
        f"Axial forces of the end columns under {label} of the set {name}, with the dead load and zero; the "
        f"least is {least:.4g} m_c g."
    )
    caption = f"Axial forces in the joints of the end columns under {label} of the set {name}."
    return Figure(to_svg(figure, "axial-forces", title, description), caption, title, description)
