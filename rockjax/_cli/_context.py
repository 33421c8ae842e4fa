"""Data of the running command, for the attributes of the files that it writes."""

from __future__ import annotations

from contextvars import ContextVar
from typing import Any

COMMAND: ContextVar[str] = ContextVar("command")  # the command line
# Number of columns and masses [kg], as attributes of files, if the structure is given by dimensions.
MASSES: ContextVar[dict[str, Any]] = ContextVar("masses")
