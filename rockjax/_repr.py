"""What structures and motions say of themselves."""

from __future__ import annotations

import dataclasses
from typing import Any

import equinox as eqx
import jax
import numpy as np

from ._checks import concrete

_UNITS = {"m s-2": "m/s²", "m s-1": "m/s", "1": ""}


def units(of: str) -> str:
    """The units of a dataset as they are shown; nothing for ratios."""
    return _UNITS.get(of, of)


def readable(module: eqx.Module) -> str:
    """A structure or motion as the call that makes it, with its numbers; arrays by shape and range."""
    fields = ((field.name, getattr(module, field.name)) for field in dataclasses.fields(module))
    return f"{type(module).__name__}({', '.join(f'{name}={_value(value)}' for name, value in fields)})"


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
