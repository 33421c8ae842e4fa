"""Tables of numbers: text with columns, and arrays of NumPy (.npy).

The times in a text are rounded to their last digit. The size of the last digit is 0.01 s for the times 0.00,
0.02, 0.04. `_interval` computes the sampling interval despite the rounding.
"""

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
_FLOAT32 = 1.2e-7  # relative spacing of float32
_MAX_ROUNDING = 0.25  # largest deviation of times that counts as rounding, divided by the mean step
# Largest size of the last digit of times in long records, divided by the mean step. The limit is higher than
# `_MAX_ROUNDING`, because the mean step of a long record is accurate despite the rounding.
_MAX_ROUNDING_LONG = 2.1
# If the step of coarsely rounded times differs from a multiple of the last digit by less than this fraction,
# the multiple is the step. Without this rule, a few missing rows would look like a slightly longer step.
_ROUND_STEP = 0.003
_MAX_HEADINGS = 3  # largest number of lines of headings


class _Table(NamedTuple):
    """A table of numbers."""

    rows: np.ndarray  # the numbers, shape (rows, columns)
    line_numbers: list[int] | None = None  # line number of each row; None for an array of NumPy
    cells: list[list[str]] | None = None  # cells of each row as text; None for an array of NumPy
    headings: list[Heading] | None = None  # heading of each column; None without headings
    heading_line: int = 0  # number of the last line of headings; 0 without headings
    raw_location: str = ""  # location of the statement that the data are not corrected; empty if none


def _load_array(path: Path) -> np.ndarray:
    """Return the array in a .npy file, with the axes (rows, columns)."""
    try:
        array = np.load(path, allow_pickle=False)
    except (ValueError, OSError, EOFError) as error:
        raise ValueError(f"{path}: the file is not a NumPy array of numbers: {first_line(error)}") from None
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiu" or array.ndim not in (1, 2):
        raise ValueError(f"{path}: the file is not a NumPy array of numbers with one or two axes")
    if not array.size:
        raise ValueError(f"{path}: the file contains no numbers")
    return np.asarray(array, float).reshape(len(array), -1)


def _split_cells(text: str) -> list[str]:
    """Return the cells of a row of numbers, separated by semicolons, blanks or commas. If semicolons or
    blanks separate the cells, commas in the numbers are decimal commas."""
    words = text.split()
    has_decimal_commas = any(map(_DECIMAL_COMMA.fullmatch, words)) and not re.search(r",\s|\s,|\.", text)
    if ";" in text:
        cells = text.split(";")
    elif "," not in text or (len(words) > 1 and has_decimal_commas):
        cells = words
    else:
        cells = next(csv.reader([text]))
    return [cell.strip().strip('"') for cell in cells]


def _is_heading(cells: list[str]) -> bool:
    """Return True for a row of headings, which is a row whose first cell is not a number. The first cell of
    the headings may be empty, as in files that pandas writes. Then the other cells must be names or column
    numbers."""
    if not cells[0]:
        return all(_NUMBER_LIKE.match(cell) is None or re.fullmatch(r"\d{1,3}", cell) for cell in cells[1:])
    return _NUMBER_LIKE.match(cells[0]) is None


def split_headings(text: str, count: int) -> list[str] | None:
    """Split a line of headings into `count` cells; None if no separator gives this number of cells."""
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
    space_separated = re.split(r"\s{2,}", text)
    units = tokens if all(token[0] in "[(" for token in tokens) else joined
    for cells in (text.split(";"), text.split("\t"), comma_separated, space_separated, joined, units):
        cells = [cell.strip() for cell in cells]
        if len(cells) == count + 1 and not cells[-1]:
            cells.pop()
        for k in range(len(cells) - 1, 0, -1):  # a unit belongs to the quantity before it
            if len(cells) > count and unit_of(cells[k]) and not unit_of(cells[k - 1]):
                cells[k - 1 : k + 1] = [f"{cells[k - 1]}, {cells[k]}"]
        if len(cells) == count:
            return cells
    return None


def _parse_headings(path: Path, lines: list[tuple[int, str]], count: int) -> list[Heading]:
    """Return the heading of each column. The headings may extend over several lines, such as a line of names
    and a line of units."""
    names = [""] * count
    for i, text in lines:
        cells = split_headings(text, count)
        if cells is None or len(lines) > _MAX_HEADINGS:
            raise ValueError(
                f"{path}:{i}: the heading {abbreviate(text.strip())} does not name {count} columns; give "
                "each column a name and a unit, such as time [s],acceleration [g]; begin comments with #, "
                "and write decimal points, not commas"
            )
        names = [
            f"{a} [{b.strip('[]()')}]" if a and unit_of(b) else f"{a} {b}".strip()
            for a, b in zip(names, cells, strict=True)
        ]
    location = f"{path}:{lines[-1][0]}"
    return [parse_heading(location, name) for name in names]


def _headings_of_comment(path: Path, text: str, line: int, count: int) -> list[Heading] | None:
    """Return the headings in a comment, or None if it contains none. `numpy.savetxt` writes headings in the
    last comment above the numbers."""
    cells = split_headings(text, count)
    if cells is None or len(text.split()) > 4 * count:
        return None
    try:
        headings = [parse_heading(f"{path}:{line}", cell) for cell in cells]
    except ValueError:
        return None
    is_understood = all(heading.kind for heading in headings) if count > 1 else headings[0].unit is not None
    return headings if is_understood else None


def _parse_table(path: Path, lines: list[str]) -> _Table:
    """Parse a table of numbers with its headings. Raises a `ValueError` that names the file and the line."""
    rows: list[list[float]] = []
    line_numbers: list[int] = []
    cells_of_rows: list[list[str]] = []
    heading_lines: list[tuple[int, str]] = []
    comment: tuple[int, str] | None = None
    raw_location, decimal_marks = "", set()
    for i, line in enumerate(lines, start=1):
        text = line.strip()
        if not text or text[0] in "#%!":
            if text and not rows:
                comment = i, text
                raw_location = raw_location or (f"line {i}" if is_raw(text) else "")
            continue
        cells = _split_cells(text)
        while len(cells) > (len(rows[0]) if rows else 1) and not cells[-1]:
            cells.pop()  # empty cell after a separator at the end of the line
        if not rows and _is_heading(cells):
            heading_lines.append((i, line))
            raw_location = raw_location or (f"line {i}" if is_raw(text) else "")
            continue
        if not any(cells):
            raise ValueError(f"{path}:{i}: the line contains no number")
        decimal_marks |= {mark for mark in ".," for cell in cells if mark in cell}
        if len(decimal_marks) == 2:
            raise ValueError(
                f"{path}:{i}: numbers of the file contain both commas and points; write decimal points, and "
                "nothing between thousands"
            )
        cells = [cell.replace(",", ".") if _DECIMAL_COMMA.fullmatch(cell) else cell for cell in cells]
        row = [parse_number(path, i, cell) for cell in cells]
        if rows and len(row) != len(rows[0]):
            raise ValueError(
                f"{path}:{i}: the line has {len(row)} columns, but the lines before have {len(rows[0])}"
            )
        rows.append(row)
        line_numbers.append(i)
        cells_of_rows.append(cells)
    if not rows:
        raise ValueError(f"{path}: the file contains no numbers")
    headings, count = None, len(rows[0])
    if heading_lines:
        headings = _parse_headings(path, heading_lines, count)
    elif comment:
        heading_lines, headings = [comment], _headings_of_comment(path, comment[1], comment[0], count)
    heading_line = heading_lines[-1][0] if heading_lines else 0
    return _Table(np.array(rows), line_numbers, cells_of_rows, headings, heading_line, raw_location)


def _choose_samples(path: Path, table: _Table, component: Component) -> Samples:
    """Return the samples of the requested component in a table. They include the sampling interval if the
    table has a column of times."""
    rows, headings = table.rows, table.headings
    columns = range(rows.shape[1])
    headings = headings and [_as_channel(heading, rows[:, k]) for k, heading in enumerate(headings)]
    kinds = [heading.kind for heading in headings] if headings else _guess_kinds(path, rows, component)
    location = f"{path}:{table.heading_line}" if table.heading_line else f"{path}"
    time_column = next((k for k in columns if kinds[k] == "time"), None)
    candidates = [k for k in columns if kinds[k] in ("acceleration", "counts")]
    # If no column is an acceleration, the candidates are the columns of unknown kind. A table with a single
    # column has a candidate even if the heading is that of sample numbers.
    candidates = candidates or [
        k for k in columns if not kinds[k] or (kinds[k] == "index" and len(columns) == 1)
    ]
    if headings and not candidates:
        texts = ", ".join(repr(heading.text.strip()) for heading in headings)
        raise ValueError(f"{location}: none of the headings names an acceleration; the headings are {texts}")
    if headings and time_column is None and len(columns) > 1 and not kinds[0] and _is_rising(rows[:, 0]):
        raise ValueError(
            f"{location}: the heading {headings[0].text.strip()!r} is unknown, and its column rises evenly; "
            "name it time [s] if it contains times"
        )
    names = [_direction(headings[k].quantity) if headings else f"column {k + 1}" for k in candidates]
    if headings and isinstance(component, str):  # the user may pass the heading without its unit
        full_names = [headings[k].quantity for k in candidates]
        component = next((n for n, name in enumerate(full_names, 1) if component == name), component)
    n = choose_channel(path, list(enumerate(names, start=1)), component) if len(candidates) > 1 else 0
    chosen, metadata = candidates[n], {"format": "table"}
    if len(candidates) > 1 or (headings and component is not None):
        metadata["component"] = names[n]
    if len(candidates) == 1 and not (headings and component in (1, "1")):
        require_only_component(path, component, Samples(rows, None, None, metadata))
    heading = headings[chosen] if headings else None
    stated_unit = heading.unit if heading else None
    samples = Samples(
        rows[:, chosen], None, unit_key(stated_unit), metadata, stated_unit, raw_location=table.raw_location
    )
    if heading and stated_unit:
        samples.unit_location = f"{location}: the heading {heading.text.strip()!r}"
        if unit_key(stated_unit) is None:
            raise ValueError(
                f"{samples.unit_location} gives raw {stated_unit}, which must be converted to acceleration"
            )
    if time_column is not None:
        factor = UNITS[headings[time_column].unit or "s"].factor if headings else 1.0
        samples.dt = _interval(path, table, factor, time_column)
        samples.dt_statement = f"{path}: the times in it are {samples.dt:g} s apart" if samples.dt else ""
    elif len(columns) > 1:
        samples.dt_statement = f"{location}: the table has no column of times" + (
            " (a column without name, or of sample numbers, does not count)" if "index" in kinds else ""
        )
    return samples


def _as_channel(heading: Heading, values: np.ndarray) -> Heading:
    """Return the heading of a column. N, U and 1 become names of channels (north, up, first channel), unless
    the column rises evenly, as sample numbers and times do. Other headings are returned unchanged."""
    name = heading.text.strip("\"' ")
    if name not in ("N", "U", "1") or _is_rising(values):
        return heading
    return heading._replace(quantity=name, kind="", unit=None)


def _direction(quantity: str) -> str:
    """Return the direction in a heading such as Acc N-S. If there is no direction, return the heading."""
    return re.sub(r"^acc[a-z]*[\s_.:-]+", "", quantity, flags=re.I).strip("() ") or quantity


def _guess_kinds(path: Path, rows: np.ndarray, component: Component) -> list[str]:
    """Return the kinds of the columns of a table without headings: accelerations, except that the first of
    two columns contains sample numbers or times, and the first of more columns sample numbers, times or an
    acceleration. Raises `ValueError` for more than two columns if no component is requested."""
    count = rows.shape[1]
    if count == 1:
        return ["acceleration"]
    first = rows[:, 0]
    if count > 2 and component is None:
        raise ValueError(
            f"{path}: the table has {count} columns and no headings; give component (on the command line "
            "--component): 1 for the first column of acceleration; a first column of times is not numbered"
        )
    is_index = (
        np.array_equal(first, first[0] + np.arange(len(first))) and first[0] in (0, 1) and len(first) > 2
    )
    if is_index:
        return ["index", *["acceleration"] * (count - 1)]
    return ["time" if count == 2 or _is_rising(first) else "acceleration", *["acceleration"] * (count - 1)]


def _is_rising(values: np.ndarray) -> bool:
    """Return True if values rise like times: the largest step is shorter than twice the smallest step."""
    steps = np.diff(values)
    return bool(len(steps) and steps.min() > 0 and steps.max() < 2 * steps.min())


def _last_digit(times: list[str], values: np.ndarray) -> float:
    """Return the size of the last digit of times in their unit, such as 0.01; 0 if all times are 0. All times
    are assumed to have the same number of decimals, or the same number of significant digits."""
    largest = float(np.abs(values).max())
    if not largest:
        return 0.0
    decimals = significant = 0
    for word in times:
        try:
            digits, exponent = Decimal(word.upper().replace("D", "E")).as_tuple()[1:]
        except ArithmeticError:  # a Fortran exponent without E
            continue
        assert isinstance(exponent, int)
        decimals = max(decimals, -exponent)
        significant = max(significant, len(digits) if any(digits) else 0)
    return max(10.0**-decimals, 10.0 ** (np.floor(np.log10(largest)) + 1 - significant))


def _interval(path: Path, table: _Table, factor: float, column: int) -> float | None:
    """Return the sampling interval of a column of times [s]; None if there is only one time. `factor` is the
    size of the unit of the times [s]. Raises `ValueError` unless the times are equally spaced within their
    rounding."""
    values = table.rows[:, column]
    count = len(values)
    if count < 2:
        return None
    indices, steps, step = np.arange(count), np.diff(values), (values[-1] - values[0]) / (count - 1)
    deviations = np.abs(values - values[0] - step * indices)
    rounding = _last_digit([cells[column] for cells in table.cells], values) if table.cells else 0.0
    digit = max(rounding, _FLOAT32 * float(np.abs(values).max()))
    is_coarse = (
        _MAX_ROUNDING * step < digit <= _MAX_ROUNDING_LONG * step
        and digit < TIME_TOLERANCE * (values[-1] - values[0])
        and steps.min() >= 0
    )
    # If the rounding is coarse, the step is the slope of a line fitted to all times. Rounding then changes
    # the distance between successive times by less than the last digit.
    if is_coarse:
        step = float(np.polyfit(indices, values, 1)[0])
        multiple = digit * round(step / digit)
        is_multiple = abs(multiple / step - 1) < _ROUND_STEP
        step = _simplest_step(values, multiple if is_multiple else step, digit, factor)
        deviations = np.abs(np.diff(values, prepend=values[0] - step) - step)
        is_even = deviations.max() < (1 - 1e-6) * digit and np.ptp(values - step * indices) < 1.2 * digit
    else:
        is_even = step > 0 and deviations.max() <= max(
            TIME_TOLERANCE * step, min(1.001 * digit, _MAX_ROUNDING * step)
        )
    if not is_even:
        median_step = float(np.median(steps))
        uneven = np.flatnonzero(~(np.abs(steps - median_step) <= max(0.5 * median_step, 2 * digit)))
        first = int(np.argmax(deviations > 0.999 * deviations.max()))
        k = int(uneven[0]) + 1 if len(uneven) else max(1, first)
        location = f"{path}:{table.line_numbers[k]}" if table.line_numbers else f"{path}: row {k + 1}"
        missing = (values[k] - values[k - 1]) / median_step - 1 if median_step > 0 else 0.0
        is_gap = missing > 0.5 and abs(missing - round(missing)) < 0.1 and count > 3
        is_integer = table.rows[:, 0] == np.round(table.rows[:, 0])
        cure = "write them with more digits, or " if digit > _MAX_ROUNDING * step > 0 else ""
        has_decimal_commas = is_integer.all() and table.rows.shape[1] == 2 and not step > 0
        raise ValueError(
            f"{location}: times must rise in equal steps, got {factor * values[k - 1]:.9g} s and then "
            f"{factor * values[k]:.9g} s, but the mean step is {factor * step:.6g} s; "
            + (f"{round(missing)} samples are missing (a gap)" if is_gap else f"{cure}resample the record")
            + ("; or write decimal points if the commas are decimal" if has_decimal_commas else "")
        )
    return factor * (
        step if is_coarse else _simplest_step(values, step, digit if table.cells else 0.0, factor)
    )


def _simplest_step(values: np.ndarray, step: float, digit: float, factor: float) -> float:
    """Return the step of rounded times for which the sampling rate [Hz] has the fewest decimals; the mean
    `step` if no rate with at most four decimals fits the times almost as well. `digit` is the size of the
    last digit of the times, `factor` the size of their unit [s]."""
    k, rate = np.arange(len(values)), 1 / (factor * step)
    allowed = min(digit, 1.2 * float(np.ptp(values - step * k))) + 1e-15 * float(np.abs(values).max())
    candidates = (1 / (factor * round(rate, digits)) for digits in range(5) if round(rate, digits) > 0)
    return next(
        (candidate for candidate in candidates if np.ptp(values - candidate * k) <= allowed), float(step)
    )


def read_array(path: Path, component: Component) -> Samples:
    """Return the samples of the requested component in a .npy file, without a unit."""
    return _choose_samples(path, _Table(_load_array(path)), component)


def _read(path: Path, lines: list[str], component: Component) -> Samples:
    return _choose_samples(path, _parse_table(path, lines), component)


FORMAT = Format("table", lambda path, lines: True, _read)
