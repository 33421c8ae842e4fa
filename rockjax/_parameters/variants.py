"""Read and set parameters of structures by name, and convert dimensionless amplitudes and frequencies of
pulses to SI units. Eq. (25) is in docs/model.md."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from rockjax._checks import array_module, require
from rockjax._structures import Podium, g_tan_alpha, slenderness_and_size
from rockjax._structures.modes import split_row, split_unless_scalar, stack_row, with_fields

from .registry import (
    MOTION,
    MULTI_MODE_SCALARS,
    ROWS,
    STRUCTURE,
    WHOLE_ROWS,
    WIDTH_AND_HEIGHT,
    Parameter,
    find_clash,
    numbered_parameter,
)


def find_parameter(name: str) -> Parameter | None:
    """Return the parameter of a structure that has this name, or that has this attribute path in `STRUCTURE`;
    None if there is no such parameter."""
    for table in (STRUCTURE, MULTI_MODE_SCALARS):
        if name in table:
            return table[name]
    row, _, number = name.rpartition("_")
    if row in ROWS and number.isdecimal():
        return numbered_parameter(ROWS[row], int(number))
    return next((entry for entry in STRUCTURE.values() if entry.attribute_path == name), None)


def attribute_path_of(name: str) -> str:
    """Return the attribute path of a parameter of a structure; empty for other names and derived
    parameters."""
    parameter = find_parameter(name)
    return "" if parameter is None else parameter.attribute_path


def is_of_elevation(name: str) -> bool:
    """Return whether a parameter, or a row in `WHOLE_ROWS`, affects only the forces in the joints."""
    path = ROWS[WHOLE_ROWS[name]].attribute_path if name in WHOLE_ROWS else attribute_path_of(name)
    return path.startswith(("elevation.", _STORY_HEIGHTS_PATH))


def parameters_of(podium: Podium) -> dict[str, Parameter]:
    """Return the parameters of this podium by name, including derived ones such as `tan_alpha`."""
    entries = (STRUCTURE | MULTI_MODE_SCALARS).items()
    parameters = {
        name: entry for name, entry in entries if not entry.is_integer and has_parameter(podium, entry)
    }
    for entry in ROWS.values():
        parameters |= {parameter.name: parameter for parameter in row_of(podium, entry)}
    return parameters


def row_of(podium: Podium, entry: Parameter) -> list[Parameter]:
    """Return the parameters of the values of a row, one for each mode, story or column, as in `_row`."""
    return [numbered_parameter(entry, k + 1) for k in range(len(_row(podium, entry)))]


def lists_of(podium: Podium) -> dict[str, list[str]]:
    """Return the names of the values of each row, by the attribute path of the row, such as
    `superstructure.masses`."""
    rows = {entry.attribute_path: row_of(podium, entry) for entry in ROWS.values()}
    return {path: [y.name for y in row] for path, row in rows.items() if row}


def _row(podium: Podium, entry: Parameter) -> tuple[Any, ...]:
    """Return the values of a parameter that has a value for each mode, story or column.

    The result is empty if one value holds for all modes, stories or columns, or if the podium has no such
    parameter.
    """
    path, _, field = entry.attribute_path.partition(".")
    holder = getattr(podium, path)
    if field not in getattr(holder, "rows", ()) or (
        entry.attribute_path == _TOP_HEIGHT_PATH and not _has_several_heights(podium)
    ):
        return ()
    if entry.attribute_path == _STORY_HEIGHTS_PATH and podium.elevation is None:
        return ()
    values = getattr(holder, field)
    row = () if values is None else split_unless_scalar(values)
    return row if isinstance(row, tuple) else ()


def _has_several_heights(podium: Podium) -> bool:
    """Return whether each mode or floor of the superstructure has a height of its own.

    Otherwise an array of heights means a batch of structures.
    """
    superstructure = podium.superstructure
    return superstructure is not None and superstructure.height_count is not None


_TOP_HEIGHT_PATH = STRUCTURE["top_height"].attribute_path
_STORY_HEIGHTS_PATH = ROWS["story_height"].attribute_path


def has_parameter(podium: Podium, parameter: Parameter) -> bool:
    """Return whether this podium has a parameter. Every podium has the derived parameters, such as
    `tan_alpha`."""
    if parameter.attribute_path == _TOP_HEIGHT_PATH:
        return podium.elevation is not None and not _has_several_heights(podium)
    if parameter.attribute_path.startswith(_STORY_HEIGHTS_PATH) and podium.elevation is None:
        return False
    try:
        _stored_value(podium, parameter.attribute_path)
    except AttributeError:
        return False
    return True


def is_fixed(podium: Podium, parameter: Parameter) -> bool:
    """Return whether a parameter of this podium is static, such as the exponent of a linear damper.

    A static parameter is fixed before tracing and has no derivative.
    """
    try:
        return not jax.tree.leaves(_stored_value(podium.split_rows(), parameter.attribute_path))
    except AttributeError:  # a residual mass of 0 is not stored, so it cannot vary
        return True


def read(podium: Podium, name: str) -> Any:
    """Return the value of a parameter of this podium, by name. Raises `ValueError` for other names."""
    parameter = _require_parameter(podium, name)
    if parameter.attribute_path:
        return _stored_value(podium, parameter.attribute_path)
    return jnp.tan(podium.alpha) if parameter.name == "tan_alpha" else getattr(podium, parameter.name)


def with_values(podium: Podium, values: Mapping[str, Any]) -> Podium:
    """Return the podium with some of its parameters changed.

    Raises `ValueError` for names that are not parameters of the podium, for two names of the same quantity,
    and for values out of range.
    """
    parameters = {name: _require_parameter(podium, name) for name in values}
    values = {parameters[name].name: value for name, value in values.items()}
    clash = find_clash(values)
    if clash is not None:
        raise ValueError(f"{clash[0]} and {clash[1]} describe the same quantity; give one of them")
    paths = {entry.name: entry.attribute_path for entry in parameters.values() if entry.attribute_path}
    stored = {
        paths[name]: _for_all_modes(podium, paths[name], value)
        for name, value in values.items()
        if name in paths
    }
    if "tan_alpha" in values:
        stored["alpha"] = jnp.arctan(values["tan_alpha"])
    if any(name in values for name in WIDTH_AND_HEIGHT):
        width, height = (values.get(name, getattr(podium, name)) for name in WIDTH_AND_HEIGHT)
        stored["alpha"], stored["R"] = slenderness_and_size(width, height)
    return _with_changes(podium, {tuple(path.split(".")): value for path, value in stored.items()})


def check_values(
    owner: str, values: Mapping[str, Any], parameters: Mapping[str, Parameter] | None = None
) -> None:
    """Raise `ValueError` for parameters of a structure or a pulse that are out of range.

    - `parameters`: the parameters by name; by default those of podiums and pulses
    """
    for name, value in values.items():
        entry = find_parameter(name) or MOTION[name] if parameters is None else parameters[name]
        allowed = entry.range
        condition = allowed.text if allowed.text.startswith("in") else f"finite and {allowed.text}"
        require(owner, name, value, allowed.holds, condition.removesuffix(" and "))


def pulse_acceleration(podium: Podium, acceleration_ratio: Any) -> Any:
    """Convert a_p/(g tan α) of a pulse to a_p [m/s²]."""
    return acceleration_ratio * g_tan_alpha(podium.alpha, podium.g)


def pulse_period(p: Any, frequency_ratio: Any) -> Any:
    """Convert ω_p/p of a pulse to T_p [s], for a podium with the frequency parameter p, Eq. (25)."""
    return 2 * math.pi / (frequency_ratio * p)


def _require_parameter(podium: Podium, name: str) -> Parameter:
    parameter = find_parameter(name)
    if parameter is None or not has_parameter(podium, parameter):
        raise ValueError(
            f"name must be one of the parameters of this podium, {', '.join(parameters_of(podium))}; "
            f"got {name!r}"
        )
    return parameter


def _stored_value(holder: Any, path: str) -> Any:
    """Return the value stored at an attribute path. Raises `AttributeError` if the object has no such
    value."""
    for step in path.split(".") if path else ():
        if step.isdecimal():
            holder = _row_value(holder, int(step))
        elif isinstance(holder, tuple):
            holder = holder[_index_of_class(holder, step)]
        else:
            rows = [] if path == _TOP_HEIGHT_PATH else getattr(holder, "rows", ())
            holder = getattr(holder, step)
            if step in rows and path.endswith(step) and split_unless_scalar(holder) is not holder:
                raise AttributeError(f"{step} is a row of numbers")
            if holder is None:
                raise AttributeError(f"{step} is None")
    return holder


def _row_value(values: Any, number: int) -> Any:
    """Return a value of a row by number, from 1. Raises `AttributeError` if there is no such value."""
    if split_unless_scalar(values) is values and not isinstance(values, tuple):
        raise AttributeError("a single number applies to all")
    row = split_row(values)
    if not 1 <= number <= len(row):
        raise AttributeError(f"the row has {len(row)} values, so there is no number {number}")
    return row[number - 1]


def _index_of_class(members: tuple, class_name: str) -> int:
    """Return the index of the only member with this class. Raises `AttributeError` for none or several."""
    indices = [k for k, member in enumerate(members) if type(member).__name__ == class_name]
    if len(indices) != 1:
        raise AttributeError(f"{len(indices)} members of class {class_name}")
    return indices[0]


def _for_all_modes(podium: Podium, path: str, value: Any) -> Any:
    """Return the new values of a parameter, in the form in which the podium stores it.

    - `path`: attribute path of the parameter
    - `value`: a number, or an array of values for a batch of podiums

    If the podium stores a value for each mode, but `value` has one value for each podium of a batch, each
    value is repeated for all modes along a new last axis. Without the new axis, the axis of the batch would
    be taken for the axis of modes.
    """
    superstructure, field = podium.superstructure, path.removeprefix("superstructure.")
    if field == path or superstructure is None or field not in superstructure.rows:
        return value
    if isinstance(getattr(superstructure, field), tuple) or not np.ndim(value):
        return value
    return array_module(value).repeat(value[..., None], superstructure.count, -1)


def _with_changes(holder: Any, changes: Mapping[tuple[str, ...], Any]) -> Any:
    """Return a variant of a dataclass, or of a tuple of dataclasses, with new values.

    `changes` maps the path of a value, as a tuple of the steps of its attribute path, to the new value.
    """
    by_step: dict[str, dict[tuple[str, ...], Any]] = {}
    for (step, *rest), value in changes.items():
        by_step.setdefault(step, {})[tuple(rest)] = value
    new_values: dict[str, Any] = {}
    for step, inner_changes in by_step.items():
        if () in inner_changes:
            new_values[step] = inner_changes[()]
        elif all(len(rest) == 1 and rest[0].isdecimal() for rest in inner_changes):
            new_values[step] = _with_row_values(
                getattr(holder, step), {int(k): y for (k,), y in inner_changes.items()}
            )
        else:
            new_values[step] = _with_changes(_stored_value(holder, step), inner_changes)
    if isinstance(holder, tuple):
        members = {_index_of_class(holder, step): value for step, value in new_values.items()}
        return tuple(members.get(k, member) for k, member in enumerate(holder))
    if any(isinstance(getattr(holder, field), tuple) for field in getattr(holder, "rows", ())):
        return with_fields(holder, new_values)  # in a program, rows are split into tuples of scalars
    return dataclasses.replace(holder, **new_values)


def _with_row_values(values: Any, changes: Mapping[int, Any]) -> Any:
    """Return a row with some values replaced. `changes` maps the number of a value, from 1, to the new
    value."""
    row = tuple(changes.get(k, y) for k, y in enumerate(split_row(values), start=1))
    return row if isinstance(values, tuple) else stack_row(row)
