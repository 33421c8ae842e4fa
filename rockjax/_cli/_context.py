"""Facts about the running command that its files record."""

from __future__ import annotations

from contextvars import ContextVar
from typing import Any

COMMAND: ContextVar[str] = ContextVar("command")
MASSES: ContextVar[dict[str, Any]] = ContextVar("masses")  # of a structure by dimensions
