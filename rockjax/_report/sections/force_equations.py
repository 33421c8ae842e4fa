"""Equations of the forces in the joints, with the numbers of the governing instants."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rockjax._outputs.base import JOINT_NAMES
from rockjax._report.blocks import Equation, Equations, Paragraph
from rockjax._report.tables import Formula, Quantity, Text, TextCell

from .common import column_offsets
from .instants import Instant, column_text
from .structure import column_count, derived_numbers

if TYPE_CHECKING:
    from rockjax._report.evaluation import Evaluation
    from rockjax._report.problem import Problem

BOTTOM, TOP = 0, 1
SAME_DIGITS = 5e-5  # relative difference of numbers that the page shows as equal


class Extreme(NamedTuple):
    """The least or the largest force, or a friction demand, of a set of motions.

    - `output`: name of the output; `joint`: index of the joint, −1 for the foundation
    - `value`: value of the output; axial forces are divided by the weight m_c g of a column
    - `set_name`, `motion`: names of the set and of the governing motion
    - `instant`: instant of the value in the history of the motion; None if it is unknown
    """

    output: str
    joint: int
    value: float
    set_name: str
    motion: str
    instant: Instant | None


def in_weights(problem: Problem, value: float) -> Quantity:
    """Return a force that is divided by the weight m_c g of a column as a force, or as the number of weights
    if the mass of a column is unknown."""
    if problem.column_mass is None:
        return Quantity(value, "number")
    return Quantity(value * problem.column_mass * float(problem.podium.g), "force")


def total_weight(problem: Problem) -> float:
    """Return the total weight of the structure, divided by the weight m_c g of a column."""
    podium = problem.podium
    return (1 + float(podium.gamma) + float(podium.eta)) * (column_count(problem) or 1)


def contact_area(problem: Problem) -> float | None:
    """Return the contact area b_c d_c at an edge of a column [m²]; None if an input of the contact pressure
    is missing."""
    joints = problem.joints
    if joints.contact_width is None or joints.contact_depth is None or problem.column_mass is None:
        return None
    return joints.contact_width * joints.contact_depth


def equations(evaluation: Evaluation, extremes: list[Extreme]) -> list[Paragraph | Equations]:
    """Return a paragraph on the governing instants, and the equations of the forces with their numbers.

    - `evaluation`: the evaluation; `extremes`: the extreme forces of all sets
    """
    problem, podium = evaluation.problem, evaluation.problem.podium

    def extreme(output: str, joint: int | None = None) -> Extreme | None:
        """Return the extreme over all sets, at the given joint or, for None, at any joint."""
        found = [y for y in extremes if y.output == output and joint in (None, y.joint)]
        sign = -1 if output.startswith("least") else 1
        return max(found, key=lambda y: sign * y.value) if found else None

    least, friction = extreme("least_axial_force", TOP), extreme("peak_friction")
    shear, largest = extreme("peak_foundation_shear"), extreme("peak_axial_force")
    rows = [
        _mean_axial_force(problem, least),
        _axial_force(problem, least),
        _friction(problem, friction),
        _foundation_shear(problem, shear),
        _impulses(evaluation),
    ]
    area = contact_area(problem)
    if area is not None and largest is not None:
        force, joints = in_weights(problem, largest.value), problem.joints
        width, depth = (
            Quantity(float(y or 0), "length", is_input=True)
            for y in (joints.contact_width, joints.contact_depth)
        )
        numbers = force, " / (", width, " · ", depth, ")"
        rows.append(Equation(Formula("contact_pressure"), numbers, Quantity(force.value / area, "stress")))
    instants = [(y, words) for y, words in ((least, "F3, F8"), (friction, "F9"), (shear, "F5")) if y]
    if not podium.vibrates and not instants:
        return [Equations(tuple(rows))]
    parts: list[Text] = [_instant_text(problem, y, words) for y, words in instants]
    text = (
        "The numbers in the equations are those of samples of histories at the governing instants. Where the "
        "peak between two samples differs, the equation states it too. ",
        *(z for y in parts for z in y),
    )
    return [Paragraph(text, is_note=True), Equations(tuple(rows))] if parts else [Equations(tuple(rows))]


def _instant_text(problem: Problem, extreme: Extreme, labels: str) -> tuple:
    """Return a sentence on the instant of an extreme. `labels`: numbers of the equations."""
    if extreme.instant is None:
        return (f"{labels}: {extreme.motion} of {extreme.set_name}. ",)
    where = () if extreme.joint < 0 else (f", {JOINT_NAMES[extreme.joint]} joint, ",)
    column = column_text(problem, extreme.instant) if where else ()
    column = (column,) if isinstance(column, str) else column
    time = Quantity(extreme.instant.time, "time")
    return f"{labels}: {extreme.motion} of {extreme.set_name} at ", time, *where, *column, ". "


def _mean_axial_force(problem: Problem, least: Extreme | None) -> Equation:
    """Return (F3). For structures with devices, whose forces are not in the formula, it has no numbers."""
    formula, podium = Formula("axial_force_mean"), problem.podium
    if least is None or least.instant is None or podium.restrainers:
        return Equation(formula, label="F3")
    ratio, g, mean = float(podium.gamma) + float(podium.eta), float(podium.g), least.instant.mean_axial
    sign, rise = _signed(g * (mean / ratio - 1))
    numbers: tuple = (
        *(Quantity(ratio, "number"), " · (", Quantity(g, "acceleration")),
        *(sign, Quantity(rise, "acceleration"), ")"),
    )
    if problem.column_mass is not None:
        numbers += " · ", Quantity(problem.column_mass, "mass", is_input=True)
    return Equation(formula, numbers, in_weights(problem, mean), "F3")


def _axial_force(problem: Problem, least: Extreme | None) -> Equation:
    """Return (F8) at the least axial force in the top joint. It has no numbers for columns with round ends,
    whose forces have another lever."""
    formula, podium = Formula("axial_force"), problem.podium
    is_flat = problem.column_enlargement == 1
    if least is None or least.instant is None or podium.elevation is None or not is_flat:
        return Equation(formula, label="F8")
    instant, offsets = least.instant, column_offsets(podium)
    radius = Quantity(float(np.sqrt(np.mean(offsets**2))), "length")
    sign, x = _signed(float(offsets[int(instant.column)]))
    lever_sign, lever = _signed(instant.eccentricity * float(podium.width) / 2)
    mean, kind = in_weights(problem, instant.mean_axial), "number"
    moment = instant.moment
    if problem.column_mass is not None:
        moment, kind = moment * problem.column_mass * float(podium.g), "moment"
    numbers = (
        *(mean, sign, Quantity(x, "length", is_input=True), " / (", radius, ")² · ("),
        *(Quantity(moment, kind), lever_sign, Quantity(lever, "length"), " · ", mean, ")"),
    )
    return Equation(formula, numbers, _with_peak(problem, instant.axial, least.value), "F8")


def _with_peak(problem: Problem, value: float, peak: float, is_force: bool = True) -> Quantity:
    """Return a result at a sample of a history, with the peak between two samples as a note if its four
    digits differ.

    - `value`, `peak`: the result and the peak; forces are divided by the weight m_c g of a column
    """
    result, other = (in_weights(problem, y) if is_force else Quantity(y, "number") for y in (value, peak))
    if np.isclose(value, peak, rtol=SAME_DIGITS):
        return result
    return dataclasses.replace(result, note=("peak between two samples: ", other))


def _signed(value: float) -> tuple[str, float]:
    """Return " + " or " − ", and the absolute value of a number."""
    return " − " if value < 0 else " + ", abs(value)


def _friction(problem: Problem, friction: Extreme | None) -> Equation:
    """Return (F9) at the largest friction demand, or the text that a joint opens."""
    formula = Formula("friction")
    if friction is None or friction.instant is None:
        return Equation(formula, label="F9")
    if not np.isfinite(friction.value):
        axial = in_weights(problem, friction.instant.axial)
        return Equation(formula, ("… / ", axial), TextCell("joint opens", "joint opens"), "F9")
    forces = abs(friction.instant.shear), friction.instant.axial
    shear, axial = (in_weights(problem, y) for y in forces)
    result = _with_peak(problem, forces[0] / forces[1], friction.value, is_force=False)
    return Equation(formula, (shear, " / ", axial), result, "F9")


def _foundation_shear(problem: Problem, shear: Extreme | None) -> Equation:
    """Return (F5), the largest foundation shear as a share of the total weight."""
    formula = Formula("foundation_shear")
    if shear is None:
        return Equation(formula, label="F5")
    weight, share = in_weights(problem, total_weight(problem)), Quantity(shear.value, "number")
    if problem.column_mass is None:
        return Equation(formula, "share of the total weight", share, "F5")
    force = in_weights(problem, shear.value * total_weight(problem))
    return Equation(formula, (share, " · ", weight, " (total weight)"), force, "F5")


def _impulses(evaluation: Evaluation) -> Equation:
    """Return (F12) at the bottom joint. Inertances change the impulses; then the numbers are left out."""
    formula, podium = Formula("impulse_ratio"), evaluation.problem.podium
    numbers = derived_numbers(evaluation)
    if "impact_friction" not in numbers:
        return Equation(formula, label="F12")
    exact = float(numbers["impact_friction"].values[BOTTOM])
    e, tan = float(numbers["restitution"]), float(np.tan(float(podium.alpha)))
    gamma, eta = (float(y) for y in numbers["mass_ratios"].values)
    value = abs(1 - e) / ((1 + e) * tan) * (gamma + 0.5) / (gamma + eta + 0.5)
    text = (
        f"(1 − {e:.4g}) / ((1 + {e:.4g}) · {tan:.4g}) · ({gamma:.4g} + 0.5) / ({gamma:.4g} + {eta:.4g} + 0.5)"
    )
    return Equation(formula, text if np.isclose(value, exact) else "", Quantity(exact, "number"), "F12")
