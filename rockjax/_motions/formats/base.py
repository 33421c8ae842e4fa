"""What the readers of all formats share: samples as they come out of a file, and numbers with the line they
stand in.

Whatever is wrong with a file is a `ValueError` of one line that names the file, the line where there is one,
and the cause.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from rockjax._structures import STANDARD_GRAVITY

UNITS = {"g": STANDARD_GRAVITY, "m/s2": 1.0, "cm/s2": 1e-2, "gal": 1e-2, "mm/s2": 1e-3}
EVEN = 1e-3  # times in files are rounded: so much of a step may they be off
NUMBER = r"[\d.]+(?:[ED][+-]?\d+)?"
DATE = re.compile(r"(?<!\d)(\d{1,4}[/-]\d{1,2}[/-]\d{1,4})(?!\d)")
_FORTRAN = re.compile(r"\((\d{1,3})[FEI](\d{1,3})(?:\.\d+)?\)", re.I)
Component = int | str | None


@dataclasses.dataclass
class Samples:
    """What a file holds, in its own units: `units` is None and `dt` is None where it does not say them."""

    values: np.ndarray
    dt: float | None
    units: str | None
    metadata: dict[str, Any]
    said: str | None = None  # the unit in the words of the file
    says_dt: str = ""  # where the file says dt, and in what words


class Format(NamedTuple):
    """A format of text files.

    - `name`: in words; `recognises`: whether a file, of a path and these lines, is of it
    - `read`: the samples of a channel, where there are several; raises where the file is wrong, or the format
      is not read
    """

    name: str
    recognises: Callable[[Path, list[str]], bool]
    read: Callable[[Path, list[str], Component], Samples]


def alone(path: Path, component: Component, samples: Samples) -> Samples:
    own = samples.metadata.get("component")
    if component is not None and (own is None or plain(component) != plain(own)):
        known = f"it is {own!r}" if own else "leave component out"
        raise ValueError(f"{path}: holds one motion, not component {component!r}; {known}")
    return samples


def plain(name: int | str) -> str:
    return re.sub(r"[^a-z0-9]", "", str(name).casefold())


def choose(path: Path, channels: Sequence[tuple[int, str]], component: Component) -> int:
    """Which of several channels, (number, name), is meant."""
    if component is None and len(channels) == 1:
        return 0
    if isinstance(component, int):
        found = [k for k, (number, _) in enumerate(channels) if number == component]
    elif component is not None:
        found = [k for k, (_, name) in enumerate(channels) if plain(component) == plain(name)]
        found = found or [
            k for k, (_, name) in enumerate(channels) if name and plain(component) == plain(name.split()[0])
        ]
    else:
        found = []
    if len(found) != 1:
        listed = ", ".join(f"{number} ({name})" for number, name in channels)
        asked = "" if component is None else f", {len(found) or 'none'} of them {component!r}"
        raise ValueError(
            f"{path}: holds {len(channels)} channels{asked}: {listed}; choose one by its number or name, "
            f"such as "
            f"component {channels[0][0]} (on the command line --component)"
        )
    return found[0]


def first_line(error: BaseException) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]


def number(path: Path, line: int, word: str) -> float:
    """A number of a file; Fortran's exponent D is one as well, Python's underscore is none."""
    try:
        value = float(word.upper().replace("D", "E")) if "_" not in word else None
    except ValueError:
        value = None
    if value is None:
        raise ValueError(f"{path}:{line}: {short(word)} is not a number")
    if not np.isfinite(value):
        raise ValueError(f"{path}:{line}: {short(word)} is not a finite number")
    return value


def short(word: str) -> str:
    return repr(word if len(word) <= 40 else word[:37] + "...")


def interval(path: Path, line: int, word: str, name: str) -> float:
    value = number(path, line, word)
    if not value > 0:
        raise ValueError(f"{path}:{line}: {name} must be > 0 s, got {value:g}")
    return value


def unit(said: str | None) -> str | None:
    """The unit that a header means, where it is one of ours."""
    words = re.sub(r"[\s^*.]", "", said or "").lower().replace("sec", "s").replace("/s/s", "/s2")
    return words if words in UNITS else None


def counted(path: Path, line: int, name: str, count: int, values: list[float]) -> np.ndarray:
    if len(values) != count:
        cause = "is it cut short?" if len(values) < count else "what are the others?"
        raise ValueError(f"{path}:{line}: {name} is {count}, but {len(values)} values follow: {cause}")
    return np.array(values)


def words(path: Path, lines: list[str], start: int) -> list[float]:
    """All numbers from the line with the index `start` on."""
    return [
        number(path, i, word)
        for i, line in enumerate(lines[start:], start=start + 1)
        for word in line.split()
    ]


def fixed_width(path: Path, lines: list[str], start: int, count: int, text: str) -> np.ndarray:
    """`count` numbers in columns of fixed width, which may touch one another, below the line that tells the
    format."""
    found = _FORTRAN.search(text)
    per_line, width = (int(found[1]), int(found[2])) if found else (8, 10)
    if not (per_line and width):
        raise ValueError(f"{path}:{start}: {short(found[0] if found else '')} is not a format of numbers")
    values: list[float] = []
    for i in range(start, min(start + -(-count // per_line), len(lines))):
        line = lines[i].rstrip()
        due = min(per_line, count - len(values))
        row = [line[k : k + width].strip() for k in range(0, len(line), width)]
        if len(row) != due:
            raise ValueError(
                f"{path}:{i + 1}: holds {len(row)} columns of {width} characters where {due} are due"
            )
        values += [number(path, i + 1, word) for word in row]
    return counted(path, start, "the number of points", count, values)


def first_match(pattern: re.Pattern, lines: list[str], start: int, end: int) -> tuple[int, re.Match] | None:
    return next(((k, match) for k in range(start, end) if (match := pattern.match(lines[k]))), None)


def corners(band: re.Match | None) -> dict[str, float]:
    """Corner frequencies of the filters [Hz], where both are numbers."""
    try:
        return {"high_pass_Hz": float(band[1]), "low_pass_Hz": float(band[2])} if band else {}
    except ValueError:
        return {}
