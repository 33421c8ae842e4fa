"""Check of the English of docstrings, messages and pages; the style guide is in CONTRIBUTING.md."""

from . import prose


def test_prose_follows_the_style_guide():
    assert prose.problems() == []


def test_openings_and_phrases_are_found(tmp_path):
    path = tmp_path / "module.py"
    path.write_text(
        '"""What a scene has to say."""\n\n\ndef f():\n    """The same, and nobody knows why."""\n'
    )
    assert [line.removeprefix(f"{path}:") for line in (*prose.openings(path), *prose.phrases(path))] == [
        "1: docstring opens with 'What a scene has to say.'",
        "4: docstring opens with 'The same, and nobody knows why.'",
        "1: reword 'What a scene has to say'",
        "5: reword 'nobody knows'",
    ]
