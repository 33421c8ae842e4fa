"""Display and print of a page in a browser."""

import io
import re
import unicodedata

import pytest

MODES = [(1100, "light"), (1100, "dark"), (390, "light")]  # width of the window [px], theme


def assert_shown(browser, path, width, theme):
    """Check that only the file is requested, nothing is wider than the window, and ids and anchors agree."""
    context = browser.new_context(viewport={"width": width, "height": 800}, color_scheme=theme)
    page, events = context.new_page(), []
    page.on("console", lambda message: events.append(message.text))
    page.on("pageerror", lambda error: events.append(str(error)))
    page.on("request", lambda request: events.append(request.url))
    page.goto(path.as_uri())
    assert [entry for entry in events if not entry.startswith("data:")] == [path.as_uri()]
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    ids = page.evaluate("[...document.querySelectorAll('[id]')].map(y => y.id)")
    assert len(ids) == len(set(ids))
    anchors = page.evaluate(
        "[...document.querySelectorAll('a[href^=\"#\"]')].map(y => y.getAttribute('href').slice(1))"
    )
    assert set(anchors) <= set(ids)
    context.close()


def assert_accessible(browser, path, width, theme):
    """axe-core finds nothing that people with impairments could not read or reach."""
    reason = "axe-playwright-python is not installed"
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason=reason)
    context = browser.new_context(viewport={"width": width, "height": 800}, color_scheme=theme)
    page = context.new_page()
    page.goto(path.as_uri())
    results = axe.Axe().run(page)
    assert results.response["passes"]
    assert not results.response["violations"], results.generate_report()
    context.close()


def printed(browser, path):
    """Return the texts of the printed A4 pages, without spaces, in NFKC."""
    pypdf = pytest.importorskip("pypdf", reason="pypdf, which reads the printed page, is not installed")
    page = browser.new_page()
    page.goto(path.as_uri())
    pages = pypdf.PdfReader(io.BytesIO(page.pdf(prefer_css_page_size=True, print_background=True))).pages
    page.close()
    assert {tuple(round(float(side)) for side in sheet.mediabox[2:]) for sheet in pages} == {(595, 842)}
    # ligatures such as "fi" become letters
    return [re.sub(r"\s", "", unicodedata.normalize("NFKC", sheet.extract_text())) for sheet in pages]
