"""Pages of reports and their files: escaped texts, equal numbers, reproducible bytes, valid HTML."""

import csv
import dataclasses
import html
import io
import json
import re
import sys
import xml.etree.ElementTree as ET
import zipfile
from importlib.resources import files

import html5lib
import pytest

from rockjax._report import blocks, formulas, markup
from rockjax._report._formats import FORMATS
from rockjax._report._formats.xlsx import check_path
from rockjax._report.page import css_string
from rockjax._report.tables import Quantity, Table, format_number, plain
from rockjax._report.units import KINDS, Units, si_unit

from . import sample
from .browsing import MODES, assert_accessible, assert_shown, printed

UNITS = Units.parse("kN,m,deg,g,mm")
OTHERS = Units.parse("N,cm,rad,m/s²,Pa,kg,–,N/m,Nm")
XML = {"main": "http://schemas.openxmlformats.org/spreadsheetml/2006/main"}


def files_of(page, units=UNITS):
    return {name: content for encode in FORMATS.values() for name, content in encode(page, units).items()}


def parsed(content):
    """Return the elements of a page; invalid HTML raises an error."""
    return html5lib.HTMLParser(strict=True, namespaceHTMLElements=False).parse(content.decode())


def visible(element):
    return "".join(element.itertext())


def csv_rows(content):
    assert content.startswith(b"\xef\xbb\xbf")
    return list(csv.reader(io.StringIO(content.decode("utf-8-sig"), newline="")))


def sheets(content):
    """Return the rows of cells by sheet name, with numbers as numbers; a formula raises an error."""
    archive = zipfile.ZipFile(io.BytesIO(content))
    read = lambda name: ET.fromstring(archive.read(name))
    texts = ["".join(entry.itertext()) for entry in read("xl/sharedStrings.xml").findall("main:si", XML)]
    found = {}
    for k, sheet in enumerate(read("xl/workbook.xml").iter(f"{{{XML['main']}}}sheet"), 1):
        rows = read(f"xl/worksheets/sheet{k}.xml").findall("main:sheetData/main:row", XML)
        assert not [cell for row in rows for cell in row if cell.find("main:f", XML) is not None]
        value = lambda cell: float(cell[0].text) if cell.get("t") != "s" else texts[int(cell[0].text)]
        found[sheet.get("name")] = [[value(cell) for cell in row] for row in rows]
    return found


@pytest.mark.smoke
def test_a_page_is_sound_html():
    page = sample.page()
    content = files_of(page)["report.html"]
    root = parsed(content)
    ids = [element.get("id") for element in root.iter() if element.get("id")]
    assert len(set(ids)) == len(ids)
    links = [element.get("href") for element in root.iter("a")]
    assert {link.removeprefix("#") for link in links} <= set(ids)
    assert [visible(heading) for heading in root.iter("h1")] == ["Example podium"]
    assert [visible(heading) for heading in root.iter("h2")] == [part.heading for part in page.sections]
    assert not list(root.iter("script"))
    assert all(cell.get("scope") in ("col", "row") for cell in root.iter("th"))
    assert all(table.find("caption") is not None for table in root.iter("table"))
    assert "default-src 'none'" in content.decode()
    assert not re.search(r"(src|href)\s*=\s*[\"']?(https?:|//|file:)", content.decode())
    assert len(content) < 1_000_000


def test_tables_are_complete_on_the_page():
    root = parsed(files_of(sample.page())["report.html"])
    tables = list(root.iter("table"))
    assert len(tables) == 5
    for table in tables:
        assert table.findall("tbody/tr")
        for row in table.findall("tbody/tr"):
            cells = list(row)
            assert all(visible(cell).strip() not in ("", "-", "–", "—") for cell in cells)
            width = sum(int(cell.get("colspan", 1)) for cell in cells)
            assert width == len(table.findall("thead/tr/th"))
    assert not re.search(r"\b(nan|inf|None|Undefined)\b|\{\{|\{%", visible(root.find("body")))


@pytest.mark.parametrize("text", sample.HOSTILE)
def test_texts_of_a_file_stay_texts(text):
    page = sample.page(text=text)
    made = files_of(page)
    root = parsed(made["report.html"])
    assert not list(root.iter("script"))
    assert visible(root.find("body//h1")) == f"{text} podium"
    assert text in visible(root.find("head/title"))
    table = next(table for table in root.iter("table") if "Inputs" in visible(table.find("caption")))
    assert [visible(row[-1]) for row in table.findall("tbody/tr")][:-1] == [text] * 5
    assert text in visible(list(root.iter("pre"))[-1])
    styles = [element for element in root.iter("style") if element is not root.find("head/style")]
    assert styles == []
    document = json.loads(made["report.json"])
    assert document["tables"]["inputs"]["rows"][0][-1] == {"text": text, "state": "text"}
    protected = "'" + text if text.startswith("=") else text
    assert csv_rows(made["inputs.csv"])[1][-1] == protected
    assert sheets(made["report.xlsx"])["inputs"][2][-1] == text


def test_a_text_in_css_ends_nowhere():
    assert css_string("a b7") == "a b7"
    assert css_string('"</style>\n\\') == r"\000022 \00003c \00002f style\00003e \00000a \00005c "


def test_control_characters_do_not_reach_the_page():
    assert (
        markup.safe("a\x00b\x1bc\ud800<")
        == "a\N{REPLACEMENT CHARACTER}b\N{REPLACEMENT CHARACTER}c\N{REPLACEMENT CHARACTER}&lt;"
    )


def test_a_file_of_windows_keeps_its_lines():
    page = sample.page()
    text = '\r\n[project]\r\ntitle = "a"\r\n'
    annex = blocks.Section(14, "More", (blocks.Verbatim(text),))
    made = files_of(blocks.Page(page.title, {}, page.verdict, (), (*page.sections, annex)))
    assert visible(list(parsed(made["report.html"]).iter("pre"))[-1]) == text.replace("\r\n", "\n")
    assert json.loads(made["report.json"])["sections"][-1]["blocks"] == [{"verbatim": text}]


def test_tables_with_long_names_have_sheets():
    """The names of sheets have at most 31 characters."""
    page = sample.page()
    (name, *_), table = (sheet.name for sheet in page.tables()), sample.motions()
    long = [dataclasses.replace(table, name=f"rotation-of-the-maximum-considered-{k}") for k in (1, 2)]
    section = dataclasses.replace(page.sections[0], blocks=(*page.sections[0].blocks, *long))
    content = files_of(dataclasses.replace(page, sections=(section, *page.sections[1:])))["report.xlsx"]
    found = [sheet for sheet in sheets(content) if sheet.startswith("rotation-of-the-maximum")]
    assert len(found) == 2
    assert all(len(sheet) <= 31 for sheet in found)
    assert name in sheets(content)


def test_without_xlsxwriter_the_message_names_the_command(monkeypatch):
    monkeypatch.setitem(sys.modules, "xlsxwriter", None)
    with pytest.raises(ValueError, match=r"XLSX files need XlsxWriter.*pip install XlsxWriter"):
        FORMATS["xlsx"](sample.page(), UNITS)
    assert FORMATS["csv"](sample.page(), UNITS)


def test_a_workbook_has_the_suffix_xlsx():
    check_path("report.xlsx")
    with pytest.raises(ValueError, match=r"must be a .xlsx file, got report.csv"):
        check_path("folder/report.csv")


def test_the_same_page_gives_the_same_bytes():
    assert files_of(sample.page()) == files_of(sample.page())


def test_another_date_changes_one_line():
    before, after = (files_of(sample.page(date)) for date in ("2026-11-26", "2027-01-02"))
    assert {name for name in before if before[name] != after[name]} == {"report.html", "report.json"}
    for name in ("report.html", "report.json"):
        pairs = zip(before[name].splitlines(), after[name].splitlines(), strict=True)
        assert sum(old != new for old, new in pairs) == 1


def quantities(content):
    """Yield all numbers of a page, in blocks, texts and cells."""
    if isinstance(content, Quantity):
        yield content
    if hasattr(content, "__dataclass_fields__"):
        content = [getattr(content, name) for name in content.__dataclass_fields__]
    if isinstance(content, dict):
        content = list(content.values())
    if isinstance(content, list | tuple):
        for part in content:
            yield from quantities(part)


@pytest.mark.parametrize("units", [UNITS, OTHERS, Units.si()])
def test_all_files_have_the_same_numbers(units):
    assert_equal_numbers(sample.page(), units)


def assert_equal_numbers(page, units):
    """Compare the numbers of all tables, except the summary, in the files of a page."""
    made = files_of(page, units)
    root, document = parsed(made["report.html"]), json.loads(made["report.json"])
    books = sheets(made["report.xlsx"])
    for table, shown in list(zip(page.tables(), root.iter("table"), strict=True))[1:]:
        assert visible(shown.find("caption")) == plain(table.caption, units)
        rows = shown.findall("tbody/tr")
        grid, book = csv_rows(made[f"{table.name}.csv"]), books[table.name]
        assert [list(map(str, row)) for row in book[1:2]] == grid[:1]
        for number, row in enumerate(table.rows):
            flat, sheet = grid[number + 1], book[number + 2]
            for k, cell in enumerate(row):
                entry = document["tables"][table.name]["rows"][number][k]
                if not isinstance(cell, Quantity):
                    continue
                assert (entry["value"], entry["unit"]) == (cell.value, si_unit(cell.kind))
                assert entry.get("error") == cell.error
                assert visible(rows[number][k]).startswith(
                    format_number(Quantity(**_read(entry, cell)), units)
                )
                value = repr(units.show(cell.value, cell.kind))
                assert value in flat
                assert float(f"{float(value):.16G}") in sheet  # the digits that XlsxWriter writes
                assert units.unit(cell.kind) in flat


def _read(entry, cell):
    return {
        "value": entry["value"],
        "kind": cell.kind,
        "error": entry.get("error"),
        "is_input": cell.is_input,
    }


def test_other_units_change_the_factor_only():
    page = sample.page()
    for name in (f"{table.name}.csv" for table in page.tables()):
        here, there = (csv_rows(files_of(page, units)[name]) for units in (UNITS, OTHERS))
        factors = {unit: size for kind in KINDS.values() for unit, size in kind.units.items()}
        for k, heading in enumerate(here[0]):
            column = heading.removesuffix(": unit")
            if column == heading:
                continue
            value = here[0].index(column)
            for old, new in zip(here[1:], there[1:], strict=True):
                if re.fullmatch(r"[-\d.e]+", old[value]):
                    si = float(old[value]) * factors[old[k]]
                    assert float(new[value]) * factors[new[k]] == pytest.approx(si, rel=1e-15)


def test_json_is_in_si_for_all_units():
    page = sample.page()
    assert FORMATS["json"](page, UNITS) == FORMATS["json"](page, OTHERS)
    document = json.loads(FORMATS["json"](page, UNITS)["report.json"])
    assert document["schema"] == "rockjax-report/1"
    check = document["checks"][3]
    assert check["limit"] == {"sense": "at most", "value": 1.5 * 9.80665, "unit": "m/s²", "given_in": "g"}
    assert document["checks"][7]["value"]["state"] == "joint opens"
    assert document["verdict"].startswith("Not verified")


def test_every_check_has_one_row():
    page = sample.page()
    made = files_of(page)
    ids = [check["id"] for check in json.loads(made["report.json"])["checks"]]
    rows = next(iter(parsed(made["report.html"]).iter("table"))).findall("tbody/tr")
    assert [visible(row[0]) for row in rows] == ids
    assert [row[0] for row in csv_rows(made["summary.csv"])[1:]] == ids


def test_a_limit_keeps_the_unit_in_which_it_was_given():
    content = files_of(sample.page())["report.html"].decode()
    assert "≤\u00a020 mm<small>given as 2 cm</small>" in content
    assert "given as 0.75" not in content
    assert (
        "≤\u00a00.0075<small>given as 0.75 %</small>"
        in files_of(sample.page(), OTHERS)["report.html"].decode()
    )


def test_links_lead_somewhere():
    page = sample.page()
    section = blocks.Section(14, "More", (blocks.Paragraph((blocks.Link("A9", "A9"),)),))
    with pytest.raises(ValueError, match="no section, check or row has the anchor A9"):
        blocks.Page(page.title, page.head, page.verdict, (), (*page.sections, section))
    with pytest.raises(ValueError, match="names of tables must differ, got derived, inputs"):
        blocks.Page(page.title, page.head, page.verdict, (), (*page.sections, page.sections[1]))
    double = '<svg viewBox="0 0 1 1"><g id="a"/><g id="a"/></svg>'
    with pytest.raises(ValueError, match="anchors must differ, got a more than once"):
        sample.page(drawing=double)
    with pytest.raises(ValueError, match="Page: Author must be text"):
        blocks.Page(page.title, {"Author": ""}, page.verdict, (), page.sections)
    anchors = [blocks.check_anchor(id) for id in ("C1", "c1", "Б", "C 1", "C_1", "C-1")]
    assert len(set(anchors)) == len(anchors)
    assert all(re.fullmatch(r"[A-Za-z][\w.-]*", anchor, re.ASCII) for anchor in anchors)


def test_formulas_are_well_formed_and_those_of_their_sources():
    for name in formulas.names():
        root = ET.fromstring(formulas.mathml(name).replace("&ApplyFunction;", "\N{FUNCTION APPLICATION}"))
        assert root.tag == "math"
        assert formulas.latex(name)
        assert re.fullmatch(r"(\([A-Z]?\d+\))?", formulas.source(name))
    with pytest.raises(ValueError, match="Formula: name must be one of slenderness"):
        formulas.latex("slendernes")
    math_core = pytest.importorskip("math_core", reason="math-core makes the MathML; it is not installed")
    translate = math_core.LatexToMathML(fancy_error=False).convert_with_local_state
    for name in formulas.names():
        assert translate(formulas.latex(name), displaystyle=True) == formulas.mathml(name), name


def test_the_package_holds_its_data():
    folder = files("rockjax._report")
    for name in ("page.html.jinja", "page.css", "formulas.json", "formulas.woff"):
        assert folder.joinpath(name).is_file()
    assert len(folder.joinpath("formulas.woff").read_bytes()) <= 60_000


def test_a_table_of_another_library_is_escaped():
    table = Table.from_rows("t", "<b>", {"<i>": None}, [["</td>"]])
    assert "&lt;b&gt;" in markup.table(table, UNITS)
    assert "&lt;i&gt;" in markup.table(table, UNITS)
    assert html.unescape(markup.table(table, UNITS)).count("</td>") == 1


def test_a_printed_page_is_a4_and_breaks_no_row(browser, tmp_path):
    path = tmp_path / "report.html"
    content = sample.page()
    path.write_bytes(files_of(content)["report.html"])
    texts = printed(browser, path)
    assert all(row.id in texts[0] for row in content.sections[0].blocks[0].rows)
    assert len(content.sections[0].blocks[0].rows) == 14
    rows = [format_number(row[2], UNITS) + format_number(row[3], UNITS) for row in sample.motions().rows]
    found = [[k for k, text in enumerate(texts) if row in text] for row in rows]
    assert {len(places) for places in found} == {1}
    heads = [k for k, text in enumerate(texts) if "No.Source" in text]
    assert heads == sorted({k for places in found for k in places})  # heads are repeated
    assert len(heads) > 1


@pytest.mark.parametrize("text", ["Example", sample.HOSTILE[0], sample.HOSTILE[2]])
@pytest.mark.parametrize(("width", "theme"), MODES)
def test_a_browser_shows_the_page(browser, tmp_path, width, theme, text):
    path = tmp_path / "report.html"
    path.write_bytes(files_of(sample.page(text=text))["report.html"])
    assert_shown(browser, path, width, theme)
    assert_accessible(browser, path, width, theme)
