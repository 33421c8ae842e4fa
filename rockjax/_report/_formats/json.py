"""JSON file with the texts and numbers of the page. Numbers are in SI and not rounded.

Of a picture, the file has the title, the description and the caption. Sections, and the blocks of a section,
have the order of the page.
"""

from __future__ import annotations

import json
from typing import Any

from rockjax._report import formulas
from rockjax._report.blocks import (
    Block,
    Equation,
    Equations,
    Figure,
    Limit,
    Page,
    Pair,
    Paragraph,
    Summary,
    SummaryRow,
    Verbatim,
)
from rockjax._report.tables import (
    Bare,
    Cell,
    Formula,
    Part,
    Quantity,
    Series,
    Table,
    Text,
    TextCell,
    plain,
    plain_part,
)
from rockjax._report.units import Units, si_unit

SCHEMA = "rockjax-report/1"  # increment if a change breaks programs that read the file


def encode(page: Page, units: Units) -> dict[str, bytes]:
    """Return the page as a JSON file in SI. Only the gravity of `units` is used."""
    return {
        "report.json": (json.dumps(document(page, units.g), ensure_ascii=False, indent=1) + "\n").encode()
    }


def document(page: Page, g: float) -> dict[str, Any]:
    """Return the page as numbers, strings, lists and dicts.

    - `page`: the page
    - `g`: gravity [m/s²]

    The keys are `schema`, `title`, `subject`, `head`, `origin`, `verdict`, `is_verified`, `notices`, `checks`
    (one for each row of the summary), `tables` (by name) and `sections`. The key `is_target` of a check
    states whether it is a design target. A cell is a dict whose keys depend on its content: "value", "unit"
    and, if known, "error" for a number; "values" and "unit" for several numbers; "text" and "state" for a
    text; "latex" for a formula. The key "note" is the second line of the cell. A text that contains numbers
    is a list of strings and of cells with one number.
    """
    converter = _Converter(Units.si(g))
    summaries = [block for block in page.blocks() if isinstance(block, Summary)]
    return {
        "schema": SCHEMA,
        "title": page.title,
        "subject": page.subject,
        "head": {term: converter.text(content) for term, content in page.head.items()},
        "origin": {term: converter.text(content) for term, content in page.origin.items()},
        "verdict": page.verdict,
        "is_verified": page.is_verified,
        "notices": [converter.text(notice) for notice in page.notices],
        "checks": [converter.check(row) for summary in summaries for row in summary.rows],
        "tables": {block.name: converter.table(block) for block in page.blocks() if isinstance(block, Table)},
        "sections": [
            {
                "number": section.number,
                "title": section.title,
                "blocks": [converter.block(block) for block in section.blocks],
            }
            for section in page.sections
        ],
    }


class _Converter:
    """Conversion of the parts of a page to JSON values, in SI units."""

    def __init__(self, units: Units):
        self.units = units

    def text(self, content: Text) -> Any:
        """Return a text as a string. If it contains quantities, return a list of strings and of cells with a
        number."""
        if isinstance(content, str) or not any(isinstance(part, Quantity | Bare) for part in content):
            return plain(content, self.units)
        return [self._part(part) for part in content]

    def _part(self, part: Part) -> Any:
        if isinstance(part, Quantity):
            return self.cell(part)
        return self.cell(part.quantity) if isinstance(part, Bare) else plain_part(part, self.units)

    def cell(self, cell: Cell) -> Any:
        if isinstance(cell, Formula):
            return {"latex": formulas.latex(cell.name)}
        note = {"note": self.text(cell.note)} if cell.note else {}
        if isinstance(cell, TextCell):
            return {"text": self.text(cell.text), "state": cell.state, **note}
        if isinstance(cell, Series):
            return {"values": list(cell.values), "unit": si_unit(cell.kind), **note}
        error = {} if cell.error is None else {"error": cell.error}
        return {"value": cell.value, "unit": si_unit(cell.kind), **error, **note}

    def table(self, table: Table) -> dict[str, Any]:
        columns = [
            {"head": column.heading, **({"note": self.text(column.note)} if column.note else {})}
            for column in table.columns
        ]
        rows = [[self.cell(cell) for cell in row] for row in table.rows]
        return {
            "caption": self.text(table.caption),
            "columns": columns,
            "rows": rows,
            **({"governing": list(table.governing)} if table.governing else {}),
        }

    def check(self, row: SummaryRow) -> dict[str, Any]:
        texts = {name: getattr(row, name) for name in ("governs", "sensitivities", "spread", "reason")}
        return {
            "id": row.id,
            "name": self.text(row.name),
            "scope": self.text(row.scope),
            "value": self.cell(row.value),
            "limit": self._limit(row.limit),
            "utilisation": self.cell(row.utilisation),
            "result": row.result,
            **{name: self.text(text) for name, text in texts.items() if text},
            "section": row.section,
            "assumptions": list(row.assumptions),
            "flags": [flag.text for flag in row.flags],
            **({"clause": row.clause} if row.clause else {}),
            "is_target": row.is_target,
        }

    def _limit(self, limit: Limit | TextCell) -> Any:
        if isinstance(limit, TextCell):
            return self.cell(limit)
        note = {"note": self.text(limit.note)} if limit.note else {}
        sense = {"≤": "at most", "≥": "at least"}[limit.comparison]
        given = {} if limit.unit is None else {"given_in": limit.unit}
        return {"sense": sense, **self.cell(limit.quantity), **given, **note}

    def block(self, block: Block) -> dict[str, Any]:
        if isinstance(block, Paragraph):
            return {"paragraph": self.text(block.text)}
        if isinstance(block, Verbatim):
            return {"verbatim": block.text}
        if isinstance(block, Equations):
            return {"equations": [self._equation(row) for row in block.rows]}
        if isinstance(block, Figure):
            return {"figure": self._figure(block)}
        if isinstance(block, Pair):
            return {"figures": [self._figure(block.left), self._figure(block.right)]}
        return {"table": block.name if isinstance(block, Table) else "checks"}

    def _equation(self, row: Equation) -> dict[str, Any]:
        numbers = {"numbers": self.text(row.numbers)} if row.numbers else {}
        result = {} if row.result is None else {"result": self.cell(row.result)}
        label = {"label": row.label} if row.label else {}
        return {"latex": formulas.latex(row.formula.name), **numbers, **result, **label}

    def _figure(self, figure: Figure) -> dict[str, Any]:
        texts = {name: self.text(getattr(figure, name)) for name in ("description", "caption")}
        return {"title": figure.title, **texts}
