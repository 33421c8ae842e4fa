"""Section 4: rotation, uplift and overturning in every scene. A scene is the structure under one motion."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from rockjax._batch.batch import LANES
from rockjax._report.blocks import Figure, Paragraph, Section
from rockjax._report.cells import number_cell, peak_cell, slug, unanswered_cell
from rockjax._report.kinds import KINDS
from rockjax._report.kinds.peaks import deck_displacement
from rockjax._report.kinds.risk import FragilityKind
from rockjax._report.pictures import to_svg
from rockjax._report.scales import MAX_SCALE, least_factors
from rockjax._report.tables import Column, Quantity, Table, Text, TextCell, plain
from rockjax._report.units import Units, kind_of_unit

from . import instants
from .common import (
    details,
    governing_motion,
    governing_scene,
    in_page_units,
    plot_label,
    sets_with_scenes,
    stored_figure,
)

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
FACTORS = LANES  # number of factors on the governing motion, which take no longer than one
BEYOND = 1.5  # these factors extend to this multiple of the least factor that overturns


def section(evaluation: Evaluation, units: Units) -> Section:
    """Return section 4 of the page."""
    blocks: list[Any] = [_table(evaluation, name) for name in sets_with_scenes(evaluation)]
    scene = governing_scene(evaluation.scenes, sets_with_scenes(evaluation))
    if scene is None:
        blocks.append(Paragraph("No scene finished without overturning, so there is no history to draw."))
    else:
        blocks.insert(0, _history(evaluation, *scene))
        if _has_factors(evaluation, scene[0]):
            blocks.insert(1, _factors(evaluation, *scene, units))
    blocks += _analyses(evaluation, units)
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
    windows = least_factors(scenes, name, "overturning") if _has_factors(evaluation, name) else None
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


def _has_factors(evaluation: Evaluation, name: str) -> bool:
    """Return whether a check of the set needs the least factors on its motions that overturn the columns."""
    return any(
        check.kind is KINDS["overturning-scale"] and check.motions == name and check.values is not None
        for check in evaluation.checks
    )


def _window_cells(windows: xarray.Dataset, k: int) -> list[Quantity | TextCell]:
    """Return the cells of the columns `WINDOW_COLUMNS` for a motion.

    - `windows`: result of `least_factors`; `k`: index of the motion
    """
    factor, survives = (float(windows[y][k]) for y in ("factor", "survives_from"))
    text = f"none up to {float(windows['window_end'][k]):.3g}" if np.isfinite(factor) else "none"
    end = float(windows["end"][k])
    note = f"or less: known up to {end:.3g} only" if bool(windows["is_open"][k]) else ""
    with np.errstate(invalid="ignore"):
        width = number_cell(np.divide(survives - factor, factor), "ratio", text=text)
    # Windows may be so narrow that four digits do not show them.
    factor_cell, *ends = (
        dataclasses.replace(cell, is_input=True) if isinstance(cell, Quantity) else cell
        for cell in (
            number_cell(factor, "number", text=f"none up to {end:.3g}", note=note),
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


def _history(evaluation: Evaluation, name: str, k: int) -> Figure | Paragraph:
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


def _factors(evaluation: Evaluation, name: str, k: int, units: Units) -> Figure | Paragraph:
    """Return the picture of the rotation as a function of the factor on motion k of a set."""
    scenes, motions = evaluation.scenes, evaluation.problem.motions[name]
    windows = least_factors(scenes, name, "overturning").isel(motion=k)
    limits = {
        check.id: check.limit
        for check in evaluation.checks
        if check.kind is KINDS["overturning-scale"] and check.motions == name
    }
    factor, end = float(windows["factor"]), float(windows["end"])
    last = max(1.2, *(1.1 * y for y in limits.values()), BEYOND * factor if np.isfinite(factor) else end)
    factors = _factors_up_to(min(last, MAX_SCALE))
    # The outputs are those of other scenes of the set, which have a compiled program.
    outputs = tuple(y for y in scenes.outputs(name) if y != "errors")
    options = scenes.options(name).replace(outputs=outputs)

    def draw() -> Figure:
        excitations = [motions.excitations[k].scaled(y) for y in factors]
        data = scenes.peaks_under(f"factors.{name}.{k}", options, excitations)
        analysis = _analysis_of_factors(data, factors, windows, float(options.overturn_ratio))
        lines = {1.0: "as given"} | {y: f"limit of {id}" for id, y in limits.items()}
        label = motions.names[k]
        title = f"Rotation under multiples of {label}"
        caption = (
            f"Largest rotation under {label} of the set {name} as a function of the factor on the motion"
        )
        description = f"{caption}; {_windows_text(windows)}."
        return _draw_analysis(analysis, "factors", title, description, description, lines, units)

    inputs = [windows[y].values for y in sorted(map(str, windows.data_vars))], factors, options, limits
    structure = scenes.problem.podium, motions.identities[k], motions.names[k], name
    return stored_figure(evaluation, "factors", (inputs, structure), draw)


def _factors_up_to(last: float) -> np.ndarray:
    """Return `FACTORS` factors up to `last` > 1 in equal steps, (FACTORS,). The factor nearest to 1 is
    replaced by 1, because the rotation under a factor near 1 may differ much from that under the motion as
    given."""
    factors = np.linspace(0, last, FACTORS + 1)[1:]
    factors[np.argmin(np.abs(factors - 1))] = 1.0
    return factors


def _windows_text(windows: xarray.Dataset) -> str:
    """Return a text with the least factor that overturns the columns, and the window of survival above it.

    `windows`: result of `least_factors` for one motion
    """
    factor, end, survives, again = (
        float(windows[y]) for y in ("factor", "end", "survives_from", "overturns_again_from")
    )
    if not np.isfinite(factor):
        return f"no factor up to {end:.3g} overturns the columns"
    text = f"the least factor that overturns the columns is {factor:.6g}"
    if bool(windows["is_open"]):
        text += f", or less, because scenes above {end:.3g} did not finish"
    if np.isfinite(survives):
        text += f"; they survive again from {survives:.6g}"
    return text + (f" to {again:.6g}" if np.isfinite(again) else "")


def _analysis_of_factors(
    data: xarray.Dataset, factors: np.ndarray, windows: xarray.Dataset, ratio: float
) -> xarray.Dataset:
    """Return scenes under multiples of a motion as an incremental dynamic analysis of one record.

    - `data`: peaks along `motion`, one for each of the `factors`
    - `windows`: result of `least_factors` for the motion; `ratio`: the option `overturn_ratio`
    """
    import xarray

    boundaries = [float(windows[y]) for y in ("factor", "survives_from", "overturns_again_from")]
    names = "peak_rotation", "overturned", "result"
    variables: dict[str, Any] = {y: (("record", "intensity"), data[y].values[None]) for y in names}
    variables["boundaries"] = (
        ("record", "boundary"),
        np.where(np.isfinite(boundaries), boundaries, np.nan)[None],
    )
    coords = {"intensity": ("intensity", factors, {"units": "1"})}
    attrs = {"measure": "factor on the motion", "overturn_ratio": ratio}
    return xarray.Dataset(variables, coords, attrs)


def _analyses(evaluation: Evaluation, units: Units) -> list[Figure | Paragraph]:
    """Return a picture of the incremental dynamic analysis of each set of motions that has one."""
    figures: dict[str, Figure | Paragraph] = {}
    for check in evaluation.checks:
        kind = check.kind
        if check.values is None or not isinstance(kind, FragilityKind) or not check.motions:
            continue
        curve, motions = kind.curve(check.entry, evaluation.scenes), check.motions
        name = f"analysis-{slug(motions)}-{slug(curve.attrs['measure'])}"
        inputs = {str(y): z.values for y, z in curve.items()}, motions, units.names, units.g
        draw = functools.partial(_draw_motions, curve, name, motions, units)
        figures[name] = stored_figure(evaluation, name, inputs, draw)
    return list(figures.values())


def _draw_motions(curve: xarray.Dataset, name: str, motions: str, units: Units) -> Figure:
    """Draw the incremental dynamic analysis of a set of motions.

    - `curve`: result of `FragilityKind.curve`; `name`: name of the picture
    - `motions`: name of the set; `units`: units of the drawing
    """
    measure, capacity = curve.attrs["measure"], curve["capacity"].values
    title = f"Rotation as a function of {measure}, set {motions}"
    description: Text = f"{title}; no motion overturns the columns."
    if np.isfinite(capacity).any():
        description = (
            f"Largest rotation under each motion of the set {motions} as a function of {measure}; the least "
            f"{measure} that overturns the columns is ",
            Quantity(float(np.nanmin(capacity)), kind_of_unit(curve["intensity"].attrs["units"])),
            ".",
        )
    caption = f"Largest rotation under the motions of the set {motions}, scaled to the same {measure}."
    texts = title, description, caption
    return _draw_analysis(in_page_units(curve, units), name, *texts, {}, units)


def _draw_analysis(
    data: xarray.Dataset,
    name: str,
    title: str,
    description: Text,
    caption: str,
    lines: dict[float, str],
    units: Units,
) -> Figure:
    """Draw an incremental dynamic analysis, with a horizontal line and its text for each of the `lines`.

    - `data`: the analysis, in the units of the page; `name`: name of the picture
    - `title`, `description`, `caption`: as for `Figure`; `units`: units of the page
    """
    import matplotlib.pyplot as plt

    from rockjax import plots
    from rockjax.plots._style import COLOURS, in_style

    with in_style():
        figure, axes = plt.subplots(figsize=(6.4, 4.0), layout="constrained")
        plots.incremental_dynamic_analysis(data, axes)
        for y, text in lines.items():
            axes.axhline(y, color=COLOURS[1] if y != 1 else "0.3", linestyle="--", linewidth=0.9)
            axes.annotate(
                plot_label(text),
                (0.01, y),
                (0, 2),
                ha="left",
                textcoords="offset points",
                xycoords=("axes fraction", "data"),
            )
    return Figure(to_svg(figure, name, title, plain(description, units)), caption, title, description)
