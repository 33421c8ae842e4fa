"""Section 2: the structure, its inputs and derived quantities."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from rockjax._parameters.registry import STRUCTURE
from rockjax._programs.program import StoredProgram
from rockjax._report.blocks import Equation, Equations, Figure, Paragraph, Section
from rockjax._report.pictures import elevation_caption, elevation_drawing, to_svg
from rockjax._report.store import dataset_of, fingerprint
from rockjax._report.tables import Cell, Code, Column, Formula, Quantity, Series, Table, Text, TextCell
from rockjax._report.units import Units, kind_of_unit
from rockjax._structures import Podium

from .common import governing_scene, sets_with_scenes, stored_figure

if TYPE_CHECKING:
    import xarray

    from rockjax._report.evaluation import Evaluation
    from rockjax._report.problem import Input, Problem

# Key of an input, with or without its table → (meaning, kind of the number). Meanings of other inputs are in
# the registry of parameters, `STRUCTURE`.
_MEANINGS = {
    "story_masses": ("Storey masses from the bottom", "mass"),
    "story_stiffnesses": ("Storey stiffnesses", "stiffness"),
    "story_heights": ("Storey heights", "length"),
    "positions": ("Positions of the columns x", "length"),
    "beam_depth": ("Depth of the beam", "length"),
    "column_mass": ("Mass of a column m_c", "mass"),
    "beam_mass": ("Mass of the beam m_b", "mass"),
    "top_mass": ("Mass of the superstructure m_t", "mass"),
    "period": ("Period of the superstructure T_s", "time"),
    "damping": ("Damping ratio ζ", "ratio"),
    "columns": ("Number of columns N", "count"),
    "elevation.columns": ("Positions of the columns x", "length"),
    "stories": ("Number of stories", "count"),
    "modes": ("Number of modes", "count"),
    "tendon_force": ("Force of a tendon P₀", "force"),
    "tendon_stiffness": ("Stiffness of a tendon K", "stiffness"),
    "inertance": ("Inertance b", "mass"),
    "top_height": ("Height of the superstructure above the beam", "length"),
    "residual_height": ("Height of the residual mass above the beam", "length"),
    "end_radius": ("Radius of the column ends", "length"),
}


def section(evaluation: Evaluation, units: Units) -> Section:
    """Return section 2 of the page; `units`: units of its picture."""
    problem = evaluation.problem
    figure = _elevation(evaluation, units)
    inputs = Table(
        "inputs",
        "Inputs",
        (Column("Quantity"), Column("Key"), Column("Value"), Column("Source")),
        tuple(_row(entry) for entry in problem.inputs) + tuple(_joint_rows(evaluation)),
    )
    blocks = (figure, inputs, *_round_ends(problem), _derived(evaluation), *_modes(evaluation))
    return Section(2, "Structure and inputs", blocks)


def _round_ends(problem: Problem) -> list[Paragraph]:
    """Return a note on the equivalent columns, in a list; an empty list for columns with flat ends."""
    if problem.column_enlargement == 1:
        return []
    text = (
        "The columns have round ends. R and the width and height in the equations, and all quantities that "
        "follow from them, are those of the equivalent column with flat ends, which is "
        f"{problem.column_enlargement:.4g} times as large and rotates less by this factor."
    )
    return [Paragraph(text, is_note=True)]


def _elevation(evaluation: Evaluation, units: Units) -> Figure:
    """Return the picture of the structure, and of a column at the largest rotation of the governing scene.
    This is the scene with the largest rotation without overturning."""
    problem, scene = evaluation.problem, governing_scene(evaluation.scenes, sets_with_scenes(evaluation))
    podium, size = problem.podium, problem.column_size
    rotation, label = None, ""
    if scene is not None:
        name, k = scene
        rotation = float(evaluation.scenes.peaks(name)["peak_rotation"][k]) * float(podium.alpha)
        label = problem.motions[name].names[k]
    columns = int({y.key: y.value for y in problem.inputs}.get("columns") or 2)
    mass = problem.column_mass

    def draw() -> Figure:
        drawing = elevation_drawing(
            podium, units, column_mass=mass, columns=columns, rotation=rotation, label=label, size=size
        )
        title = "Elevation of the structure"
        description = f"Columns {size[0]:.4g} m wide and {size[1]:.4g} m high"
        if rotation is not None:
            angle = rotation * problem.column_enlargement
            description += f"; beside them a column at its largest rotation, {angle:.4g} rad"
        svg = to_svg(drawing, "elevation", title, f"{description}.")
        return Figure(svg, elevation_caption(units), title, f"{description}.", True)

    inputs = podium, units.names, units.g, mass, columns, rotation, label, size
    return stored_figure(evaluation, "elevation", inputs, draw)


def _source(source: str | None) -> TextCell:
    return TextCell("no source given", "no source") if source is None else TextCell(source)


def _row(entry: Input) -> tuple[Cell, ...]:
    """Return the row of an input: meaning, key, value and source."""
    name = entry.key.rpartition(".")[2]
    meaning, kind = _MEANINGS.get(entry.key) or _MEANINGS.get(name, ("", ""))
    if not meaning and name in STRUCTURE:
        parameter = STRUCTURE[name]
        meaning = f"{parameter.meaning[:1].upper()}{parameter.meaning[1:]} {parameter.symbol}"
        kind = "count" if parameter.is_integer else kind_of_unit(parameter.unit)
        kind = "length" if kind == "displacement" else kind  # inputs are dimensions
    return (
        TextCell(meaning or name),
        TextCell((Code(f"structure.{entry.key}"),)),
        value_cell(entry.value, kind or "number"),
        _source(entry.source),
    )


def value_cell(value: Any, kind: str) -> Cell:
    """Return an input as a cell: a number, a series of numbers, or a text."""
    if isinstance(value, str):
        return TextCell(value)
    if isinstance(value, list | tuple):
        return Series(tuple(float(y) for y in value), kind, is_input=True)
    return Quantity(float(value), kind, is_input=True)


def _joint_rows(evaluation: Evaluation):
    """Yield a row, in the form of `_row`, for each property of the joints that the file gives."""
    meanings = {
        "friction": ("Friction coefficient of the joints μ", "number"),
        "contact_width": ("Width of the contact strip at an edge", "length"),
        "contact_depth": ("Depth of a column across the plane", "length"),
    }
    for name, (meaning, kind) in meanings.items():
        value = getattr(evaluation.problem.joints, name)
        if value is not None:
            source = evaluation.problem.sources.get(f"joints.{name}")
            yield (
                TextCell(meaning),
                TextCell((Code(f"joints.{name}"),)),
                value_cell(value, kind),
                _source(source),
            )


def _derived(evaluation: Evaluation) -> Equations:
    """Return the derived quantities as equations, with numbers inserted."""
    problem, podium = evaluation.problem, evaluation.problem.podium
    numbers = {name: y.values for name, y in _numbers(evaluation).items()}
    width, height = float(numbers["width"]), float(numbers["height"])
    alpha, g, R = float(podium.alpha), float(podium.g), float(podium.R)
    gamma, eta = float(podium.gamma), float(podium.eta)

    def plain(value: float, digits: int = 7) -> str:
        return f"{value:.{digits}g}"

    factor_in_use = float(numbers["restitution"])
    rows = [
        Equation(
            Formula("slenderness"),
            f"{plain(width)} / {plain(height)}",
            Quantity(np.tan(alpha), "number"),
            "1",
        ),
        Equation(
            Formula("half_diagonal"), f"√({plain(width / 2)}² + {plain(height / 2)}²)", Quantity(R, "length")
        ),
        Equation(
            Formula("frequency_parameter"),
            f"√(3 · {plain(g)} / (4 · {plain(R)}))",
            Quantity(float(numbers["p"]), "angular frequency"),
            "25",
        ),
        Equation(Formula("beam_mass_ratio"), "", Quantity(gamma, "number"), "2"),
    ]
    if eta:
        rows.append(Equation(Formula("superstructure_mass_ratio"), "", Quantity(eta, "number"), "2"))
    laws: dict[str, Any] = {"paper": "27", "compatible": "C13"}
    for name, label in laws.items():
        factor = float(numbers[f"restitution_{name}"])
        note = " (in use)" if factor == factor_in_use else " (not in use)"
        rows.append(
            Equation(Formula(f"restitution_{name}"), f"law {name}{note}", Quantity(factor, "number"), label)
        )
    # The prestress of tendons raises the uplift threshold and the dead load. The formulas of the report do
    # not contain the prestress, but the inserted numbers and the results do.
    uplift = float(numbers["uplift_acceleration"])
    ratio = uplift / (g * np.tan(alpha))
    prestress = "" if np.isclose(ratio, 1, rtol=1e-9) else f" · {plain(ratio, 4)} (prestress of the tendons)"
    rows.append(
        Equation(
            Formula("uplift_acceleration"),
            f"{plain(g)} · {plain(np.tan(alpha))}{prestress}",
            Quantity(uplift, "acceleration"),
            "5",
        )
    )
    if podium.vibrates:
        demand = Quantity(float(numbers["uplift_demand"]), "acceleration")
        note = f"g tan α (1+2γ+2η)/(1+2γ){prestress}" if prestress else ""
        rows.append(Equation(Formula("uplift_demand"), note, demand, "9"))
    if problem.column_mass is not None:
        bottom, top = (float(y) for y in numbers["dead_load"])
        weight = problem.column_mass * g
        tendons = Quantity((top - gamma - eta) * weight, "force", is_input=True)

        def terms(symbols: str) -> Text:
            """Return the text of the sum `symbols` · m_c g + prestress; "" without prestress."""
            return (f"{symbols} m_c g + ", tendons, " (prestress of the tendons)") if prestress else ""

        top_load, bottom_load = (Quantity(y * weight, "force") for y in (top, bottom))
        rows += [
            Equation(Formula("dead_load"), terms("(γ+η)"), top_load, "F3"),
            Equation(Formula("dead_load_bottom"), terms("(γ+η+1)"), bottom_load, "F3"),
        ]
    if podium.elevation is not None:
        rows.append(
            Equation(Formula("core_distance"), "", Quantity(float(numbers["core_distance"]), "length"), "F8")
        )
    return Equations(tuple(rows))


def _numbers(evaluation: Evaluation) -> xarray.Dataset:
    """Return the derived numbers of this section; compute them only if the store does not have them."""
    podium = evaluation.problem.podium
    compute = lambda: dataset_of(_derived_numbers(podium))
    return evaluation.scenes.store.get("structure", fingerprint(podium), compute)


@StoredProgram
def _derived_numbers(podium: Podium) -> dict[str, Any]:
    """Return name → derived number or array of a podium."""
    laws = {name: podium.replace(restitution=name).restitution_factor for name in ("paper", "compatible")}
    values = {
        "width": podium.width,
        "height": podium.height,
        "p": podium.p,
        "restitution": podium.restitution_factor,
        "uplift_acceleration": podium.uplift_ground_acceleration,
        "dead_load": podium.dead_load,
    } | {f"restitution_{name}": factor for name, factor in laws.items()}
    if podium.vibrates:
        values["uplift_demand"] = podium.uplift_demand
        values["uplifted_frequencies"] = podium.uplifted_frequencies
    if podium.elevation is not None:
        values["core_distance"] = podium.core_distance
    return values


def _modes(evaluation: Evaluation) -> list[Any]:
    """Return the table of modes of the superstructure, or a sentence if no superstructure vibrates."""
    podium = evaluation.problem.podium
    oscillators = None if podium.superstructure is None else podium.superstructure.oscillators
    if oscillators is None:
        return [Paragraph("No superstructure vibrates.")]
    periods, etas, zetas = np.broadcast_arrays(
        np.atleast_1d(oscillators.T_s), np.atleast_1d(oscillators.eta), np.atleast_1d(oscillators.zeta)
    )
    # The first frequency belongs to the rocking mode.
    uplifted = _numbers(evaluation)["uplifted_frequencies"].values[1:] / (2 * np.pi)
    columns = {
        "Mode": "count",
        "Period with a fixed base T_i": "time",
        "Mass ratio η_i": "number",
        "Damping ratio ζ_i": "ratio",
        "Frequency on lifted columns": "frequency",
    }
    rows = [
        (k + 1, *(float(y) for y in row))
        for k, row in enumerate(zip(periods, etas, zetas, uplifted, strict=True))
    ]
    return [Table.from_rows("modes", "Modes of the building", columns, rows)]
