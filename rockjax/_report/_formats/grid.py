"""Tables as rows of numbers and texts, for CSV and XLSX files."""

from __future__ import annotations

from typing import NamedTuple

from rockjax._report.tables import (
    Cell,
    Column,
    Formula,
    Quantity,
    Series,
    Table,
    TextCell,
    format_number,
    plain,
    plain_cell,
)
from rockjax._report.units import NO_UNIT, Units

NONE = "none"  # text in columns of errors and notes for a cell that has no error or no note


class Number(NamedTuple):
    """A number in the unit of the page.

    - `value`: the number, not rounded
    - `digits`: the rounded number as text, as on the page; "" in columns of errors
    """

    value: float
    digits: str


class Grid(NamedTuple):
    """Headings and rows of a table. Errors, units and notes have their own columns."""

    headings: list[str]
    rows: list[list[Number | str]]


def grid(table: Table, units: Units) -> Grid:
    """Return a table as rows of texts and numbers. Numbers are in the units of the page and not rounded."""
    headings: list[str] = []
    rows: list[list[Number | str]] = [[] for _ in table.rows]
    for k, column in enumerate(table.columns):
        cells = [row[k] for row in table.rows]
        parts = [_main_column(cells, column, units), *_extra_columns(cells, column, units)]
        for name, values in parts:
            headings.append(name)
            for row, content in zip(rows, values, strict=True):
                row.append(content)
    return Grid(headings, rows)


def _main_column(cells: list[Cell], column: Column, units: Units) -> tuple[str, list[Number | str]]:
    """Return the heading and the values of a column."""
    note = plain(column.note, units)
    name = f"{column.heading} ({note})" if note else column.heading
    return name, [
        Number(units.show(cell.value, cell.kind), format_number(cell, units))
        if isinstance(cell, Quantity)
        else plain_cell(cell, units, shows_unit=False)
        for cell in cells
    ]


def _extra_columns(cells: list[Cell], column: Column, units: Units) -> list[tuple[str, list[Number | str]]]:
    """Return headings and values of the additional columns for the errors, units and notes of a column."""
    extra: list[tuple[str, list[Number | str]]] = []
    errors: list[Number | str] = []
    for cell in cells:
        error = cell.error if isinstance(cell, Quantity) else None
        errors.append(NONE if error is None else Number(units.show(error, _kind(cell)), ""))
    if any(isinstance(error, Number) for error in errors):
        extra.append((f"{column.heading}: error", errors))
    if any(isinstance(cell, Quantity | Series) for cell in cells):
        shown_units = [units.unit(_kind(cell)) if _kind(cell) else NO_UNIT for cell in cells]
        extra.append((f"{column.heading}: unit", [*shown_units]))
    notes = [NONE if isinstance(cell, Formula) else plain(cell.note, units) or NONE for cell in cells]
    if set(notes) != {NONE}:
        extra.append((f"{column.heading}: note", [*notes]))
    return extra


def _kind(cell: Cell) -> str:
    return "" if isinstance(cell, TextCell | Formula) else cell.kind
