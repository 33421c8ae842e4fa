"""HTML of texts, cells and tables. All texts are escaped, here or by the template."""

from __future__ import annotations

import re
from typing import Final

from markupsafe import Markup, escape

from . import formulas
from .tables import (
    Bare,
    Cell,
    Code,
    Column,
    Formula,
    Link,
    Part,
    Quantity,
    Series,
    Strong,
    Table,
    Text,
    TextCell,
    Tone,
    column_heading,
    format_error,
    format_number,
    format_series,
    plain,
    with_unit,
)
from .units import Units

# Tone of a text (its colour, see `tables.Tone`) → class of page.css.
CLASSES: Final[dict[Tone, str]] = {"plain": "", "good": "good", "bad": "bad", "unverified": "unverified"}
_FORBIDDEN = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\ufffe\uffff\ud800-\udfff]")
SHORT_NAME = 16  # headings of rows with at most this number of characters stay on one line
# Start of the element around a table. On narrow screens the element scrolls sideways.
SCROLL_BOX_START = Markup(
    '<div class="scroll" tabindex="0" role="group" aria-label="table, scrolls sideways">'
)


def safe(string: str) -> Markup:
    """Return a string as HTML, with Unix line ends. U+FFFD replaces surrogates, U+FFFE, U+FFFF, and control
    characters other than tabs and line ends."""
    string = string.replace("\r\n", "\n").replace("\r", "\n")
    return escape(_FORBIDDEN.sub("\N{REPLACEMENT CHARACTER}", string))


def text(content: Text, units: Units) -> Markup:
    """Return a text as HTML, with its quantities in the units of the page."""
    parts = (content,) if isinstance(content, str) else content
    return Markup("").join(_part(part, units) for part in parts)


def _part(part: Part, units: Units) -> Markup:
    if isinstance(part, Quantity):
        return safe(with_unit(format_number(part, units), part.kind, units))
    if isinstance(part, Bare):
        return safe(format_number(part.quantity, units))
    if isinstance(part, Formula):
        return formula(part).replace('display="block"', 'display="inline"')
    if isinstance(part, Code):
        return Markup("<code>{}</code>").format(safe(part.text))
    if isinstance(part, Link):
        return Markup('<a href="#{}">{}</a>').format(part.target, safe(part.text))
    if isinstance(part, Strong):
        return emphasised(safe(part.text), part.tone)
    return safe(part)


def emphasised(content: Markup, tone: Tone) -> Markup:
    """Return HTML in bold and in the colour of a tone."""
    css_class = CLASSES[tone]
    attributes = Markup(' class="{}"').format(css_class) if css_class else Markup("")
    return Markup("<b{}>{}</b>").format(attributes, content)


def formula(part: Formula) -> Markup:
    """Return the MathML of a formula."""
    return Markup(formulas.mathml(part.name).replace("&ApplyFunction;", "\N{FUNCTION APPLICATION}"))


def second_line(content: Text, units: Units) -> Markup:
    """Return a text as HTML for the second line of a cell. For an empty text, return ""."""
    return Markup("<small>{}</small>").format(text(content, units)) if content else Markup("")


def value(cell: Cell, units: Units, *, shows_unit: bool = True) -> Markup:
    """Return the content of a cell as HTML: number or text, error and note.

    `shows_unit`: whether to add the unit to a number; False in columns whose heading has the unit
    """
    if isinstance(cell, Formula):
        return formula(cell)
    if isinstance(cell, TextCell):
        first = text(cell.text, units)
        if cell.tone != "plain":
            first = emphasised(first, cell.tone)
        return first + second_line(cell.note, units)
    if isinstance(cell, Series):
        digits, error = format_series(cell, units), Markup("")
    else:
        digits, error = format_number(cell, units), format_error(cell, units)
        error = Markup("<small>± {}</small>").format(error) if error else Markup("")
    return (
        safe(with_unit(digits, cell.kind, units) if shows_unit else digits)
        + error
        + second_line(cell.note, units)
    )


def table(content: Table, units: Units) -> Markup:
    """Return a table as HTML, with a caption and with units in the headings of columns."""
    is_number = [  # for each column
        all(isinstance(row[k], Quantity) for row in content.rows) or column.kind is not None
        for k, column in enumerate(content.columns)
    ]
    headings = Markup("").join(
        Markup('<th scope="col"{}>{}{}</th>').format(
            _alignment(is_number[k] and k > 0),
            safe(column_heading(column, units)),
            second_line(column.note, units),
        )
        for k, column in enumerate(content.columns)
    )
    rows = Markup("\n").join(_row(content, index, is_number, units) for index in range(len(content.rows)))
    return Markup("<table><caption>{}</caption><thead><tr>{}</tr></thead><tbody>{}</tbody></table>").format(
        text(content.caption, units), headings, rows
    )


def _row(content: Table, index: int, is_number: list[bool], units: Units) -> Markup:
    attributes = Markup(' id="{}"').format(content.ids[index]) if content.ids else Markup("")
    if index in content.governing:
        attributes += Markup(' class="gov"')
    cells = Markup("").join(
        _cell(cell, column, k, is_number[k], units)
        for k, (cell, column) in enumerate(zip(content.rows[index], content.columns, strict=True))
    )
    return Markup("<tr{}>{}</tr>").format(attributes, cells)


def _cell(cell: Cell, column: Column, k: int, is_number: bool, units: Units) -> Markup:
    shown_value = value(cell, units, shows_unit=column.kind is None)
    if k == 0 and not isinstance(cell, Formula):
        is_short = isinstance(cell, TextCell) and len(plain(cell.text, units)) <= SHORT_NAME
        attributes = Markup(' class="nb"' if is_short else "")
        return Markup('<th scope="row"{}>{}</th>').format(attributes, shown_value)
    attributes = Markup(' class="eq"') if isinstance(cell, Formula) else _alignment(is_number)
    return Markup("<td{}>{}</td>").format(attributes, shown_value)


def _alignment(is_number: bool) -> Markup:
    return Markup(' class="r"' if is_number else "")
