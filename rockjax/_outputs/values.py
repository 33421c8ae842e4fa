"""Holders of answers by name: attributes of peaks, errors and sensitivities."""

from __future__ import annotations

from typing import Any

from .registry import VARIABLES


def by_name(holder: Any, name: str) -> Any:
    """Return one of the values of a holder by its name; None for an output of the registry that it does not
    have. Raises `AttributeError` for other names."""
    values = holder.__dict__.get("values", {})
    if name in values or name in VARIABLES:
        return values.get(name)
    raise AttributeError(f"{type(holder).__name__} has no attribute {name!r}")
