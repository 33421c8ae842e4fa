"""Pages of the site and of a package index, which need no external resources."""

import importlib.util
import re
import tomllib
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted(ROOT.glob("docs/**/*.md"))]


def hook(name: str) -> ModuleType:
    for needed in ("mkdocs", "math_core", "fontTools", "griffe"):
        pytest.importorskip(needed)
    spec = importlib.util.spec_from_file_location(name, ROOT / "docs" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def formulas(page: Path) -> list[tuple[str, str]]:
    """Return the formulas that the Markdown extension marks: ("span", …) within a line, ("div", …) on
    separate lines."""
    text = re.sub(r"^```.*?^```|`[^`\n]*`", "", page.read_text(encoding="utf-8"), flags=re.S | re.M)
    found = re.finditer(r"\$\$(.+?)\$\$|(?<![\\$])\$([^$\s](?:[^$\n]|\n(?!\n))*?)\$", text, re.S)
    return [("div", one[1]) if one[1] else ("span", one[2]) for one in found]


def test_every_formula_of_the_pages_becomes_mathml():
    site = hook("site_formulas")
    count = 0
    for path in PAGES:
        page = SimpleNamespace(file=SimpleNamespace(src_uri=path.name))
        for element, latex in formulas(path):
            marks = ("\\(", "\\)") if element == "span" else ("\\[", "\\]")
            escaped = latex.replace("&", "&amp;").replace("<", "&lt;")
            made = site.on_page_content(
                f'<{element} class="arithmatex">{marks[0]}{escaped}{marks[1]}</{element}>', page=page
            )
            assert made.startswith(f'<{element} class="formula"><math')
            assert "\\tag" not in made
            count += 1
    assert count > 400


def test_a_formula_that_cannot_be_set_stops_the_build():
    site = hook("site_formulas")
    page = SimpleNamespace(file=SimpleNamespace(src_uri="model.md"))
    numbered = site.on_page_content(r'<div class="arithmatex">\[p^2=\frac{3g}{4R}\tag{25}\]</div>', page=page)
    assert numbered.endswith('</math><span class="number">(25)</span></div>')
    with pytest.raises(Exception, match=r"model\.md: the formula .*nosuch.* cannot be translated"):
        site.on_page_content(r'<span class="arithmatex">\(\nosuch{x}\)</span>', page=page)


def test_signatures_have_one_parameter_a_line():
    one_a_line = hook("site_signatures").one_parameter_a_line
    assert one_a_line("()") == "()"
    assert one_a_line("(podium: Podium) -> dict[str, int]") == "(podium: Podium) -> dict[str, int]"
    complete = (
        '(vary: tuple[str, tuple[float, float]], *, rule: str = "a, (b", '
        "make: Callable[[Any, Any], X]) -> tuple[A, B]"
    )
    assert one_a_line(complete).splitlines() == [
        "(",
        "    vary: tuple[str, tuple[float, float]],",
        "    *,",
        '    rule: str = "a, (b",',
        "    make: Callable[[Any, Any], X],",
        ") -> tuple[A, B]",
    ]


def test_the_site_loads_nothing_from_elsewhere():
    assert not re.search(r"https?://", (ROOT / "mkdocs.yml").read_text(encoding="utf-8"))
    for sheet in (ROOT / "docs" / "stylesheets").glob("*.css"):
        assert not re.search(r"https?://|@import", sheet.read_text(encoding="utf-8"))
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        assert not re.search(r"!\[[^\]]*\]\(https?://|<(?:script|iframe|img)", text), page
        assert "```mermaid" not in text, (
            f"{page}: mermaid is drawn by a script from a network; give a picture"
        )


def test_the_readme_on_a_package_index_points_nowhere_that_is_not_there():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert re.findall(r"!\[[^\]]*\]\(docs/images/", text)
    for change in project["tool"]["hatch"]["metadata"]["hooks"]["fancy-pypi-readme"]["substitutions"]:
        text = re.sub(change["pattern"], change["replacement"], text)
    assert not [target for target in re.findall(r"\]\(([^)]+)\)", text) if not target.startswith("https://")]
    for path in re.findall(r"Picture, `([^`]+)`|\(`([^`]+\.md)`\)", text):
        assert (ROOT / "".join(path)).exists(), path
