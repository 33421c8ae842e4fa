"""Data of the running command for the attributes of its files."""

from __future__ import annotations

from contextvars import ContextVar
from typing import Any

COMMAND: ContextVar[str] = ContextVar("command")  # the command line
# Attributes of files: number of columns and masses [kg] of a structure by dimensions.
MASSES: ContextVar[dict[str, Any]] = ContextVar("masses")
