import ast
import os
import re
import subprocess
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import pytest

ROOT = Path(__file__).parents[2]
NOTEBOOKS = sorted(ROOT.glob("notebooks/*.py"))
REDUCED = 'REDUCED = os.environ.get("ROCKJAX_NOTEBOOKS") == "reduced"'

by_name = pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)


def cells(notebook: Path) -> list[tuple[str, str]]:
    """Return (kind, text) of every cell; the kind is "code" or "markdown"."""
    header, *rest = re.split(r"^(# %%.*)\n", notebook.read_text(encoding="utf-8"), flags=re.M)
    assert re.fullmatch(r"# ---\n(#.*\n)+# ---\n\n", header)
    assert "format_name: percent" in header
    marks = {"# %%": "code", "# %% [markdown]": "markdown"}
    return [(marks[mark], text) for mark, text in zip(rest[::2], rest[1::2], strict=True)]


@pytest.mark.slow(but=["01_first_steps"])
@by_name
def test_notebooks_run(notebook, tmp_path, monkeypatch):
    if "optimise.explore" in notebook.read_text():
        pytest.importorskip("ipywidgets")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("ROCKJAX_NOTEBOOKS", "reduced")
    plt.close("all")
    try:
        exec(compile(notebook.read_text(), notebook, "exec"), {"__name__": "__main__"})
        assert plt.get_fignums()
        for number in plt.get_fignums():
            for ax in plt.figure(number).axes:
                assert ax.get_xlabel() or ax.get_ylabel() or not ax.axison, (
                    f"figure {number} has axes without a name"
                )
    finally:
        plt.close("all")


@by_name
def test_cells(notebook):
    """Every cell has a marker, text cells are comments, and each notebook has the common parts."""
    found = cells(notebook)
    assert found[0][0] == "markdown"
    assert re.match(r"# # \w", found[0][1])
    for kind, text in found:
        lines = text.strip("\n").splitlines()
        assert lines
        if kind == "markdown":
            assert all(re.match(r"#( |$)", line) for line in lines)
            assert len(lines) <= 25
        else:
            ast.parse(text)
            assert len(lines) <= 45
    assert sum(REDUCED in text for _, text in found) == 1
    assert found[-1][0] == "markdown"
    assert "# ## Next\n" in found[-1][1]


@by_name
def test_names_and_links_exist(notebook):
    """Notebooks are referred to by names such as `05_…`, pages by links."""
    text = notebook.read_text()
    for name in re.findall(r"`(\d\d_\w+)`", text):
        assert (ROOT / "notebooks" / f"{name}.py").exists(), name
    links = re.findall(r"^#.*\]\(([^)#\s]+)(?:#[^)\s]*)?\)", text, re.M)
    assert links
    for target in links:
        assert (notebook.parent / target).exists(), target


@by_name
def test_they_become_notebooks(notebook):
    jupytext = pytest.importorskip("jupytext")
    made = jupytext.read(notebook)
    assert [cell["cell_type"] for cell in made.cells] == [kind for kind, _ in cells(notebook)]
    assert all(not cell.get("outputs") for cell in made.cells)
    assert jupytext.reads(jupytext.writes(made, "ipynb"), "ipynb").cells == made.cells


@by_name
def test_links_stay_below_the_folder_that_jupyter_is_started_in(notebook):
    """A server opens nothing above its root folder, and the page starts `jupyter lab` in the folder of the
    project."""
    commands = re.findall(r"^ {4}(jupyter lab.*)$", (ROOT / "docs" / "notebooks.md").read_text(), re.M)
    assert commands == ["jupyter lab"]
    text = notebook.read_text()
    for target in re.findall(r"^#.*\]\(([^)#\s]+)(?:#[^)\s]*)?\)", text, re.M):
        assert (notebook.parent / target).resolve().is_relative_to(ROOT), target
    unlinked = re.findall(r"(?<!\[)`\d\d_\w+`", text)
    assert not unlinked


def test_the_page_lists_them_all():
    page = (ROOT / "docs" / "notebooks.md").read_text()
    assert re.findall(r"`(\d\d_\w+)\.py`", page) == [notebook.stem for notebook in NOTEBOOKS]


@pytest.mark.parametrize("decorator", ["styled", "on_axes"])
def test_our_style_leaves_a_notebook_interactive(decorator, tmp_path):
    """The first figure of a session loads the backend, which switches on the interactive mode of
    notebooks."""
    (tmp_path / "lively.py").write_text(
        "from matplotlib.backends.backend_agg import *\nimport matplotlib\nmatplotlib.interactive(True)\n"
    )
    code = (
        "import matplotlib, matplotlib.pyplot as plt\nfrom rockjax.plots import _style\n"
        f"_style.{decorator}(lambda data, ax=None: ax or plt.figure())(None)\n"
        "assert plt.get_fignums()\nassert matplotlib.is_interactive()"
    )
    paths = os.pathsep.join([str(tmp_path), str(ROOT), os.environ.get("PYTHONPATH", "")])
    environment = os.environ | {"MPLBACKEND": "module://lively", "PYTHONPATH": paths}
    subprocess.run([sys.executable, "-c", code], env=environment, check=True)
