"""Standard output and error: closed pipes, full disks, encodings without Greek letters, colours."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from typing import Any


class _Stream:
    """A standard stream whose failures never end a command: text after a failure is dropped.

    `failure` is the `OSError` of the first write that failed, such as a full disk; a pipe closed at its
    other end, as by `| head -1`, is no failure.
    """

    def __init__(self, stream: Any):
        self._stream = stream
        self._closed = False
        self.failure: OSError | None = None
        with contextlib.suppress(AttributeError, ValueError):  # streams of notebooks and tests
            stream.reconfigure(errors="backslashreplace")  # cp1252 has no α

    def write(self, text: str) -> int:
        self._attempt(self._stream.write, text)
        return len(text)

    def flush(self) -> None:
        self._attempt(self._stream.flush)

    def _attempt(self, call: Any, *arguments: str) -> None:
        if self._closed:
            return
        try:
            call(*arguments)
        except OSError as error:
            self._closed = True
            if not isinstance(error, BrokenPipeError):
                self.failure = error
            # Python flushes the stream once more at the end.
            with contextlib.suppress(OSError, ValueError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), self._stream.fileno())

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextlib.contextmanager
def terminal() -> Iterator[None]:
    """Guard stdout and stderr while a command runs; NO_COLOR leaves text without any codes.

    Raises `SystemExit` with status 1 after the command if stdout could not be written, as on a full disk.
    """
    if os.environ.get("NO_COLOR"):
        _switch_off_styles()
    _open_closed_streams()
    before = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = out, errors = _Stream(before[0]), _Stream(before[1])
    try:
        yield
    finally:
        out.flush()
        if out.failure is not None:
            errors.write(f"rockjax: standard output could not be written: {out.failure.strerror}\n")
        errors.flush()
        sys.stdout, sys.stderr = before
        if out.failure is not None:
            raise SystemExit(1)


def _open_closed_streams() -> None:
    """Open the null device in place of standard streams that the parent process closed.

    Otherwise the next file opened would get their number, and text printed by libraries would go into it.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest free number, this one
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115


def _switch_off_styles() -> None:
    """Switch off bold and dim text too, which rich keeps under NO_COLOR."""
    with contextlib.suppress(ImportError):
        from typer import rich_utils

        rich_utils.COLOR_SYSTEM = None
