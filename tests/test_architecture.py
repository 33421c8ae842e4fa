"""Imports between modules: none is circular, and none is from a lower row of the table in
docs/architecture.md."""

import ast
import graphlib
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FILES = {
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
    for package in ("rockjax", "optimise")
    for path in (ROOT / package).rglob("*.py")
}


def imports(name: str) -> Iterator[str]:
    """Yield the modules that a module imports, including imports in functions and for types."""
    package = name if FILES[name].name == "__init__.py" else name.rpartition(".")[0]
    for node in ast.walk(ast.parse(FILES[name].read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in FILES)
        elif isinstance(node, ast.ImportFrom):
            parents = package.split(".")[: 1 - node.level or None] if node.level else []
            base = ".".join([*parents, *([node.module] if node.module else [])])
            for alias in node.names:
                target = f"{base}.{alias.name}"
                yield from (found for found in (target if target in FILES else base,) if found in FILES)


def rows() -> dict[str, int]:
    """Return the row of each folder or module that the table names."""
    page = (ROOT / "docs/architecture.md").read_text(encoding="utf-8")
    found = {}
    for row, cell in enumerate(re.findall(r"^\| (`[^|]*) \|", page, re.M)):
        for path in re.findall(r"`([\w./]+)`", cell):
            place = path.removesuffix("/").removesuffix(".py").replace("/", ".")
            found[place if place == "optimise" else f"rockjax.{place}".removesuffix(".__init__")] = row
    return found


def row_of(name: str, table: dict[str, int]) -> int | None:
    """Return the row of a module: its own, or that of the nearest folder around it."""
    while name not in table and name.count("."):
        name = name.rpartition(".")[0]
        if name == "rockjax":
            return None
    return table.get(name)


def test_every_module_has_a_row():
    table = rows()
    assert [name for name in FILES if row_of(name, table) is None] == []
    assert [place for place in table if place not in FILES] == []


def test_no_module_imports_upwards():
    table = rows()
    upward = [
        f"{name} imports {target}"
        for name in FILES
        for target in imports(name)
        if row_of(target, table) > row_of(name, table)
    ]
    assert upward == []


def test_no_circle():
    """`__init__` modules re-export their own folder and are ignored."""
    folders = {name for name, path in FILES.items() if path.name == "__init__.py"}
    graph = {
        name: {target for target in imports(name) if target not in folders | {name}}
        for name in FILES
        if name not in folders
    }
    graphlib.TopologicalSorter(graph).prepare()  # raises CycleError with the modules of the circle


def test_a_circle_is_found():
    with pytest.raises(graphlib.CycleError):
        graphlib.TopologicalSorter({"a": {"b"}, "b": {"a"}}).prepare()


def test_internal_stays_small():
    tree = ast.parse(FILES["rockjax.internal"].read_text(encoding="utf-8"))
    (names,) = (ast.literal_eval(node.value) for node in tree.body if isinstance(node, ast.Assign))
    assert len(names) <= 20
