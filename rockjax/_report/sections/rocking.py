"""Section 4: rotation, uplift and overturning in every scene. A scene is the structure under one motion."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from rockjax._report.blocks import Figure, Paragraph, Section
from rockjax._report.cells import number_cell, peak_cell, slug, unanswered_cell
from rockjax._report.kinds import KINDS
from rockjax._report.kinds.peaks import deck_displacement
from rockjax._report.pictures import to_svg
from rockjax._report.scales import least_factors
from rockjax._report.tables import Column, Quantity, Table, TextCell
from rockjax._report.units import Units

from . import instants
from .common import details, governing_motion, governing_scene, sets_with_scenes, stored_figure

if TYPE_CHECKING:
    import xarray

    from rockjax._report.evaluation import Evaluation
    from rockjax._report.scenes import Scenes

WINDOW_COLUMNS = {  # variable of `least_factors` → heading
    "factor": "Least factor that overturns",
    "width": "Width of the window / factor",
    "survives_from": "Survives again from",
    "overturns_again_from": "Overturns again from",
}
AFTER_LAST_IMPACT = 1.2  # histories end at this multiple of the time of the last impact


def section(evaluation: Evaluation, units: Units) -> Section:
    """Return section 4 of the page."""
    blocks: list[Any] = [_table(evaluation, name) for name in sets_with_scenes(evaluation)]
    scene = governing_scene(evaluation.scenes, sets_with_scenes(evaluation))
    if scene is None:
        blocks.append(Paragraph("No scene finished without overturning, so there is no history to draw."))
    else:
        blocks.insert(0, _history(evaluation, *scene))
    return Section(4, "Rotation, uplift, overturning", (*blocks, *details(evaluation, 4)))


def start(scenes: Scenes, names: Sequence[str]) -> None:
    """Start to compute the history of the governing scene, and the instants of governing values, in other
    threads.

    - `scenes`: the scenes of the problem; `names`: names of the sets of motions on the page
    """
    scene = governing_scene(scenes, names)
    if scene is not None:
        scenes.start_history(*scene)
    instants.start(scenes, names)


def _table(evaluation: Evaluation, name: str) -> Table:
    """Return the table of the uplift, the peak rotation and the impacts under each motion of a set. If the
    problem file has a check `overturning-scale` of the set, the table also has the overturning factors."""
    scenes = evaluation.scenes
    data, motions = scenes.peaks(name), evaluation.problem.motions[name]
    columns = [
        Column("Motion"),
        Column("First uplift", "time"),
        Column("max|θ|/α", "number"),
        Column("max|θ|", "angle"),
        Column("Time of the peak", "time"),
        Column("u_b at max|θ|", "displacement"),
        Column("Impacts", "count"),
        Column("Impacts before the peak", "count"),
    ]
    is_requested = any(
        check.kind is KINDS["overturning-scale"] and check.motions == name for check in evaluation.checks
    )
    windows = least_factors(scenes, name, "overturning") if is_requested else None
    if windows is not None:
        columns += [Column(head, "ratio" if y == "width" else "number") for y, head in WINDOW_COLUMNS.items()]
    else:
        columns.append(Column(WINDOW_COLUMNS["factor"]))
    rows = []
    for k, label in enumerate(motions.names):
        unanswered = unanswered_cell(data["result"].values[k])
        answers = _answers(evaluation, data, k) if unanswered is None else [unanswered] * 7
        row: list[Any] = [TextCell(label), *answers]
        if windows is not None:
            row += _window_cells(windows, k)
        else:
            row.append(TextCell("not asked", "not asked"))
        rows.append(tuple(row))
    governing = governing_motion(data, "peak_rotation")
    return Table(
        f"rotation-{slug(name)}",
        f"Rotation and uplift, set {name}",
        tuple(columns),
        tuple(rows),
        governing=() if governing is None else (governing,),
    )


def _window_cells(windows: xarray.Dataset, k: int) -> list[Quantity | TextCell]:
    """Return the cells of the columns `WINDOW_COLUMNS` for a motion.

    - `windows`: result of `least_factors`; `k`: index of the motion
    """
    factor, survives = (float(windows[y][k]) for y in ("factor", "survives_from"))
    text = f"none up to {float(windows['window_end'][k]):.3g}" if np.isfinite(factor) else "none"
    with np.errstate(invalid="ignore"):
        width = number_cell(np.divide(survives - factor, factor), "ratio", text=text)
    # Windows may be so narrow that four digits do not show them.
    factor_cell, *ends = (
        dataclasses.replace(cell, is_input=True) if isinstance(cell, Quantity) else cell
        for cell in (
            number_cell(factor, "number", text=f"none up to {float(windows['end'][k]):.3g}"),
            *(number_cell(float(windows[y][k]), "number", text=text) for y in list(WINDOW_COLUMNS)[2:]),
        )
    )
    return [factor_cell, width, *ends]


def _answers(evaluation: Evaluation, data: xarray.Dataset, k: int) -> list[Any]:
    """Return the seven cells of a scene that finished, from its first uplift to its impacts before the peak.

    - `evaluation`: the evaluation; `data`: dataset of scenes along `motion`; `k`: index of the scene
    """
    rotation = float(data["peak_rotation"][k])
    uplifted = bool(data["uplifted"][k])
    problem = evaluation.problem
    angle = rotation * float(problem.podium.alpha) * problem.column_enlargement
    u_b = deck_displacement(problem.podium, rotation)
    return [
        Quantity(float(data["uplift_time"][k]), "time") if uplifted else TextCell("no uplift", "none"),
        peak_cell(data, k, rotation, "number", data["peak_rotation_error"][k]),
        peak_cell(data, k, angle, "angle"),
        Quantity(float(data["peak_rotation_time"][k]), "time") if uplifted else TextCell("no uplift", "none"),
        peak_cell(data, k, u_b, "displacement"),
        _impacts(float(data["impacts"][k])),
        _impacts(float(data["impacts_before_peak"][k])),
    ]


def _impacts(count: float) -> Quantity | TextCell:
    if not np.isfinite(count):
        return TextCell("not counted", "none")
    return Quantity(count, "count") if count else TextCell("no impact", "none")


def _history(evaluation: Evaluation, name: str, k: int) -> Figure:
    """Return the picture of the history under motion k of a set, up to shortly after the last impact."""
    data, label = evaluation.scenes.history(name, k), evaluation.problem.motions[name].names[k]
    inputs = data.attrs["fingerprint"], name, label
    return stored_figure(
        evaluation, "history", inputs, lambda: _draw_history(evaluation, name, k, data, label)
    )


def _draw_history(evaluation: Evaluation, name: str, k: int, data: xarray.Dataset, label: str) -> Figure:
    from rockjax import plots

    end = data["impact_times"].values.max(initial=0.0)
    if end > 0:
        data = data.sel(time=slice(None, AFTER_LAST_IMPACT * float(end)))
    figure = plots.response(data).figure
    peaks = evaluation.scenes.peaks(name)
    title = f"History under {label}"
    description = (
        f"Rotation of the columns and motion of the structure under {label} of the set {name}; the largest "
        f"rotation is {float(peaks['peak_rotation'][k]):.4g} α, at "
        f"{float(peaks['peak_rotation_time'][k]):.4g} s."
    )
    caption = (
        f"History under {label}, the motion of the set {name} with the largest rotation without overturning."
    )
    return Figure(to_svg(figure, "history", title, description), caption, title, description)
