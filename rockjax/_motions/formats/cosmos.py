"""COSMOS format, volume 2."""

from __future__ import annotations

import re
from pathlib import Path

from rockjax._units import UNITS

from .base import (
    DATE,
    Component,
    Format,
    Samples,
    choose_channel,
    filter_corners,
    first_match,
    fixed_width,
    unit_key,
)

_COSMOS = re.compile(
    r"\s*(CORRECTED|UNCORRECTED|RAW)\s+(ACCELERATION|VELOCITY|DISPLACEMENT)\b.*\(FORMAT V", re.I
)
_COSMOS_DATA = re.compile(r"\s*(\d{1,9})\s+ACCELERATION\s+PTS\b.*?UNITS\s*=\s*([^\s(,]+)", re.I)


def _read_cosmos(path: Path, lines: list[str], component: Component) -> Samples:
    """Read COSMOS format 1.20. Each channel has a text header, an integer header, a header of real numbers,
    comments and data. Each of these parts begins with a line that states the length of the part."""
    sections = [(k, match) for k, line in enumerate(lines) if (match := _COSMOS.match(line))]
    ends = [k for k, _ in sections[1:]] + [len(lines)]
    title = sections[0][1]
    if title[1].upper() != "CORRECTED":
        content = f"{title[1]} {title[2]}".lower()
        raise ValueError(f"{path}:1: the file has raw COSMOS data ({content}); volume 2 (.V2c) can be read")
    accelerations = [
        (start, end)
        for (start, match), end in zip(sections, ends, strict=True)
        if match[2].upper() == "ACCELERATION"
    ]
    if not accelerations:
        raise ValueError(f"{path}:1: the file has {title[2].lower()}, not acceleration")
    channels = []
    for n, (start, end) in enumerate(accelerations, start=1):
        channel = re.search(
            r"STA CHAN\s*(\d{1,6}|\S*?)\s*:\s*(.*?)\s*(?:\(|$)",
            " ".join(lines[start + 8 : min(start + 9, end)]),
            re.I,
        )
        channels.append(
            (int(channel[1]) if channel and channel[1].isdecimal() else n, channel[2] if channel else "")
        )
    chosen = choose_channel(path, channels, component)
    start, end = accelerations[chosen]
    data = first_match(_COSMOS_DATA, lines, start, end)
    reals = first_match(re.compile(r"\s*(\d{1,9})\s+REAL-HEADER VALUES\b", re.I), lines, start, end)
    if data is None or reals is None:
        missing = "Real-header values" if reals is None else "acceleration pts"
        raise ValueError(f"{path}:{start + 1}: channel {channels[chosen][0]} has no line 'N {missing}'")
    k, match = data
    reals_line, reals_match = reals
    header = fixed_width(path, lines, reals_line + 1, int(reals_match[1]), lines[reals_line])
    if len(header) < 62 or not header[61] > 0:
        raise ValueError(
            f"{path}:{reals_line + 1}: real-header value 62, the sampling interval, must be > 0 ms"
        )
    head = [line.rstrip() for line in lines[start:reals_line]] + [""] * 13
    band = re.search(r"FILTERED BELOW\s*([\d.]+).*?ABOVE\s*([\d.]+)", head[11], re.I)
    station, date = re.search(r"CODE:\s*(.*)", head[4], re.I), DATE.search(head[7])
    metadata = {
        "format": "COSMOS",
        "event": re.sub(r"^\s*Record of\s*", "", head[1], flags=re.I).strip(),
        "date": date[1] if date else "",
        "station": " ".join(station[1].split()) if station else "",
        "component": channels[chosen][1],
        "channel": channels[chosen][0],
        **filter_corners(band),
    }
    values = fixed_width(path, lines, k + 1, int(match[1]), lines[k])
    dt = float(header[61]) * UNITS["ms"].factor
    dt_statement = f"{path}:{reals_line + 1}: real-header value 62 is {header[61]:g} ms"
    return Samples(values, dt, unit_key(match[2]), metadata, match[2], dt_statement)


FORMAT = Format("COSMOS volume 2", lambda path, lines: bool(_COSMOS.match(lines[0])), _read_cosmos)
