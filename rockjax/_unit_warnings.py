"""Warnings about values that are hardly plausible, such as dimensions in millimetres.

A warning states how rockjax understood the value. Traced values are not checked.
"""

from __future__ import annotations

import warnings

from ._machine.environment import switched_off


class PlausibilityWarning(UserWarning):
    """Warning about a value that suggests a unit error, or about a restitution factor that is too small for
    impacts between rigid faces. The message states how rockjax understood the value.

    `warnings.simplefilter("ignore", rockjax.PlausibilityWarning)`, or `ROCKJAX_PLAUSIBILITY=off` in the
    environment, silences all such warnings.
    """


def warn_about_units(
    message: str, stacklevel: int, category: type[PlausibilityWarning] = PlausibilityWarning
) -> None:
    """Emit a warning, unless the environment variable `ROCKJAX_PLAUSIBILITY` switches such warnings off.

    - `message`: text of the warning
    - `stacklevel`: stack level as in `warnings.warn`, counted from the function that calls this one
    - `category`: class of the warning
    """
    if not switched_off("ROCKJAX_PLAUSIBILITY"):
        warnings.warn(message, category, stacklevel + 1)
