"""Section 2: the structure, its inputs and derived quantities."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import jax.numpy as jnp
import numpy as np

from rockjax._parameters.registry import STRUCTURE
from rockjax._programs.program import StoredProgram
from rockjax._report.blocks import Equation, Equations, Figure, Paragraph, Section
from rockjax._report.pictures import elevation_drawing, elevation_units, to_svg
from rockjax._report.store import dataset_of, fingerprint
from rockjax._report.tables import Cell, Code, Column, Formula, Quantity, Series, Table, Text, TextCell
from rockjax._report.units import Units, kind_of_unit
from rockjax._structures import Podium
from rockjax._structures.elevation import Elevation

from .common import column_offsets, governing_scene, sets_with_scenes, stored_figure

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
    "stories": ("Number of storeys", "count"),
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
        (*map(_row, problem.inputs), *_law_rows(problem), *_joint_rows(evaluation), *_hazard_rows(problem)),
    )
    blocks = (figure, inputs, *_round_ends(problem), _derived(evaluation), *_modes(evaluation))
    return Section(2, "Structure and inputs", blocks)


def _round_ends(problem: Problem) -> list[Paragraph]:
    """Return a note on the equivalent columns, in a list; an empty list for columns with flat ends."""
    if problem.column_enlargement == 1:
        return []
    text = (
        "The columns have round ends. R and the width and height in the equations, and all quantities that "
        "follow from them, are those of the equivalent column with flat ends. This column is "
        f"{problem.column_enlargement:.4g} times as large as a real column, and its rotations are smaller by "
        "this factor."
    )
    return [Paragraph(text, is_note=True)]


def _elevation(evaluation: Evaluation, units: Units) -> Figure | Paragraph:
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
        return Figure(svg, "Elevation to scale.", title, f"{description}.", True, elevation_units(units))

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


def _law_rows(problem: Problem) -> Iterator[tuple[Cell, ...]]:
    """Yield the row, in the form of `_row`, of the law of impact if the file does not give one."""
    if all(entry.key != "restitution" for entry in problem.inputs):
        key = TextCell((Code("structure.restitution"),))
        yield TextCell("Law of impact"), key, TextCell("paper"), TextCell("default of the program")


def _hazard_rows(problem: Problem) -> Iterator[tuple[Cell, ...]]:
    """Yield the row, in the form of `_row`, of the hazard curve of the file."""
    hazards = [entry.arguments["hazard"] for entry in problem.checks if entry.uses_hazard_of_file]
    if not hazards:
        return
    intensity = np.asarray(hazards[0].intensity, float)
    kind = kind_of_unit(hazards[0].units)
    ends = (Quantity(float(y), kind, is_input=True) for y in (intensity[0], intensity[-1]))
    first, last = ends
    value = TextCell((f"{intensity.size} points, {hazards[0].measure} from ", first, " to ", last))
    key = TextCell((Code("risk.hazard"),))
    yield TextCell("Hazard curve"), key, value, _source(problem.sources.get("risk.hazard"))


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
    numbers = {str(name): y.values for name, y in derived_numbers(evaluation).items()}
    rows = [
        *_geometry_rows(evaluation, numbers),
        *_mass_rows(evaluation.problem),
        *_restitution_rows(evaluation.problem, numbers),
        *_uplift_rows(evaluation.problem, numbers),
        *_load_rows(evaluation.problem, numbers),
    ]
    return Equations(tuple(rows))


def _plain(value: float, digits: int = 7) -> str:
    return f"{float(value):.{digits}g}"


def _geometry_rows(evaluation: Evaluation, numbers: dict[str, Any]) -> Iterator[Equation]:
    """Yield tan α, R and p, and the displacement of the beam at the largest rotation of the page."""
    problem, podium = evaluation.problem, evaluation.problem.podium
    width, height = float(numbers["width"]), float(numbers["height"])
    alpha, g, R = float(podium.alpha), float(podium.g), float(podium.R)
    tan = Quantity(np.tan(alpha), "number", note=("α = ", Quantity(alpha, "angle")))
    length = lambda y: Quantity(y, "length", is_input=True)
    yield Equation(Formula("slenderness"), (length(width), " / ", length(height)), tan, "1")
    text = "√((", length(width / 2), ")² + (", length(height / 2), ")²)"
    yield Equation(Formula("half_diagonal"), text, Quantity(R, "length"), "1")
    text = "√(3 · ", Quantity(g, "acceleration"), " / (4 · ", Quantity(R, "length"), "))"
    p = Quantity(float(numbers["p"]), "angular frequency")
    yield Equation(Formula("frequency_parameter"), text, p, "25")
    yield Equation(Formula("inertia_factor"), "", Quantity(float(podium.lam), "number"), "3")
    scene = governing_scene(evaluation.scenes, sets_with_scenes(evaluation))
    if scene is not None:
        name, k = scene
        theta = float(evaluation.scenes.peaks(name)["peak_rotation"][k]) * alpha
        displacement = 2 * R * (np.sin(alpha) - np.sin(alpha - theta))
        sines = _plain(np.sin(alpha), 4), _plain(np.sin(alpha - theta), 4)
        text = "2 · ", Quantity(R, "length"), f" · [{sines[0]} − {sines[1]}]"
        note = f"{problem.motions[name].names[k]} of {name}"
        result = Quantity(displacement, "displacement", note=note)
        yield Equation(Formula("beam_displacement"), text, result, "13")


def _mass_rows(problem: Problem) -> Iterator[Equation]:
    """Yield the mass ratios. A structure by ratios has no masses to insert."""
    podium, structure = problem.podium, problem.structure
    given = lambda name: getattr(structure, name, None)
    count = column_count(problem)

    def numbers(mass: Any) -> Text:
        if mass is None or problem.column_mass is None or count is None:
            return ""
        column, total = (
            Quantity(float(y), "mass", is_input=True) for y in (problem.column_mass, np.sum(mass))
        )
        return total, f" / ({count} · ", column, ")"

    gamma, eta = float(podium.gamma), float(podium.eta)
    yield Equation(Formula("beam_mass_ratio"), numbers(given("beam_mass")), Quantity(gamma, "number"), "2")
    if eta:
        masses = given("story_masses") if given("top_mass") is None else given("top_mass")
        ratio = Quantity(eta, "number")
        yield Equation(Formula("superstructure_mass_ratio"), numbers(masses), ratio, "2")


def column_count(problem: Problem) -> int | None:
    """Return the number of columns N; None for a structure by ratios without positions of the columns."""
    if problem.podium.elevation is not None:
        return column_offsets(problem.podium).size
    if problem.column_mass is None:
        return None
    return int(getattr(problem.structure, "columns", None) or 2)  # the default of `Podium.from_dimensions`


def _restitution_rows(problem: Problem, numbers: dict[str, Any]) -> Iterator[Equation]:
    """Yield the factors of restitution of the laws of impact. The numbers are left out if devices change a
    factor, because the formulas do not contain devices."""
    podium, in_use = problem.podium, float(numbers["restitution"])
    sin2, lam = float(np.sin(float(podium.alpha)) ** 2), float(podium.lam)
    gamma, eta = (float(y) for y in numbers["mass_ratios"])
    g4, e4, s4, l4 = (_plain(y, 4) for y in (gamma, eta, sin2, lam))
    forms = {
        "paper": (
            1 - sin2 * (2 * gamma + 2 * eta + 0.5) / (0.25 * (1 + lam) + gamma + eta),
            f"1 − {s4} · (2 · {g4} + 2 · {e4} + 0.5) / (0.25 · (1 + {l4}) + {g4} + {e4})",
            "27",
        ),
        "compatible": (
            1 - 2 * sin2 * (1 + 4 * gamma + 4 * eta) / (1 + lam + 4 * gamma + 4 * eta * sin2),
            f"1 − 2 · {s4} · (1 + 4 · {g4} + 4 · {e4}) / (1 + {l4} + 4 · {g4} + 4 · {e4} · {s4})",
            "C13",
        ),
    }
    for name, (value, inserted, label) in forms.items():
        factor = float(numbers[f"restitution_{name}"])
        law = next((y.value for y in problem.inputs if y.key == "restitution"), "paper")
        other = "same factor as in use" if factor == in_use else "not in use"
        use = "in use" if name == law else other
        result = Quantity(factor, "number", note=f"law “{name}”, {use}")
        text = inserted if np.isclose(value, factor) else ""
        yield Equation(Formula(f"restitution_{name}"), text, result, label)


def _uplift_rows(problem: Problem, numbers: dict[str, Any]) -> Iterator[Equation]:
    """Yield the ground acceleration that lifts the columns, and the threshold of the uplift demand.

    The prestress of tendons raises both. The formulas do not contain the prestress, but the inserted numbers
    and the results do.
    """
    podium = problem.podium
    g, tan = float(podium.g), float(np.tan(float(podium.alpha)))
    uplift = float(numbers["uplift_acceleration"])
    prestress = _prestress(problem, numbers)
    gravity = Quantity(g, "acceleration")
    text: tuple[Any, ...] = gravity, f" · {_plain(tan)}{prestress}"
    yield Equation(Formula("uplift_acceleration"), text, Quantity(uplift, "acceleration"), "5")
    if podium.vibrates:
        gamma, eta = (_plain(y, 4) for y in numbers["mass_ratios"])
        ratio = f"(1 + 2 · {gamma} + 2 · {eta}) / (1 + 2 · {gamma})"
        text = gravity, f" · {_plain(tan)} · {ratio}{prestress}"
        demand = Quantity(float(numbers["uplift_demand"]), "acceleration")
        yield Equation(Formula("uplift_demand"), text, demand, "9")


def _prestress(problem: Problem, numbers: dict[str, Any]) -> str:
    """Return the factor by which the prestress of tendons raises the uplift threshold, as the end of a
    product; "" without prestress."""
    podium = problem.podium
    ratio = float(numbers["uplift_acceleration"]) / (float(podium.g) * np.tan(float(podium.alpha)))
    return "" if np.isclose(ratio, 1, rtol=1e-9) else f" · {_plain(ratio, 4)} (prestress of the tendons)"


def _load_rows(problem: Problem, numbers: dict[str, Any]) -> Iterator[Equation]:
    """Yield the dead loads of a column and, with positions of the columns, h̄ and ℓ_p."""
    podium, mass = problem.podium, problem.column_mass
    gamma, eta = float(podium.gamma), float(podium.eta)
    if mass is not None:
        bottom, top = (float(y) for y in numbers["dead_load"])
        weight = mass * float(podium.g)
        tendons = Quantity((top - gamma - eta) * weight, "force", is_input=True)
        has_prestress = bool(_prestress(problem, numbers))
        ending: tuple = (" + ", tendons, " (prestress of the tendons)") if has_prestress else ()
        factors = (
            " · ",
            Quantity(mass, "mass", is_input=True),
            " · ",
            Quantity(float(podium.g), "acceleration"),
        )
        for formula, ratio, load in (("dead_load", "", top), ("dead_load_bottom", " + 1", bottom)):
            text = f"({_plain(gamma, 4)} + {_plain(eta, 4)}{ratio})"
            yield Equation(
                Formula(formula), (text, *factors, *ending), Quantity(load * weight, "force"), "F3"
            )
    if podium.elevation is not None:
        offsets = column_offsets(podium)
        if gamma + eta > 0:
            yield Equation(
                Formula("mean_height"), "", Quantity(float(numbers["mean_height"]), "length"), "F8"
            )
        radius, largest = float(np.sqrt(np.mean(offsets**2))), float(np.abs(offsets).max())
        text = "(", Quantity(radius, "length"), ")² / ", Quantity(largest, "length", is_input=True)
        distance = Quantity(float(numbers["core_distance"]), "length")
        yield Equation(Formula("core_distance"), text, distance, "F8")


def derived_numbers(evaluation: Evaluation) -> xarray.Dataset:
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
        "mass_ratios": jnp.stack(jnp.broadcast_arrays(*podium.mass_ratios)),
    } | {f"restitution_{name}": factor for name, factor in laws.items()}
    if podium.vibrates:
        values["uplift_demand"] = podium.uplift_demand
        values["uplifted_frequencies"] = podium.uplifted_frequencies
    if podium.elevation is not None:
        values["core_distance"] = podium.core_distance
        values["impact_friction"] = podium.impact_friction
        assert isinstance(podium.elevation, Elevation)
        arms = podium.elevation.resolved(podium.gamma, podium.superstructure)
        moments = arms.beam if arms.modes is None else arms.beam + jnp.sum(arms.modes)
        values["mean_height"] = moments / (podium.gamma + podium.eta)
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
    uplifted = derived_numbers(evaluation)["uplifted_frequencies"].values[1:] / (2 * np.pi)
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
