"""HTML file with the whole page."""

from __future__ import annotations

from rockjax._report.blocks import Page
from rockjax._report.page import render
from rockjax._report.units import Units


def encode(page: Page, units: Units) -> dict[str, bytes]:
    """Return the page as one HTML file."""
    return {"report.html": render(page, units).encode()}
