"""CSV files, one for each table, in UTF-8 with the byte order mark that spreadsheets expect."""

from __future__ import annotations

import codecs
import csv
import io

from rockjax._report.blocks import Page
from rockjax._report.tables import Table
from rockjax._report.units import Units

from .grid import Number, grid

_FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r")


def encode(page: Page, units: Units) -> dict[str, bytes]:
    """Return the tables of a page as CSV files, named after the tables.

    Numbers are in the units of the page and not rounded. A text that a spreadsheet would take for a formula
    gets an apostrophe in front.
    """
    return {f"{table.name}.csv": _content(table, units) for table in page.tables()}


def _content(table: Table, units: Units) -> bytes:
    table_grid, text = grid(table, units), io.StringIO(newline="")
    writer = csv.writer(text)
    writer.writerow(map(_field, table_grid.headings))
    writer.writerows([_field(cell) for cell in row] for row in table_grid.rows)
    return codecs.BOM_UTF8 + text.getvalue().encode()


def _field(cell: Number | str) -> str:
    if isinstance(cell, Number):
        return repr(cell.value)
    return "'" + cell if cell.startswith(_FORMULA_STARTS) else cell
