"""Small tables: as aligned lines of text, and as HTML for notebooks."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import Literal

Rows = Sequence[Sequence[str]]


def align_rows(rows: Rows, numbers: bool = False) -> list[str]:
    """Return rows as lines of text, with columns aligned left. If `numbers`, all columns but the first are
    aligned right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(
            cell.rjust(width) if numbers and k else cell.ljust(width)
            for k, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]


def html(rows: Rows, caption: str = "", headings: Literal["row", "column", "none"] = "none") -> str:
    """Return an HTML table of escaped text. `headings` states whether the first row, the first column or no
    cell is a heading.

    If a row has two cells and the second is empty, the first cell spans both columns.
    """
    body = "".join(f"<tr>{_cells(row, k, headings)}</tr>" for k, row in enumerate(rows))
    return f"<table>{f'<caption>{escape(caption)}</caption>' if caption else ''}{body}</table>"


def _cells(row: Sequence[str], k: int, headings: str) -> str:
    if len(row) == 2 and not row[1]:
        return f'<td colspan="2">{escape(row[0])}</td>'
    cells = []
    for j, cell in enumerate(row):
        tag = "th" if (headings == "row" and k == 0) or (headings == "column" and j == 0) else "td"
        cells.append(f'<{tag} style="text-align: left">{escape(cell)}</{tag}>')
    return "".join(cells)
