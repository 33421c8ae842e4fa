"""ESM, ITACA and AFAD."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from .base import (
    Component,
    Format,
    Samples,
    abbreviate,
    filter_corners,
    is_raw,
    parse_interval,
    read_numbers,
    require_count,
    require_only_component,
    unit_key,
)

_BAND = re.compile(r"([\d.]+)\s+AND\s+([\d.]+)")
_KEY = re.compile(r"([A-Z][A-Z0-9_/^]*(?: [A-Z0-9_/^]+)*):\s*(.*?)\s*$")  # ITACA once had blanks in its keys
_UNCORRECTED_NAME = re.compile(r"\.U\.ACC\.ASC$|\.UNP\.ACC$|\.CV\.ACC\.ASC$", re.I)
_HEADER = 80  # lines in which the sampling interval is searched


def _esm(path: Path, lines: list[str], component: Component) -> Samples:
    """Read ESM, ITACA and AFAD (DYNA 1.2): 64 lines KEY: value, then one value a line."""
    header: dict[str, tuple[int, str]] = {}
    end = 0
    for k, line in enumerate(lines):
        match = _KEY.match(line)
        if match is None:
            if line.strip():
                break
            continue
        header[match[1].replace(" ", "_")], end = (k + 1, match[2]), k + 1
    for key in ("SAMPLING_INTERVAL_S", "NDATA", "UNITS"):
        if key not in header:
            raise ValueError(f"{path}: its header has no {key}")
    kind = header.get("DATA_TYPE", (1, ""))
    if re.sub(r"(?:RAW|UNCORRECTED|UNPROCESSED)\s+", "", kind[1].upper()) not in ("", "ACCELERATION"):
        raise ValueError(f"{path}:{kind[0]}: holds {abbreviate(kind[1])}, not ACCELERATION")
    line, count = header["NDATA"]
    if not re.fullmatch(r"\d{1,9}", count, re.ASCII):
        raise ValueError(f"{path}:{line}: NDATA must be a whole number, got {abbreviate(count)}")
    step_line, step = header["SAMPLING_INTERVAL_S"]
    dt = parse_interval(path, step_line, step, "SAMPLING_INTERVAL_S")
    stated_unit = header["UNITS"][1]
    own = {key: value for key, (_, value) in header.items() if value}
    metadata: dict[str, Any] = {
        "format": "ESM",
        "event": " ".join(own.get(key, "") for key in ("EVENT_NAME", "EVENT_ID")).strip(),
        "date": own.get("EVENT_DATE_YYYYMMDD", ""),
        "station": ".".join(own[key] for key in ("NETWORK", "STATION_CODE") if key in own),
        "component": own.get("STREAM", ""),
        **filter_corners(
            _BAND.match(f"{own.get('LOW_CUT_FREQUENCY_HZ', '')} AND {own.get('HIGH_CUT_FREQUENCY_HZ', '')}")
        ),
        **{key.lower(): value for key, value in own.items()},
    }
    values = require_count(path, line, "NDATA", int(count), read_numbers(path, lines, end))
    dt_place = f"{path}:{step_line}: SAMPLING_INTERVAL_S is {dt:g} s"
    keys = ("PROCESSING", "BASELINE_CORRECTION", "DATA_TYPE")
    marks = [(k, text) for k, text in (header.get(key, (0, "")) for key in keys) if _is_raw(text)]
    raw_place = f"line {marks[0][0]}" if marks else "its name" if _UNCORRECTED_NAME.search(path.name) else ""
    return require_only_component(
        path,
        component,
        Samples(values, dt, unit_key(stated_unit), metadata, stated_unit, dt_place, raw_place=raw_place),
    )


def _is_raw(text: str) -> bool:
    return is_raw(text) or text.strip().casefold() == "none"


def _is_esm(path: Path, lines: list[str]) -> bool:
    return any(line.replace(" ", "_").startswith("SAMPLING_INTERVAL_S:") for line in lines[:_HEADER])


FORMAT = Format("ESM", _is_esm, _esm)
