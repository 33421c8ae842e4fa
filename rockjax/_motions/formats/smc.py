"""SMC format (National Strong-Motion Project, US Geological Survey)."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from .base import Component, Format, Samples, abbreviate, fixed_width, require_only_component

_TITLES = re.compile(
    r"([0-6]) (UNKNOWN|UNCORRECTED ACCELEROGRAM|CORRECTED ACCELEROGRAM|VELOCITY|DISPLACEMENT|.*SPECTRA.*)\s*$"
)
_TEXT_LINES, _INTEGER_LINES, _REAL_LINES = 11, 6, 10  # number of lines of text, integers and reals
# Indices among the 48 integers: number of comment lines, number of samples.
_COMMENTS_INDEX, _COUNT_INDEX = 15, 16
# Indices among the 50 reals: number that stands for missing values, samples per second.
_MISSING_INDEX, _RATE_INDEX = 0, 1


def _read_smc(path: Path, lines: list[str], component: Component) -> Samples:
    """Read SMC: 11 lines of text, 48 integers, 50 real numbers, lines of comments, and samples [cm/s²] in 8
    columns."""
    title = _TITLES.match(lines[0])
    if title is None or title[1] != "2" or title[2].startswith("UN"):
        content = title[2].strip().lower() if title else "?"
        description = f"{abbreviate(content)}{', raw data' if title and title[1] == '1' else ''}"
        raise ValueError(
            f"{path}:1: the SMC file has {description}; only a corrected accelerogram can be read"
        )
    reals_start = _TEXT_LINES + _INTEGER_LINES
    start = reals_start + _REAL_LINES
    integers = fixed_width(path, lines, _TEXT_LINES, 48, "(8I10)")
    reals = fixed_width(path, lines, reals_start, 50, "(5E15.7)")
    comments, count, rate = (
        int(integers[_COMMENTS_INDEX]),
        int(integers[_COUNT_INDEX]),
        float(reals[_RATE_INDEX]),
    )
    if comments < 0 or count < 2:
        raise ValueError(
            f"{path}:{_TEXT_LINES + 2}: integer 16, the number of comment lines, must be >= 0, and integer "
            f"17 (in the next line), the number of samples, must be >= 2; got {comments} and {count}"
        )
    if not (0 < rate < 1e5 and rate != reals[_MISSING_INDEX]):
        raise ValueError(
            f"{path}:{reals_start + 1}: real 2, the samples per second, must be > 0, < 1e5, and not the mark "
            f"of missing values (real 1); got {rate:g}"
        )
    station = re.search(r"station\s*=\s*(.*?)\s*component\s*=\s*(.*?)\s*$", lines[5], re.I)
    event = lines[3].split(None, 4)
    metadata = {
        "format": "SMC",
        "event": event[4].strip() if len(event) > 4 else "",
        "date": "/".join(event[:3]),
        "station": station[1] if station else "",
        "component": station[2] if station else "",
        "comments": " ".join(line.lstrip("|").strip() for line in lines[start : start + comments]).strip(),
    }
    values = fixed_width(path, lines, start + comments, count, "(8F10)")
    dt_statement = f"{path}:{reals_start + 1}: real 2 is {rate:g} samples per second"
    samples = Samples(np.asarray(values), 1 / rate, "cm/s2", metadata, "cm/s2", dt_statement)
    return require_only_component(path, component, samples)


FORMAT = Format("SMC", lambda path, lines: bool(_TITLES.match(lines[0])), _read_smc)
