"""Settings that the environment gives."""

from __future__ import annotations

import os


def switched_off(variable: str) -> bool:
    """Whether a variable of the environment says off."""
    return os.environ.get(variable, "").strip().lower() in ("0", "off", "no", "false")
