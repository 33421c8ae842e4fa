"""Common parts of the readers of file formats: types, and functions that parse numbers and choose channels.

An error in a file raises a `ValueError`. Its message is one line with the name of the file, the number of the
line if there is one, and the cause. Numbers of lines start from 1, indices of lines from 0.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from rockjax._motions.components import is_vertical, points_down
from rockjax._units import ACCELERATIONS, unit_of

TIME_TOLERANCE = 1e-3  # allowed error of times in a file, divided by the sampling interval [–]
NUMBER = r"[\d.]+(?:[ED][+-]?\d+)?"  # a number without a sign
DATE = re.compile(r"(?<!\d)(\d{1,4}[/-]\d{1,2}[/-]\d{1,4})(?!\d)")
# Numbers as Fortran writes them. Before an exponent of three digits, Fortran omits the E (1.0-101). There is
# no blank between two numbers that fill their columns. A third digit belongs to the exponent only if a sign,
# a blank or the end of the line follows; otherwise it begins the next number.
_MANTISSA = r"[+-]?(?:\d+\.?\d*|\.\d+)"
_EXPONENT = r"(?:[ED][+-]?(?:\d{3}(?=[\s+-]|$)|\d{1,2})|[+-]\d{3}(?![\d.]))"
_WITHOUT_E = re.compile(rf"({_MANTISSA})([+-]\d{{3}})", re.I)
_TOUCHING = re.compile(rf"\s*({_MANTISSA}{_EXPONENT}|{_MANTISSA}(?=[\s+-]|$))", re.I)
_MISSING = {"nan", "na", "n/a", "<na>", "nil", "none", "null", "-", "--", ""}  # words for missing values
_RAW = re.compile(r"(?<![a-z])(?:un-?corrected|un-?processed|raw|volume 1|not removed)(?![a-z])", re.I)
# A Fortran format, such as (8F10.4): number of columns, and width of a column in characters.
_FORTRAN = re.compile(r"\((\d{1,3})[FEI](\d{1,3})(?:\.\d+)?\)", re.I)
Component = int | str | None  # number or name of a channel; None selects the only channel of a file


@dataclasses.dataclass
class Samples:
    """Samples of one channel of a file, with the unit, sampling interval and header that the file states."""

    values: np.ndarray  # samples in the unit of the file, shape (n,)
    dt: float | None  # sampling interval [s]; None if the file does not state it
    units: str | None  # key in `ACCELERATIONS`; None if the file states no known unit of acceleration
    metadata: dict[str, Any]  # contents of the header
    stated_unit: str | None = None  # unit as written in the file, known or not; None if there is no unit
    dt_statement: str = ""  # for messages: location and value of `dt`, or the reason why it is None
    unit_location: str = ""  # location of the unit in the file; empty for the header
    # Location of the statement that the samples are uncorrected, such as "line 3"; empty if there is none.
    raw_location: str = ""


class Format(NamedTuple):
    """A format of text files."""

    name: str
    recognises: Callable[[Path, list[str]], bool]  # (path, lines) ↦ True if the file has this format
    # (path, lines, component) ↦ samples. Raises `ValueError` for errors in the file. For a format that is
    # recognised but not supported, it always raises.
    read: Callable[[Path, list[str], Component], Samples]


def require_only_component(path: Path, component: Component, samples: Samples) -> Samples:
    """Return the samples of a file with one channel. Raises `ValueError` if `component` is neither None nor
    the name of this channel."""
    component_name = samples.metadata.get("component")
    if component is not None and (
        component_name is None or not _names_component(component, str(component_name))
    ):
        hint = f"it is {component_name!r}" if component_name else "leave component out"
        raise ValueError(f"{path}: the file has one motion, not component {component!r}; {hint}")
    return samples


def _names_component(requested: int | str, name: str) -> bool:
    """Return True if a name means the requested component. Two names of vertical components agree if both
    point up or both point down."""
    if normalise_name(requested) == normalise_name(name):
        return True
    both_vertical = is_vertical(str(requested)) and is_vertical(name)
    return both_vertical and points_down(str(requested)) == points_down(name)


def is_raw(text: str) -> bool:
    """Return True if a text states that data are uncorrected."""
    return _RAW.search(text) is not None


def normalise_name(name: int | str) -> str:
    """Return the letters and digits of a name, in lower case. Zeros at the start of a number are removed,
    because spreadsheets write 90 for 090."""
    return re.sub(r"[^a-z0-9]|^0+(?=\d)", "", str(name).casefold())


def choose_channel(path: Path, channels: Sequence[tuple[int, str]], component: Component) -> int:
    """Return the index of the requested channel. Raises `ValueError` unless exactly one channel matches.

    - `channels`: (number, name) of each channel of the file
    - `component`: number or name of the requested channel. Instead of the name, its first word suffices. For
      a vertical channel, any name of the same direction is accepted. Text such as "1" is taken as a number if
      no name matches. None is valid only for a file with one channel
    """
    if component is None and len(channels) == 1:
        return 0
    matches = []
    if isinstance(component, str):
        matches = [
            k for k, (_, name) in enumerate(channels) if normalise_name(component) == normalise_name(name)
        ]
        matches = matches or [
            k
            for k, (_, name) in enumerate(channels)
            if name and normalise_name(component) == normalise_name(name.split()[0])
        ]
        matches = matches or [k for k, (_, name) in enumerate(channels) if _names_component(component, name)]
    if not matches and str(component).isdecimal():
        matches = [k for k, (number, _) in enumerate(channels) if number == int(component or 0)]
    if len(matches) != 1:
        channel_list = ", ".join(f"{number} ({name})" for number, name in channels)
        requested = "" if component is None else f", {len(matches) or 'none'} of them {component!r}"
        raise ValueError(
            f"{path}: the file has {len(channels)} channels{requested}: {channel_list}; choose one by number "
            f"or name, such as component {channels[0][0]} (on the command line --component)"
        )
    return matches[0]


def first_line(error: BaseException | str) -> str:
    """Return the first line of an error message, or the name of its class if the message is empty."""
    return (str(error).splitlines() or [type(error).__name__])[0]


def parse_number(path: Path, line: int, word: str) -> float:
    """Return the number that a word of a file represents. Exponents may be written as in Fortran (1D-3,
    1.0-101). Raises `ValueError` if it is not a finite number."""
    value = _parse(word)
    if value is None:
        raise ValueError(f"{path}:{line}: {abbreviate(word)} is not a number{_cause(word)}")
    if not np.isfinite(value):
        cause = " (a missing value)" if np.isnan(value) else ""
        raise ValueError(f"{path}:{line}: {abbreviate(word)} is not a finite number{cause}")
    return value


def _parse(word: str) -> float | None:
    """Return the number that a word represents, or None if it is not a number. A word with an underscore is
    not a number here, although Python's `float` accepts 1_000."""
    if match := _WITHOUT_E.fullmatch(word):
        word = f"{match[1]}E{match[2]}"
    try:
        return float(word.upper().replace("D", "E")) if "_" not in word else None
    except ValueError:
        return None


def _cause(word: str) -> str:
    """Return the end of a message about a word that is not a number: the probable reason or the cure. If
    neither is known, the result is empty."""
    if word.casefold() in _MISSING:
        return " (a missing value)"
    if set(word) == {"*"}:
        return " (it did not fit into its column when the file was written)"
    return (
        "; write the decimal comma as a point"
        if re.fullmatch(r"[+-]?\d*,\d+(?:E[+-]?\d+)?", word, re.I)
        else ""
    )


def abbreviate(word: str, length: int = 40) -> str:
    """Return a string in quotes, shortened to `length` characters."""
    return repr(word if len(word) <= length else word[: length - 3] + "...")


def parse_interval(path: Path, line: int, word: str, name: str) -> float:
    """Return a sampling interval of a file [s]. Raises `ValueError`, which calls it `name`, unless it is >
    0."""
    value = parse_number(path, line, word)
    if not value > 0:
        raise ValueError(f"{path}:{line}: {name} must be > 0 s, got {value:g}")
    return value


def unit_key(stated_unit: str | None) -> str | None:
    """Return the key in `ACCELERATIONS` for a unit as written in a file. If the unit is not a known unit of
    acceleration, return None."""
    key = unit_of(stated_unit)
    return key if key in ACCELERATIONS else None


def require_count(path: Path, line: int, name: str, count: int, values: list[float]) -> np.ndarray:
    """Return values as an array. Raises `ValueError` unless their number equals the `count` that a line of
    the file states as `name`."""
    if len(values) != count:
        cause = "; the file may be cut short" if len(values) < count else ""
        raise ValueError(f"{path}:{line}: {name} is {count}, but the file has {len(values)} values{cause}")
    return np.array(values)


def read_numbers(path: Path, lines: list[str], start: int) -> list[float]:
    """Return all numbers in the lines from the index `start` on. Blanks separate the numbers; in a line whose
    columns touch, there may be no blanks."""
    numbers: list[float] = []
    for i, line in enumerate(lines[start:], start=start + 1):
        row = line.split()
        if any(_parse(word) is None for word in row):
            row = _split_touching(line) or row
        numbers += [parse_number(path, i, word) for word in row]
    return numbers


def _split_touching(line: str) -> list[str] | None:
    """Return the words of a line whose columns touch; None if they cannot be separated. A word ends before a
    sign, and after an exponent. If that does not separate the words, all columns must have the same width,
    with the decimal point at the same position in each column."""
    line, position, words = line.rstrip(), 0, []
    while match := _TOUCHING.match(line, position):
        words.append(match[1])
        position = match.end()
    if position == len(line):
        return words
    points = [k for k, character in enumerate(line) if character == "."]
    width, remainder = divmod(len(line), max(1, len(points)))
    if remainder or len({k % width for k in points}) != 1:
        return None
    return [line[k : k + width] for k in range(0, len(line), width)]


def fixed_width(path: Path, lines: list[str], start: int, count: int, text: str) -> np.ndarray:
    """Return `count` numbers in columns of fixed width, which may touch. Raises `ValueError` for a wrong
    number of columns or values, and for a format without columns.

    - `start`: index of the first line with numbers. Messages about the format or the count name the line
      before it
    - `text`: text that contains the Fortran format, such as (8F10.4). If it contains none, the format is
      eight columns of 10 characters
    """
    match = _FORTRAN.search(text)
    per_line, width = (int(match[1]), int(match[2])) if match else (8, 10)
    if not (per_line and width):
        raise ValueError(
            f"{path}:{start}: {abbreviate(match[0] if match else '')} is not a format of numbers"
        )
    values: list[float] = []
    for i in range(start, min(start + -(-count // per_line), len(lines))):
        line = lines[i].rstrip()
        expected = min(per_line, count - len(values))
        row = [line[k : k + width].strip() for k in range(0, len(line), width)]
        words = line.split()
        if len(words) == expected and (len(row) != expected or None in map(_parse, row)):
            row = words  # an editor has removed or replaced blanks
        if len(row) != expected:
            raise ValueError(
                f"{path}:{i + 1}: the line must have {expected} columns of {width} characters, got {len(row)}"
            )
        values += [parse_number(path, i + 1, word) for word in row]
    return require_count(path, start, "the number of points", count, values)


def first_match(pattern: re.Pattern, lines: list[str], start: int, end: int) -> tuple[int, re.Match] | None:
    """Return index and match of the first line, among those with the indices `start` ≤ k < `end`, that
    matches a pattern; None if no line does."""
    return next(((k, match) for k in range(start, end) if (match := pattern.match(lines[k]))), None)


def filter_corners(band: re.Match | None) -> dict[str, float]:
    """Return the corner frequencies of the high-pass and low-pass filter [Hz], the two groups of `band`, as
    metadata. Unless both are numbers, the result is empty."""
    try:
        return {"high_pass_Hz": float(band[1]), "low_pass_Hz": float(band[2])} if band else {}
    except ValueError:
        return {}
