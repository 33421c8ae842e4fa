"""PEER's .AT2."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from .base import DATE, NUMBER, Component, Format, Samples, alone, counted, interval, unit, words

_AT2_COUNT = re.compile(r"NPTS\s*=?\s*(\d{1,9})(?!\d)", re.I), re.compile(rf"DT\s*=?\s*({NUMBER})", re.I)
_AT2_PLAIN = re.compile(rf"^\s*(\d{{1,9}})\s+({NUMBER})\s+NPTS\s*,?\s*DT", re.I)
_AT2_UNITS = re.compile(r"UNITS\s+OF\s+(\S+)", re.I)


def _at2(path: Path, lines: list[str]) -> Samples:
    head = lines[:8]
    for k, line in enumerate(head):  # noqa: B007
        plain = _AT2_PLAIN.match(line)
        count, step = (
            (plain[1], plain[2])
            if plain
            else (match and match[1] for match in (p.search(line) for p in _AT2_COUNT))
        )
        if count and step:
            break
    else:
        raise ValueError(
            f"{path}: has no line with NPTS and DT among its first {len(head)}: is this an .AT2 file?"
        )
    dt = interval(path, k + 1, step, "DT")
    said = next((match[1].strip(".,") for match in map(_AT2_UNITS.search, lines[:k]) if match), None)
    metadata: dict[str, Any] = {"format": "PEER"}
    title = [part.strip() for part in lines[1].split(",")] if k > 1 else []
    if len(title) >= 3:  # event and date, station, component
        event = ", ".join(part for part in title[:-2] if part)
        date = DATE.search(event)
        metadata |= {
            "event": event.replace(date[1], "").strip(" ,") if date else event,
            "date": date[1] if date else "",
            "station": title[-2],
            "component": title[-1],
        }
    values = counted(path, k + 1, "NPTS", int(count), words(path, lines, k + 1))
    return Samples(values, dt, unit(said), metadata, said, f"{path}:{k + 1}: DT is {dt:g} s")


def _read(path: Path, lines: list[str], component: Component) -> Samples:
    return alone(path, component, _at2(path, lines))


FORMAT = Format("PEER .AT2", lambda path, lines: path.suffix.lower() == ".at2", _read)
