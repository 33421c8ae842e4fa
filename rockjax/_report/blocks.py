"""The content of a report: a page of sections, which consist of blocks such as paragraphs, figures and
tables.

The folder `sections` makes the blocks. `page.py` converts them to HTML, and the folder `_formats` to other
formats. All numbers are in SI. A number within a text is a `Quantity`, which HTML, CSV and XLSX files show in
the units of the page.
"""

from __future__ import annotations

import dataclasses
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any, TypeAlias

from .tables import Column, Formula, Link, Quantity, Table, Text, TextCell, checked_text
from .units import unit_of_kind

# Result of a check → state of its `TextCell`, and symbol on the page.
RESULTS = {
    "PASS": ("pass", "✓"),
    "FAIL": ("fail", "✗"),
    "UNDECIDED": ("undecided", "?"),
    "NOT VALID": ("not valid", "!"),
    "NOT MADE": ("not made", "–"),
    "BY OTHERS": ("by others", "→"),
}


def check_anchor(id: str) -> str:
    """Return the anchor of a check on the page, which is the `target` of a `Link` to the check.

    `id`: id of the check, any text, such as "C1"
    """
    return "check-" + re.sub(r"[^A-Za-z0-9.-]", lambda match: f"_{ord(match[0]):x}", id)


@dataclasses.dataclass(frozen=True)
class Paragraph:
    """A paragraph. If `is_note`, it is an explanation, which the page shows in small type."""

    text: Text
    is_note: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "text", checked_text(self.text, "Paragraph.text"))


@dataclasses.dataclass(frozen=True)
class Verbatim:
    """A text shown with its line breaks and spaces, such as a problem file."""

    text: str


@dataclasses.dataclass(frozen=True)
class Equation:
    """A row of `Equations`.

    - `formula`: the equation in symbols
    - `numbers`: right-hand side with numbers inserted, or a remark; "" for none
    - `result`: value of the right-hand side; None if there is none
    - `label`: number of the equation in the documentation, such as "F8"; "" for none
    """

    formula: Formula
    numbers: Text = ""
    result: Quantity | TextCell | None = None
    label: str = ""


@dataclasses.dataclass(frozen=True)
class Equations:
    """One or more equations, one below the other."""

    rows: tuple[Equation, ...]

    def __post_init__(self) -> None:
        if not self.rows:
            raise ValueError("Equations: rows must not be empty")


@dataclasses.dataclass(frozen=True)
class Figure:
    """A picture.

    - `svg`: result of `pictures.to_svg` for the same `title`, and for `description` in the units of the page
    - `caption`: text below the picture
    - `title`: short title
    - `description`: text for readers who cannot see the picture, with its most important number
    - `is_narrow`: whether the picture is narrower than the page
    - `units_note`: sentence on the units of the drawing, which the page shows after the caption. JSON files
      leave it out, because they have no drawings
    """

    svg: str
    caption: Text
    title: str
    description: Text
    is_narrow: bool = False
    units_note: str = ""

    def __post_init__(self) -> None:
        if not self.svg.startswith("<svg"):
            raise ValueError("Figure: svg must be the result of pictures.to_svg, and start with '<svg'")
        for name in ("caption", "title", "description"):
            checked_text(getattr(self, name), f"Figure.{name}")


@dataclasses.dataclass(frozen=True)
class Pair:
    """Two figures beside each other."""

    left: Figure
    right: Figure


@dataclasses.dataclass(frozen=True)
class Limit:
    """The limit of a check.

    - `comparison`: "≤" (at most) or "≥" (at least)
    - `quantity`: the limit [SI]
    - `unit`: unit of the limit in the problem file; None if the file gives no unit. If the page has another
      unit, it shows the limit in both units
    - `note`: a second line, such as the key of the problem file from which the limit comes
    """

    comparison: str
    quantity: Quantity
    unit: str | None = None
    note: Text = ""

    def __post_init__(self) -> None:
        if self.comparison not in ("≤", "≥"):
            raise ValueError(f"Limit: comparison must be '≤' or '≥', got {self.comparison!r}")
        if self.unit is not None:
            unit = unit_of_kind(self.unit, self.quantity.kind, owner="Limit.unit")
            object.__setattr__(self, "unit", unit)


@dataclasses.dataclass(frozen=True)
class SummaryRow:
    """A check in the summary.

    - `id`: id of the check, such as "C1"
    - `name`: name of the checked quantity
    - `scope`: set of motions and statistic, such as "design, largest of 11"
    - `value`: value with the numerical error, or a text if there is no number
    - `limit`: the limit, or a text if there is none
    - `utilisation`: utilisation U = value/limit (limit/value for a minimum), or a text such as "> 1" or "no
      value"
    - `result`: one of `RESULTS`
    - `governs`: text with the governing motion, and the storey, joint or time of the value
    - `sensitivities`: text with the largest derivatives d ln U/d ln y and their inputs y
    - `spread`: text with the least and the largest U if one input at a time is multiplied by 1 − s or 1 + s,
      where s is the key `report.spread` of the problem file
    - `reason`: why there is no value; "" if there is a value. A reason replaces the texts `governs`,
      `sensitivities` and `spread`
    - `section`: number of the section with the details
    - `assumptions`: ids of the violated assumptions, such as "A7". Each id is also the anchor of a row in
      section 10
    - `flags`: other short links beside the result
    - `clause`: clause of a standard or brief that asks for the check
    - `is_target`: whether the check is a design target

    Raises `ValueError` for an unknown result, for a missing id or text, and if `utilisation` is a number of a
    kind other than "utilisation".
    """

    id: str
    name: Text
    scope: Text
    value: Quantity | TextCell
    limit: Limit | TextCell
    utilisation: Quantity | TextCell
    result: str
    governs: Text = ""
    sensitivities: Text = ""
    spread: Text = ""
    reason: Text = ""
    section: int = 10
    assumptions: tuple[str, ...] = ()
    flags: tuple[Link, ...] = ()
    clause: str = ""
    is_target: bool = False

    def __post_init__(self) -> None:
        checked_text(self.id, "SummaryRow.id")
        owner = f"SummaryRow {self.id}"
        if self.result not in RESULTS:
            raise ValueError(f"{owner}: result must be one of {', '.join(RESULTS)}, got {self.result!r}")
        texts = ("reason",) if self.reason else ("governs", "sensitivities", "spread")
        for name in ("name", "scope", *texts):
            object.__setattr__(self, name, checked_text(getattr(self, name), f"{owner}: {name}"))
        if isinstance(self.utilisation, Quantity) and self.utilisation.kind != "utilisation":
            raise ValueError(f"{owner}: utilisation must be of kind 'utilisation'")

    @property
    def state(self) -> str:
        """State of the `TextCell` that shows the result, one of `tables.STATES`."""
        return RESULTS[self.result][0]

    @property
    def anchor(self) -> str:
        """Anchor on the page."""
        return check_anchor(self.id)

    @property
    def symbol(self) -> str:
        """Symbol of the result on the page."""
        return RESULTS[self.result][1]


@dataclasses.dataclass(frozen=True)
class Summary:
    """The summary of checks, with at least one row. The ids of the rows must differ. `note` explains the
    columns."""

    rows: tuple[SummaryRow, ...]
    note: Text

    def __post_init__(self) -> None:
        ids = [row.id for row in self.rows]
        if not ids:
            raise ValueError("Summary: rows must not be empty")
        if len(set(ids)) < len(ids):
            repeated = sorted({name for name in ids if ids.count(name) > 1})
            raise ValueError(f"Summary: ids must differ, got {', '.join(repeated)} more than once")

    def table(self) -> Table:
        """Return the summary as a table, for files."""
        headings = ("No.", "Check", "Motions", "Value", "Comparison", "Limit", "U", "Result", "Reason")
        headings += ("Governs", "Changes with", "U with spread", "Clause")
        return Table(
            "summary", "Summary of checks", tuple(map(Column, headings)), tuple(map(_cells, self.rows))
        )


def _cells(row: SummaryRow) -> tuple[Quantity | TextCell, ...]:
    """Return a row of the summary as cells of a table."""
    # If there is a reason, the texts `governs`, `sensitivities` and `spread` are empty.
    no_text = TextCell("not made" if row.reason else "none given", "none")
    reasons = [*row.assumptions, *(flag.text for flag in row.flags)]
    reason = row.reason or ", ".join(reasons)
    return (
        TextCell(row.id),
        TextCell(row.name),
        TextCell(row.scope),
        row.value,
        TextCell({"≤": "at most", "≥": "at least"}[row.limit.comparison])
        if isinstance(row.limit, Limit)
        else row.limit,
        row.limit.quantity if isinstance(row.limit, Limit) else row.limit,
        row.utilisation,
        TextCell(row.result, row.state),
        TextCell(reason) if reason else TextCell("none", "none"),
        *(TextCell(text) if text else no_text for text in (row.governs, row.sensitivities, row.spread)),
        TextCell(row.clause) if row.clause.strip() else TextCell("none given", "none"),
    )


Block: TypeAlias = Paragraph | Verbatim | Equations | Figure | Pair | Summary | Table


@dataclasses.dataclass(frozen=True)
class Section:
    """A section of the page. Its anchor is "s" followed by its number, such as "s4".

    - `number`: number of the section, from 1
    - `title`: heading
    - `blocks`: at least one block
    - `is_numbered`: whether the heading shows the number
    """

    number: int
    title: str
    blocks: tuple[Block, ...]
    is_numbered: bool = True

    def __post_init__(self) -> None:
        checked_text(self.title, f"Section {self.number}: title")
        if not self.blocks:
            raise ValueError(f"Section {self.number}: blocks must not be empty")

    @property
    def heading(self) -> str:
        """Title with its number."""
        return f"{self.number} {self.title}" if self.is_numbered else self.title


@dataclasses.dataclass(frozen=True)
class Page:
    """The content of a report.

    - `title`: title of the project, the first heading
    - `head`: label → text, such as "Project", "Revision", "Author", "Date"
    - `verdict`: first sentence, which states how many checks pass
    - `notices`: paragraphs below the verdict, such as violated assumptions
    - `sections`: the sections in the order of the page
    - `is_verified`: whether every check passes or is made by others, and at least one passes
    - `subject`: line below the title
    - `origin`: label → text below `head`, such as "Problem file" and "Command"
    - `footer`: text at the foot of printed pages

    Raises `ValueError` for an empty text, for a link to a missing anchor, for two tables of the same name,
    and for two sections, rows or parts of figures with the same anchor or id.
    """

    title: str
    head: Mapping[str, Text]
    verdict: str
    notices: tuple[Text, ...]
    sections: tuple[Section, ...]
    is_verified: bool = False
    subject: str = ""
    origin: Mapping[str, Text] = dataclasses.field(default_factory=dict)
    footer: str = ""

    def __post_init__(self) -> None:
        checked_text(self.title, "Page.title")
        checked_text(self.verdict, "Page.verdict")
        for term, content in {**self.head, **self.origin}.items():
            checked_text(content, f"Page: {term}")
        for notice in self.notices:
            checked_text(notice, "Page.notices")
        names = [table.name for table in self.tables()]
        anchors, figure_ids = [f"s{section.number}" for section in self.sections], []
        for block in self.blocks():
            if isinstance(block, Summary):
                anchors += [row.anchor for row in block.rows]
            elif isinstance(block, Table):
                anchors += block.ids
            elif isinstance(block, Figure | Pair):
                figures = (block,) if isinstance(block, Figure) else (block.left, block.right)
                for figure in figures:
                    figure_ids += re.findall(r'\bid="([^"]*)"', figure.svg)
        for noun, values in {"names of tables": names, "anchors": [*anchors, *figure_ids]}.items():
            if repeated := sorted(name for name, times in Counter(values).items() if times > 1):
                raise ValueError(f"Page: {noun} must differ, got {', '.join(repeated[:5])} more than once")
        if missing := sorted(set(_targets(self)) - set(anchors)):
            raise ValueError(f"Page: no section, check or row has the anchor {', '.join(missing)}")

    def blocks(self) -> Iterator[Block]:
        """Yield the blocks of all sections."""
        for section in self.sections:
            yield from section.blocks

    def tables(self) -> tuple[Table, ...]:
        """Return all tables; the first is the summary of checks."""
        return tuple(
            block.table() if isinstance(block, Summary) else block
            for block in self.blocks()
            if isinstance(block, Summary | Table)
        )


def _targets(content: Any) -> Iterator[str]:
    """Yield the targets of all links within blocks, texts and cells."""
    if isinstance(content, Link):
        yield content.target
    elif isinstance(content, SummaryRow):
        yield f"s{content.section}"
        yield from content.assumptions
    if dataclasses.is_dataclass(content):
        content = [getattr(content, field.name) for field in dataclasses.fields(content)]
    if isinstance(content, Mapping):
        content = list(content.values())
    if isinstance(content, list | tuple):
        for part in content:
            yield from _targets(part)
