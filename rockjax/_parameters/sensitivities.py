"""Parameters of sensitivities: checks of their names, and podiums with parameters multiplied by factors.

The sensitivity of an answer f to a parameter y is y ∂f/∂y, the derivative of f with respect to a factor on y.
Some names, such as `positions`, denote a factor on all values of a row.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Array, Float

from rockjax import _checks
from rockjax._structures import Podium

from . import variants
from .registry import ROWS, WHOLE_ROWS, find_clash


def check_parameters(owner: str, podium: Podium, names: Sequence[str], more: Sequence[str] = ()) -> None:
    """Raise `ValueError` unless derivatives with respect to the named parameters exist.

    - `owner`: name of the calling function, for error messages
    - `podium`: the podium
    - `names`: names of parameters
    - `more`: names that are valid in addition to the parameters of the podium

    Unknown names, parameters without a derivative, a name that occurs twice, and two names for the same
    quantity are invalid.
    """
    names = _checks.as_strings(owner, "sensitivities", names)
    rows, parameters = _whole_rows(podium), variants.parameters_of(podium)
    fixed = {name for name, parameter in parameters.items() if variants.is_fixed(podium, parameter)}
    valid = [*(name for name in parameters if name not in fixed), *rows, *more]
    for name in names:
        if name in fixed:
            value = float(np.max(variants.read(podium, name)))
            cure = f"give it as an array, np.array({value:g})" if value else "give another value"
            raise ValueError(
                f"{owner}: sensitivities contain {name!r}, which is fixed at {value:g} in this podium before "
                f"tracing and has no derivative; {cure}"
            )
        if name not in valid:
            raise ValueError(
                f"{owner}: sensitivities must each be one of {valid} for this podium, got {name!r}"
            )
    if len(set(names)) < len(names):
        raise ValueError(f"{owner}: sensitivities must name each parameter once, got {list(names)}")
    clash = find_clash(names) or next(
        ((row, y) for row in rows for y in rows[row] if {row, y} <= {*names}), None
    )
    if clash is not None:
        raise ValueError(
            f"{owner}: sensitivities contain {clash[0]} and {clash[1]}, which cannot vary at the same time; "
            "give one of them"
        )


def with_factors(
    podium: Podium, names: Sequence[str], factors: Float[Array, " n"] | Sequence[Array]
) -> Podium:
    """Return the podium with the named parameters multiplied by factors, one for each name."""
    rows = _whole_rows(podium)
    factor_of = {y: z for name, z in zip(names, factors, strict=True) for y in rows.get(name, [name])}
    return variants.with_values(
        podium, {name: factor * variants.read(podium, name) for name, factor in factor_of.items()}
    )


def _whole_rows(podium: Podium) -> dict[str, list[str]]:
    """Return the names in `WHOLE_ROWS` that this podium has, and the names of the values of each row."""
    rows = {name: [y.name for y in variants.row_of(podium, ROWS[row])] for name, row in WHOLE_ROWS.items()}
    return {name: row for name, row in rows.items() if row}
