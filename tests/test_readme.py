import re
from pathlib import Path

README = (Path(__file__).parent.parent / "README.md").read_text()


def test_code_of_the_readme_runs(capsys):
    blocks = re.findall(r"```python\n(.*?)```", README, re.S)
    assert blocks
    for block in blocks:
        assert len(block.splitlines()) <= 18
        exec(compile(block, "README.md", "exec"), {})
    assert "peak rotation" in capsys.readouterr().out


def test_links_of_the_readme_exist():
    for target in re.findall(r"\]\(([^)#]+)\)", README):
        assert (Path(__file__).parent.parent / target).exists(), target
