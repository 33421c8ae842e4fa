"""Access to answers as attributes of `Peak`, `Errors` and `Sensitivities`."""

from __future__ import annotations

from typing import Any

from .registry import VARIABLES


def by_name(holder: Any, name: str) -> Any:
    """Return `holder.values[name]`. If the holder does not contain this answer, return None for the name of
    an answer of a registered output, and raise `AttributeError` for other names."""
    values = holder.__dict__.get("values", {})
    if name in values or name in VARIABLES:
        return values.get(name)
    raise AttributeError(f"{type(holder).__name__} has no attribute {name!r}")
