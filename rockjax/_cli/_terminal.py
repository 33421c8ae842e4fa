"""The terminal, or what stands in its place: readers that have seen enough, and those who want no colours."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from typing import Any


class _Spoken:
    """Standard output that may be closed at its other end, as `| head -1` does: what comes after goes
    nowhere."""

    def __init__(self, stream: Any):
        self._stream = stream
        self._closed = False

    def write(self, text: str) -> int:
        self._quietly(self._stream.write, text)
        return len(text)

    def flush(self) -> None:
        self._quietly(self._stream.flush)

    def _quietly(self, call: Any, *arguments: str) -> None:
        if self._closed:
            return
        try:
            call(*arguments)
        except BrokenPipeError:
            self._closed = True
            # Python flushes it once more at the end.
            os.dup2(os.open(os.devnull, os.O_WRONLY), self._stream.fileno())

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextlib.contextmanager
def terminal() -> Iterator[None]:
    """Write to a terminal or a pipe: a pipe that is closed early is no error, and NO_COLOR leaves text
    without any codes."""
    if os.environ.get("NO_COLOR"):
        _plain()
    before = sys.stdout
    sys.stdout = _Spoken(before)
    try:
        yield
    finally:
        sys.stdout.flush()
        sys.stdout = before


def _plain() -> None:
    """No bold and no dim text either, which rich leaves in."""
    with contextlib.suppress(ImportError):
        from typer import rich_utils

        rich_utils.COLOR_SYSTEM = None
