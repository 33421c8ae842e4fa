"""Columns of text, and NumPy's .npy."""

from __future__ import annotations

import csv
import re
from decimal import Decimal
from pathlib import Path
from typing import NamedTuple

import numpy as np

from rockjax._motions.headings import Heading, parse_heading
from rockjax._units import UNITS, unit_of

from .base import (
    TIME_TOLERANCE,
    Component,
    Format,
    Samples,
    abbreviate,
    choose_channel,
    first_line,
    is_raw,
    parse_number,
    require_only_component,
    unit_key,
)

_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+(?:[ED][+-]?\d+)?", re.I)
_NUMBER_LIKE = re.compile(r"[+-]?[.,]?\d|[+-]?(?:nan|inf|infinity)$|\*", re.I)
_FLOAT32 = 1.2e-7  # relative spacing
_COARSE = 0.25  # rounding of times, as a share of a step, that is accepted without further checks …
_COARSEST = 2.0  # … and that is accepted for long records
_MAX_HEADINGS = 3  # lines


class _Table(NamedTuple):
    """A table of numbers.

    - `rows`: shape (rows, columns); `numbers`: the line of each row; `cells`: text of the rows
    - `headings`: of each column, if there are any; `line`: the line of the last of them
    - `raw_place`: the line that states that the data are raw
    """

    rows: np.ndarray
    numbers: list[int] | None = None
    cells: list[list[str]] | None = None
    headings: list[Heading] | None = None
    line: int = 0
    raw_place: str = ""


def _array(path: Path) -> np.ndarray:
    try:
        array = np.load(path, allow_pickle=False)
    except (ValueError, OSError, EOFError) as error:
        raise ValueError(f"{path}: is not a NumPy array of numbers: {first_line(error)}") from None
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiu" or array.ndim not in (1, 2):
        raise ValueError(f"{path}: is not a NumPy array of numbers in one column or two")
    return np.asarray(array, float).reshape(len(array), -1)


def _cells(text: str) -> list[str]:
    """Return the cells of a row of numbers; commas are decimal if another separator is used."""
    blanks = text.split()
    decimal = any(map(_DECIMAL_COMMA.fullmatch, blanks)) and not re.search(r",\s|\s,|\.", text)
    if ";" in text:
        cells = text.split(";")
    elif "," not in text or (len(blanks) > 1 and decimal):
        cells = blanks
    else:
        cells = text.split(",")
    return [cell.strip().strip('"') for cell in cells]


def _is_heading(cells: list[str]) -> bool:
    """Return whether a row names columns: no number first, or no first name, as pandas writes it."""
    if not cells[0]:
        return all(_NUMBER_LIKE.match(cell) is None or re.fullmatch(r"\d{1,3}", cell) for cell in cells[1:])
    return _NUMBER_LIKE.match(cells[0]) is None


def _heading_cells(text: str, count: int) -> list[str] | None:
    """Return a line of headings in `count` cells; None if it does not divide into them."""
    text = text.strip().lstrip("#%!").strip()
    if count == 1:
        return [text]
    tokens = re.findall(r"[^\s\[(]*(?:\[[^\]]*\]|\([^)]*\))|\S+", text)
    joined: list[str] = []
    for token in tokens:  # a unit belongs to the word before it
        if joined and token[0] in "[(/":
            joined[-1] += " " + token
        else:
            joined.append(token)
    comma_separated = next(csv.reader([text]), [])
    wide = re.split(r"\s{2,}", text)
    for cells in (text.split(";"), text.split("\t"), comma_separated, wide, joined, tokens):
        cells = [cell.strip() for cell in cells]
        if len(cells) == count + 1 and not cells[-1]:
            cells.pop()
        for k in range(len(cells) - 1, 0, -1):  # a unit belongs to the quantity before it
            if len(cells) > count and unit_of(cells[k]) and not unit_of(cells[k - 1]):
                cells[k - 1 : k + 1] = [f"{cells[k - 1]}, {cells[k]}"]
        if len(cells) == count:
            return cells
    return None


def _headings(path: Path, lines: list[tuple[int, str]], count: int) -> list[Heading]:
    """Return the meaning of each column, from one line of headings or several, such as names and units."""
    names = [""] * count
    for i, text in lines:
        cells = _heading_cells(text, count)
        if cells is None or len(lines) > _MAX_HEADINGS:
            raise ValueError(
                f"{path}:{i}: the heading {abbreviate(text.strip())} does not name {count} columns; give "
                "each a "
                "name and a unit, such as time [s],acceleration [g], begin other lines with #, and write "
                "decimal points, not commas"
            )
        names = [
            f"{a} [{b.strip('[]()')}]" if a and unit_of(b) else f"{a} {b}".strip()
            for a, b in zip(names, cells, strict=True)
        ]
    where = f"{path}:{lines[-1][0]}"
    return [parse_heading(where, name) for name in names]


def _headings_of_comment(path: Path, text: str, line: int, count: int) -> list[Heading] | None:
    """Return headings in the comment above the numbers, as NumPy writes them; None if it is another
    comment."""
    cells = _heading_cells(text, count)
    if cells is None or len(text.split()) > 4 * count:
        return None
    try:
        found = [parse_heading(f"{path}:{line}", cell) for cell in cells]
    except ValueError:
        return None
    named = all(each.kind for each in found) if count > 1 else found[0].unit is not None
    return found if named else None


def _table(path: Path, lines: list[str]) -> _Table:
    """Return the numbers of a table, with its headings."""
    rows: list[list[float]] = []
    numbers: list[int] = []
    texts: list[list[str]] = []
    headings: list[tuple[int, str]] = []
    comment: tuple[int, str] | None = None
    raw_place, marks = "", set()
    for i, line in enumerate(lines, start=1):
        text = line.strip()
        if not text or text[0] in "#%!":
            if text and not rows:
                comment = i, text
                raw_place = raw_place or (f"line {i}" if is_raw(text) else "")
            continue
        cells = _cells(text)
        while len(cells) > (len(rows[0]) if rows else 1) and not cells[-1]:
            cells.pop()  # empty cell after a separator at the end of the line
        if not rows and _is_heading(cells):
            headings.append((i, line))
            raw_place = raw_place or (f"line {i}" if is_raw(text) else "")
            continue
        if not any(cells):
            raise ValueError(f"{path}:{i}: holds no number")
        marks |= {mark for mark in ".," for cell in cells if mark in cell}
        if len(marks) == 2:
            raise ValueError(
                f"{path}:{i}: commas and points both stand within the numbers of the file; write decimal "
                "points, and nothing between thousands"
            )
        cells = [cell.replace(",", ".") if _DECIMAL_COMMA.fullmatch(cell) else cell for cell in cells]
        row = [parse_number(path, i, cell) for cell in cells]
        if rows and len(row) != len(rows[0]):
            raise ValueError(f"{path}:{i}: has {len(row)} columns where the lines before have {len(rows[0])}")
        rows.append(row)
        numbers.append(i)
        texts.append(cells)
    if not rows:
        raise ValueError(f"{path}: holds no numbers")
    found, count = None, len(rows[0])
    if headings:
        found = _headings(path, headings, count)
    elif comment:
        headings, found = [comment], _headings_of_comment(path, comment[1], comment[0], count)
    return _Table(np.array(rows), numbers, texts, found, headings[-1][0] if headings else 0, raw_place)


def _samples(path: Path, table: _Table, component: Component) -> Samples:
    """Return the acceleration in a table, and its interval if it has times."""
    rows, headings = table.rows, table.headings
    columns = range(rows.shape[1])
    kinds = [each.kind for each in headings] if headings else _guess_kinds(path, rows, component)
    where = f"{path}:{table.line}" if table.line else f"{path}"
    clock = next((k for k in columns if kinds[k] == "time"), None)
    chosen = [k for k in columns if kinds[k] in ("acceleration", "counts")]
    chosen = chosen or [k for k in columns if not kinds[k] or (kinds[k] == "index" and len(columns) == 1)]
    if headings and not chosen:
        listed = ", ".join(repr(each.text.strip()) for each in headings)
        raise ValueError(f"{where}: holds no acceleration; its headings are {listed}")
    if headings and clock is None and len(columns) > 1 and not kinds[0] and _is_rising(rows[:, 0]):
        raise ValueError(
            f"{where}: the heading {headings[0].text.strip()!r} is not known, and its column rises evenly; "
            "call it time [s] if it holds times"
        )
    names = [_direction(headings[k].quantity) if headings else f"column {k + 1}" for k in chosen]
    if headings and isinstance(component, str):  # also by the full heading
        component = next((n for n, k in enumerate(chosen, 1) if component == headings[k].quantity), component)
    n = choose_channel(path, list(enumerate(names, start=1)), component) if len(chosen) > 1 else 0
    own, metadata = chosen[n], {"format": "table"}
    if len(chosen) > 1 or (headings and component is not None):
        metadata["component"] = names[n]
    if len(chosen) == 1 and not (headings and component == 1):
        require_only_component(path, component, Samples(rows, None, None, metadata))
    heading = headings[own] if headings else None
    stated_unit = heading.unit if heading else None
    samples = Samples(
        rows[:, own], None, unit_key(stated_unit), metadata, stated_unit, raw_place=table.raw_place
    )
    if heading and stated_unit:
        samples.units_place = f"{where}: its heading {heading.text.strip()!r}"
        if unit_key(stated_unit) is None:
            raise ValueError(
                f"{samples.units_place} gives raw {stated_unit}, which must be converted to acceleration"
            )
    if clock is not None:
        factor = UNITS[headings[clock].unit or "s"].factor if headings else 1.0
        samples.dt = _interval(path, table, factor, clock)
        samples.dt_place = f"{path}: the times in it are {samples.dt:g} s apart" if samples.dt else ""
    elif len(columns) > 1:
        samples.dt_place = f"{where}: has no column of times" + (
            " (one that counts samples, or has no name, is none)" if "index" in kinds else ""
        )
    return samples


def _direction(quantity: str) -> str:
    """Return the direction in a heading such as Acc N-S, or the full heading."""
    return re.sub(r"^acc[a-z]*[\s_.:-]+", "", quantity, flags=re.I).strip("() ") or quantity


def _guess_kinds(path: Path, rows: np.ndarray, component: Component) -> list[str]:
    """Return the kinds of the columns of a table without headings: acceleration, preceded by times or a
    count."""
    count = rows.shape[1]
    if count == 1:
        return ["acceleration"]
    first = rows[:, 0]
    if count > 2 and component is None:
        raise ValueError(
            f"{path}: has {count} columns and no headings; one (acceleration) or two (time, acceleration) "
            "can be read, and of more the one that component gives (on the command line --component), 1 for "
            "the first beside the times"
        )
    counts = np.array_equal(first, first[0] + np.arange(len(first))) and first[0] in (0, 1) and len(first) > 2
    if counts:
        return ["index", *["acceleration"] * (count - 1)]
    return ["time" if count == 2 or _is_rising(first) else "acceleration", *["acceleration"] * (count - 1)]


def _is_rising(values: np.ndarray) -> bool:
    """Return whether a column rises in about equal steps, as times do."""
    steps = np.diff(values)
    return bool(len(steps) and steps.min() > 0 and steps.max() < 2 * steps.min())


def _rounding(times: list[str], values: np.ndarray) -> float:
    """Return one unit of the last digit of the times: of their decimals, or of their significant digits."""
    largest = float(np.abs(values).max())
    if not largest:
        return 0.0
    decimals = significant = 0
    for word in times:
        try:
            digits, exponent = Decimal(word.upper().replace("D", "E")).as_tuple()[1:]
        except ArithmeticError:  # an exponent without E
            continue
        assert isinstance(exponent, int)
        decimals = max(decimals, -exponent)
        significant = max(significant, len(digits) if any(digits) else 0)
    return max(10.0**-decimals, 10.0 ** (np.floor(np.log10(largest)) + 1 - significant))


def _interval(path: Path, table: _Table, factor: float, column: int) -> float | None:
    """Return the interval of times that are equally spaced within their rounding [s]; `factor` is their
    unit."""
    values = table.rows[:, column]
    count = len(values)
    if count < 2:
        return None
    step = (values[-1] - values[0]) / (count - 1)
    off = np.abs(values - values[0] - step * np.arange(count))
    rounding = _rounding([cells[column] for cells in table.cells], values) if table.cells else 0.0
    digit = max(rounding, _FLOAT32 * float(np.abs(values).max()))
    allowed = max(TIME_TOLERANCE * step, min(digit, _COARSE * step))
    if (
        digit <= _COARSEST * step
        and digit < TIME_TOLERANCE * (values[-1] - values[0])
        and np.diff(values).min() >= 0
    ):
        allowed = max(allowed, digit)
    if not step > 0 or off.max() > allowed:
        median_step = float(np.median(np.diff(values)))
        uneven = np.flatnonzero(~(np.abs(np.diff(values) - median_step) <= max(0.5 * median_step, 2 * digit)))
        k = int(uneven[0]) + 1 if len(uneven) else max(1, int(off.argmax()))
        where = f"{path}:{table.numbers[k]}" if table.numbers else f"{path}: row {k + 1}"
        missing = (values[k] - values[k - 1]) / median_step - 1 if median_step > 0 else 0.0
        gap = missing > 0.5 and abs(missing - round(missing)) < 0.1 and count > 3
        is_integer = table.rows[:, 0] == np.round(table.rows[:, 0])
        raise ValueError(
            f"{where}: times must rise in equal steps, got {factor * values[k - 1]:.9g} s and then "
            f"{factor * values[k]:.9g} s where the mean step is {factor * step:.6g} s; "
            + (f"{round(missing)} samples are missing (a gap)" if gap else "resample the record")
            + (
                "; or are its commas decimal?"
                if is_integer.all() and table.rows.shape[1] == 2 and not step > 0
                else ""
            )
        )
    return factor * _simplest_step(values, step, digit if table.cells else 0.0, factor)


def _simplest_step(values: np.ndarray, step: float, digit: float, factor: float) -> float:
    """Return the step whose inverse has the fewest digits among those that explain rounded times about as
    well as `step`; `step` itself if none does."""
    k, rate = np.arange(len(values)), 1 / (factor * step)
    allowed = min(digit, 1.2 * float(np.ptp(values - step * k))) + 1e-15 * float(np.abs(values).max())
    candidates = (1 / (factor * round(rate, digits)) for digits in range(5) if round(rate, digits) > 0)
    return next((each for each in candidates if np.ptp(values - each * k) <= allowed), float(step))


def read_array(path: Path, component: Component) -> Samples:
    return _samples(path, _Table(_array(path)), component)


def _read(path: Path, lines: list[str], component: Component) -> Samples:
    return _samples(path, _table(path, lines), component)


FORMAT = Format("table", lambda path, lines: True, _read)
