"""Shared parts of the readers: samples in the units of a file, and numbers with their line.

Any fault of a file raises a one-line `ValueError` that names the file, the line if there is one, and the
cause.
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

TIME_TOLERANCE = 1e-3  # share of a step by which the rounded times of a file may be off
NUMBER = r"[\d.]+(?:[ED][+-]?\d+)?"
DATE = re.compile(r"(?<!\d)(\d{1,4}[/-]\d{1,2}[/-]\d{1,4})(?!\d)")
# Fortran omits the E in exponents of three digits, and fills columns so that numbers touch. An exponent
# of three digits ends where a sign or a blank follows.
_MANTISSA = r"[+-]?(?:\d+\.?\d*|\.\d+)"
_EXPONENT = r"(?:[ED][+-]?(?:\d{3}(?=[\s+-]|$)|\d{1,2})|[+-]\d{3}(?![\d.]))"
_WITHOUT_E = re.compile(rf"({_MANTISSA})([+-]\d{{3}})", re.I)
_TOUCHING = re.compile(rf"\s*({_MANTISSA}{_EXPONENT}|{_MANTISSA}(?=[\s+-]|$))", re.I)
_GAPS = {"nan", "na", "n/a", "<na>", "nil", "none", "null", "-", "--", ""}
_RAW = re.compile(r"(?<![a-z])(?:un-?corrected|un-?processed|raw|volume 1|not removed)(?![a-z])", re.I)
_FORTRAN = re.compile(r"\((\d{1,3})[FEI](\d{1,3})(?:\.\d+)?\)", re.I)
Component = int | str | None


@dataclasses.dataclass
class Samples:
    """Samples of a file in its own units; `units` and `dt` are None where the file does not state them."""

    values: np.ndarray
    dt: float | None
    units: str | None
    metadata: dict[str, Any]
    stated_unit: str | None = None  # text of the unit in the file
    dt_place: str = ""  # place and text of dt in the file; without dt, the reason why there is none
    units_place: str = ""  # place of the unit in the file, its header by default
    raw_place: str = ""  # place of the statement that the samples are raw, such as line 3


class Format(NamedTuple):
    """A format of text files.

    - `name`: name for messages; `recognises`: whether a file, given its path and lines, has this format
    - `read`: return the samples of a channel; raises if the file is wrong, or the format is not supported
    """

    name: str
    recognises: Callable[[Path, list[str]], bool]
    read: Callable[[Path, list[str], Component], Samples]


def require_only_component(path: Path, component: Component, samples: Samples) -> Samples:
    component_name = samples.metadata.get("component")
    if component is not None and (
        component_name is None or not _names_component(component, str(component_name))
    ):
        hint = f"it is {component_name!r}" if component_name else "leave component out"
        raise ValueError(f"{path}: holds one motion, not component {component!r}; {hint}")
    return samples


def _names_component(requested: int | str, name: str) -> bool:
    """Return whether a name means a component; a vertical one may have any of its usual names."""
    if normalise_name(requested) == normalise_name(name):
        return True
    both_vertical = is_vertical(str(requested)) and is_vertical(name)
    return both_vertical and points_down(str(requested)) == points_down(name)


def is_raw(text: str) -> bool:
    """Return whether a header marks the data as uncorrected."""
    return _RAW.search(text) is not None


def normalise_name(name: int | str) -> str:
    return re.sub(r"[^a-z0-9]", "", str(name).casefold())


def choose_channel(path: Path, channels: Sequence[tuple[int, str]], component: Component) -> int:
    """Choose one of several channels (number, name) by the requested component."""
    if component is None and len(channels) == 1:
        return 0
    if isinstance(component, int):
        found = [k for k, (number, _) in enumerate(channels) if number == component]
    elif component is not None:
        found = [
            k for k, (_, name) in enumerate(channels) if normalise_name(component) == normalise_name(name)
        ]
        found = found or [
            k
            for k, (_, name) in enumerate(channels)
            if name and normalise_name(component) == normalise_name(name.split()[0])
        ]
        found = found or [k for k, (_, name) in enumerate(channels) if _names_component(component, name)]
    else:
        found = []
    if len(found) != 1:
        channel_list = ", ".join(f"{number} ({name})" for number, name in channels)
        requested = "" if component is None else f", {len(found) or 'none'} of them {component!r}"
        raise ValueError(
            f"{path}: holds {len(channels)} channels{requested}: {channel_list}; choose one by its number "
            "or name, "
            f"such as "
            f"component {channels[0][0]} (on the command line --component)"
        )
    return found[0]


def first_line(error: BaseException | str) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]


def parse_number(path: Path, line: int, word: str) -> float:
    """Return a number of a file; Fortran's exponents (1D-3, 1.0-101) are accepted, Python's underscores are
    not."""
    value = _value(word)
    if value is None:
        raise ValueError(f"{path}:{line}: {abbreviate(word)} is not a number{_cause(word)}")
    if not np.isfinite(value):
        gap = ": a gap" if np.isnan(value) else ""
        raise ValueError(f"{path}:{line}: {abbreviate(word)} is not a finite number{gap}")
    return value


def _value(word: str) -> float | None:
    if without := _WITHOUT_E.fullmatch(word):
        word = f"{without[1]}E{without[2]}"
    try:
        return float(word.upper().replace("D", "E")) if "_" not in word else None
    except ValueError:
        return None


def _cause(word: str) -> str:
    """Describe what is wrong with a word in the place of a number."""
    if word.casefold() in _GAPS:
        return ": a gap"
    if set(word) == {"*"}:
        return ": it did not fit into its column when the file was written"
    return (
        "; write the decimal comma as a point"
        if re.fullmatch(r"[+-]?\d*,\d+(?:E[+-]?\d+)?", word, re.I)
        else ""
    )


def abbreviate(word: str) -> str:
    return repr(word if len(word) <= 40 else word[:37] + "...")


def parse_interval(path: Path, line: int, word: str, name: str) -> float:
    """Return a sampling interval of a file [s]. Raises `ValueError` unless it is > 0.

    - `path`, `line`: place in the file, for messages; `word`: text of the number; `name`: name of the number,
      for messages
    """
    value = parse_number(path, line, word)
    if not value > 0:
        raise ValueError(f"{path}:{line}: {name} must be > 0 s, got {value:g}")
    return value


def unit_key(stated_unit: str | None) -> str | None:
    """Return the key of the unit that a header gives, if it is a known one."""
    found = unit_of(stated_unit)
    return found if found in ACCELERATIONS else None


def require_count(path: Path, line: int, name: str, count: int, values: list[float]) -> np.ndarray:
    """Return values as an array. Raises `ValueError` unless their number is the `count` of the header.

    - `path`, `line`: place of the count in the file; `name`: name of the count, for messages
    - `count`: expected number; `values`: the values
    """
    if len(values) != count:
        cause = "is it cut short?" if len(values) < count else "what are the others?"
        raise ValueError(f"{path}:{line}: {name} is {count}, but {len(values)} values follow: {cause}")
    return np.array(values)


def read_numbers(path: Path, lines: list[str], start: int) -> list[float]:
    """Return all numbers from the line with index `start` on, in columns that are separated by blanks or that
    touch."""
    found: list[float] = []
    for i, line in enumerate(lines[start:], start=start + 1):
        row = line.split()
        if any(_value(word) is None for word in row):
            row = _split_touching(line) or row
        found += [parse_number(path, i, word) for word in row]
    return found


def _split_touching(line: str) -> list[str] | None:
    """Split a line whose columns touch: by signs and exponents, or else in columns of one width with aligned
    points.

    None if neither applies.
    """
    line, at, found = line.rstrip(), 0, []
    while match := _TOUCHING.match(line, at):
        found.append(match[1])
        at = match.end()
    if at == len(line):
        return found
    points = [k for k, character in enumerate(line) if character == "."]
    width, remainder = divmod(len(line), max(1, len(points)))
    if remainder or len({k % width for k in points}) != 1:
        return None
    return [line[k : k + width] for k in range(0, len(line), width)]


def fixed_width(path: Path, lines: list[str], start: int, count: int, text: str) -> np.ndarray:
    """Return numbers in columns of fixed width, which may touch.

    - `path`, `lines`: of the file
    - `start`: index of the first line with numbers, below the line that gives the format
    - `count`: how many numbers to read
    - `text`: contains the Fortran format, such as 8F10.4, which is the default

    Raises `ValueError` for a wrong number of columns or values.
    """
    found = _FORTRAN.search(text)
    per_line, width = (int(found[1]), int(found[2])) if found else (8, 10)
    if not (per_line and width):
        raise ValueError(
            f"{path}:{start}: {abbreviate(found[0] if found else '')} is not a format of numbers"
        )
    values: list[float] = []
    for i in range(start, min(start + -(-count // per_line), len(lines))):
        line = lines[i].rstrip()
        expected = min(per_line, count - len(values))
        row = [line[k : k + width].strip() for k in range(0, len(line), width)]
        if len(row) != expected:
            raise ValueError(
                f"{path}:{i + 1}: holds {len(row)} columns of {width} characters where {expected} are due"
            )
        values += [parse_number(path, i + 1, word) for word in row]
    return require_count(path, start, "the number of points", count, values)


def first_match(pattern: re.Pattern, lines: list[str], start: int, end: int) -> tuple[int, re.Match] | None:
    """Return index and match of the first line that matches a pattern, or None.

    - `pattern`: compiled pattern; `lines`: of the file; `start`, `end`: range of indices of the lines to
      search
    """
    return next(((k, match) for k in range(start, end) if (match := pattern.match(lines[k]))), None)


def filter_corners(band: re.Match | None) -> dict[str, float]:
    """Return the corner frequencies of the filters [Hz], if both are numbers."""
    try:
        return {"high_pass_Hz": float(band[1]), "low_pass_Hz": float(band[2])} if band else {}
    except ValueError:
        return {}
