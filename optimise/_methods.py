"""The methods of `design`: a module and a line each."""

from __future__ import annotations

from typing import Any, NamedTuple

from ._descent import Descend
from ._sqp import MAX_ITERATIONS, descend_by_sqp


class Method(NamedTuple):
    """`descend`: one descent; `max_iterations`: that it is given by default."""

    descend: Descend
    max_iterations: int


METHODS = {
    "sqp": Method(descend_by_sqp, MAX_ITERATIONS),
}


def method_of(given: Any) -> Method:
    """The method of a name. Raises `ValueError` for others."""
    if isinstance(given, str) and given in METHODS:
        return METHODS[given]
    raise ValueError(f"design: method must be {', '.join(map(repr, METHODS))}, got {given!r}")
