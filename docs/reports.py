"""Make the reports of `report-gallery.md` and their pictures: `python docs/reports.py [NAME ...]`.

Pictures need Playwright and Chromium; without them the script makes only the reports.
"""

from __future__ import annotations

import contextlib
import shutil
import sys
import tempfile
from pathlib import Path

FOLDER = Path(__file__).parent / "reports"
IMAGES = Path(__file__).parent / "images"
NAMES = ("block", "tendons", "eight-storeys")
WIDTH, HEIGHT = 1100, 1000  # size of the pictures [px]


def main(names: list[str]) -> None:
    from rockjax._cli import main as command

    for name in names or NAMES:
        page = FOLDER / f"{name}.html"
        with tempfile.TemporaryDirectory() as folder:
            made = Path(folder) / page.name
            sys.argv = ["rockjax", "report", str(FOLDER / f"{name}.toml"), "-o", str(made)]
            with contextlib.suppress(SystemExit):  # status 1: some checks fail
                command()
            shutil.copy(made, page)
        photograph(page)


def photograph(page: Path) -> None:
    """Write the picture of the upper part of a page."""
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        print(f"no picture of {page.name}: pip install playwright", file=sys.stderr)
        return
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        window = browser.new_page(viewport={"width": WIDTH, "height": HEIGHT}, color_scheme="light")
        window.goto(page.as_uri())
        window.screenshot(path=str(IMAGES / f"report-{page.stem}.png"))
        browser.close()


if __name__ == "__main__":
    main(sys.argv[1:])
