"""Numbers of the surveys in docs/practice.md and in the texts of results, and the time of an ensemble in
docs/performance.md, agree with the stored results."""

import json
from pathlib import Path

import pytest

from rockjax._practice.registry import METHODS

ROOT = Path(__file__).parents[2]
TABLE = json.loads((ROOT / "benchmarks/results/practice.json").read_text(encoding="utf-8"))
ROWS = {row["method"]: row for row in TABLE["rows"]}
ELASTIC = json.loads((ROOT / "benchmarks/results/practice-elastic.json").read_text(encoding="utf-8"))["rows"]
PAGE = (ROOT / "docs/practice.md").read_text(encoding="utf-8")
AT_LIMIT = "(P7) q = 2, PGA = 2.00 g tan α"


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


def test_rotations_of_the_circolare_on_the_page():
    row, limit = ROWS["(P7) rotation"], ROWS[AT_LIMIT]
    assert row["date"] == limit["date"]
    words = " ".join(PAGE.split())
    quantiles = f"{row['5 %']:.2f}, {row['50 %']:.2f} and {row['95 %']:.1f}"
    assert f"has the fractiles {quantiles}" in words
    scenes = f"{row['scenes']:,}".replace(",", " ")
    assert f"measured on {row['date']} in {scenes} scenes under {row['motions']} motions" in words


@pytest.mark.parametrize("row", ELASTIC, ids=lambda row: row["method"])
def test_uplift_of_elastic_buildings_on_the_page(row):
    columns = ("least", "5 %", "50 %", "95 %", "largest")
    start = row["method"] + (" |" if row["method"] == "(P2)" else "")
    found = [share(row["unsafe"]).replace("0.00 %", "0 %"), *(f"{row[column]:.2f}" for column in columns)]
    assert uplift_cells(start) == found
    buildings = f"{row['buildings']:,}".replace(",", " ")
    assert (
        f"Measured on {row['date']} for {buildings} buildings under {row['motions']} of the motions" in PAGE
    )


def test_sentences_on_elastic_buildings():
    static, bound, srss = ELASTIC
    buildings = f"{static['buildings']:,} elastic buildings".replace(",", " ")
    texts = [METHODS[name].reliability for name in ("static", "spectral_uplift")]
    assert all(buildings in text for text in texts)
    assert f"{100 * static['unsafe']:.0f} % lifted" in texts[0]
    assert f"{static['50 %']:.2f} times" in texts[0]
    assert f"{bound['least']:.2f} to {bound['largest']:.2f} times" in texts[1]
    assert f"{srss['least']:.2f} to {srss['largest']:.2f}." in texts[1]


def uplift_cells(start: str) -> list[str]:
    """Return the cells, except the first, of a row of the table of elastic buildings."""
    table = PAGE[PAGE.index("| least PGA of uplift") :]
    (line,) = [line for line in table.splitlines() if line.startswith(f"| {start}")]
    return [cell.strip() for cell in line.strip("| ").split("|")][1:]


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


def test_time_of_the_ensemble_on_the_page_of_performance():
    table = json.loads((ROOT / "benchmarks/results/ensemble.json").read_text(encoding="utf-8"))
    rotation, peaks = table["rows"]
    words = " ".join((ROOT / "docs/performance.md").read_text(encoding="utf-8").split())
    assert rotation["scenes"] == peaks["scenes"] == 10_000
    seconds = f"the rotation alone needs {rotation['seconds']:.1f} s, and three peaks with estimated errors"
    assert f"{rotation['cpu']} (family 25, model 17) {seconds} need {peaks['seconds']:.1f} s" in words
