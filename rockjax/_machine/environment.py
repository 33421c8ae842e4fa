"""Settings from environment variables."""

from __future__ import annotations

import os


def switched_off(variable: str) -> bool:
    """Return whether an environment variable is "0", "off", "no" or "false", in upper or lower case."""
    return os.environ.get(variable, "").strip().lower() in ("0", "off", "no", "false")
