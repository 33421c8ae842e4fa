"""SMC of the US Geological Survey's National Strong-Motion Project."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from .base import Component, Format, Samples, abbreviate, fixed_width, require_only_component

_KINDS = re.compile(
    r"([0-6]) (UNKNOWN|UNCORRECTED ACCELEROGRAM|CORRECTED ACCELEROGRAM|VELOCITY|DISPLACEMENT|.*SPECTRA.*)\s*$"
)
_TEXTS, _INTEGERS, _REALS = 11, 6, 10  # lines of each header
_COMMENTS, _COUNT = 15, 16  # indices among the integers
_RATE = 1  # index among the reals


def _smc(path: Path, lines: list[str], component: Component) -> Samples:
    """Read SMC: 11 lines of text, 48 integers, 50 reals, comments, and values in cm/s² in eight columns that
    may touch."""
    kind = _KINDS.match(lines[0])
    if kind is None or kind[1] != "2":
        content = kind[2].strip().lower() if kind else "?"
        description = f"{abbreviate(content)}{', raw data' if kind and kind[1] == '1' else ''}"
        raise ValueError(f"{path}:1: is SMC and holds {description}; a corrected accelerogram can be read")
    reals_at = _TEXTS + _INTEGERS
    start = reals_at + _REALS
    integers = fixed_width(path, lines, _TEXTS, 48, "(8I10)")
    reals = fixed_width(path, lines, reals_at, 50, "(5E15.7)")
    comments, count, rate = int(integers[_COMMENTS]), int(integers[_COUNT]), float(reals[_RATE])
    if comments < 0 or count < 2:
        raise ValueError(
            f"{path}:{_TEXTS + 2}: integers 16 and 17, of comments and of samples, must be >= 0 and >= 2, "
            f"got "
            f"{comments} and {count}"
        )
    if not (0 < rate < 1e5 and rate != reals[0]):
        raise ValueError(
            f"{path}:{reals_at + 1}: real 2, samples a second, must be > 0 and < 1e5, got {rate:g}"
        )
    place = re.search(r"station\s*=\s*(.*?)\s*component\s*=\s*(.*?)\s*$", lines[5], re.I)
    event = lines[3].split(None, 4)
    metadata = {
        "format": "SMC",
        "event": event[4].strip() if len(event) > 4 else "",
        "date": "/".join(event[:3]),
        "station": place[1] if place else "",
        "component": place[2] if place else "",
        "comments": " ".join(line.lstrip("|").strip() for line in lines[start : start + comments]).strip(),
    }
    values = fixed_width(path, lines, start + comments, count, "(8F10)")
    dt_place = f"{path}:{reals_at + 1}: real 2 is {rate:g} samples a second"
    return require_only_component(
        path, component, Samples(np.asarray(values), 1 / rate, "cm/s2", metadata, "cm/s2", dt_place)
    )


FORMAT = Format("SMC", lambda path, lines: bool(_KINDS.match(lines[0])), _smc)
