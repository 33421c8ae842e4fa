"""Numbers of the survey in docs/practice.md and in the texts of results agree with the stored results."""

import json
from pathlib import Path

import pytest

from rockjax._practice.registry import METHODS

ROOT = Path(__file__).parents[2]
TABLE = json.loads((ROOT / "benchmarks/results/practice.json").read_text(encoding="utf-8"))
ROWS = {row["method"]: row for row in TABLE["rows"]}
PAGE = (ROOT / "docs/practice.md").read_text(encoding="utf-8")
AT_LIMIT = "(P7) q = 2, PGA = 1.93 g tan α"


def cells(start: str) -> list[str]:
    """Return the cells, except the first, of the row of the page that begins with `start`."""
    (line,) = [line for line in PAGE.splitlines() if line.startswith(f"| {start}")]
    return [cell.strip() for cell in line.strip("| ").split("|")][1:]


def share(value: float | None) -> str:
    return "none fails" if value is None else f"{100 * value:.{2 if value < 0.001 else 1}f} %"


@pytest.mark.parametrize("method", ["(P3)", "(P4)", "(P5)"])
def test_rotations_of_the_page(method):
    row = ROWS[method]
    shares = [share(row[y]) for y in ("unsafe", "overturnings missed", "false overturnings")]
    quantiles = [f"{row['5 %']:.2f}", f"{row['50 %']:.2f}", f"{row['95 %']:.1f}"]
    assert cells(method) == [*shares, *quantiles, share(row["several answers"])]


@pytest.mark.parametrize(
    ("method", "start"),
    [
        ("(P7) displacement", "(P7) displacement"),
        ("(P7) q = 2", "(P7) force, $q=2$ |"),
        (AT_LIMIT, "(P7) force, $q=2$, "),
    ],
)
def test_acceptance_of_the_page(method, start):
    columns = ("pass", "of these above 0.4 α", "of these overturned", "of those that fail within 0.4 α")
    found = [share(ROWS[method][column]).replace("100.0 %", "100 %") for column in columns]
    assert cells(start) == found


def test_the_page_names_the_survey():
    row = ROWS["(P3)"]
    scenes = f"{row['scenes']:,}".replace(",", " ")
    assert f"Measured on {row['date']}: {scenes} scenes" in PAGE
    assert f"under {row['motions']} synthetic motions" in PAGE
    assert f"{row['exact overturned']:.0%}".replace("%", " %") + " of the others overturn" in PAGE


@pytest.mark.parametrize(
    ("name", "row", "columns"),
    [
        ("priestley", "(P3)", ("unsafe", "overturnings missed", "several answers")),
        ("fema_356", "(P4)", ("unsafe", "overturnings missed", "several answers")),
        ("asce_43_05_rocking", "(P5)", ("unsafe", "overturnings missed")),
        ("circolare_displacement", "(P7) displacement", ("of these above 0.4 α", "of these overturned")),
        ("circolare_force", AT_LIMIT, ("of these above 0.4 α", "of these overturned")),
    ],
)
def test_sentences_of_the_results(name, row, columns):
    for column in columns:
        value = ROWS[row][column]
        words = f"{100 * value:.0f} %" if value > 0.1 else share(value)
        assert words in METHODS[name].reliability
