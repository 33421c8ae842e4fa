"""Section 8: derivatives of utilisations U with respect to the inputs y, and utilisations with changed
inputs."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from rockjax._report.blocks import Paragraph, Section
from rockjax._report.cells import number_cell, slug
from rockjax._report.tables import Cell, Column, Quantity, Table, TextCell
from rockjax._report.units import Units

if TYPE_CHECKING:
    from rockjax._report.evaluation import Check, Evaluation

_NOTE = (
    "A derivative is valid for one motion and one order of impacts. U with one input decreased or increased "
    "is computed from all motions, so it also shows the effect if another motion governs or the columns "
    "overturn."
)


def section(evaluation: Evaluation, units: Units) -> Section:
    """Return section 8 of the page."""
    del units
    spread = evaluation.problem.report.spread
    tables = [_table(check, spread) for check in evaluation.checks if check.sensitivities or check.spread]
    if not tables:
        text = "No check has a derivative or a spread to show."
        return Section(8, "Influence of the inputs", (Paragraph(text),))
    return Section(8, "Influence of the inputs", (Paragraph(_NOTE, is_note=True), *tables))


def _table(check: Check, spread: float) -> Table:
    """Return the table of a check: derivatives of its utilisation, and utilisations with changed inputs.

    `spread`: relative change of the inputs
    """
    columns = (
        Column("Input"),
        Column("d ln U/d ln y", "number"),
        Column("U with the input decreased", "utilisation"),
        Column("U with the input increased", "utilisation"),
    )
    names = dict.fromkeys((*check.sensitivities, *check.spread))

    def row(name: str) -> tuple[Cell, ...]:
        slope: Any = TextCell(check.no_slopes, "none")
        if name in check.sensitivities:
            slope = number_cell(check.sensitivities[name], "number")
        ends = [TextCell("not computed", "none")] * 2
        if name in check.spread:
            ends = [
                TextCell(check.spread_events[name, k], check.spread_events[name, k].partition(" (")[0])
                if (name, k) in check.spread_events
                else number_cell(u, "utilisation", text="no value" if math.isnan(u) else "no finite value")
                for k, u in enumerate(check.spread[name])
            ]
        return TextCell(name), slope, *ends

    suffix = f", set {check.motions}" if check.motions else ""
    is_finite = math.isfinite(check.utilisation)
    u = Quantity(check.utilisation, "utilisation") if is_finite else "no finite value"
    caption = ("Check ", check.id, f", {check.name}{suffix}: U = ", u)
    rows = (*map(row, names), *_exact_rows(check, spread))
    return Table(f"influences-{slug(check.id)}", caption, columns, rows)


def _exact_rows(check: Check, spread: float) -> list[tuple[Cell, ...]]:
    """Return the rows of the inputs to which U is proportional or inversely proportional: the limit, and for
    a contact pressure the contact area. `spread`: relative change of the inputs."""
    u = check.utilisation
    if not (math.isfinite(u) and u > 0) or not check.kind.has_limit:
        return []
    exponents = {"limit": 1 if check.kind.is_minimum else -1}
    if check.kind.name == "contact-pressure":
        exponents |= {"joints.contact_width": -1, "joints.contact_depth": -1}

    def cells(exponent: int) -> list[Quantity]:
        ends = [u * (1 + change) ** exponent for change in (-spread, spread)]
        return [Quantity(exponent, "number"), *(Quantity(y, "utilisation") for y in ends)]

    return [(TextCell(name), *cells(exponent)) for name, exponent in exponents.items()]
