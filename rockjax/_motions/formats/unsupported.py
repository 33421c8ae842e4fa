"""Formats that are recognised but not supported. They are recognised so that the error can name them."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

from .base import Component, Format, Samples


def _refuse(reason: str) -> Callable[[Path, list[str], Component], Samples]:
    """Return a reader that raises `ValueError` with this reason."""

    def read(path: Path, lines: list[str], component: Component) -> Samples:
        raise ValueError(f"{path}:1: {reason}")

    return read


def _is_raw(path: Path, lines: list[str]) -> bool:
    return re.match(r"(?!\s*[#%!]).*\b(?:UNCORRECTED|RAW) ACCELEROGRAM", lines[0], re.I) is not None


def _is_spectra(path: Path, lines: list[str]) -> bool:
    has_title = any(
        re.match(r"(?!\s*[#%!]).*\b(?:RESPONSE|FOURIER)\b.*\bSPECTRA\b", line, re.I) for line in lines[:2]
    )
    return has_title or path.suffix.lower() in (".v3", ".v3c")


def _is_usc(path: Path, lines: list[str]) -> bool:
    """Return True for volume 2 of USC: a corrected accelerogram whose header contains USC#, or a number (the
    length of the line) in columns 73 and 74 of each of the lines 3 to 12. Files of CSMIP also begin with
    "corrected accelerogram"; they are excluded."""
    header = lines[2:12]
    has_lengths = len(header) == 10 and all(re.fullmatch(r"\s?\d{1,2}", line[72:74]) for line in header)
    names_usc = has_lengths or re.search(r"\bUSC\s*#", " ".join(lines[:12]), re.I) is not None
    is_csmip = any("POINTS OF ACCEL" in line.upper() for line in lines)
    return bool(re.search(r"\bCORRECTED ACCELEROGRAM", lines[0], re.I)) and names_usc and not is_csmip


_RAW = _refuse("the file is volume 1 (raw data); volume 2 (.V2) can be read")
FORMATS = (
    Format("volume 1", _is_raw, _RAW),
    Format(
        "volume 3",
        _is_spectra,
        _refuse("the file is volume 3 (response or Fourier spectra); volume 2 (.V2) can be read"),
    ),
    Format(
        "USC volume 2",
        _is_usc,
        _refuse("volume 2 of USC is not supported; volume 2 of CSMIP or COSMOS (.V2) can be read"),
    ),
)
VOLUME_1 = Format("volume 1", lambda path, lines: path.suffix.lower() in (".v0", ".v1", ".v0c", ".v1c"), _RAW)
VOLUME_2 = Format(
    "volume 2",
    lambda path, lines: path.suffix.lower() in (".v2", ".v2c", ".v2a"),
    _refuse(
        "a .V2 file must begin with 'Corrected accelerogram' (CSMIP, GeoNet) or 'Corrected acceleration' "
        "(COSMOS)"
    ),
)
ITACA = Format(
    "ITACA",
    lambda path, lines: path.name.lower().endswith((".cor.acc", ".unp.acc")),
    _refuse(
        "according to its name, the file has an old format of ITACA without headers KEY: value, which is not "
        "supported; download the present format (ASCII) of ESM or ITACA, or remove the header and give units "
        "and dt"
    ),
)
