"""Formats that are known and not read, so that a file of theirs is called what it is."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

from .base import Component, Format, Samples


def _refused(why: str) -> Callable[[Path, list[str], Component], Samples]:
    def read(path: Path, lines: list[str], component: Component) -> Samples:
        raise ValueError(f"{path}:1: {why}")

    return read


FORMATS = (
    Format(
        "CSMIP volume 1",
        lambda path, lines: bool(re.match(r"\s*UNCORRECTED ACCELEROGRAM", lines[0], re.I)),
        _refused("is volume 1, an uncorrected accelerogram; volume 2 (.V2) can be read"),
    ),
)
VOLUME_2 = Format(
    "volume 2",
    lambda path, lines: path.suffix.lower() in (".v2", ".v2c", ".v2a"),
    _refused("is neither 'Corrected accelerogram' (CSMIP, GeoNet) nor 'Corrected acceleration' (COSMOS)"),
)
ITACA = Format(
    "ITACA",
    lambda path, lines: path.name.lower().endswith((".cor.acc", ".unp.acc")),
    _refused(
        "by its name is of ITACA before it had headers of KEY: value, which is not read; get it as ESM or "
        "ITACA write it "
        "today (ASCII), or take its header off and give units and dt"
    ),
)
