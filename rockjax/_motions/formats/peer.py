"""PEER format (.AT2)."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from rockjax._units import UNITS, unit_of

from .base import (
    DATE,
    NUMBER,
    Component,
    Format,
    Samples,
    abbreviate,
    is_raw,
    parse_interval,
    read_numbers,
    require_count,
    require_only_component,
    unit_key,
)

_DT = rf"(?:\d*,(?=\d))?{NUMBER}"  # a decimal comma is matched, so that it is refused
_AT2_COUNT = (
    re.compile(r"NPTS\s*=?\s*(\d{1,9})(?!\d)", re.I),
    re.compile(rf"DT\s*=?\s*({_DT})\s*([a-z]*)", re.I),
)
_AT2_PLAIN = re.compile(rf"^\s*(\d{{1,9}})\s+({_DT})\s+NPTS\s*,?\s*DT", re.I)
_OTHER_QUANTITY = re.compile(
    r"(?!.*ACCEL).*\b(VELOCITY|DISPLACEMENT|SPECTR\w*)\b.*\b(?:UNITS|TIME\s+(?:SERIES|HISTORY))", re.I
)
_SUFFIXES = {".vt2": "velocity", ".dt2": "displacement"}
_SEARCHED_LINES = 8  # NPTS (number of samples) and DT (interval [s]) must be in one of these first lines
OWN_TITLE = "ROCKJAX GROUND MOTION"  # first line of the files that rockjax writes
_AT2_UNITS = re.compile(r"UNITS\s+OF\s+(\S+)", re.I)


def _count_and_step(line: str) -> tuple[str, str, str] | None:
    """Return the values of NPTS and DT in a line, and the word after DT, as text. Return None for a comment,
    and for a line that does not contain both."""
    if line.lstrip()[:1] in tuple("#%!"):
        return None
    if plain := _AT2_PLAIN.match(line):
        return plain[1], plain[2], ""
    count, step = (pattern.search(line) for pattern in _AT2_COUNT)
    return (count[1], step[1], step[2]) if count and step else None


def _is_peer(path: Path, lines: list[str]) -> bool:
    """Return True for a file with a suffix of PEER, or with NPTS and DT in one of its first lines."""
    return path.suffix.lower() in (".at2", *_SUFFIXES) or any(map(_count_and_step, lines[:_SEARCHED_LINES]))


def _read_at2(path: Path, lines: list[str]) -> Samples:
    """Return the samples of a file. The header ends with the line that contains NPTS and DT."""
    # In a file that rockjax has written, the second line contains names chosen by the user. These may contain
    # words such as "velocity", "raw" or "NPTS", so this line is not searched for statements.
    is_own = lines[0] == OWN_TITLE
    searched = [(k, line) for k, line in enumerate(lines[:_SEARCHED_LINES]) if not (is_own and k == 1)]
    matches = [(k, match) for k, line in searched if (match := _count_and_step(line))]
    if not matches:
        raise ValueError(
            f"{path}: an .AT2 file needs a line with NPTS and DT among its first {_SEARCHED_LINES}; this one "
            "has none"
        )
    k, (count, step, word) = matches[0]
    statements = [(i + 1, line) for i, line in searched if i < k]
    for i, line in statements:
        if other := _OTHER_QUANTITY.match(line):
            content = other[1].lower()
            raise ValueError(
                f"{path}:{i}: the file has {content} ({abbreviate(line.strip())}), not acceleration"
            )
    if content := _SUFFIXES.get(path.suffix.lower()):
        raise ValueError(f"{path}: the suffix means {content}, not acceleration")
    time_unit = UNITS.get(unit_of(word) or "", UNITS["s"])
    dt = parse_interval(path, k + 1, step, "DT") * (time_unit.factor if time_unit.dimension == "time" else 1)
    units = (_AT2_UNITS.search(line) for _, line in statements)
    stated_unit = next((match[1].strip(".,") for match in units if match), None)
    metadata: dict[str, Any] = {"format": "PEER"}
    title = [field.strip() for field in lines[1].split(",")] if k > 1 else []
    if is_own and len(title) == 4:
        metadata |= dict(zip(("event", "date", "station", "component"), title, strict=True))
    elif len(title) >= 3:  # event and date, station, component
        event = ", ".join(field for field in title[:-2] if field)
        date = DATE.search(event)
        metadata |= {
            "event": event.replace(date[1], "").strip(" ,") if date else event,
            "date": date[1] if date else "",
            "station": title[-2],
            "component": title[-1],
        }
    values = require_count(path, k + 1, "NPTS", int(count), read_numbers(path, lines, k + 1))
    raw_location = next((f"line {i}" for i, line in statements if is_raw(line)), "")
    dt_statement = f"{path}:{k + 1}: DT is {dt:g} s"
    unit = unit_key(stated_unit)
    return Samples(values, dt, unit, metadata, stated_unit, dt_statement, raw_location=raw_location)


def _read(path: Path, lines: list[str], component: Component) -> Samples:
    return require_only_component(path, component, _read_at2(path, lines))


FORMAT = Format("PEER .AT2", _is_peer, _read)
