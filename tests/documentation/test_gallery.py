"""The reports of the gallery have the style, the structure and the inputs that the package gives them now."""

import ast
import html
import re
from pathlib import Path

import pytest

import rockjax._report
from rockjax._report import page

ROOT = Path(__file__).parents[2]
REPORTS = ROOT / "docs/reports"
CODE = Path(rockjax._report.__file__).parent
NAMES = ["block", "tendons", "eight-storeys"]
CURE = "run `python docs/reports.py`"


def headings():
    """Return the headings of the sections in the source code, by number."""
    calls = [
        node
        for path in (CODE / "sections").glob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "Section"
    ]
    return dict(
        sorted((y.args[0].value, y.args[1].value) for y in calls if isinstance(y.args[1], ast.Constant))
    )


@pytest.mark.parametrize("name", NAMES)
def test_a_report_has_the_style_and_the_fixed_parts_of_the_template(name):
    text = (REPORTS / f"{name}.html").read_text(encoding="utf-8")
    assert page._read("page.css") in text, CURE
    assert page._font() in text, CURE
    fixed = [line for line in page._read("page.html.jinja").splitlines() if not set(line) & set("{}")]
    assert len(fixed) > 5
    assert [line for line in fixed if line not in text] == [], CURE


@pytest.mark.parametrize("name", NAMES)
def test_a_report_has_the_sections_of_the_code(name):
    text = (REPORTS / f"{name}.html").read_text(encoding="utf-8")
    found = re.findall(r'<h2 id="s(\d+)">\1 (.*?)</h2>', text)
    expected = headings()
    assert [int(number) for number, _ in found] == list(range(1, 13)), CURE
    assert len(expected) >= 10
    assert {number: html.unescape(title) for number, title in found if int(number) in expected} == {
        str(number): title for number, title in expected.items()
    }, CURE


@pytest.mark.parametrize("name", NAMES)
def test_a_report_has_the_problem_file_and_its_checks(name):
    text = (REPORTS / f"{name}.html").read_text(encoding="utf-8")
    problem = (REPORTS / f"{name}.toml").read_text(encoding="utf-8")
    annex = html.unescape(text[text.rindex("<pre") :])
    assert problem.strip() in annex, CURE
    rows = re.findall(r'<tr class="\w+" id="([^"]+)">', text)
    assert len(rows) == len(re.findall(r"^\[\[(checks|targets)\]\]", problem, re.MULTILINE)) > 0, CURE
    assert len(set(rows)) == len(rows)


def test_the_documentation_builds_the_gallery():
    (session,) = re.findall(
        r"\ndef docs\(.*?\n\n\n", (ROOT / "noxfile.py").read_text(encoding="utf-8"), re.DOTALL
    )
    assert '"docs/reports.py"' in session
