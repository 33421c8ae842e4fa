"""Section 6: the building, storey by storey."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from rockjax._report.blocks import Figure, Paragraph, Section
from rockjax._report.cells import number_cell, peak_cell, slug
from rockjax._report.pictures import to_svg
from rockjax._report.tables import Cell, Column, Table, TextCell
from rockjax._report.units import Units

from .common import (
    NO_SCENE,
    details,
    drifts_of,
    governing_motion,
    governing_scene,
    omitted_scenes,
    plot_label,
    sets_with_scenes,
    stored_figure,
    surviving_scenes,
)

if TYPE_CHECKING:
    from rockjax._report.evaluation import Evaluation


def section(evaluation: Evaluation, units: Units) -> Section:
    """Return section 6 of the page."""
    del units
    blocks: list[Any] = []
    shears = []
    for name in sets_with_scenes(evaluation):
        data = evaluation.scenes.peaks(name)
        if drifts_of(data) is not None:
            blocks.append(_stories(evaluation, name))
        if "peak_shear" in data:
            shears.append(_shear(evaluation, name))
    if shears:
        columns = (
            Column("Set"),
            Column("Motion"),
            Column("Base shear / weight", "number"),
            Column("Largest velocity jump of the deck", "velocity", note="with its motion"),
        )
        blocks.append(
            Table(
                "base-shear",
                "Base shear of the building, governing motion of each set",
                columns,
                tuple(shears),
            )
        )
        blocks.append(
            Paragraph(
                "Accelerations and shear do not contain the impulses at impacts; the velocity jump is the "
                "impulse on a unit mass that moves with the deck.",
                is_note=True,
            )
        )
    if not blocks:
        has_building = evaluation.problem.podium.superstructure is not None
        text = (
            "No check was made with ground motions." if has_building else "The structure carries no building."
        )
        blocks.append(Paragraph(text))
    blocks += [*_picture(evaluation), *details(evaluation, 6)]
    return Section(6, "Building", tuple(blocks))


def _shear(evaluation: Evaluation, name: str) -> tuple[Cell, ...]:
    """Return the row of a set in the table of the largest base shear, among the scenes that survive."""
    data = evaluation.scenes.peaks(name)
    heading = TextCell(name, note=omitted_scenes(data))
    k = governing_motion(data, "peak_shear")
    if k is None:
        return heading, *[NO_SCENE] * 3
    names = evaluation.problem.motions[name].names
    jump, of_motion = math.nan, ""
    if "peak_velocity_jump" in data:
        jumps = np.where(surviving_scenes(data), data["peak_velocity_jump"].values, np.nan)
        jump = float(np.fmax.reduce(jumps))
        of_motion = names[int(np.argmax(np.nan_to_num(jumps, nan=-1.0)))] if math.isfinite(jump) else ""
    return (
        heading,
        TextCell(names[k]),
        peak_cell(data, k, data["peak_shear"][k], "number"),
        number_cell(jump, "velocity", text="no impact", note=of_motion),
    )


def _stories(evaluation: Evaluation, name: str) -> Table:
    """Return the table of the largest and the mean peaks in each storey. The peaks are those of the scenes in
    which the columns survive. A scene is the structure under one motion. A single oscillator is a storey."""
    data, problem = evaluation.scenes.peaks(name), evaluation.problem
    heights, survives, drifts = problem.story_heights, surviving_scenes(data), drifts_of(data)
    assert drifts is not None
    if "peak_drift" in data:
        accelerations = data["peak_floor_acceleration"].values
    else:  # the only mass has the acceleration V/m
        accelerations = data["peak_shear"].values[:, None] * float(problem.podium.g)
    drift, acceleration = drifts[survives], accelerations[survives]
    columns = (
        Column("Storey"),
        Column("Largest drift", "displacement"),
        Column("Mean drift", "displacement"),
        Column("Largest drift / height", "ratio"),
        Column("Largest floor acceleration", "acceleration"),
        Column("Mean floor acceleration", "acceleration"),
    )
    rows = []
    for j in range(drifts.shape[-1]):
        if not len(drift):
            rows.append((TextCell(f"storey {j + 1}"), *[NO_SCENE] * 5))
            continue
        ratio = (
            number_cell(drift[:, j].max() / heights[j], "ratio")
            if heights is not None
            else TextCell("no height", "none")
        )
        rows.append(
            (
                TextCell(f"storey {j + 1}"),
                number_cell(drift[:, j].max(), "displacement"),
                number_cell(drift[:, j].mean(), "displacement"),
                ratio,
                number_cell(acceleration[:, j].max(), "acceleration"),
                number_cell(acceleration[:, j].mean(), "acceleration"),
            )
        )
    note = omitted_scenes(data)
    caption = f"Storeys, set {name}" + (f" ({note})" if note else "")
    return Table(f"stories-{slug(name)}", caption, columns, tuple(rows))


def _picture(evaluation: Evaluation) -> list[Figure | Paragraph]:
    """Return the picture of the drifts and floor accelerations over the height under the governing motion of
    the page, in a list. The list is empty for a building without stories."""
    scene = governing_scene(evaluation.scenes, sets_with_scenes(evaluation))
    if scene is None:
        return []
    data = evaluation.scenes.history(*scene)
    if "drift" not in data:
        return []
    name, k = scene
    label = evaluation.problem.motions[name].names[k]

    def draw() -> Figure:
        from rockjax import plots

        largest = float(np.nanmax(np.abs(data["drift"].values)))
        title = f"Drifts and floor accelerations under {label}"
        description = f"{title} of the set {name}, over the height; the largest drift is {largest:.4g} m."
        caption = f"Largest drifts and floor accelerations under {label} of the set {name}."
        svg = to_svg(plots.stories(data, label=plot_label(label)), "stories", title, description)
        return Figure(svg, caption, title, description)

    return [stored_figure(evaluation, "stories", (data.attrs["fingerprint"], name, label), draw)]
