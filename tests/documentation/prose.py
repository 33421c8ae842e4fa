"""Check the project's English: first words of docstrings, unclear phrases, lengths of pages.

    python tests/documentation/prose.py

The style guide is in CONTRIBUTING.md. The check finds patterns; it cannot judge a sentence.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
# Relative clauses instead of nouns.
OPENINGS = re.compile(
    r"(What|Whether|Who|Which|Where|How|Of|The same|Those|As above|Likewise|All that|Numbers that|That)\b"
)
PHRASES = re.compile(
    "|".join(
        (
            r"of the time (it|they|that|as)\b",
            r"takes? (0?\.\d+|half|two thirds|a (third|quarter|fifth|tenth)) ",
            r"\bmend(s|ed)?\b",
            r"leaves the possible",
            r"what is asked",
            r"what .{1,30} has to say",
            r"is (a )?(building|podium)s? of\b",
            r"\b(is|are) said\b",
            r"\bsays? so\b",
            r"\bwhat it was\b",
            r"\bas it was\b",
            r"\bof once\b",
            r"has the last word",
            r"\bnobody (knows|looks)\b",
            r"looked at again",
            r"whole or not at all",
            r"from what stands on",
            r"\bin turn\b.{0,40}\bthe shorter\b",
            r"tried and not kept",
            r"\(since(,| the)",
            r"\bhardly (are|is)\b",
            r"\bso many\b",
            r"that there (is|are)\b",
            r"\bof which one\b",
            r"\bis one whose\b",
            r"as (loosely|tightly) as",
            r"\bsays? the same of\b",
            r"\b(is|are) instead of\b",
            r"\bhas no meaning\b",
        )
    ),
    re.I,
)
LENGTHS = {
    "performance.md": 150,
    "verification.md": 150,
    "CHANGELOG.md": 60,
    "README.md": 130,
    "CONTRIBUTING.md": 120,
}
LENGTH = 250  # lines of any other page; validation reports may be longer


def openings(path: Path) -> Iterator[str]:
    """Yield docstrings that open with a relative clause."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            text = ast.get_docstring(node) or ""
            if OPENINGS.match(text):
                yield f"{path}:{getattr(node, 'lineno', 1)}: docstring opens with {text.splitlines()[0]!r}"


def phrases(path: Path) -> Iterator[str]:
    """Yield lines with unclear phrases, except in the table of the style guide."""
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        if path.name == "CONTRIBUTING.md" and line.startswith("|"):
            continue
        if match := PHRASES.search(line):
            yield f"{path}:{number}: reword {match[0]!r}"


def problems() -> list[str]:
    """Return all findings, with file and line."""
    modules = [path for package in ("rockjax", "optimise") for path in sorted((ROOT / package).rglob("*.py"))]
    pages = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").glob("*.md"))]
    notebooks = sorted((ROOT / "notebooks").glob("*.py"))
    found = [finding for path in modules for finding in openings(path)]
    found += [finding for path in (*modules, *pages, *notebooks) for finding in phrases(path)]
    for page in pages:
        lines, limit = len(page.read_text(encoding="utf-8").splitlines()), LENGTHS.get(page.name, LENGTH)
        if lines > limit:
            found.append(f"{page}: has {lines} lines, {lines - limit} too many")
    return [finding.removeprefix(f"{ROOT}/") for finding in found]


if __name__ == "__main__":
    findings = problems()
    for finding in findings:
        print(finding)
    sys.exit(bool(findings))
