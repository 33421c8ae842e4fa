"""Text and HTML representations of structures, motions and options."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any

import equinox as eqx
import jax
import numpy as np

from rockjax._checks import concrete
from rockjax._parameters import registry
from rockjax._tree import Module

from . import tables


class PrintedModule(Module):
    """Base class of modules that are shown as the call that constructs them and, in notebooks, as a table."""

    def __repr__(self):
        return format_call(self)

    def _repr_html_(self):
        return format_html(self)


def format_call(module: eqx.Module) -> str:
    """Return a structure or motion as the call that constructs it. Arrays are shown by their shape, minimum
    and maximum."""
    arguments = ", ".join(f"{name}={_format_value(value)}" for name, value in _fields(module))
    return f"{type(module).__name__}({arguments})"


def format_html(module: eqx.Module, meanings: Mapping[str, str] | None = None) -> str:
    """Return a structure, motion or options as an HTML table of names, values and meanings with units.

    `meanings`: name → meaning, for properties, and for fields that are not in the registry of parameters. The
    table lists the properties after the fields.
    """
    other_meanings, rows = dict(meanings or {}), []
    for name, value, meaning in _rows(module):
        rows.append((name, value, other_meanings.pop(name, meaning)))
    rows += [
        (name, _format_value(getattr(module, name)), meaning) for name, meaning in other_meanings.items()
    ]
    return tables.html(rows, caption=type(module).__name__, headings="column")


def _fields(module: eqx.Module, *, empty: bool = False) -> list[tuple[str, Any]]:
    """Return names and values of public fields. Fields with an empty tuple are left out unless `empty` is
    True."""
    fields = [
        (field.name, getattr(module, field.name))
        for field in dataclasses.fields(module)
        if field.name[0] != "_"
    ]
    return [(name, value) for name, value in fields if empty or not (isinstance(value, tuple) and not value)]


def _rows(module: eqx.Module, prefix: str = "") -> Iterator[tuple[str, str, str]]:
    """Yield name, value and meaning of every public field, and of the fields of its parts. `prefix`: text
    before the names."""
    for name, value in _fields(module, empty=True):
        meaning = _meaning(module, name)
        if isinstance(value, tuple) and not value:
            yield f"{prefix}{name}", "none", meaning
        elif isinstance(value, tuple) and all(isinstance(member, eqx.Module) for member in value):
            for k, member in enumerate(value):
                yield f"{prefix}{name}[{k}]", type(member).__name__, meaning
                yield from _rows(member, f"{prefix}{name}[{k}].")
        elif (
            isinstance(value, eqx.Module)
            and type(value).__repr__ is not eqx.Module.__repr__
            and _fields(value)
        ):
            yield f"{prefix}{name}", type(value).__name__, meaning
            yield from _rows(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", _format_value(value), meaning


def _meaning(module: eqx.Module, name: str) -> str:
    """Return the heading of a field in the registry of parameters; "" if the field is not a parameter."""
    parts = "superstructure", f"restrainers.{type(module).__name__}", "elevation"
    paths = (name, *(f"{part}.{name}" for part in parts))
    entries = registry.STRUCTURE | registry.BUILDING
    if hasattr(module, "support"):  # only motions have a support
        entries = registry.MOTION
    elif hasattr(module, "column_mass"):  # only `Dimensions` have masses in kg
        entries |= registry.DIMENSIONS
    for entry in (*entries.values(), *registry.MULTI_MODE_SCALARS.values(), *registry.ROWS.values()):
        if entry.attribute_path in paths or (not entry.attribute_path and entry.name == name):
            return entry.heading
    return ""


def _format_value(value: Any) -> str:
    """Return a value as text: a number with six digits, an array as its shape, minimum and maximum."""
    if isinstance(value, float):
        return f"{value:.6g}"
    if not isinstance(value, jax.Array | np.ndarray):
        return repr(value)
    numbers = concrete(value)
    if numbers is None:
        return "traced"
    if numbers.ndim == 0:
        return f"{float(numbers):.6g}"
    span = f", {numbers.min():.4g} … {numbers.max():.4g}" if numbers.size else ""
    return f"array(shape {numbers.shape}{span})"
