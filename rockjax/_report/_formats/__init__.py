"""Formats of a report: a new one is a module with a function `encode`, and its line in `FORMATS`."""

from __future__ import annotations

from collections.abc import Callable

from rockjax._report.blocks import Page
from rockjax._report.units import Units

from . import csv, html, json, xlsx

# Name of a format → function of a page and of the units of its texts, which returns files by name. All of
# them read the same tables; none computes anything.
FORMATS: dict[str, Callable[[Page, Units], dict[str, bytes]]] = {
    "html": html.encode,
    "json": json.encode,
    "csv": csv.encode,
    "xlsx": xlsx.encode,
}
