"""Data of the running command for the attributes of its files."""

from __future__ import annotations

from contextvars import ContextVar
from typing import Any

COMMAND: ContextVar[str] = ContextVar("command")  # the command line
# Number of columns and masses [kg] of a structure by dimensions, as attributes; else empty.
MASSES: ContextVar[dict[str, Any]] = ContextVar("masses")
