"""Formulas of reports by name: LaTeX source, MathML and equation number, from `formulas.json`.

`docs/report_formulas.py` makes the MathML in this file.
"""

from __future__ import annotations

import functools
import json
from importlib.resources import files


@functools.cache
def _formulas() -> dict[str, dict[str, str]]:
    return json.loads(files("rockjax._report").joinpath("formulas.json").read_text(encoding="utf-8"))


def names() -> tuple[str, ...]:
    """Return the names of all formulas."""
    return tuple(_formulas())


def latex(name: str) -> str:
    """Return the LaTeX source of a formula. Raises `ValueError` for an unknown name."""
    return _entry(name)["latex"]


def mathml(name: str) -> str:
    """Return the MathML of a formula, in display style. Raises `ValueError` for an unknown name."""
    return _entry(name)["mathml"]


def source(name: str) -> str:
    """Return the number of the equation in the documentation, such as "(25)"; "" for a formula without one.

    Raises `ValueError` for an unknown name.
    """
    return _entry(name)["source"]


def _entry(name: str) -> dict[str, str]:
    try:
        return _formulas()[name]
    except KeyError:
        raise ValueError(f"Formula: name must be one of {', '.join(_formulas())}, got {name!r}") from None
