"""Reading of problem files for reports."""

from __future__ import annotations

import dataclasses
import difflib
import hashlib
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import jax

from rockjax._motions.convert import make_unique
from rockjax._motions.motion import Motion
from rockjax._problem import models
from rockjax._problem.models.fields import NO_VALUE
from rockjax._problem.reading import Reader, load_table
from rockjax._structures import Podium
from rockjax._text.reading import read_text

from .entry import BOUNDS, Entry
from .kinds import KINDS, check_model
from .problem import Input, MotionSet, Problem
from .units import Units, unit_of_kind


def read_problem(path: str | Path) -> Problem:
    """Read a problem file for a report.

    - `path`: a TOML file with `[structure]`, `[motions.NAME]`, and `[[checks]]` or `[[targets]]`

    Returns a [`rockjax.Problem`][]. Raises `ValueError` if the file is invalid or cannot be read. The message
    names the file, the key, the cause and the cure.
    """
    path = Path(path)
    return problem_of(load_table(path), path)


def problem_of(table: Mapping[str, Any], path: Path) -> Problem:
    """Return the problem that a table describes. Raises `ValueError` as `read_problem` does.

    - `table`: contents of a problem file, in which the command line may have replaced some values
    - `path`: path of the file, whose folder is the base of relative paths
    """
    reader = Reader(path)
    file = reader.check(models.Problem, table)
    if file.structure is None:
        reader.fail(
            "structure", "is missing; a report needs the table [structure], with ratios or dimensions"
        )
    podium = reader.structure(file.structure)
    sets: dict[str, MotionSet] = {}
    for name in file.motions:
        if name.lower() in map(str.lower, sets):
            reader.fail(
                f"motions.{name}",
                "is the name of another set; choose another name (upper and lower case do not count)",
            )
        members = tuple(reader.members(file.motions, name, podium))
        names = make_unique([_name(member, k) for k, member in enumerate(members, 1)])
        sets[name] = MotionSet(name, file.report.motions.get(name, name), members, tuple(names))
    for name in file.report.motions:
        if name not in sets:
            reader.require_set(sets, name, f"report.motions.{name}")
    try:
        Units.parse(file.report.units or ())
    except ValueError as error:
        reader.fail("report.units", str(error).removeprefix("units: "))
    checks = tuple(read_checks(reader, table, file, podium))
    if not checks:
        reader.fail("checks", "is missing; a report needs [[checks]] or [[targets]]")
    sources = file.sources | dict.fromkeys(_replaced(table, load_table(path)), "command line")
    inputs = tuple(
        Input(key, value, sources.get(f"structure.{key}") or None) for key, value in _inputs(file.structure)
    )
    keys = {f"structure.{entry.key}" for entry in inputs} | set(_paths(table))
    for name in file.sources:
        if name not in keys:
            reader.fail(
                f"sources.{name}",
                "is not a key of this file; give the path of a key, such as 'structure.width'",
            )
    problem = Problem(
        path=path,
        text=read_text(path, utf8_only=True),
        sha256=hashlib.sha256(path.read_bytes()).hexdigest(),
        podium=podium,
        inputs=inputs,
        motions=sets,
        checks=checks,
        options=reader.options(file.options),
        sources=sources,
        project=file.project,
        joints=file.joints,
        report=file.report,
        fragility=file.fragility,
        risk=file.risk,
        structure=file.structure,
        given=file.model_fields_set,
    )
    strip, width = problem.joints.contact_width, problem.column_size[0]
    if strip is not None and strip > width:
        reader.fail(
            "joints.contact_width", f"must be at most the width of a column, {width:g} m, got {strip:g}"
        )
    return problem


def _name(member: Any, number: int) -> str:
    """Return the name of a record, or for a pulse a name such as "Ricker(2, 0.5)". A name that looks like a
    missing value, such as "-", is replaced by "motion 3", with the `number` of the motion."""
    if isinstance(member, Motion):
        return f"motion {number}" if NO_VALUE.fullmatch(member.name) else member.name
    values = ", ".join(f"{float(y):.4g}" for y in jax.tree.leaves(member))
    return f"{type(member).__name__}({values})"


def _inputs(structure: models.Keys) -> Iterator[tuple[str, Any]]:
    """Yield the key and the value of every input of a structure. A key of an inner table has the form
    "table.key"."""
    for name, value in structure.as_arguments().items():
        if isinstance(value, models.Keys):
            yield from ((f"{name}.{inner}", y) for inner, y in value.as_arguments().items())
        else:
            yield name, value


def _replaced(table: Mapping[str, Any], original: Mapping[str, Any]) -> list[str]:
    """Return the paths of the keys of `[structure]` whose values in `table` differ from those of the file,
    `original`."""

    def leaves(of: Mapping[str, Any]) -> dict[str, Any]:
        found = {}
        for path in _paths({"structure": of.get("structure", {})}):
            value: Any = of
            for name in path.split("."):
                value = value[name]
            found[path] = value
        return found

    values = leaves(original)
    return [
        path
        for path, value in leaves(table).items()
        if not isinstance(value, dict) and (path not in values or values[path] != value)
    ]


def _paths(table: Mapping[str, Any], prefix: str = "") -> Iterator[str]:
    """Yield the paths of all keys of a table, such as "structure.width"."""
    for name, value in table.items():
        yield f"{prefix}{name}"
        if isinstance(value, dict):
            yield from _paths(value, f"{prefix}{name}.")


def read_checks(
    reader: Reader,
    table: Mapping[str, Any],
    file: models.Problem,
    podium: Podium,
    parts: tuple[str, ...] = ("checks", "targets"),
) -> Iterator[Entry]:
    """Yield the entries of `[[checks]]` and `[[targets]]`.

    - `reader`: reader of the file
    - `table`: contents of the file; `file`: the contents after validation
    - `podium`: the structure
    - `parts`: names of the lists of tables to read, in this order

    Raises `ValueError` for an invalid entry, with the file, the key and the cause.
    """
    used_ids: set[str] = set()
    for part in parts:
        entries = table.get(part, [])
        if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
            reader.fail(part, f"must be a list of tables [[{part}]]")
        for k, given in enumerate(entries):
            with reader.errors_at(f"{part}[{k}]"):
                entry = _entry(reader, table, file, podium, f"{part}[{k}]", given)
            identity = entry.id or f"{'C' if part == 'checks' else 'T'}{k + 1}"
            if identity.lower() in used_ids:
                reader.fail(
                    f"{part}[{k}].id",
                    f"{identity!r} is the id of another check; give each check its own id "
                    "(upper and lower case do not count)",
                )
            used_ids.add(identity.lower())
            motions = None
            if KINDS[entry.kind].uses_motions(entry.arguments):
                motions = reader.require_set(file.motions, entry.motions, f"{part}[{k}].motions")
            yield dataclasses.replace(entry, id=identity, motions=motions, is_target=part == "targets")


def _entry(
    reader: Reader,
    table: Mapping[str, Any],
    file: models.Problem,
    podium: Podium,
    where: str,
    given: Mapping[str, Any],
) -> Entry:
    """Return an entry. The caller replaces its fields `id`, `motions` and `is_target` by their final values.

    - `reader`, `table`, `file`, `podium`: as for `read_checks`
    - `where`: key of the entry, such as "checks[0]"; `given`: table of the entry
    """
    name = given.get("kind")
    if name is None:
        raise ValueError(f"kind is missing; the kinds are {', '.join(KINDS)}")
    if name not in KINDS:
        near = difflib.get_close_matches(str(name), KINDS, 1)
        hint = f"did you mean {near[0]}?" if near else f"the kinds are {', '.join(KINDS)}"
        raise ValueError(f"kind must be a kind of check, got {name!r}; {hint}")
    kind = KINDS[name]
    resolved = {key: _resolve(table, key, value) for key, value in given.items()}
    keys = reader.check(check_model(name), resolved, where)
    arguments = kind.read(keys, reader, file, podium)
    kind.check(keys, kind.uses_motions(arguments))
    quantity = kind.quantity_of(keys, file)
    if keys.unit is not None and kind.has_limit:
        try:
            unit_of_kind(keys.unit, quantity, subject=name)
        except ValueError as error:
            reader.fail(f"{where}.unit", str(error).removeprefix("unit: "))
    limit = kind.limit(keys, quantity, float(podium.g))
    return Entry(keys.id or "", name, keys, arguments, keys.motions, quantity, limit, False)


def _resolve(table: Mapping[str, Any], name: str, value: Any) -> Any:
    """Return a value of an entry. If the value is a limit that names a key of the file, such as
    "joints.friction", return the number at this key instead. If the file does not have this key but may have
    it, return the name of the key.

    - `table`: contents of the problem file
    - `name`, `value`: key and value in the table of the check

    Raises `ValueError` for other texts, and if the value at the key is not a finite number.
    """
    if name not in BOUNDS or not isinstance(value, str):
        return value
    number: Any = table
    for part in value.split("."):
        number = number.get(part) if isinstance(number, dict) else None
    if number is None and _is_valid_key(value):
        return value
    if not isinstance(number, int | float) or isinstance(number, bool) or not math.isfinite(number):
        raise ValueError(
            f"{name} must be a number or a key of this file with a number, such as 'joints.friction'; "
            f"got {value!r}"
        )
    return float(number)


def _is_valid_key(path: str) -> bool:
    """Return whether problem files may have a value at a path such as "joints.friction"."""
    model: Any = models.Problem
    for name in path.split("."):
        fields = getattr(model, "model_fields", {})
        if name not in fields:
            return False
        model = fields[name].annotation
    return not hasattr(model, "model_fields")
