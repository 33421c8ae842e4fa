import importlib
import inspect
import re
import shlex
import tomllib
from pathlib import Path

import matplotlib.pyplot as plt
import pytest
import typer

from rockjax._motions import formats

ROOT = Path(__file__).parents[2]
README = ROOT / "README.md"
PAGES = sorted(ROOT.glob("docs/*.md"))
TEXTS = [README, ROOT / "CHANGELOG.md", *PAGES, *sorted(ROOT.glob("docs/*/*.md"))]
LANGUAGES = {"python", "toml", "bibtex", "text"}  # languages of code blocks; shell commands are indented


def name(path: Path) -> str:
    return str(path.relative_to(ROOT))


def blocks(page: Path) -> list[str]:
    """Return the Python blocks of a page, each with its line numbers."""
    text = page.read_text()
    found = re.finditer(r"^```python\n(.*?)^```", text, re.S | re.M)
    return ["\n" * text.count("\n", 0, block.start(1)) + block[1] for block in found]


def test_code_of_the_readme_runs(capsys):
    found = blocks(README)
    assert found
    for block in found:
        assert len(block.strip().splitlines()) <= 18
        exec(compile(block, README, "exec"), {})
    assert "peak rotation" in capsys.readouterr().out


@pytest.mark.slow(but=["getting-started", "extending"])
@pytest.mark.parametrize("page", [page for page in PAGES if blocks(page)], ids=lambda page: page.stem)
def test_code_of_the_pages_runs(page, tmp_path, monkeypatch):
    """The blocks of a page run in order."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(formats, "FORMATS", formats.FORMATS)  # one page adds a format
    names: dict = {}
    for block in blocks(page):
        exec(compile(block, page, "exec"), names)
    plt.close("all")


@pytest.mark.parametrize("page", TEXTS, ids=name)
def test_every_block_is_of_a_known_kind(page):
    """All blocks have a known language, so the test above runs all Python code."""
    fences = re.findall(r"^ *```(.*)$", page.read_text(), re.M)
    assert all(not closing for closing in fences[1::2])
    assert {opening.strip() for opening in fences[::2]} <= LANGUAGES


def commands(page: Path) -> list[str]:
    """Return the commands of a page: indented lines and lines within backticks."""
    text = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.S | re.M)
    lines = re.findall(r"^ {4,}(\S.*)$|(?<!`)`([^`\n]+)`(?!`)", text, re.M)
    parts = [part.strip() for line in lines for part in "".join(line).split("&&")]
    return [part for part in parts if re.match(r"(rockjax|python|pip|pytest|mkdocs) +\S", part)]


@pytest.mark.parametrize("page", [page for page in TEXTS if commands(page)], ids=name)
def test_commands_exist(page, monkeypatch):
    """`rockjax` accepts the arguments, and extras and scripts exist."""
    from rockjax._cli import app

    monkeypatch.chdir(ROOT)
    group = typer.main.get_command(app)
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    for line in commands(page):
        words = shlex.split(line, comments=True)
        if words[0] == "rockjax" and words[1].startswith("-"):
            expected = {option for parameter in group.params for option in parameter.opts}
            assert words[1] in expected | {"--help"}, line
        elif words[0] == "rockjax":
            command = group.commands[words[1]]
            arguments = [word for word in words[2:] if word != "--help"]
            if arguments:
                command.make_context(words[1], arguments)  # raises for unknown options
        elif "install" in words:
            assert set(re.findall(r"\.\[(\w+)\]", line)) <= set(extras), line
        elif words[1] == "-m" and words[2].startswith("benchmarks."):
            assert (ROOT / (words[2].replace(".", "/") + ".py")).exists(), line
        elif words[1].endswith(".py"):
            assert (ROOT / words[1]).exists(), line


@pytest.mark.parametrize("page", TEXTS, ids=name)
def test_links_exist(page):
    for target in re.findall(r"\]\(([^)#\s]+)(?:#[^)\s]*)?\)", page.read_text()):
        if not target.startswith("http"):
            assert page.parent.joinpath(target).exists(), target


@pytest.mark.parametrize(
    "page", [*TEXTS, ROOT / "CONTRIBUTING.md", ROOT / "rockjax/_engine/README.md"], ids=name
)
def test_files_that_are_named_exist(page):
    """For part of a path, a file exists whose path ends with it."""
    words = re.findall(
        r"`((?:[\w.-]+/)*[\w.-]+\.(?:py|md)|(?:rockjax|optimise|tests|benchmarks|docs)/[\w./-]*)`",
        page.read_text(),
    )
    paths = {
        f"/{path.relative_to(ROOT).as_posix()}" for kind in ("*.py", "*.md") for path in ROOT.rglob(kind)
    }
    for word in words:
        there = any(path.endswith(f"/{word}") for path in paths) or (ROOT / word).exists()
        assert there or word == "your_model.py", word


@pytest.mark.parametrize("package", ["rockjax", "optimise"])
def test_every_public_name_is_in_the_reference(package):
    reference = "".join(page.read_text() for page in ROOT.glob("docs/api/*.md"))
    named = set(re.findall(rf"^::: {package}\.(\w+)$", reference, re.M))
    public = set(importlib.import_module(package).__all__) - {"__version__"}
    assert public == named - {"plots"}


def test_every_picture_is_in_the_reference():
    from rockjax import plots

    page = (ROOT / "docs/api/plots.md").read_text()
    drawn = {name for name in plots.__all__ if inspect.isfunction(getattr(plots, name))}
    assert drawn == set(re.findall(r"^ +- (\w+)$", page, re.M))


def test_versions_agree():
    import rockjax

    for page in ("CITATION.cff", "docs/citing.md"):
        assert set(re.findall(r"version\W+([\d.]+\d)", (ROOT / page).read_text())) - {"1.2.0"} == {
            rockjax.__version__
        }
