"""Pages of the site that live at the top of the repository: the README is the home page, and the changelog.

A hook of `mkdocs.yml`. Links are written as they work in the repository, and made to work on the site.
"""

from __future__ import annotations

import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

from rockjax._parameters import table

ROOT = Path(__file__).parent.parent
PAGES = {"README.md": "index.md", "CHANGELOG.md": "changelog.md"}


def on_files(files: Files, *, config: MkDocsConfig) -> Files:
    for source, page in PAGES.items():
        text = (ROOT / source).read_text(encoding="utf-8").replace("](docs/", "](")
        for other, target in PAGES.items():
            text = text.replace(f"]({other})", f"]({target})")
        files.append(File.generated(config, page, content=text))
    return files


def parameters_table() -> str:
    """The parameters of structures, their dimensions and ground motions, as the package knows them."""
    lines = ["| name | symbol | unit | range | meaning |", "|---|---|---|---|---|"]
    of_structure = table.STRUCTURE | table.DIMENSIONS
    for name, y in [
        *of_structure.items(),
        *(pair for pair in table.MOTION.items() if pair[0] not in of_structure),
    ]:
        lines.append(f"| `{name}` | {y.symbol} | {table.written(y.unit)} | {y.range.words} | {y.meaning} |")
    return "\n".join(lines)


def on_page_markdown(markdown: str, *, page: Page, **_) -> str:
    """Files beside docs/ are not on the site: their links become their paths."""
    if "/" in page.file.src_uri:
        return markdown

    def link(found: re.Match) -> str:
        text, path = found.groups()
        return f"[{text}]({PAGES[path]})" if path in PAGES else f"{text} (`{path}`)"

    markdown = markdown.replace("<!-- table of parameters -->", parameters_table())
    return re.sub(r"(?<!!)\[([^\]]+)\]\(\.\./([^)#]+)\)", link, markdown)
