"""Add the README, as the home page, and the changelog to the site, and generated tables to pages.

This hook of `mkdocs.yml` also changes links that work in the repository so that they work on the site.
"""

from __future__ import annotations

import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

from optimise._problem import problem_schema
from rockjax._parameters import registry
from rockjax._units import displayed

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
    """Return the table of all parameters of structures, dimensions and ground motions. Parameters with one
    value for each mode, story or column have numbered names."""
    lines = ["| name | symbol | unit | range | meaning |", "|---|---|---|---|---|"]
    of_structure = registry.STRUCTURE | registry.DIMENSIONS
    for name, y in [
        *of_structure.items(),
        *(pair for pair in registry.MOTION.items() if pair[0] not in of_structure),
        *registry.INITIAL.items(),
    ]:
        lines.append(f"| `{name}` | {y.symbol} | {displayed(y.unit)} | {y.range.text} | {y.meaning} |")
    for name, y in registry.ROWS.items():
        cells = f"{displayed(y.unit)} | {y.range.text} | {y.meaning} 1, …"
        lines.append(f"| `{name}_1`, … | {y.symbol} | {cells} |")
    return "\n".join(lines)


def problem_keys() -> str:
    """Return the tables of all keys of problem files."""
    schema = problem_schema()
    parts = [_keys("A problem file", schema)]
    parts += [_keys(name, part) for name, part in schema["$defs"].items() if "properties" in part]
    return "\n\n".join(parts)


def _keys(name: str, schema: dict) -> str:
    """Return the table of the keys of one model."""
    lines = [
        f"### {name}",
        "",
        schema.get("description", ""),
        "",
        "| key | holds | default | meaning |",
        "|---|---|---|---|",
    ]
    for key, part in schema["properties"].items():
        default = part.get("default")
        needed = (
            "needed" if key in schema.get("required", ()) else "" if default in (None, []) else f"`{default}`"
        )
        lines.append(f"| `{key}` | {_describe_value(part)} | {needed} | {part.get('description', '')} |")
    return "\n".join(lines)


def _describe_value(part: dict) -> str:
    """Return a description of the values of a key."""
    if "$ref" in part:
        name = part["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    if "const" in part or "enum" in part:
        return ", ".join(f"`{value}`" for value in part.get("enum", [part.get("const")]))
    kinds = part.get("anyOf") or part.get("oneOf")
    if kinds:
        words = (_describe_value(kind) for kind in kinds if kind.get("type") != "null")
        return " or ".join(dict.fromkeys(words))
    if part.get("type") == "array":
        return "lowest, highest" if "prefixItems" in part else f"list of {_describe_value(part['items'])}"
    if part.get("type") == "object":
        return f"table of {_describe_value(part['additionalProperties'])}"
    words = {"number": "number", "integer": "whole number", "string": "text", "boolean": "true or false"}
    signs = {"exclusiveMinimum": ">", "minimum": "≥", "exclusiveMaximum": "<", "maximum": "≤"}
    limits = ", ".join(f"{sign} {part[name]:g}" for name, sign in signs.items() if name in part)
    return f"{words.get(part.get('type', ''), 'anything')} {limits}".rstrip()


def on_page_markdown(markdown: str, *, page: Page, **_) -> str:
    """Insert generated tables, and replace links to files outside the site by the paths of these files."""
    if "/" in page.file.src_uri:
        return markdown

    def link(found: re.Match) -> str:
        text, path = found.groups()
        return f"[{text}]({PAGES[path]})" if path in PAGES else f"{text} (`{path}`)"

    markdown = markdown.replace("<!-- table of parameters -->", parameters_table())
    markdown = markdown.replace("<!-- keys of problem files -->", problem_keys())
    return re.sub(r"(?<!!)\[([^\]]+)\]\(\.\./([^)#]+)\)", link, markdown)
