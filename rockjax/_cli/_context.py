"""Data of the running command that its output files contain as attributes."""

from __future__ import annotations

from contextvars import ContextVar
from typing import Any

COMMAND: ContextVar[str] = ContextVar("command")  # the command line
# Name of an attribute ↦ value: number of columns and masses [kg]. Empty unless the structure is given by
# dimensions.
MASSES: ContextVar[dict[str, Any]] = ContextVar("masses")
