"""Older text format of AFAD (Turkey) and of its predecessor, the Earthquake Department.

A file has one column for each component. `esm.py` reads the present format of AFAD.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from .base import Component, Format, Samples, abbreviate, choose_channel, is_raw, parse_interval, parse_number

_TITLE = "STRONG GROUND MOTION RECORDS OF T"  # TURKIYE, TÜRKİYE or TURKEY
_KEY = re.compile(r"([A-Z][A-Z ]*(?:\([A-Za-z]+\))?)\s*:\s*(.*?)\s*$")
_COMPONENTS = ("N-S", "E-W", "U-D")
_PEAK_TOLERANCE = 0.01  # largest difference between peak of the samples and peak in the header, as a fraction


def _read_afad(path: Path, lines: list[str], component: Component) -> Samples:
    """Read a file: lines KEY: value, then a line with the names of the components, then rows of samples."""
    header: dict[str, tuple[int, str]] = {}  # key ↦ line number, value
    end = next((k for k, line in enumerate(lines) if tuple(line.split()) == _COMPONENTS), None)
    if end is None:
        raise ValueError(
            f"{path}: the header has no line {'  '.join(_COMPONENTS)}, after which the values begin"
        )
    for k, line in enumerate(lines[:end], start=1):
        if match := _KEY.match(line):
            header[match[1].strip()] = k, match[2]
    for key in ("NUMBER OF DATA", "SAMPLING INTERVAL (sec)"):
        if key not in header:
            raise ValueError(f"{path}: the header has no {key}")
    line, count = header["NUMBER OF DATA"]
    if not re.fullmatch(r"\d{1,9}", count, re.ASCII):
        raise ValueError(f"{path}:{line}: NUMBER OF DATA must be a whole number, got {abbreviate(count)}")
    step_line, step = header["SAMPLING INTERVAL (sec)"]
    dt = parse_interval(path, step_line, step, "SAMPLING INTERVAL")
    chosen = choose_channel(path, list(enumerate(_COMPONENTS, start=1)), component)
    rows = []
    for k, text in enumerate(lines[end + 1 :], start=end + 2):
        words = text.split()
        if words and len(words) != len(_COMPONENTS):
            raise ValueError(f"{path}:{k}: the line must have three columns, got {len(words)}")
        rows += [[parse_number(path, k, word) for word in words]] if words else []
    if len(rows) != int(count):
        raise ValueError(
            f"{path}:{line}: NUMBER OF DATA is {count}, but the file has {len(rows)} lines of values"
        )
    values = np.array(rows).reshape(-1, len(_COMPONENTS))[:, chosen]
    value_of = lambda key: header.get(key, (0, ""))[1]
    metadata = {
        "format": "AFAD",
        "event": value_of("EPICENTER COORDINATES"),
        "date": value_of("EARTHQUAKE DATE"),
        "station": " ".join(y for y in (value_of("STATION ID"), value_of("PLACE")) if y),
        "component": _COMPONENTS[chosen],
        **{key: text for key, (_, text) in header.items() if text},
    }
    unit = _unit(value_of("RAW PGA VALUES (gal)"), _COMPONENTS[chosen], values)
    dt_statement = f"{path}:{step_line}: SAMPLING INTERVAL is {dt:g} s"
    raw_location = next((f"line {line}" for key, (line, _) in header.items() if is_raw(key)), "")
    return Samples(values, dt, unit, metadata, unit, dt_statement, raw_location=raw_location)


def _unit(peaks: str, name: str, values: np.ndarray) -> str | None:
    """Return "gal" if the peak of the samples agrees within 1 % with the peak of this component in `peaks`,
    the text in the header that states peaks in gal. Otherwise the unit is unknown (None)."""
    match = re.search(rf"\({re.escape(name)}\)\s*([\d.]+)", peaks)
    try:
        peak = float(match[1]) if match else 0.0
    except ValueError:
        return None
    return "gal" if values.size and abs(np.abs(values).max() - peak) <= _PEAK_TOLERANCE * peak else None


FORMAT = Format("AFAD text", lambda path, lines: _TITLE in lines[0].upper(), _read_afad)
