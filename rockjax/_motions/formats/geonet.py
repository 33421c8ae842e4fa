"""GeoNet format (GNS Science, New Zealand), volume 2 (.V2A)."""

from __future__ import annotations

import re
from pathlib import Path

from .base import (
    Component,
    Format,
    Samples,
    choose_channel,
    filter_corners,
    fixed_width,
    parse_interval,
    unit_key,
)

_START = re.compile(r"\s*(UN)?CORRECTED ACCELEROGRAM\s+(\S+)", re.I)
_STEP = re.compile(r"DATA AT\s*([\d.]+)\s*S(?:EC)?\b", re.I)
_FILTER = re.compile(r"BANDS ARE\s*[\d.]+-([\d.]+)\s*HZ AND\s*([\d.]+)-", re.I)
_TEXT_LINES, _INTEGER_LINES, _REAL_LINES = 16, 4, 6  # number of lines of text, integers and reals
_COUNT_INDEX = 33  # index of the number of samples of acceleration among the integers


def _is_geonet(path: Path, lines: list[str]) -> bool:
    names_gns = "GNS SCIENCE" in lines[0].upper() or "GEOLOGICAL & NUCLEAR" in lines[0].upper()
    return bool(_START.match(lines[0])) and names_gns


def _read_geonet(path: Path, lines: list[str], component: Component) -> Samples:
    """Read volume 2 of GeoNet. For each component, a file has 16 lines of text, 40 integers, 60 real numbers,
    and the samples of acceleration, velocity and displacement. Lines of numbers contain ten numbers."""
    starts = [k for k, line in enumerate(lines) if _START.match(line)]
    match = _START.match(lines[0])
    assert match is not None
    if match[1]:
        raise ValueError(f"{path}:1: the file is volume 1 of GeoNet (raw data); volume 2 (.V2A) can be read")
    channels = []
    for n, start in enumerate(starts, start=1):
        name = re.match(r"\s*Component\s+(\S+)", _line(lines, start + 12), re.I)
        channels.append((n, name[1] if name else ""))
    chosen = choose_channel(path, channels, component)
    start = starts[chosen]
    step = _STEP.search(_line(lines, start + 10))
    if step is None:
        raise ValueError(f"{path}:{start + 11}: the line must state the interval, such as DATA AT 0.02 SEC")
    dt = parse_interval(path, start + 11, step[1], "the interval")
    peak = re.search(r"ACCELERATION:\s+PEAK\s+\S+\s+(\S+)", _line(lines, start + 13), re.I)
    stated_unit = peak[1] if peak else None
    integers = fixed_width(path, lines, start + _TEXT_LINES, 10 * _INTEGER_LINES, "(10I8)")
    count = int(integers[_COUNT_INDEX])
    if count < 2:
        raise ValueError(
            f"{path}:{start + _TEXT_LINES + 4}: integer 34, the number of samples, must be >= 2, got {count}"
        )
    origin = re.match(r"\s*(\d{4} \w+ \d{1,2})", _line(lines, start + 7))
    metadata = {
        "format": "GeoNet",
        "event": _line(lines, start + 6).strip(),
        "date": origin[1] if origin else "",
        "station": " ".join([*_line(lines, start + 1).split()[1:2], _line(lines, start + 2).strip()]),
        "component": channels[chosen][1],
        "channel": channels[chosen][0],
        **filter_corners(_FILTER.search(_line(lines, start + 11))),
    }
    values = fixed_width(path, lines, start + _TEXT_LINES + _INTEGER_LINES + _REAL_LINES, count, "(10F8.1)")
    return Samples(
        values,
        dt,
        unit_key(stated_unit),
        metadata,
        stated_unit,
        f"{path}:{start + 11}: the interval is {dt:g} s",
    )


def _line(lines: list[str], k: int) -> str:
    """Return the line with index k; an empty string beyond the last line."""
    return lines[k] if k < len(lines) else ""


FORMAT = Format("GeoNet volume 2", _is_geonet, _read_geonet)
