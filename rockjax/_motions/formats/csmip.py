"""CSMIP format, volume 2."""

from __future__ import annotations

import re
from pathlib import Path

from .base import (
    DATE,
    NUMBER,
    Component,
    Format,
    Samples,
    choose_channel,
    filter_corners,
    first_match,
    fixed_width,
    parse_interval,
    unit_key,
)

_CSMIP = re.compile(r"\s*CORRECTED ACCELEROGRAM\b(?:.*?CHAN\s*(\d{1,6})\s*:\s*(.*?)\s*(?:FROM\s*)?$)?", re.I)
_CSMIP_DATA = re.compile(rf"\s*(\d{{1,9}})\s+POINTS OF ACCEL DATA EQUALLY SPACED AT\s*({NUMBER})\s*SEC", re.I)


def _read_csmip(path: Path, lines: list[str], component: Component) -> Samples:
    """Read volume 2 of CSMIP. Each channel consists of 25 lines of text, then integers, then real numbers,
    and finally the samples of acceleration, velocity and displacement."""
    starts = [(k, match) for k, line in enumerate(lines) if (match := _CSMIP.match(line))]
    channels = [(int(match[1] or n), match[2] or "") for n, (_, match) in enumerate(starts, start=1)]
    chosen = choose_channel(path, channels, component)
    start = starts[chosen][0]
    end = starts[chosen + 1][0] if chosen + 1 < len(starts) else len(lines)
    data = first_match(_CSMIP_DATA, lines, start, end)
    if data is None:
        raise ValueError(
            f"{path}:{start + 1}: channel {channels[chosen][0]} has no line 'N points of accel data', which "
            "CSMIP volume 2 requires"
        )
    k, match = data
    stated_unit = re.search(r"UNITS:\s*([^)]*)\)|,\s*IN\s+(\S+)", lines[k], re.I)
    stated_unit = (stated_unit[1] or stated_unit[2]).strip(" .") if stated_unit else None
    head = [line.rstrip() for line in lines[start:k]] + [""] * 25
    band = re.search(r"FILTERED.*?([\d.]+)\s+AND\s+([\d.]+)", head[14], re.I)
    station, code = (
        head[6].split("  ")[0].strip(),
        re.search(r"STATION\s+(?:NO|ID)\.?\s+(\S+)", head[5], re.I),
    )
    date = DATE.search(head[4]) or DATE.search(head[3])
    metadata = {
        "format": "CSMIP",
        "event": head[2].split("  ")[0].strip(),
        "date": date[1] if date else "",
        "station": " ".join(word for word in (code[1] if code else "", station) if word),
        "component": channels[chosen][1],
        "channel": channels[chosen][0],
        **filter_corners(band),
    }
    values = fixed_width(path, lines, k + 1, int(match[1]), lines[k])
    dt = parse_interval(path, k + 1, match[2], "the interval")
    return Samples(
        values, dt, unit_key(stated_unit), metadata, stated_unit, f"{path}:{k + 1}: the interval is {dt:g} s"
    )


FORMAT = Format("CSMIP volume 2", lambda path, lines: bool(_CSMIP.match(lines[0])), _read_csmip)
