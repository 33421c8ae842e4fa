"""Reports of a rigid podium: values compared with functions of the package, files, texts."""

import dataclasses
import html
import json
import math
import re
import subprocess
import sys
import unicodedata
from pathlib import Path

import numpy as np
import pytest
import xarray

import rockjax as rj
from rockjax._cli._report import _without_folder
from rockjax._files import write_dataset
from rockjax._problem.reading import load_table
from rockjax._report import markup
from rockjax._report.blocks import Equations, Figure, Pair, Section
from rockjax._report.kinds import KINDS
from rockjax._report.reading import problem_of
from rockjax._report.sections import rocking
from rockjax._report.sections.common import details
from rockjax._report.store import Store
from rockjax._report.tables import Quantity, plain_cell
from rockjax._report.uplift import UpliftRatio

from .browsing import MODES, assert_accessible, assert_shown, printed

FILE = """
[structure]
width = 0.6
height = 3.0
column_mass = 2700.0
beam_mass = 60e3
positions = [-4.0, 0.0, 4.0]
beam_depth = 0.5

[joints]
friction = 0.5

[motions.pulses]
kind = "ricker"
a_p = [2.5, 3.5]
T_p = 1.0

[motions.strong]
kind = "ricker"
a_p = [3.5, 30.0]
T_p = 1.0

[report]
laws = ["paper"]

[[checks]]
kind = "peak-rotation"
limit = 0.6
motions = "pulses"

[[checks]]
kind = "peak-rotation"
statistic = "mean"
limit = 0.6
motions = "strong"

[[checks]]
kind = "peak-friction"
limit = "joints.friction"
motions = "pulses"

[[checks]]
kind = "uplift-scale"
at_least = 0.5
motions = "pulses"

[[checks]]
kind = "sliding-displacement"
limit = 20
unit = "mm"
motions = "pulses"

[[checks]]
kind = "contact-pressure"
limit = 30
unit = "MPa"
motions = "pulses"

[[checks]]
kind = "by-others"
text = "Foundation"
reference = "report G-01"
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("report")


@pytest.fixture(scope="module")
def report(folder):
    path = folder / "problem.toml"
    path.write_text(FILE, encoding="utf-8")
    return rj.report(path, folder / "page.html")


@pytest.fixture(scope="module")
def checks(report):
    return {check.id: check for check in report.evaluation.checks}


def test_values_are_those_of_the_package(report, checks):
    """Peaks are bitwise those of a batch with the same outputs; the motion with the largest value governs."""
    scenes = report.evaluation.scenes
    motions = report.evaluation.problem.motions["pulses"]
    peaks = rj.peak_responses(
        report.evaluation.problem.podium, motions.excitations, options=scenes.options("pulses")
    )
    np.testing.assert_array_equal(checks["C1"].values.values, peaks.peak_rotation)
    assert checks["C1"].value == peaks.peak_rotation.max()
    assert checks["C1"].governing == 1
    assert checks["C1"].utilisation == checks["C1"].value / 0.6
    np.testing.assert_array_equal(checks["C3"].values.values, peaks.peak_friction.max(axis=-1))


def test_words(report, checks):
    """A motion that overturns fails the mean of its set. A check with a missing input is NOT MADE and names
    the key."""
    assert checks["C1"].result == "PASS"
    assert checks["C2"].result == "FAIL"
    assert checks["C2"].utilisation == math.inf
    assert "overturned at −0.2" in checks["C2"].text  # with the sign "−"; the pulse starts before t = 0
    assert checks["C2"].state == "overturned"
    assert checks["C5"].result == checks["C6"].result == "NOT MADE"
    assert "contact_width" in checks["C6"].reason
    assert checks["C7"].result == "BY OTHERS"
    assert not report.verified
    assert report.evaluation.verdict.startswith("Not verified: of 6 checks")


def test_uplift_factor_is_exact(report, checks):
    """For a rigid podium the factor is g tan α divided by the largest ground acceleration, a_p of a Ricker
    pulse."""
    podium = report.evaluation.problem.podium
    expected = float(podium.g) * np.tan(float(podium.alpha)) / np.array([2.5, 3.5])
    np.testing.assert_allclose(checks["C4"].values.values, expected, rtol=1e-8)
    slopes = checks["C4"].sensitivities  # U = 0.5 a_p/(g tan α)
    assert slopes["width"] == pytest.approx(-1, abs=1e-8)
    assert slopes["height"] == pytest.approx(1, abs=1e-8)
    assert slopes["motion"] == pytest.approx(1, abs=1e-8)
    assert slopes["column_mass"] == pytest.approx(0, abs=1e-8)


@pytest.mark.slow
def test_uplift_factor_of_a_building_with_vertical_motion():
    """Just below the factor no column lifts, just above it one does."""
    podium = rj.Podium(0.15, 3.0, 5.0, superstructure=rj.Elastic(eta=10.0, T_s=0.5, zeta=0.05))
    options = rj.Options(outputs=(UpliftRatio(),))
    motion = rj.GroundMotion(rj.Ricker(1.0, 0.6), rj.Ricker(0.5, 0.3))
    factor = 0.3
    for _ in range(2):
        factor = (
            0.9
            * factor
            / float(rj.peak_response(podium, motion.scaled(0.9 * factor), options=options).uplift_ratio)
        )
    assert not rj.peak_response(podium, motion.scaled(factor * (1 - 1e-7))).uplifted
    assert rj.peak_response(podium, motion.scaled(factor * (1 + 1e-7))).uplifted


def test_derivatives_are_those_of_differences(report, checks):
    """Derivatives with respect to every input and the factor on the motions agree with differences of
    accurate solutions."""
    problem = report.evaluation.problem
    motion = problem.motions["pulses"].excitations[1]
    options = rj.Options(rtol=1e-11, atol=1e-13, outputs=("peak_rotation",))

    def rotation(name, factor):
        podium = problem.podium if name == "motion" else problem.varied({name: factor})
        scaled = motion.scaled(factor) if name == "motion" else motion
        return float(np.log(rj.peak_response(podium, scaled, options=options).peak_rotation))

    h = 1e-4
    for name, slope in checks["C1"].sensitivities.items():
        difference = (rotation(name, 1 + h) - rotation(name, 1 - h)) / (2 * h)
        assert slope == pytest.approx(difference, rel=1e-6, abs=1e-6), name


def equations_of(report, number):
    """Return the rows of all equations of a section."""
    blocks = report.page.sections[number - 1].blocks
    return [row for block in blocks if isinstance(block, Equations) for row in block.rows]


def figures_of(block):
    """Return the pictures of a block."""
    return [block.left, block.right] if isinstance(block, Pair) else [block] * isinstance(block, Figure)


def inserted(text):
    """Return the value of numbers that are inserted in an equation, without words and units."""
    parts = [f"({part.value!r})" if isinstance(part, Quantity) else part for part in text]
    plain = re.sub(r"\(prestress.*$", "", "".join(parts))
    for mark, code in (("√", "sqrt"), ("²", "**2"), ("·", "*"), ("−", "-"), ("[", "("), ("]", ")")):
        plain = plain.replace(mark, code)
    return eval(plain, {"sqrt": math.sqrt})


def test_equations_of_the_structure(report):
    """Results of the equations of section 2 are those of the package, and follow from the inserted
    numbers."""
    podium = report.evaluation.problem.podium
    rows = {row.formula.name: row for row in equations_of(report, 2)}
    weight = 2700 * float(podium.g)
    peak = report.evaluation.scenes.peaks("pulses")["peak_rotation"].values.max() * float(podium.alpha)
    alpha, compatible = float(podium.alpha), podium.replace(restitution="compatible")
    expected = {
        "slenderness": 0.2,
        "half_diagonal": podium.R,
        "frequency_parameter": podium.p,
        "beam_mass_ratio": podium.gamma,
        "restitution_paper": podium.restitution_factor,
        "restitution_compatible": compatible.restitution_factor,
        "uplift_acceleration": podium.uplift_ground_acceleration,
        "beam_displacement": 2 * podium.R * (np.sin(alpha) - np.sin(alpha - peak)),
        "dead_load": podium.gamma * weight,
        "dead_load_bottom": (podium.gamma + 1) * weight,
        "core_distance": podium.core_distance,
    }
    for name, value in expected.items():
        assert rows[name].result.value == pytest.approx(float(value), rel=1e-12), name
        assert inserted(rows[name].numbers) == pytest.approx(float(value), rel=2e-3), name
    assert rows["mean_height"].result.value == pytest.approx(0.25)  # half the depth of the beam
    assert rows["half_diagonal"].label == "1"


def test_inputs_of_the_structure_include_the_law_of_impact(report):
    rows = {row[1].text[0].text: row for row in report.tables["inputs"].rows}
    assert rows["structure.restitution"][2].text == "paper"
    assert rows["joints.friction"][2].value == 0.5


def test_instants_of_governing_forces(report):
    """The table of section 5 names the column and the time of each force. At this time, a history of the
    package has the force, and the terms of (F3) and (F8) add up to it."""
    problem = report.evaluation.problem
    podium, mass = problem.podium, problem.column_mass
    weight = mass * float(podium.g)
    rows = {str(row[0].text): row for row in report.tables["governing-forces-pulses"].rows}
    expected = (("Least axial force N, top joint", 1, min), ("Largest axial force N, bottom joint", 0, max))
    for name, joint, worst in expected:
        _, force, motion, column, time = rows[name]
        index = problem.motions["pulses"].names.index(motion.text)
        response = rj.simulate(podium, problem.motions["pulses"].members[index])
        axial = np.asarray(response.joint_forces(time.value).axial)[:, joint] * weight
        position = column.text[1].value
        assert position == [-4.0, 0.0, 4.0][list(axial).index(worst(axial))]
        assert worst(axial) == pytest.approx(force.value, rel=1e-3)
    (force,) = (row for row in equations_of(report, 5) if row.label == "F8")
    least = rows["Least axial force N, top joint"]
    assert force.result.value == pytest.approx(least[1].value, rel=1e-3)
    numbers = [part.value for part in force.numbers if isinstance(part, Quantity)]
    signs = [1 if part == " + " else -1 for part in force.numbers if part in (" + ", " − ")]
    mean_force, x, radius, moment, lever, _ = numbers
    total = mean_force + signs[0] * x / radius**2 * (moment + signs[1] * lever * mean_force)
    assert total == pytest.approx(force.result.value, rel=1e-12)
    assert radius**2 == pytest.approx(32 / 3)
    stored = report.evaluation.scenes.store.data
    histories = [data for name, data in stored.items() if name.startswith("history.")]
    assert histories
    assert all(data.sizes["impact"] for data in histories)
    assert all(np.isin(data["impact_times"], data["time"]).all() for data in histories)


def test_steep_derivatives_of_means_are_not_shown(report):
    """Derivatives are hidden if, by a derivative, a change of the spread changes U by more than U."""
    first = report.evaluation.problem.checks[0]
    mean = dataclasses.replace(first, keys=first.keys.model_copy(update={"statistic": "mean"}))
    problem = dataclasses.replace(report.evaluation.problem, checks=(mean,))
    gentle = problem.report.model_copy(update={"spread": 1e-9})
    (check,) = rj.evaluate(dataclasses.replace(problem, report=gentle), skip=("spread",)).checks
    steepest = max(map(abs, check.sensitivities.values()))
    for spread, is_shown in ((0.99 / steepest, True), (1.01 / steepest, False)):
        settings = problem.report.model_copy(update={"spread": spread})
        only = dataclasses.replace(problem, report=settings)
        (check,) = rj.evaluate(only, skip=("spread",)).checks
        assert bool(check.sensitivities) == is_shown
        assert check.no_slopes == ("no derivative" if is_shown else "not smooth")


def numbers_of(content):
    """Return all numbers in a part of the JSON file."""
    if isinstance(content, dict):
        return [y for key, value in content.items() if key != "unit" for y in numbers_of(value)]
    if isinstance(content, list):
        return [y for value in content for y in numbers_of(value)]
    return [] if isinstance(content, str | bool) else [content]


def test_numbers_in_texts_are_numbers_in_the_json(report, checks):
    """Derivatives, times of overturning, results of the tests of assumptions and counts of motions."""
    data = json.loads(report.json)
    rows = {row["id"]: row for row in data["checks"]}
    slopes = sorted(checks["C1"].sensitivities.values(), key=lambda y: -abs(y))
    assert numbers_of(rows["C1"]["sensitivities"]) == slopes[:4]
    peaks = report.evaluation.scenes.peaks("pulses")
    assert peaks["peak_rotation_time"].values[1] in numbers_of(rows["C1"]["governs"])
    assert numbers_of(rows["C1"]["scope"]) == [2]
    time = report.evaluation.scenes.peaks("strong")["overturn_time"].values[1]
    assert (numbers_of(rows["C2"]["value"]), rows["C2"]["value"]["state"]) == ([time], "overturned")
    outcome = report.evaluation.assumptions["pulses"]["A7"]
    (row,) = (y for y in data["tables"]["assumptions"]["rows"] if y[0]["text"] == "A7")
    assert outcome.worst in numbers_of(row[4])
    for row in (*data["checks"], *data["tables"]["assumptions"]["rows"]):
        for text in strings_of(
            [y for key, y in row.items() if key != "name"] if isinstance(row, dict) else row
        ):
            assert not re.search(r"(?<![A-Za-z(])\d\.\d", text), text


def strings_of(content):
    if isinstance(content, str):
        return [content]
    values = content.values() if isinstance(content, dict) else content if isinstance(content, list) else []
    return [y for value in values for y in strings_of(value)]


def test_spread_is_that_of_changed_structures(report, checks):
    problem = report.evaluation.problem
    options = report.evaluation.scenes.options("pulses")
    narrower = rj.peak_responses(
        problem.varied({"width": 0.95}), problem.motions["pulses"].excitations, options=options
    )
    assert checks["C1"].spread["width"][0] == pytest.approx(narrower.peak_rotation.max() / 0.6, rel=1e-10)


def test_files(folder, report):
    """The files are written to one folder. A second run makes the same page from the stored scenes without
    solving any."""
    assert [path.name for path in report.written] == ["page.html", "page.json", "page.nc"]
    page = (folder / "page.html").read_text(encoding="utf-8")
    assert page == report.html
    for number in range(1, 13):
        assert f'id="s{number}"' in page
    for word in ("nan", "inf", "None", "{{"):
        assert f">{word}<" not in page
    again = rj.report(folder / "problem.toml", folder / "page.html")
    assert again.evaluation.scenes.store.computed == 0
    assert again.html == page
    found = json.loads((folder / "page.json").read_text(encoding="utf-8"))
    assert found["schema"]
    tables = report.to_csv(folder / "csv")
    assert {path.stem for path in tables} == set(report.tables)


OPTIONAL = (
    "[project]",
    "[joints]",
    "[sources]",
    "[report]",
    "positions beam_depth",
    "beam_depth",
    "number",
    "friction",
)


def test_the_same_input_gives_the_same_bytes(folder, report, monkeypatch):
    """On another day one line differs."""
    pages = []
    for seconds in ("1700000000", "1700000000", "1800000000"):
        monkeypatch.setenv("SOURCE_DATE_EPOCH", seconds)
        pages.append(rj.report(folder / "problem.toml", folder / "page.html").html)
    assert pages[0] == pages[1]
    lines = [page.splitlines() for page in pages]
    assert len(lines[0]) == len(lines[2])
    assert sum(a != b for a, b in zip(lines[0], lines[2], strict=True)) == 1


def test_scenes_of_an_older_problem_do_not_change_the_page(folder, report):
    store = Store(folder / "page.nc")
    store.get("peaks.older", "inputs", lambda: xarray.Dataset({"result": ("motion", [0, 0])}))
    store.path = folder / "older.nc"
    store.save()
    assert rj.report(folder / "problem.toml", folder / "older.html").html == report.html


def test_values_of_the_command_line_have_no_source_in_the_file(tmp_path):
    path = tmp_path / "problem.toml"
    path.write_text('[sources]\n"structure.width" = "drawing"\n"structure.height" = "drawing"\n' + FILE)
    table = load_table(path)
    table["structure"] = table["structure"] | {"width": 0.65, "beam_mass": 60e3}
    problem = problem_of(table, path)
    sources = {entry.key: entry.source for entry in problem.inputs}
    assert sources["width"] == problem.sources["structure.width"] == "command line"
    assert (sources["height"], sources["beam_mass"]) == ("drawing", None)


def test_inputs_of_all_tables_are_counted(tmp_path):
    path = tmp_path / "problem.toml"
    sources = '"structure.width" = "drawing"\n"joints.friction" = "test"\n"motions.pulses.a_p" = "study"\n'
    path.write_text(f"[sources]\n{sources}" + FILE)
    found = rj.read_problem(path).sources_of_inputs({"pulses", None})
    assert found["structure.width"] == "drawing"
    assert found["structure.height"] is None
    assert {name: y for name, y in found.items() if not name.startswith("structure.")} == {
        "joints.friction": "test",
        "motions.pulses": "study",
    }


def test_a_check_that_stops_with_an_error_is_not_made(folder, report, monkeypatch):
    """The other checks are made."""

    def fail(*arguments, **options):
        raise KeyError("a name")

    kind = type(report.evaluation.checks[3].kind)
    monkeypatch.setattr(kind, "values", fail)
    monkeypatch.setattr(kind, "start", fail)
    checks = rj.evaluate(folder / "problem.toml", store=folder / "page.nc", skip=("methods",)).checks
    assert checks[3].result == "NOT MADE"
    assert checks[3].reason == "KeyError: 'a name'"
    assert [y.result for y in checks[:3]] == [y.result for y in report.evaluation.checks[:3]]


def test_details_that_stop_with_an_error_are_a_text(report, monkeypatch):
    def fail(*arguments, **options):
        raise KeyError

    check = report.evaluation.checks[3]
    monkeypatch.setattr(type(check.kind), "tables", fail)
    (table,) = [table for table in details(report.evaluation, 4) if table.name == "details-c4"]
    assert table.rows[0][0].text == "KeyError"


@pytest.mark.parametrize("gone", OPTIONAL)
def test_every_section_has_content_without_an_optional_entry(tmp_path, gone):
    texts = """[project]
title = "Title"
number = "1"

[sources]
"structure.width" = "drawing 1"
"""
    file = texts + FILE.replace('"joints.friction"', "0.5")
    blocks = [block for block in file.split("\n\n") if not block.strip().startswith(gone)]
    names = tuple(f"{name} =" for name in gone.split())
    lines = [line for line in "\n\n".join(blocks).splitlines() if not line.startswith(names)]
    assert len(lines) < len(file.splitlines())
    path = tmp_path / "problem.toml"
    path.write_text("\n".join(lines), encoding="utf-8")
    made = rj.report(path)
    assert [section.number for section in made.page.sections] == list(range(1, 13))
    assert all(section.blocks for section in made.page.sections)
    assert all(table.rows for table in made.page.tables())
    text = re.sub(r"<(style|svg|pre)\b.*?</\1>|<[^>]*>", " ", made.html, flags=re.DOTALL)
    assert not re.search(r"\b(nan|inf|None)\b|\{\{|\{%", text)


def test_a_joint_that_opens(tmp_path):
    """The heavy beam lies so high that a joint opens. Checks of the motion are not valid, the check of the
    friction fails, and the page states when the joint opens."""
    path = tmp_path / "problem.toml"
    text = FILE.replace("positions = [-4.0, 0.0, 4.0]", "positions = [-1.0, 0.0, 1.0]")
    path.write_text(text.replace("beam_depth = 0.5", "beam_depth = 6.0"), encoding="utf-8")
    made = rj.report(path, skip=("spread", "methods"))
    checks = {check.id: check for check in made.evaluation.checks}
    assert (checks["C1"].result, checks["C1"].violated) == ("NOT VALID", ("A7",))
    assert (checks["C3"].result, checks["C3"].state) == ("FAIL", "joint opens")
    row = next(y for y in made.tables["assumptions"].rows if y[0].text == "A7")
    assert row[3].state == "violated"
    assert not made.verified
    problem = made.evaluation.problem
    response = rj.simulate(problem.podium, problem.motions["pulses"].members[checks["C3"].governing])
    time = float(re.search(r"joint opens at (\S*) s", made.html)[1].replace("−", "-"))
    least = [float(np.min(response.joint_forces(time + dt).axial)) for dt in (-0.05, 0.02)]
    assert least[0] >= 0 > least[1]


def test_another_text_solves_nothing_again(folder, report):
    path = folder / "titled.toml"
    path.write_text(f'[project]\ntitle = "Another"\n{FILE}', encoding="utf-8")
    (folder / "titled.nc").write_bytes((folder / "page.nc").read_bytes())
    titled = rj.report(path, folder / "titled.html")
    assert titled.evaluation.scenes.store.computed == 0
    assert "Another" in titled.html


@pytest.mark.parametrize(("width", "theme"), MODES)
def test_a_browser_shows_the_report(browser, folder, report, width, theme):
    assert_shown(browser, folder / "page.html", width, theme)


@pytest.mark.parametrize(("width", "theme"), MODES)
def test_the_report_is_accessible(browser, folder, report, width, theme):
    assert_accessible(browser, folder / "page.html", width, theme)


def test_the_printed_report_has_every_row(browser, folder, report):
    """The summary is on page 1, and every row is on one page."""
    pages = printed(browser, folder / "page.html")
    # In the text of the page, words may follow each other without a blank.
    assert all(re.search(rf"{check.id}(?!\d)", pages[0]) for check in report.evaluation.checks)
    missing = []
    for name, table in report.tables.items():
        for row in table.rows if name != "summary" else ():  # the summary has bars and symbols instead
            text = " ".join(plain_cell(cell, report.units, shows_unit=False) for cell in row)
            words = unicodedata.normalize("NFKC", text).split()
            if not any(all(word in page for word in words) for page in pages):
                missing.append((name, words))
    assert missing == [], missing


def test_wrong_arguments(folder, report):
    with pytest.raises(ValueError, match=r"must be a \.html file.*print the page"):
        rj.report(folder / "problem.toml", folder / "page.pdf")
    with pytest.raises(ValueError, match="skip may contain only risk, methods, spread"):
        rj.evaluate(folder / "problem.toml", skip=("all",))
    with pytest.raises(ValueError, match="units"):
        rj.report(folder / "problem.toml", units="furlong")


def test_ctrl_c_at_ten_moments(tmp_path, report, monkeypatch):
    """The old page stays, solved scenes are stored, and the same command continues from them."""
    stored, get = report.evaluation.scenes.store.data, Store.get
    path, page = tmp_path / "problem.toml", tmp_path / "page.html"
    path.write_text(FILE, encoding="utf-8")
    page.write_text("old", encoding="utf-8")
    moments = np.unique(np.linspace(0, len(stored) - 1, 10).astype(int)).tolist()
    assert len(moments) == 10

    def interrupted(store, name, mark, compute):
        if name not in store.data and len(store.data) == moments[0]:
            raise KeyboardInterrupt
        return get(store, name, mark, lambda: stored[name].copy())

    monkeypatch.setattr(Store, "get", interrupted)
    monkeypatch.setattr(Store, "start", lambda *arguments: False)  # other threads would store more
    while moments:
        with pytest.raises(KeyboardInterrupt):
            rj.report(path, page)
        assert len(Store(tmp_path / "page.nc").data) == moments.pop(0)
        assert page.read_text(encoding="utf-8") == "old"
    monkeypatch.undo()
    last = rj.report(path, page)
    assert last.evaluation.scenes.store.computed == 1
    assert last.html == report.html
    assert not (tmp_path / "page.partial.nc").exists()


def test_ctrl_c_while_the_page_is_made_keeps_the_old_one(folder, tmp_path, report, monkeypatch):
    """Neither the page nor its numbers are replaced, wherever the interruption comes."""
    for name in ("problem.toml", "page.nc"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    names = "page.html", "page.json"
    for name in names:
        (tmp_path / name).write_text("old", encoding="utf-8")

    def interrupt(*arguments, **options):
        raise KeyboardInterrupt

    places = (Section, "__post_init__"), (Figure, "__post_init__"), (markup, "table")
    for owner, attribute in places:
        with monkeypatch.context() as patch:
            patch.setattr(owner, attribute, interrupt)
            with pytest.raises(KeyboardInterrupt):
                rj.report(tmp_path / "problem.toml", tmp_path / "page.html")
        assert [(tmp_path / name).read_text(encoding="utf-8") for name in names] == ["old", "old"], attribute


def test_hostile_texts_of_a_problem_stay_texts(browser, folder, tmp_path, report):
    """Texts of every table of a file are shown as they are, and fit on a phone."""
    script, braces = "<script>alert(1)</script>", "{{ 7 * 7 }}"
    texts = {"title": script + "x" * 400, "subject": braces, "author": "=1+1", "revision": "$x_{"}
    project = "".join(f"{key} = {json.dumps(text)}\n" for key, text in texts.items())
    file = FILE.replace("[report]\n", f"[report]\nmotions = {{ pulses = {json.dumps(script)} }}\n")
    names = f"name = {json.dumps('n' * 400)}\nclause = {json.dumps(braces + script)}\n"
    file = file.replace("[[checks]]\n", f"[[checks]]\nid = {json.dumps(script)}\n{names}", 1)
    path = tmp_path / "problem.toml"
    path.write_text(
        f'[project]\n{project}[sources]\n"structure.width" = "{braces}"\n{file}', encoding="utf-8"
    )
    (tmp_path / "page.nc").write_bytes((folder / "page.nc").read_bytes())
    made = rj.report(path, tmp_path / "page.html", skip=("methods",))
    assert "<script" not in made.html
    assert not {y.id for y in made.evaluation.checks} - {script, "C2", "C3", "C4", "C5", "C6", "C7"}
    assert all(made.html.count(html.escape(text)) for text in (*texts.values(), "n" * 400))
    assert_shown(browser, tmp_path / "page.html", 390, "light")


def test_rotation_under_multiples_of_a_motion_is_drawn(report, monkeypatch):
    """Section 4 draws the governing motion multiplied by 32 factors, with the answers of the package."""
    evaluation = report.evaluation
    check = dataclasses.replace(
        evaluation.checks[0],
        entry=dataclasses.replace(evaluation.checks[0].entry, limit=1.5),
        kind=KINDS["overturning-scale"],
    )
    evaluation = dataclasses.replace(evaluation, checks=(check,))
    windows = {"factor": 2.1, "survives_from": np.nan, "overturns_again_from": np.nan, "end": 10.0}
    windows |= {"window_end": 4.2, "is_open": False}
    data = xarray.Dataset({name: ("motion", [y, y]) for name, y in windows.items()})
    monkeypatch.setattr(rocking, "least_factors", lambda *arguments: data)
    store = evaluation.scenes.store  # other tests use it too
    monkeypatch.setattr(store, "data", dict(store.data))
    figure = rocking._factors(evaluation, "pulses", 1, report.units)
    assert figure.description.endswith("; the least factor that overturns the columns is 2.1.")
    assert "limit of C1" in figure.svg
    drawn = store.data["factors.pulses.1"]  # factors from 3.15/32 to 3.15, the tenth of which is 1
    rotation = evaluation.scenes.peaks("pulses")["peak_rotation"].values[1]
    assert drawn["peak_rotation"].values[9] == rotation


def test_damaged_store_is_ignored(folder, report):
    (folder / "bad.nc").write_bytes(b"not a netCDF file")
    assert Store(folder / "bad.nc").data == {}


@pytest.mark.parametrize("quiet", [True, False])
def test_the_command_writes_the_page(folder, report, quiet):
    """The command uses stored scenes and solves one additional check; the exit status is 1 for a failure."""
    from typer.testing import CliRunner

    from rockjax._cli import app

    path, output = folder / f"command-{quiet}.toml", folder / f"command-{quiet}.html"
    more = '[[checks]]\nkind = "displacement"\nlimit = 500\nunit = "mm"\nmotions = "pulses"\n'
    path.write_text(FILE + more, encoding="utf-8")
    output.with_suffix(".nc").write_bytes((folder / "page.nc").read_bytes())
    words = ["report", str(path), "-o", str(output), "--csv", str(folder / f"tables-{quiet}")]
    found = CliRunner().invoke(app, [*words, *(["-q"] if quiet else [])])
    assert found.exit_code == 1, found.output
    assert "u_b at max|θ|" in output.read_text(encoding="utf-8")
    assert ("Not verified: of 7 checks" in found.output) != quiet
    assert (folder / f"tables-{quiet}" / "summary.csv").exists()


def run(*words):
    """Run a command line, and return the result."""
    from typer.testing import CliRunner

    from rockjax._cli import app

    return CliRunner().invoke(app, ["report", *map(str, words)])


def with_scenes(folder, name, text):
    """Write a problem file, and beside its page the solved scenes of the first report. Return both paths."""
    path, output = folder / f"{name}.toml", folder / f"{name}.html"
    path.write_text(text, encoding="utf-8")
    output.with_suffix(".nc").write_bytes((folder / "page.nc").read_bytes())
    return path, output


def test_options_of_the_command(folder, report):
    """Units change the page, but not the numbers in the JSON file. Parts that are left out are named."""
    path, output = with_scenes(folder, "options", FILE)
    workbook = folder / "options.xlsx"
    found = run(path, "-o", output, "--units", "MN,cm", "--xlsx", workbook, "--skip", "spread", "--json")
    assert found.exit_code == 1, found.output
    result = json.loads(found.stdout)
    assert result["checks"]["C1"] == "PASS"
    assert result["verdict"] == report.evaluation.verdict
    assert workbook.exists()
    page = output.read_text(encoding="utf-8")
    assert "[cm]" in page
    assert "Left out on request: spread." in page
    tables = [json.loads(y.read_text()) for y in (output.with_suffix(".json"), folder / "page.json")]
    same = [
        {key: y["tables"][key] for key in ("rotation-pulses", "inputs", "modes") if key in y["tables"]}
        for y in tables
    ]
    assert same[0] == same[1]


def test_a_report_whose_checks_pass_has_the_exit_status_0(folder, report):
    only_first = FILE[: FILE.index("[[checks]]", FILE.index("[[checks]]") + 1)]
    path, output = with_scenes(folder, "passing", only_first)
    found = run(path, "-o", output, "-q", "--skip", "spread,methods")
    assert found.exit_code == 0, found.output
    assert "Verified: the only check passes." in output.read_text(encoding="utf-8")


def test_wrong_options_of_the_command(folder, report, monkeypatch):
    """Nothing is computed or written."""
    path, output = with_scenes(folder, "wrong", FILE)
    found = run(path, "-o", folder / "wrong.pdf")
    assert isinstance(found.exception, ValueError)
    assert "print the page from a browser" in str(found.exception)
    monkeypatch.setitem(sys.modules, "xlsxwriter", None)
    found = run(path, "-o", output, "--xlsx", folder / "wrong.xlsx")
    assert isinstance(found.exception, ValueError)
    assert "pip install" in str(found.exception)
    assert not output.exists()


def test_the_json_does_not_depend_on_the_units_of_the_page(report, monkeypatch):
    store = report.evaluation.scenes.store  # other tests use it too
    monkeypatch.setattr(store, "data", dict(store.data))
    other = rj.report(report.evaluation, units="N,cm,rad,m/s2")
    assert other.json == report.json
    assert "Elevation to scale. Lengths in m (column at the right: in mm)." in report.html
    assert "Elevation to scale. Lengths in cm (column at the right: in cm)." in other.html


def test_a_report_from_an_evaluation(folder, report):
    again = rj.report(report.evaluation, units="MN,cm")
    assert again.tables.keys() == report.evaluation.tables.keys() == report.tables.keys()
    assert again.tables["rotation-pulses"] == report.tables["rotation-pulses"]
    assert again.written == ()
    assert again._repr_html_().startswith("<iframe srcdoc=")
    assert again.to_xlsx(folder / "again.xlsx").stat().st_size > 1000
    assert "C1     PASS" in repr(again)


@pytest.mark.parametrize("is_solved", [False, True])
def test_an_interrupted_command_names_the_file_with_the_scenes(tmp_path, monkeypatch, is_solved):
    from typer.testing import CliRunner

    from rockjax._cli import app

    def interrupted(problem, skip, store, progress, start_page):
        with store.saved_on_interruption():
            if is_solved:
                store.get("scenes", "inputs", xarray.Dataset)
            raise KeyboardInterrupt

    monkeypatch.setattr("rockjax._report.report.evaluate_with_store", interrupted)
    (tmp_path / "problem.toml").write_text(FILE, encoding="utf-8")
    words = ["report", str(tmp_path / "problem.toml"), "-o", str(tmp_path / "page.html"), "-q"]
    found = CliRunner().invoke(app, words)
    assert found.exit_code == 130
    assert ("page.partial.nc" in found.output.replace("\n", "")) == is_solved
    assert ("no results were saved" in found.output) != is_solved


@pytest.mark.parametrize(
    ("word", "expected"),
    [
        ("{}/problem.toml", "problem.toml"),
        ("--output={}/report.html", "--output=report.html"),
        ("--units=kN,m/s2", "--units=kN,m/s2"),
        ("kN,m/s2", "kN,m/s2"),
        ("a/name/of/no/folder", "a/name/of/no/folder"),
    ],
)
def test_the_printed_command_has_no_folders(word, expected, tmp_path):
    assert _without_folder(word.format(tmp_path)) == expected


@pytest.mark.parametrize("option", ["", "--output=", "-o"])
def test_the_printed_command_has_no_folders_that_do_not_exist_yet(option):
    path = Path("/home/ann/new/page.html")
    assert _without_folder(f"{option}{path}", [Path("problem.toml"), path]) == f"{option}page.html"
    assert _without_folder("layout/x.html", [Path("out/x.html")]) == "layout/x.html"


@pytest.mark.slow
def test_annual_frequency_is_that_of_the_package(tmp_path):
    """The frequency from `[fragility]` and the hazard curve of `[risk]` equals that of
    `rj.annual_frequency`."""
    (tmp_path / "hazard.csv").write_text("PGA [m/s2],rate [1/year]\n1.0,0.02\n3.0,0.002\n10.0,0.00005\n")
    path = tmp_path / "problem.toml"
    path.write_text(
        "[structure]\nwidth = 0.6\nheight = 3.0\ncolumn_mass = 2700.0\nbeam_mass = 60e3\n"
        "[motions.design]\nsynthetic = 6\nseed = 3\n"
        "[fragility]\nintensity = [1.0, 16.0]\nlevels = 6\nsensitivities = ['gamma']\n"
        "[risk]\nhazard = 'hazard.csv'\n"
        "[[checks]]\nkind = 'annual-frequency'\nat_most = 1e-3\nmotions = 'design'\n"
    )
    report = rj.report(path, skip=("methods",))
    (check,) = report.evaluation.checks
    suite, podium = rj.synthetic_motions(6, seed=3), report.evaluation.problem.podium
    analysis = rj.incremental_dynamic_analysis(podium, suite, np.linspace(1.0, 16.0, 6))
    hazard = rj.Hazard.from_file(tmp_path / "hazard.csv").in_si()
    expected = rj.annual_frequency(rj.fragility(analysis), hazard)
    assert check.value == float(expected.frequency)  # bit for bit
    # Without a building, the mass of the beam changes γ only.
    assert check.sensitivities["beam_mass"] == pytest.approx(check.sensitivities["gamma"], rel=1e-6)
    assert {"width", "height", "column_mass", "e"} <= check.sensitivities.keys()
    labels = [row[0].text for row in report.tables["annual-c1"].rows]
    assert "d ln λ_f/d ln structure.width" in labels
    assert check.result == ("PASS" if check.value <= 1e-3 else "FAIL")
    assert {"fragility-design-pga", "annual-c1"} <= report.tables.keys()
    titles = [figure.title for block in report.page.blocks() for figure in figures_of(block)]
    expected = "Rotation as a function of PGA, set design", "Fragility of the set design"
    assert {*expected, "Annual frequency of check C1"} <= set(titles)
    write_dataset(tmp_path / "curve.nc", rj.fragility(analysis))  # the same curve, from a file
    text = path.read_text().replace("[risk]\n", "[risk]\nfragility = 'curve.nc'\n")
    path.write_text(text)
    (given,) = rj.evaluate(path).checks
    assert given.value == check.value
    path.write_text(text.replace("width = 0.6", "width = 0.61"))
    with pytest.raises(ValueError, match=r"risk: curve\.nc is for another structure"):
        rj.read_problem(path)


def test_problem_files_are_read_without_slow_imports():
    """Importing scipy.stats takes half a second, and few reports need it."""
    slow = "[name in sys.modules for name in ('scipy.stats', 'matplotlib')]"
    script = f"import sys, rockjax._report.reading\nprint(*{slow})"
    output = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert output.stdout.split() == ["False", "False"]


BARE = """
[structure]
width = 0.6
height = 3.0
column_mass = 2700.0
positions = [-2.0, 2.0]
tendon_stiffness = 1e5
[motions.one]
synthetic = 1
seed = 3
[report]
laws = []
[[checks]]
kind = "peak-rotation"
at_most = 0.5
[[checks]]
kind = "least-axial-force"
at_least = 0.1
"""


@pytest.mark.slow
def test_a_page_of_columns_that_carry_nothing_under_one_record(tmp_path):
    """The top joint has no dead load, the masses on the columns have no mean height, and numbers that belong
    to the only motion do not belong to the structure."""
    (tmp_path / "problem.toml").write_text(BARE, encoding="utf-8")
    page = rj.report(tmp_path / "problem.toml", tmp_path / "page.html", skip=("spread",))
    assert all(check.value is not None for check in page.evaluation.checks)
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "no dead load" in text
    assert not re.search(r"\bnan\b", text)
