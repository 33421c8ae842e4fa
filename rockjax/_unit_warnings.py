"""Warnings about values that suggest a unit error: units of another system, dimensions in millimetres.

A warning states what was understood; it is never an error. Only host values are checked; nothing here runs
inside a trace.
"""

from __future__ import annotations

import warnings

from ._machine.environment import switched_off


class PlausibilityWarning(UserWarning):
    """Warning about a value that suggests a unit error; it states how the value was understood.

    `warnings.simplefilter("ignore", rockjax.PlausibilityWarning)` silences all of them, and so does
    `ROCKJAX_PLAUSIBILITY=off` in the environment.
    """


def warn_about_units(
    message: str, stacklevel: int, category: type[PlausibilityWarning] = PlausibilityWarning
) -> None:
    """Warn the caller `stacklevel` frames up, as `warnings.warn` counts them from here."""
    if not switched_off("ROCKJAX_PLAUSIBILITY"):
        warnings.warn(message, category, stacklevel + 1)
