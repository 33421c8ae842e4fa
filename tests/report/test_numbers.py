"""Numbers in the files of a solved report: those of the functions of the package, and equal in all files."""

import json

import numpy as np
import pytest

import rockjax as rj
from rockjax._report.tables import Quantity, format_number
from rockjax._report.units import NO_UNIT

from .solved import EXAMPLES
from .test_page import OTHERS, UNITS, assert_equal_numbers, files_of, parsed, visible


@pytest.fixture(scope="module")
def document(solved):
    return json.loads((solved.folder / "page.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def peaks(solved):
    evaluation = solved.report.evaluation
    problem, options = evaluation.problem, evaluation.scenes.options("design")
    return rj.peak_responses(problem.podium, problem.motions["design"].excitations, options=options)


def checks_of(document):
    return {check["id"]: check for check in document["checks"]}


def test_peaks_are_bitwise_those_of_the_package(solved, document, peaks):
    checks = checks_of(document)
    expected = {
        "C1": peaks.peak_rotation.max(),
        "C2": np.mean(peaks.peak_rotation),
        "C5": peaks.peak_friction.max(),
    }
    assert {name: checks[name]["value"]["value"] for name in expected} == {
        name: float(y) for name, y in expected.items()
    }
    table = document["tables"]["rotation-design"]
    k = [column["head"] for column in table["columns"]].index("max|θ|/α")
    assert [row[k]["value"] for row in table["rows"]] == np.asarray(peaks.peak_rotation).tolist()
    assert [row[k]["error"] for row in table["rows"]] == np.asarray(peaks.errors.peak_rotation).tolist()


def test_displacements_follow_from_rotations(document, peaks):
    """u_b of Eq. (13)."""
    alpha = np.arctan(0.6 / 3.0)
    rotation = alpha * float(peaks.peak_rotation.max())
    u_b = np.hypot(0.6, 3.0) * (np.sin(alpha) - np.sin(alpha - rotation))
    assert checks_of(document)["C4"]["value"]["value"] == pytest.approx(u_b, rel=1e-13)


def test_the_annual_frequency_is_bitwise_that_of_the_package(document):
    hazard = rj.Hazard.from_file(EXAMPLES / "hazard.csv").in_si()
    annual = rj.annual_frequency(rj.Lognormal(np.array(5.0), np.array(0.4)), hazard)
    assert checks_of(document)["C8"]["value"]["value"] == float(annual.frequency)
    values = [row[1].get("value") for row in document["tables"]["annual-c8"]["rows"]]
    assert values[:2] == [float(annual.frequency), float(annual.return_period)]


def test_utilisations_follow_from_values_and_limits(document):
    for check in document["checks"]:
        if "value" in check["utilisation"] and "value" in check["limit"]:
            value, limit = check["value"]["value"], check["limit"]["value"]
            ratio = value / limit if check["limit"]["sense"] == "at most" else limit / value
            assert check["utilisation"]["value"] == ratio
            assert check["result"] in (("FAIL",) if ratio > 1 else ("PASS", "NOT VALID"))


@pytest.mark.parametrize("units", [UNITS, OTHERS])
def test_the_summary_has_the_numbers_of_the_json_file(solved, document, units):
    rows = next(parsed(files_of(solved.report.page, units)["report.html"]).iter("table")).findall("tbody/tr")
    kinds = {check.id: check.entry.quantity for check in solved.report.evaluation.checks}
    checks = checks_of(document)
    assert [visible(row[0]) for row in rows] == list(checks) == list(kinds)
    shown = 0
    for row in rows:
        check = checks[visible(row[0])]
        value, text = check["value"], visible(row)
        if "value" in value:
            quantity = Quantity(value["value"], kinds[check["id"]], value.get("error"))
            assert format_number(quantity, units) in text
            symbol = units.symbol(kinds[check["id"]])
            assert symbol == NO_UNIT or symbol in text
            shown += 1
        assert check["result"] in text
    assert shown == 7


def test_all_files_have_the_numbers_of_the_report(solved):
    assert_equal_numbers(solved.report.page, UNITS)


def test_no_cell_of_the_report_is_blank(solved):
    tables = list(parsed(solved.report.html.encode()).iter("table"))
    assert len(tables) == len(solved.report.tables)
    for row in (row for table in tables for row in table.findall("tbody/tr")):
        assert all(visible(cell).strip() not in ("", "-", "–", "—", "nan", "inf", "None") for cell in row)
