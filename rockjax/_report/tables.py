"""Tables of a report: cells, columns, and the formatting of numbers.

Values in tables are in SI. All formats (HTML, JSON, CSV, XLSX) read the same `Table`.
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Literal, TypeAlias

from rockjax._problem.models.fields import NO_VALUE

from . import formulas
from .units import KINDS, NO_UNIT, Units

# Colour of a text. "unverified" is the colour of results and inputs that are missing or not verified.
Tone: TypeAlias = Literal["plain", "good", "bad", "unverified"]
# State of a `TextCell` → its tone.
STATES: dict[str, Tone] = {
    "text": "plain",  # names, sources and other texts
    "pass": "good",
    "fail": "bad",
    "undecided": "unverified",
    "not valid": "unverified",
    "not made": "unverified",
    "by others": "unverified",
    "overturned": "bad",
    "joint opens": "bad",
    "violated": "bad",
    "holds": "good",
    "not tested": "unverified",
    "unsafe": "bad",
    "unanswered": "unverified",  # the solver gave no answer
    "no source": "unverified",
    "not asked": "plain",
    "none": "plain",  # "no impact", "no derivative", "no overturning up to 10"
}
_SUPERSCRIPTS = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")
SPACE = "\N{NO-BREAK SPACE}"


@dataclasses.dataclass(frozen=True)
class Quantity:
    """A number with a unit.

    - `value`: finite number [SI]
    - `kind`: what the number measures, one of `units.KINDS`
    - `error`: estimate of the error [SI]; None if it is unknown
    - `is_input`: whether it is an input, which is shown without trailing zeros
    - `note`: a second line in the cell, such as the time of the value

    Raises `ValueError` for an unknown kind, a value that is not finite (use a `TextCell`), and an error that
    is negative or not finite.
    """

    value: float
    kind: str
    error: float | None = None
    is_input: bool = False
    note: Text = ""

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ValueError(f"Quantity: kind must be one of {', '.join(KINDS)}, got {self.kind!r}")
        object.__setattr__(self, "value", _finite(self.value, "value"))
        if self.error is not None:
            object.__setattr__(self, "error", _finite(self.error, "error"))
            if self.error < 0:
                raise ValueError(f"Quantity: error must not be negative, got error = {self.error}")
        object.__setattr__(self, "note", checked_text(self.note, "Quantity.note", may_be_empty=True))


@dataclasses.dataclass(frozen=True)
class TextCell:
    """A text in a cell: a name, or a text that replaces a number.

    - `text`: shown text; not blank, not only a dash, and not the name of a missing number such as "nan"
    - `state`: meaning of the text for programs, one of `STATES`
    - `note`: a second line in the cell

    Raises `ValueError` for an invalid text and for an unknown state.
    """

    text: Text
    state: str = "text"
    note: Text = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "text", checked_text(self.text, "TextCell.text"))
        object.__setattr__(self, "note", checked_text(self.note, "TextCell.note", may_be_empty=True))
        if self.state not in STATES:
            raise ValueError(f"TextCell: state must be one of {', '.join(STATES)}, got {self.state!r}")

    @property
    def tone(self) -> Tone:
        """Colour of the text."""
        return STATES[self.state]


@dataclasses.dataclass(frozen=True)
class Series:
    """Numbers of one kind in a cell, such as the masses of all stories. Adjacent equal numbers are shown
    once, as in "7 × 260, 220".

    - `values`: finite numbers [SI], at least one
    - `kind`: what the numbers measure, one of `units.KINDS`
    - `is_input`: whether they are inputs, which are shown without trailing zeros
    - `note`: a second line in the cell

    Raises `ValueError` as `Quantity` does, and if there are no values.
    """

    values: tuple[float, ...]
    kind: str
    is_input: bool = False
    note: Text = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", tuple(Quantity(value, self.kind).value for value in self.values))
        if not self.values:
            raise ValueError("Series: values must not be empty")
        object.__setattr__(self, "note", checked_text(self.note, "Series.note", may_be_empty=True))


@dataclasses.dataclass(frozen=True)
class Formula:
    """The formula `name` of `formulas.json`. Raises `ValueError` for an unknown name."""

    name: str

    def __post_init__(self) -> None:
        formulas.latex(self.name)


@dataclasses.dataclass(frozen=True)
class Strong:
    """A part of a text in bold. `tone` is its colour."""

    text: str
    tone: Tone = "plain"


@dataclasses.dataclass(frozen=True)
class Code:
    """A part of a text in a monospaced font, such as a key of a file or a command."""

    text: str


@dataclasses.dataclass(frozen=True)
class Link:
    """A part of a text that is a link to an anchor of the page.

    - `text`: the shown text
    - `target`: the anchor: "s4" for section 4, `blocks.check_anchor("C1")` for check C1, or the id of a row
      of a table, such as "A7"
    """

    text: str
    target: str


@dataclasses.dataclass(frozen=True)
class Bare:
    """A quantity that a text shows without its unit, for example in an equation."""

    quantity: Quantity


Part: TypeAlias = str | Quantity | Strong | Code | Link | Bare | Formula
Text: TypeAlias = str | tuple[Part, ...]  # quantities are shown in the units of the page
Cell: TypeAlias = Quantity | Series | TextCell | Formula
_PARTS = (str, Quantity, Strong, Code, Link, Bare, Formula)


@dataclasses.dataclass(frozen=True)
class Column:
    """A column of a table.

    - `heading`: heading without a unit
    - `kind`: what the numbers measure, one of `units.KINDS`. Their unit is added to the heading. None for a
      column of texts or of numbers of several kinds, in which each number is shown with its unit
    - `note`: a second line below the heading
    """

    heading: str
    kind: str | None = None
    note: Text = ""

    def __post_init__(self) -> None:
        checked_text(self.heading, "Column.heading")
        if self.kind is not None and self.kind not in KINDS:
            raise ValueError(f"Column: kind must be one of {', '.join(KINDS)}, got {self.kind!r}")
        object.__setattr__(self, "note", checked_text(self.note, "Column.note", may_be_empty=True))


@dataclasses.dataclass(frozen=True)
class Table:
    """A table of a report.

    - `name`: name of the file, sheet and JSON entry, unique in a report. It has lower-case letters, digits
      and "-", and starts with a letter
    - `caption`: title above the table
    - `columns`: the columns; the cells of the first column are the headings of the rows
    - `rows`: at least one row, each with one cell for every column. A text becomes a `TextCell`
    - `governing`: indices of highlighted rows
    - `ids`: an anchor for every row, such as "A7"; empty for no anchors. An anchor has letters, digits, "-"
      and ".", and starts with a letter

    Raises `ValueError` for a table without rows or columns, a row with more or fewer cells than columns, a
    quantity whose kind is not that of its column, and other invalid fields.
    """

    name: str
    caption: Text
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    governing: tuple[int, ...] = ()
    ids: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[a-z][a-z0-9-]*", self.name):
            raise ValueError(
                "Table: name must have lower-case letters, digits and '-', the first a letter; "
                f"got {self.name!r}"
            )
        caption = checked_text(self.caption, f"Table {self.name}: caption")
        columns = tuple(self.columns)
        rows = tuple(tuple(_cell(cell) for cell in row) for row in self.rows)
        if not rows or not columns:
            raise ValueError(f"Table {self.name}: needs at least one row and one column")
        for index, row in enumerate(rows):
            if len(row) != len(columns):
                raise ValueError(
                    f"Table {self.name}: row {index} has {len(row)} cells for {len(columns)} columns"
                )
            for cell, column in zip(row, columns, strict=True):
                if column.kind and isinstance(cell, Quantity | Series) and cell.kind != column.kind:
                    raise ValueError(
                        f"Table {self.name}: row {index} has {KINDS[cell.kind].article} {cell.kind} in the "
                        f"column {column.heading!r} of kind {column.kind}"
                    )
        if self.ids and len(self.ids) != len(rows):
            raise ValueError(f"Table {self.name}: {len(self.ids)} ids for {len(rows)} rows")
        if not all(re.fullmatch(r"[A-Za-z][A-Za-z0-9.-]*", anchor) for anchor in self.ids):
            raise ValueError(
                f"Table {self.name}: ids must have letters, digits, '-' and '.', the first a letter; got "
                f"{', '.join(self.ids)}"
            )
        if not all(0 <= index < len(rows) for index in self.governing):
            raise ValueError(
                f"Table {self.name}: governing must hold indices of rows from 0 to {len(rows) - 1}, "
                f"got {self.governing}"
            )
        for name, value in {"caption": caption, "columns": columns, "rows": rows}.items():
            object.__setattr__(self, name, value)

    @classmethod
    def from_rows(
        cls,
        name: str,
        caption: Text,
        columns: Mapping[str, str | None],
        rows: Iterable[Sequence[Any]],
        **options: Any,
    ) -> Table:
        """Return a table from rows that may contain plain numbers.

        - `name`, `caption`: fields of the table; `options`: its other fields, such as `ids`
        - `columns`: heading → kind of the numbers, or None; see `Column`
        - `rows`: rows of cells. A plain number becomes a `Quantity` of the kind of its column, and a text
          becomes a `TextCell`

        Raises `ValueError` as the constructor does, and for a number in a column without a kind.
        """
        headings = tuple(Column(head, kind) for head, kind in columns.items())
        cells = tuple(
            tuple(
                _cell(cell)
                if isinstance(cell, str | tuple | Quantity | Series | TextCell | Formula)
                else Quantity(cell, column.kind or "")
                for cell, column in zip(row, headings, strict=True)
            )
            for row in rows
        )
        return cls(name, caption, headings, cells, **options)


def format_number(quantity: Quantity, units: Units) -> str:
    """Return the digits of a quantity in the units of a page, without unit and error.

    Numbers have at most four significant digits, and no digits after the first significant digit of the
    error. Inputs have up to six significant digits, without trailing zeros. Counts have no decimals.
    Derivatives have a sign and two significant digits.
    Utilisations have two decimals, or more if a utilisation other than 1 would be rounded to 1. Utilisations
    of 1000 or more have four significant digits.
    """
    value = units.show(quantity.value, quantity.kind)
    digits = KINDS[quantity.kind].digits
    if quantity.kind == "utilisation":
        return _signed(_utilisation(value))
    if quantity.kind == "derivative":
        return f"{value:+.{max(1 - _exponent(value, 2), 0)}f}".replace("-", "−")
    if digits is None:
        return _signed(f"{value:.0f}")
    if quantity.is_input:
        return _signed(_scientific(float(f"{value:.6g}"), f"{value:.6g}"))
    error = quantity.error and units.show(quantity.error, quantity.kind)
    return _signed(_significant(value, digits, error))


def format_error(quantity: Quantity, units: Units) -> str:
    """Return the error of a quantity with one significant digit, without unit; "" if the error is None."""
    if quantity.error is None:
        return ""
    return _signed(_significant(units.show(quantity.error, quantity.kind), 1))


def with_unit(digits: str, kind: str, units: Units) -> str:
    """Return digits with the unit of a kind: "6.14°", "0.558 %", "0.467"."""
    symbol = units.symbol(kind)
    return digits if symbol == NO_UNIT else digits + ("" if symbol == "°" else SPACE) + symbol


def format_series(series: Series, units: Units) -> str:
    """Return the numbers of a series in the units of a page, without unit: "7 × 260, 220"."""
    digits = [
        format_number(Quantity(value, series.kind, is_input=series.is_input), units)
        for value in series.values
    ]
    runs: list[tuple[int, str]] = []
    for number in digits:
        if runs and runs[-1][1] == number:
            runs[-1] = runs[-1][0] + 1, number
        else:
            runs.append((1, number))
    return ", ".join(number if count == 1 else f"{count} × {number}" for count, number in runs)


def column_heading(column: Column, units: Units) -> str:
    """Return the heading of a column with its unit."""
    if column.kind is None or units.symbol(column.kind) == NO_UNIT:
        return column.heading
    return f"{column.heading} [{units.symbol(column.kind)}]"


def joined(texts: Iterable[Text], separator: str = ", ") -> Text:
    """Return texts as one text, with a separator between them."""
    parts: list[Part] = []
    for text in texts:
        parts += [separator] if parts else []
        parts += [text] if isinstance(text, str) else text
    words = [part for part in parts if isinstance(part, str)]
    return "".join(words) if len(words) == len(parts) else tuple(parts)


def plain(text: Text, units: Units) -> str:
    """Return a text without markup, with its quantities in the units of a page."""
    if isinstance(text, str):
        return text
    return "".join(plain_part(part, units) for part in text)


def plain_part(part: Part, units: Units) -> str:
    """Return a part of a text without markup; a formula becomes its LaTeX source."""
    if isinstance(part, Quantity):
        return with_unit(format_number(part, units), part.kind, units)
    if isinstance(part, Bare):
        return format_number(part.quantity, units)
    if isinstance(part, Formula):
        return formulas.latex(part.name)
    return part if isinstance(part, str) else part.text


def plain_cell(cell: Cell, units: Units, *, shows_unit: bool = True) -> str:
    """Return a cell as text, without its note. `shows_unit`: whether to add the unit to numbers."""
    if isinstance(cell, TextCell):
        return plain(cell.text, units)
    if isinstance(cell, Formula):
        return plain_part(cell, units)
    digits = format_number(cell, units) if isinstance(cell, Quantity) else format_series(cell, units)
    return with_unit(digits, cell.kind, units) if shows_unit else digits


def _significant(value: float, digits: int, error: float | None = None) -> str:
    """Return a number with at most `digits` significant digits, and no digits after the place of the first
    significant digit of `error`."""
    exponent = _exponent(value, digits)
    decimals = digits - 1 - exponent if value else 0
    if error:
        decimals = min(decimals, -_exponent(error, 1)) if value else -_exponent(error, 1)
    rounded = round(value, decimals)
    if not rounded:
        return "0" if decimals <= 0 else f"{0:.{decimals}f}"
    return _scientific(rounded, f"{rounded:.{max(decimals, 0)}f}", max(exponent + decimals, 0))


def _exponent(value: float, digits: int) -> int:
    """Return the exponent of ten of a number that is rounded to `digits` significant digits; 0 for the number
    0."""
    return int(f"{value:.{digits - 1}e}".partition("e")[2]) if value else 0


def _scientific(value: float, decimal: str, decimals: int | None = None) -> str:
    """Return `decimal`, or the form "1.609·10⁻⁴" for a number below 10⁻³ or from 10⁶ on.

    - `value`: the number; `decimal`: the number in decimal form
    - `decimals`: decimals of the factor before the power of ten; None for five decimals without trailing
      zeros
    """
    if value == 0 or 1e-3 <= abs(value) < 1e6:
        return decimal
    mantissa, _, exponent = (f"{value:.5e}" if decimals is None else f"{value:.{decimals}e}").partition("e")
    if decimals is None:
        mantissa = mantissa.rstrip("0").rstrip(".")
    return f"{mantissa}·10{str(int(exponent)).translate(_SUPERSCRIPTS)}"


def _utilisation(value: float) -> str:
    """Return a utilisation with two decimals, or with more if a number other than 1 would be rounded to 1.
    From 1000 on, return four significant digits."""
    if abs(value) >= 1e3:
        return _significant(value, 4)
    decimals = 2
    while value != 1 and float(f"{value:.{decimals}f}") == 1 and decimals < 17:
        decimals += 1
    return f"{value:.{decimals}f}"


def _signed(digits: str) -> str:
    """Return digits with "−" as the sign of negative numbers and no sign for zero. Five or more digits before
    the decimal point are divided into groups of three."""
    negative, digits = digits.startswith("-"), digits.removeprefix("-")
    integer, point, decimals = digits.partition(".")
    if integer.isdecimal() and len(integer) > 4:
        integer = f"{int(integer):,}".replace(",", "\N{NARROW NO-BREAK SPACE}")
    sign = "−" if negative and digits.strip("0.") else ""
    return sign + integer + point + decimals


def _finite(value: Any, name: str) -> float:
    """Return a finite number as a float. Raises `ValueError` for other values."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise ValueError(f"Quantity: {name} must be a number, got {value!r}") from None
    if not math.isfinite(number):
        raise ValueError(
            f"Quantity: {name} must be finite, got {name} = {number}; use a TextCell for a missing number"
        )
    return number


def checked_text(text: Any, owner: str, *, may_be_empty: bool = False) -> Text:
    """Return a text after checking it.

    - `text`: the text; a list of parts becomes a tuple
    - `owner`: name of the text, for messages
    - `may_be_empty`: whether "" and () are valid

    Raises `ValueError` for a text with invalid parts, for a blank text, for a dash, and for the name of a
    missing number, such as "nan".
    """
    if isinstance(text, str):
        visible = text
    elif isinstance(text, tuple | list) and all(isinstance(part, _PARTS) for part in text):
        text = tuple(text)
        visible = "".join(
            part if isinstance(part, str) else getattr(part, "text", "quantity") for part in text
        )
    else:
        raise ValueError(f"{owner} must be a string or a tuple of parts, got {text!r}")
    if NO_VALUE.fullmatch(visible) and not (may_be_empty and not text):
        raise ValueError(f"{owner} must be text other than a blank, a dash, nan, inf or None; got {text!r}")
    return text


def _cell(cell: Any) -> Cell:
    """Return a cell; a text becomes a `TextCell`. Raises `ValueError` for a value of another type."""
    if isinstance(cell, str | tuple):
        return TextCell(cell)
    if not isinstance(cell, Quantity | Series | TextCell | Formula):
        raise ValueError(f"Table: a cell must be a Quantity, Series, TextCell, Formula or text, got {cell!r}")
    return cell
