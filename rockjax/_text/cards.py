"""Text and HTML representations of structures, motions and options."""

from __future__ import annotations

import dataclasses
import inspect
import re
from collections.abc import Iterator
from typing import Any

import equinox as eqx
import jax
import numpy as np

from rockjax._checks import concrete

from . import tables

LONGEST = 90  # characters of a meaning


def readable(module: eqx.Module) -> str:
    """A structure or motion as the call that makes it, with its numbers; arrays by shape and range."""
    return (
        f"{type(module).__name__}({', '.join(f'{name}={_value(value)}' for name, value in _fields(module))})"
    )


def card(module: eqx.Module, derived: tuple[str, ...] = ()) -> str:
    """A structure, motion or options as a table of HTML: its numbers, what follows from them, and what they
    mean."""
    rows = list(_rows(module))
    cls = type(module)
    for name in derived:
        rows.append((name, _value(getattr(module, name)), _plain(getattr(cls, name).__doc__)))
    return tables.html(rows, caption=cls.__name__, heads="column")


def _fields(module: eqx.Module, *, empty: bool = False) -> list[tuple[str, Any]]:
    """Names and values, with or without empty tuples."""
    fields = [
        (field.name, getattr(module, field.name))
        for field in dataclasses.fields(module)
        if field.name[0] != "_"
    ]
    return [(name, value) for name, value in fields if empty or not (isinstance(value, tuple) and not value)]


def _rows(module: eqx.Module, prefix: str = "") -> Iterator[tuple[str, str, str]]:
    """Name, value and meaning of every field; the meanings are those of the docstring, `- `name`:
    meaning`."""
    meanings = _meanings(type(module))
    for name, value in _fields(module, empty=True):
        known = meanings.get(name, "")
        if isinstance(value, tuple) and not value:
            yield f"{prefix}{name}", "none", known
        elif isinstance(value, tuple) and all(isinstance(part, eqx.Module) for part in value):
            for k, part in enumerate(value):
                yield f"{prefix}{name}[{k}]", type(part).__name__, known
                yield from _rows(part, f"{prefix}{name}[{k}].")
        elif (
            isinstance(value, eqx.Module)
            and type(value).__repr__ is not eqx.Module.__repr__
            and _fields(value)
        ):
            yield f"{prefix}{name}", type(value).__name__, known
            yield from _rows(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", _value(value), known


def _meanings(cls: type) -> dict[str, str]:
    """Read the meaning of fields from docstring bullets such as "- `A`, `B`: meaning; `C`: meaning"."""
    found = {}
    described = "\n\n".join(inspect.cleandoc(parent.__doc__ or "") for parent in reversed(cls.__mro__))
    for bullet in re.findall(r"^- (`.*(?:\n(?!- |\n).*)*)", described, re.M):
        _, *parts = re.split(r"(?:^|; )((?:`\w+`(?:, )?)+): ", " ".join(bullet.split()))
        for names, meaning in zip(parts[::2], parts[1::2], strict=True):
            found |= dict.fromkeys(re.findall(r"\w+", names), _plain(meaning))
    return found


def _plain(docstring: str | None) -> str:
    """The first sentence, without marks of the documentation."""
    words = re.sub(r"\[`(?:\w+\.)?(\w+)`\]\[\]", r"\1", " ".join((docstring or "").split())).replace("`", "")
    sentence = re.split(r"(?<!Eq)(?<!Eqs)\.(?:\s|$)|;\s", words, maxsplit=1)[0]
    return sentence if len(sentence) <= LONGEST else f"{sentence[:LONGEST].rsplit(' ', 1)[0]} …"


def _value(value: Any) -> str:
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
