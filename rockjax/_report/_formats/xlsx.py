"""XLSX workbook with a sheet for each table. Texts are never converted to numbers or formulas."""

from __future__ import annotations

import datetime
import io
import re
from pathlib import Path
from typing import Any

from rockjax._report.blocks import Page
from rockjax._report.tables import plain
from rockjax._report.units import Units

from .grid import Number, grid

_CREATED = datetime.datetime(2000, 1, 1)  # fixed, so that the same tables give the same bytes
_WIDTH_RANGE = (8, 60)  # least and largest width of a column, in characters
_MAX_CELL_LENGTH = 32_767  # largest number of characters in a cell
_MAX_NAME_LENGTH = 31  # largest number of characters in the name of a sheet


def require_library() -> Any:
    """Return the module `xlsxwriter`. If it is missing, raise `ValueError` with the command to install it."""
    try:
        import xlsxwriter
    except ImportError:
        raise ValueError(
            "XLSX files need XlsxWriter, which is missing; run `pip install XlsxWriter`"
        ) from None
    return xlsxwriter


def check_path(path: str | Path) -> None:
    """Raise `ValueError` if XlsxWriter is missing, or if the suffix of a path is not .xlsx."""
    require_library()
    if Path(path).suffix.lower() != ".xlsx":
        raise ValueError(f"report: the workbook must be a .xlsx file, got {Path(path).name}")


def encode(page: Page, units: Units) -> dict[str, bytes]:
    """Return the tables of a page as a workbook.

    Numbers are in the units of the page and not rounded. Their number format shows as many digits as the
    page. Raises `ValueError` if XlsxWriter is missing.
    """
    target = io.BytesIO()
    options = {"in_memory": True, "strings_to_numbers": False, "strings_to_formulas": False}
    workbook = require_library().Workbook(target, {**options, "strings_to_urls": False})
    workbook.set_properties({"title": page.title[:255], "created": _CREATED})
    bold, top_aligned = workbook.add_format({"bold": True}), workbook.add_format({"valign": "top"})
    formats: dict[str, Any] = {}
    for number, table in enumerate(page.tables(), 1):
        sheet = workbook.add_worksheet(_sheet_name(table.name, number))
        sheet.write_string(0, 0, plain(table.caption, units)[:_MAX_CELL_LENGTH], bold)
        table_grid = grid(table, units)
        for column, name in enumerate(table_grid.headings):
            sheet.write_string(1, column, name, bold)
            longest = max(len(_text(row[column])) for row in [table_grid.headings, *table_grid.rows])
            sheet.set_column(column, column, min(max(longest + 2, _WIDTH_RANGE[0]), _WIDTH_RANGE[1]))
        for row_index, row in enumerate(table_grid.rows, 2):
            for column, cell in enumerate(row):
                if isinstance(cell, Number):
                    style = _number_format(cell.digits)
                    if style not in formats:
                        formats[style] = workbook.add_format({"num_format": style, "valign": "top"})
                    sheet.write_number(row_index, column, cell.value, formats[style])
                else:
                    sheet.write_string(row_index, column, cell[:_MAX_CELL_LENGTH], top_aligned)
        sheet.freeze_panes(2, 1)
    workbook.close()
    return {"report.xlsx": target.getvalue()}


def _sheet_name(name: str, number: int) -> str:
    """Return the name of the sheet for a table: the name of the table. If this name is too long, "~" and the
    number of the table replace its end."""
    if len(name) <= _MAX_NAME_LENGTH:
        return name
    ending = f"~{number}"
    return name[: _MAX_NAME_LENGTH - len(ending)] + ending


def _text(cell: Number | str) -> str:
    return cell.digits if isinstance(cell, Number) else cell


def _number_format(digits: str) -> str:
    """Return the number format that shows as many decimals as the text `digits`. For an empty text, return
    0.0E+00."""
    mantissa, power, _ = digits.partition("·")
    _, point, decimals = re.sub(r"\s", "", mantissa).partition(".")
    if not digits or power:
        return f"0{point or '.'}{'0' * len(decimals) or '0'}E+00"
    return f"0{point}{'0' * len(decimals)}"
