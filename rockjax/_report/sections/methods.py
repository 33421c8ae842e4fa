"""Section 9: results of simplified methods of practice beside the exact answer."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from rockjax import _results as outcomes
from rockjax._motions.motion import Motion
from rockjax._practice.base import MethodResult
from rockjax._practice.base import Quantity as Number
from rockjax._practice.methods import simplified_methods
from rockjax._practice.registry import METHODS
from rockjax._report.blocks import Equation, Equations, Paragraph, Section
from rockjax._report.cells import number_cell, peak_cell, slug
from rockjax._report.kinds import KINDS
from rockjax._report.kinds.peaks import deck_displacement
from rockjax._report.scales import least_factors
from rockjax._report.store import Store, fingerprint
from rockjax._report.tables import Column, Formula, Quantity, Table, TextCell
from rockjax._report.units import Units, kind_of_unit

from .common import sets_with_scenes

if TYPE_CHECKING:
    from rockjax._report.entry import Entry
    from rockjax._report.evaluation import Evaluation
    from rockjax._report.problem import Problem

# Method → names of its formulas.
FORMULAS = {
    "static": ("static",),
    "spectral_uplift": ("spectral_uplift",),
    "priestley": ("priestley",),
    "fema_356": ("fema",),
    "asce_43_05_rocking": ("asce", "asce_damping"),
    "asce_43_05_sliding": ("asce_sliding",),
    "circolare_displacement": ("circolare", "circolare_displacement"),
    "circolare_force": ("circolare_simplified",),
}
_KINDS = {"rad/s": "angular frequency", "Hz": "frequency"}  # unit → kind, for units that no output has
TITLE = "Simplified methods beside the exact answer"


def section(evaluation: Evaluation, units: Units) -> Section:
    """Return section 9 of the page."""
    del units
    if "methods" in evaluation.skipped:
        return Section(9, TITLE, (Paragraph("Left out on request (skip methods)."),))
    problem = evaluation.problem
    blocks: list[Any] = [
        Paragraph("For comparison only: no check rests on these methods.", is_note=True),
    ]
    results = {
        name: _results(problem, evaluation.scenes.store, name)
        for name in sets_with_scenes(evaluation)
        if _has_records(problem, name)
    }
    if results:
        blocks += _formulas(next(iter(results.values())))
        blocks.append(_reliability(next(iter(results.values()))))
    for name, of_set in results.items():
        blocks += _tables(evaluation, name, of_set)
    if not results:
        blocks.append(Paragraph("The methods need records; no check uses a set of records."))
    return Section(9, TITLE, tuple(blocks))


def _formulas(results: list[MethodResult]) -> list[Equations | Table]:
    """Return the formulas of the methods, and the table of the numbers in them that belong to the structure.

    `results`: the results for any set of motions. Numbers of the sliding displacement are left out, because
    some of them belong to the set
    """
    rows = [Equation(Formula("equivalent_radius"))]
    numbers = []
    for result in results:
        for formula in FORMULAS[result.name]:
            rows.append(Equation(Formula(formula), label=result.equation.strip("()")))
        for number in () if result.name == "asce_43_05_sliding" else result.values.values():
            # Arrays have a value for each motion.
            if isinstance(number.value, float | int) and math.isfinite(number.value):
                kind = _KINDS.get(number.unit) or kind_of_unit(number.unit)
                title = TextCell(f"{result.title} {result.equation}")
                numbers.append((title, TextCell(number.meaning), Quantity(float(number.value), kind)))
    columns = Column("Method"), Column("Number"), Column("Value")
    caption = "Numbers of the methods for this structure"
    tables = [Table("method-numbers", caption, columns, tuple(numbers))] if numbers else []
    return [Equations(tuple(rows)), *tables]


def _reliability(results: list[MethodResult]) -> Table:
    """Return the table of the sources of the methods, and of what is known of their reliability.

    `results`: the results for any set of motions
    """
    rows = [
        (
            TextCell(f"{result.title} {result.equation}", note=result.source),
            TextCell(result.reliability),
        )
        for result in results
    ]
    caption = "Reliability of the methods"
    return Table("method-reliability", caption, (Column("Method"), Column("Reliability")), tuple(rows))


def _exact(evaluation: Evaluation, name: str, method: str) -> TextCell | Quantity:
    """Return the exact answer that a method approximates, for the same structure and motions.

    - `evaluation`: the evaluation; `name`: name of the set of motions; `method`: name of the method
    """
    data, names = evaluation.scenes.peaks(name), evaluation.problem.motions[name].names
    count, rotation = len(names), data["peak_rotation"].values
    overturned = data["overturned"].values.astype(bool)
    if outcomes.did_not_finish(data["result"].values).any():
        return TextCell("unknown: scenes did not finish", "unanswered")
    if method in ("static", "spectral_uplift"):
        lifted = int(data["uplifted"].values.sum())
        note: Any = f"{lifted} of {count} motions lift the columns"
        if not any(y.kind is KINDS["uplift-scale"] and y.motions == name for y in evaluation.checks):
            return TextCell(note)
        accelerations = least_factors(evaluation.scenes, name, "uplift")["factor"].values * [
            member.pga
            for member in evaluation.problem.motions[name].members
            if isinstance(member, Motion)  # all of them
        ]
        k = int(np.argmin(accelerations))
        return Quantity(
            accelerations[k], "acceleration", note=f"least PGA that lifts the columns, {names[k]}; {note}"
        )
    if method == "asce_43_05_sliding":
        return TextCell("not in the model", "none")
    if overturned.any():
        return TextCell(f"{int(overturned.sum())} of {count} motions overturn the columns", "overturned")
    if method == "circolare_displacement":
        podium = evaluation.problem.podium
        displacements = [float(deck_displacement(podium, y)) for y in rotation]
        return Quantity(
            float(np.mean(displacements)), "displacement", note="mean u_b; no motion overturns the columns"
        )
    k = int(np.argmax(rotation))
    return Quantity(
        rotation[k], "number", note=f"largest max|θ|/α, {names[k]}; no motion overturns the columns"
    )


def start(problem: Problem, store: Store, made: list[Entry]) -> None:
    """Start to compute the results of the methods in other threads, for the sets of motions of the entries
    `made`."""
    for name in dict.fromkeys(entry.motions for entry in made):
        if name and _has_records(problem, name):
            store.start_text(*_stored_results(problem, store, name))


def _has_records(problem: Problem, name: str) -> bool:
    """Return whether all motions of a set are records, which the methods need."""
    return all(isinstance(member, Motion) for member in problem.motions[name].members)


def _stored_results(problem: Problem, store: Store, name: str) -> tuple[str, str, Callable[[], str]]:
    """Return the arguments of `Store.text` for the results of the methods for a set of motions."""
    motions, friction = problem.motions[name], problem.joints.friction

    def compute() -> str:
        entries = []
        for method in METHODS:
            store.raise_if_stopped()
            (result,) = simplified_methods(
                problem.podium, list(motions.members), friction=friction, methods=(method,)
            )
            entries.append(dataclasses.asdict(result))
        return json.dumps(entries, default=np.ndarray.tolist)

    inputs_hash = fingerprint(problem.podium, motions.identities, motions.names, friction)
    return f"methods.{name}", inputs_hash, compute


def _results(problem: Problem, store: Store, name: str) -> list[MethodResult]:
    """Return the results of the methods for a set of motions."""
    entries = json.loads(store.text(*_stored_results(problem, store, name)))
    for entry in entries:
        for key in ("demand", "rotation_ratio"):
            entry[key] = None if entry[key] is None else np.array(entry[key])
        entry["values"] = {key: Number(*number) for key, number in entry["values"].items()}
    return [MethodResult(**entry) for entry in entries]


def _tables(evaluation: Evaluation, name: str, results: Any) -> list[Table]:
    """Return the table of the methods for a set of motions. If a method computes rotations, also return a
    table of these rotations beside the exact ones."""
    columns = (
        Column("Method"),
        Column("Compares"),
        Column("Demand"),
        Column("Capacity"),
        Column("U", "utilisation"),
        Column("Verdict"),
        Column("Exact answer"),
    )
    not_computed = TextCell("not computed", "not made")
    rows = []
    for result in results:
        kind = kind_of_unit(result.unit)
        has_values = result.governing_demand is not None and result.capacity is not None
        verdict = {
            True: TextCell("accepts", "pass"),
            False: TextCell("rejects", "fail"),
            None: TextCell("no verdict", "not made"),
        }
        rows.append(
            (
                TextCell(f"{result.title} {result.equation}", note="; ".join(result.missing)),
                TextCell(f"{result.quantity}, {result.statistic}"),
                number_cell(result.governing_demand, kind) if has_values else not_computed,
                number_cell(result.capacity, kind) if has_values else not_computed,
                number_cell(result.utilisation, "utilisation", text="no capacity")
                if has_values
                else not_computed,
                verdict[result.passes],
                _exact(evaluation, name, result.name),
            )
        )
    tables = [Table(f"methods-{slug(name)}", f"Simplified methods, set {name}", columns, tuple(rows))]
    with_rotation = [result for result in results if result.rotation_ratio is not None]
    if with_rotation:
        data = evaluation.scenes.peaks(name)
        headings = (
            Column("Motion"),
            Column("Exact max|θ|/α", "number"),
            *(Column(f"{result.title} {result.equation}", "number") for result in with_rotation),
        )
        rotation_rows = []
        for k, label in enumerate(evaluation.problem.motions[name].names):
            cells = [_rotation(result, k) for result in with_rotation]
            rotation_rows.append(
                (TextCell(label), peak_cell(data, k, data["peak_rotation"][k], "number"), *cells)
            )
        tables.append(
            Table(
                f"rotations-{slug(name)}",
                f"Rotation by the methods, set {name}",
                headings,
                tuple(rotation_rows),
            )
        )
    return tables


def _rotation(result: Any, k: int) -> Quantity | TextCell:
    """Return a cell with the rotation θ/α that a method gives under motion k. If the equation of the method
    has several stable solutions, a note states their number."""
    value = float(np.asarray(result.rotation_ratio)[k])
    count = int(np.asarray(result.stable_roots)[k])
    note = f"{count} solutions" if count > 1 else ""
    if value >= 1:
        return TextCell("overturns", "overturned", note=note)
    return number_cell(value, "number", note=note) if value > 0 else TextCell("no uplift", "none")
