import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text()


def test_code_of_the_readme_runs(capsys):
    blocks = re.findall(r"```python\n(.*?)```", README, re.S)
    assert blocks
    for block in blocks:
        assert len(block.splitlines()) <= 18
        exec(compile(block, "README.md", "exec"), {})
    assert "peak rotation" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize("page", ["overturning", "design", "pictures"])
def test_code_of_the_pages_runs(page, capsys):
    """The blocks of a page follow one another."""
    names: dict = {}
    for block in re.findall(r"```python\n(.*?)```", (ROOT / "docs" / f"{page}.md").read_text(), re.S):
        exec(compile(block, page, "exec"), names)
    assert names


@pytest.mark.parametrize("page", ["README.md", *(str(path.relative_to(ROOT)) for path in sorted(ROOT.glob("docs/*.md")))])
def test_links_exist(page):
    for target in re.findall(r"\]\(([^)#\s]+)\)", (ROOT / page).read_text()):
        if not target.startswith("http"):
            assert (ROOT / page).parent.joinpath(target).exists(), target
