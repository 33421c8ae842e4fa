"""File formats of a report. To add a format, write a module with a function `encode` and add it to
`FORMATS`."""

from __future__ import annotations

from collections.abc import Callable

from rockjax._report.blocks import Page
from rockjax._report.units import Units

from . import csv, html, json, xlsx

# Name of a format → function (page, units of the page) ↦ {name of a file: content}. These functions convert
# units and compute nothing else.
FORMATS: dict[str, Callable[[Page, Units], dict[str, bytes]]] = {
    "html": html.encode,
    "json": json.encode,
    "csv": csv.encode,
    "xlsx": xlsx.encode,
}
