"""Format of K-NET and KiK-net."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from rockjax._checks import refuse_sentinels

from .base import (
    Component,
    Format,
    Samples,
    abbreviate,
    parse_number,
    read_numbers,
    require_count,
    require_only_component,
)

_KEY_WIDTH = 18  # number of characters of a key in the header, with blanks
# Directions in the header of KiK-net ↦ names of components. Names end in 1 for the sensor in the borehole,
# and in 2 for the sensor at the surface.
_KIKNET = dict(zip("123456", ("NS1", "EW1", "UD1", "NS2", "EW2", "UD2"), strict=True))


def _read_knet(path: Path, lines: list[str], component: Component) -> Samples:
    """Read K-NET and KiK-net: a header that ends with the line Memo., followed by raw counts. A scale factor
    in the header converts the counts to gal."""
    header: dict[str, tuple[int, str]] = {}  # key ↦ line number, value
    for k, line in enumerate(lines):
        header[line[:_KEY_WIDTH].strip()] = k + 1, line[_KEY_WIDTH:].strip()
        if line.startswith("Memo"):
            break
    else:
        raise ValueError(f"{path}: the header has no Memo., after which the values begin")
    end = k + 1
    for key in ("Sampling Freq(Hz)", "Duration Time(s)", "Scale Factor"):
        if key not in header:
            raise ValueError(f"{path}: the header has no {key}")
    line, text = header["Sampling Freq(Hz)"]
    frequency = parse_number(path, line, re.sub(r"\s*Hz$", "", text))
    if not (frequency > 0 and np.isfinite(1 / frequency)):
        raise ValueError(f"{path}:{line}: the sampling frequency must be > 0 Hz, got {text}")
    factor_line, text = header["Scale Factor"]
    factor = re.fullmatch(r"(\S+?)\s*\(gal\)\s*/\s*(\S+)", text)
    if factor is None:
        raise ValueError(
            f"{path}:{factor_line}: Scale Factor must have the form 2000(gal)/8388608, got {abbreviate(text)}"
        )
    divisor = parse_number(path, factor_line, factor[2])
    if not divisor > 0:
        raise ValueError(
            f"{path}:{factor_line}: the divisor of Scale Factor must be > 0, got {abbreviate(text)}"
        )
    duration_line, text = header["Duration Time(s)"]
    count = round(min(parse_number(path, duration_line, text) * frequency, 1e9))
    direction = header.get("Dir.", (0, ""))[1]
    value = lambda key: header.get(key, (0, ""))[1]
    metadata = {
        "format": "K-NET",
        "event": f"M {value('Mag.')}" if value("Mag.") else "",
        "date": value("Origin Time"),
        "station": value("Station Code"),
        "component": _KIKNET.get(direction, direction),
        **{key: text for key, (_, text) in header.items() if key and text},
    }
    values = require_count(
        path, duration_line, "duration times frequency", count, read_numbers(path, lines, end)
    )
    refuse_sentinels(str(path), values)
    with np.errstate(over="ignore"):
        values = values * np.divide(parse_number(path, factor_line, factor[1]), divisor)
    dt_statement = f"{path}:{line}: the sampling frequency is {frequency:g} Hz"
    samples = Samples(
        values, 1 / frequency, "gal", metadata, "gal", dt_statement, raw_location="as all K-NET data"
    )
    return require_only_component(path, component, samples)


FORMAT = Format("K-NET", lambda path, lines: lines[0].startswith("Origin Time"), _read_knet)
