"""Format of ESM, which ITACA and AFAD also use (DYNA 1.2)."""

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
_KEY = re.compile(r"([A-Z][A-Z0-9_/^]*(?: [A-Z0-9_/^]+)*):\s*(.*?)\s*$")  # older ITACA keys contain blanks
_UNCORRECTED_NAME = re.compile(r"\.U\.ACC\.ASC$|\.UNP\.ACC$|\.ACC\.CV\.ASC$|_RawAcc_", re.I)
_SEARCHED_LINES = 80  # number of lines that are searched for the sampling interval


def _read_esm(path: Path, lines: list[str], component: Component) -> Samples:
    """Read DYNA 1.2: 64 lines KEY: value, followed by the samples, one per line."""
    header: dict[str, tuple[int, str]] = {}  # key ↦ line number, value
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
            raise ValueError(f"{path}: the header has no {key}")
    type_line, quantity = header.get("DATA_TYPE", (1, ""))
    if re.sub(r"(?:RAW|UNCORRECTED|UNPROCESSED)\s+", "", quantity.upper()) not in ("", "ACCELERATION"):
        raise ValueError(f"{path}:{type_line}: DATA_TYPE is {abbreviate(quantity)}, not ACCELERATION")
    line, count = header["NDATA"]
    if not re.fullmatch(r"\d{1,9}", count, re.ASCII):
        raise ValueError(f"{path}:{line}: NDATA must be a whole number, got {abbreviate(count)}")
    step_line, step = header["SAMPLING_INTERVAL_S"]
    dt = parse_interval(path, step_line, step, "SAMPLING_INTERVAL_S")
    stated_unit = header["UNITS"][1]
    facts = {key: value for key, (_, value) in header.items() if value}
    # `filter_corners` takes one match with both frequencies, so both are joined into one text.
    metadata: dict[str, Any] = {
        "format": "ESM",
        "event": " ".join(facts.get(key, "") for key in ("EVENT_NAME", "EVENT_ID")).strip(),
        "date": facts.get("EVENT_DATE_YYYYMMDD", ""),
        "station": ".".join(facts[key] for key in ("NETWORK", "STATION_CODE") if key in facts),
        "component": facts.get("STREAM", ""),
        **filter_corners(
            _BAND.match(
                f"{facts.get('LOW_CUT_FREQUENCY_HZ', '')} AND {facts.get('HIGH_CUT_FREQUENCY_HZ', '')}"
            )
        ),
        **{key.lower(): value for key, value in facts.items()},
    }
    values = require_count(path, line, "NDATA", int(count), read_numbers(path, lines, end))
    dt_statement = f"{path}:{step_line}: SAMPLING_INTERVAL_S is {dt:g} s"
    keys = ("PROCESSING", "BASELINE_CORRECTION", "DATA_TYPE")
    raw_lines = [k for k, text in (header.get(key, (0, "")) for key in keys) if _is_raw(text)]
    raw_name = "its name" if _UNCORRECTED_NAME.search(path.name) else ""
    raw_location = f"line {raw_lines[0]}" if raw_lines else raw_name
    unit = unit_key(stated_unit)
    samples = Samples(values, dt, unit, metadata, stated_unit, dt_statement, raw_location=raw_location)
    return require_only_component(path, component, samples)


def _is_raw(text: str) -> bool:
    """Return True if the value of a key states that data are uncorrected, or that there was no processing."""
    return is_raw(text) or text.strip().casefold() == "none"


def _is_esm(path: Path, lines: list[str]) -> bool:
    return any(line.replace(" ", "_").startswith("SAMPLING_INTERVAL_S:") for line in lines[:_SEARCHED_LINES])


FORMAT = Format("ESM", _is_esm, _read_esm)
