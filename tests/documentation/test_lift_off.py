"""The tables of the page on lift-off agree with the stored results of `python -m benchmarks.lift_off`."""

import json
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "validation" / "lift-off.md").read_text(encoding="utf-8").replace("−", "-")
ROWS = json.loads((ROOT / "benchmarks" / "results" / "lift_off.json").read_text(encoding="utf-8"))["rows"]
PERIODS = {"rigid": 0.0, "0.1 s": 0.1, "0.5 s": 0.5, "1 s": 1.0}


def stored(floors: str, period: float) -> dict:
    (row,) = (row for row in ROWS if row["η/γ"] == int(floors) and row["T_s"] == period)
    return row


def table(heading: str) -> list[list[str]]:
    """Return the cells of the table below a heading of the page, without the header."""
    text = PAGE.split(f"## {heading}\n")[1].split("\n## ")[0]
    rows = [line.strip("|").split("|") for line in text.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in row] for row in rows[2:]]


def agrees(text: str, value: float) -> bool:
    """Return whether a number in the text is the stored value, rounded to the digits of the text."""
    digits = len(text.partition(".")[2])
    return abs(float(text) - value) <= 0.5001 * 10.0**-digits


def test_verdicts():
    rows = table("Verdict")
    assert len(rows) == len(ROWS) == 12
    for floors, period, *cells in rows:
        result = stored(floors, PERIODS[period])
        for count, cell in zip((2, 3, 5), cells, strict=True):
            least, opens_from = result[f"{count}: least N"], result[f"{count}: opens from"]
            assert cell.startswith("**fails**" if least < 0 else "holds")
            assert (opens_from is None) == (least >= 0)
            number, *others = re.findall(r"-?[\d.]+", cell)
            assert agrees(number, least), (floors, period, count)
            if least < 0:
                share, lowest = others
                assert agrees(share, 100 * result[f"{count}: open scenes"]), (floors, period, count)
                assert agrees(lowest, opens_from), (floors, period, count)


def test_needed_core_distances():
    for floors, periods, static, needed, ratios, columns in table("How wide a podium has to be"):
        names = [periods] if periods == "rigid" else ["0.1 s", "0.5 s", "1 s"]
        needed, ratios, columns = ([*y.split(", ")] for y in (needed, ratios, columns))
        columns = columns * len(names) if len(columns) == 1 else columns
        for name, distance, ratio, count in zip(names, needed, ratios, columns, strict=True):
            result = stored(floors, PERIODS[name])
            assert agrees(static, result["static ℓ_p"])
            assert agrees(distance, result["needed ℓ_p"])
            assert agrees(ratio, result["over static"])
            assert int(count) == result["columns"]


@pytest.mark.parametrize(
    ("is_selected", "limit"),
    [
        (lambda row: row["T_s"] == 0 or row["η/γ"] == 1, "0.17"),
        (lambda row: row["T_s"] > 0 and row["η/γ"] > 1, "0.21"),
    ],
)
def test_friction(is_selected, limit):
    found = [row[f"{count}: friction"] for row in ROWS if is_selected(row) for count in (2, 3, 5)]
    assert agrees(limit, max(value for value in found if value is not None))
