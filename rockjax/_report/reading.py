"""Reading of problem files of reports."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import jax

from rockjax._motions.convert import make_unique
from rockjax._motions.motion import Motion
from rockjax._problem import models
from rockjax._problem.reading import Reader, load_table
from rockjax._structures import Podium
from rockjax._text.reading import read_text

from .kinds import KINDS, check_model
from .problem import Input, MotionSet, Problem


def read_problem(path: str | Path) -> Problem:
    """Read a problem file for a report (host).

    - `path`: a TOML file with `[structure]`, `[motions.NAME]`, and `[[checks]]` or `[[targets]]`

    Returns a [`rockjax.Problem`][]. Raises `ValueError`, which names the file, the key, the cause and
    the cure, and `OSError` if the file cannot be read.
    """
    path = Path(path)
    return problem_of(load_table(path), path)


def problem_of(table: Mapping[str, Any], path: Path) -> Problem:
    """Return the problem of a table, which may differ from its file by options of the command line.

    - `table`: contents of the file; `path`: its path, to whose folder other paths are relative
    """
    reader = Reader(path)
    file = reader.check(models.Problem, table)
    if file.structure is None:
        reader.fail("structure", "is missing; a report needs the structure, by ratios or by dimensions")
    podium = reader.structure(file.structure)
    sets = {}
    for name in file.motions:
        members = tuple(reader.members(file.motions, name, podium))
        names = make_unique([_name(member) for member in members])
        sets[name] = MotionSet(name, file.report.motions.get(name, name), members, tuple(names))
    for name in file.report.motions:
        if name not in sets:
            reader.require_set(sets, name, f"report.motions.{name}")
    checks = tuple(_checks(reader, table, sets, podium))
    if not checks:
        reader.fail("checks", "is missing; a report needs [[checks]] or [[targets]]")
    inputs = tuple(
        Input(key, value, file.sources.get(f"structure.{key}")) for key, value in _inputs(file.structure)
    )
    known = {f"structure.{entry.key}" for entry in inputs} | set(_paths(table))
    for name in file.sources:
        if name not in known:
            reader.fail(
                f"sources.{name}",
                "is not a key of this file; give the path of a key, such as 'structure.width'",
            )
    return Problem(
        path=path,
        text=read_text(path, utf8_only=True),
        podium=podium,
        inputs=inputs,
        motions=sets,
        checks=checks,
        options=reader.options(file.options),
        sources=file.sources,
        project=file.project,
        joints=file.joints,
        report=file.report,
        fragility=file.fragility,
        risk=file.risk,
        structure=file.structure,
    )


def _name(member: Any) -> str:
    if isinstance(member, Motion):
        return member.name
    values = ", ".join(f"{float(y):.4g}" for y in jax.tree.leaves(member))
    return f"{type(member).__name__}({values})"


def _inputs(structure: models.Keys) -> Iterator[tuple[str, Any]]:
    """Yield key and value of every input of a structure; of its inner tables as `table.key`."""
    for name, value in structure.as_arguments().items():
        if isinstance(value, models.Keys):
            yield from ((f"{name}.{inner}", y) for inner, y in value.as_arguments().items())
        else:
            yield name, value


def _paths(table: Mapping[str, Any], prefix: str = "") -> Iterator[str]:
    for name, value in table.items():
        yield f"{prefix}{name}"
        if isinstance(value, dict):
            yield from _paths(value, f"{prefix}{name}.")


def _checks(reader: Reader, table: Mapping[str, Any], sets: Mapping[str, Any], podium: Podium):
    """Yield the checks of a file, from `[[checks]]` and then from `[[targets]]`."""
    taken: set[str] = set()
    for part in ("checks", "targets"):
        entries = table.get(part, [])
        if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
            reader.fail(part, f"must be a list of tables [[{part}]]")
        for k, entry in enumerate(entries):
            where = f"{part}[{k}]"
            kind = entry.get("kind")
            if kind is None:
                reader.fail(where, "kind is missing")
            if kind not in KINDS:
                near = difflib.get_close_matches(str(kind), KINDS, 1)
                hint = f"did you mean {near[0]}?" if near else f"the kinds are {', '.join(KINDS)}"
                reader.fail(f"{where}.kind", f"must be a kind of check, got {kind!r}; {hint}")
            with reader.at(where):
                given = {name: _resolve(reader, table, where, name, value) for name, value in entry.items()}
                keys = reader.check(check_model(kind), given)
            identity = keys.id or f"{'C' if part == 'checks' else 'T'}{k + 1}"
            if identity in taken:
                reader.fail(f"{where}.id", f"{identity!r} is the id of another check; give each its own")
            taken.add(identity)
            motions = keys.motions
            if KINDS[kind].needs_motions:
                motions = reader.require_set(sets, motions, f"{where}.motions")
            updated = keys.model_copy(
                update={"id": identity, "motions": motions, "is_target": part == "targets"}
            )
            with reader.at(where):
                KINDS[kind].check(updated, podium)
            yield updated


def _resolve(reader: Reader, table: Mapping[str, Any], where: str, name: str, value: Any) -> Any:
    """Return the value of a limit that is a key of the file, such as "joints.friction"; other values
    unchanged."""
    if name not in ("limit", "at_least", "at_most") or not isinstance(value, str):
        return value
    found: Any = table
    for step in value.split("."):
        found = found.get(step) if isinstance(found, dict) else None
    if not isinstance(found, int | float) or isinstance(found, bool) or not math.isfinite(found):
        reader.fail(f"{where}.{name}", f"must be a number or a key of this file, got {value!r}")
    return float(found)
