"""Numbers that can be what they say, and hardly are: units of another system, dimensions in millimetres.

Said once what was understood, never an error. Only host values are looked at; nothing here runs inside a
trace.
"""

from __future__ import annotations

import warnings


class PlausibilityWarning(UserWarning):
    """A number is possible and makes little sense; the warning says what was understood.

    `warnings.simplefilter("ignore", rockjax.PlausibilityWarning)` silences all of them, in a shell
    `PYTHONWARNINGS=ignore::rockjax.PlausibilityWarning`.
    """


def doubt(message: str, stacklevel: int) -> None:
    """Warn the caller `stacklevel` frames up, as `warnings.warn` counts them from here."""
    warnings.warn(message, PlausibilityWarning, stacklevel + 1)
