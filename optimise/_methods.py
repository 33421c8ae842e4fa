"""The methods of `design`: a module and a line each."""

from __future__ import annotations

from typing import NamedTuple

import optax

from . import _augmented, _sqp
from ._descent import Descend


class Method(NamedTuple):
    """`descend`: one descent; `max_iterations`: that it is given by default; `transformation`: what it is
    made of."""

    descend: Descend
    max_iterations: int
    transformation: optax.GradientTransformation | None = None


METHODS = {
    "sqp": Method(_sqp.descend_by_sqp, _sqp.MAX_ITERATIONS),
}


def method_of(given: str | optax.GradientTransformation) -> Method:
    """The method of a name, or around a gradient transformation. Raises `ValueError` for anything else."""
    if isinstance(given, str) and given in METHODS:
        return METHODS[given]
    if isinstance(given, optax.GradientTransformation):
        return Method(_augmented.descend_by_gradients(given), _augmented.MAX_ITERATIONS, given)
    names = ", ".join(map(repr, METHODS))
    raise ValueError(
        f"design: method must be "
        f"{names} or a gradient transformation of Optax such as optax.adam(0.02), got {given!r}"
    )
