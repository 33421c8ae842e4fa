"""The base of all classes whose numbers JAX sees."""

from __future__ import annotations

import dataclasses
import functools
from typing import TYPE_CHECKING, Any, TypeVar

import equinox as eqx

_Kind = TypeVar("_Kind", bound=eqx.Module)


class Module(eqx.Module):
    """Equinox's module with the methods of any other class.

    Equinox makes a pytree of a method whenever it is looked up, so that it can be an argument of a compiled
    function. That takes .05 ms, which small batches feel, and nothing here needs it.
    """

    if not TYPE_CHECKING:
        __getattribute__ = object.__getattribute__


def filled(kind: type[_Kind], **fields: Any) -> _Kind:
    """A module whose fields are known to be right, others as by default: without checks, which take long.

    Raises `TypeError` for a field that is not given and has no default.
    """
    made = object.__new__(kind)
    for name, default in _defaults(kind):
        value = fields.get(name, default)
        if value is dataclasses.MISSING:
            raise TypeError(f"{kind.__name__}: no {name}")
        object.__setattr__(made, name, value)
    return made


@functools.cache
def _defaults(kind: type) -> tuple[tuple[str, Any], ...]:
    """The names of fields, and what each is by default."""
    return tuple((field.name, field.default) for field in dataclasses.fields(kind))
