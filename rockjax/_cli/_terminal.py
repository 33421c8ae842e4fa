"""Standard streams that tolerate closed pipes, full disks and encodings without Greek letters."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from typing import Any


class _Stream:
    """A standard stream that raises no `OSError`: after a failure, text is dropped.

    `failure` is the error of the first failed write, such as a full disk. A pipe that the reader has closed,
    as by `| head -1`, does not count as a failure.
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
            # Python flushes the stream at exit, which must not fail again.
            with contextlib.suppress(OSError, ValueError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), self._stream.fileno())

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextlib.contextmanager
def terminal() -> Iterator[None]:
    """While a command runs, replace stdout and stderr by streams that do not fail.

    If NO_COLOR is set, bold and dim text are switched off as well as colours. Raises `SystemExit` with status
    1 after the command if stdout could not be written, for example on a full disk.
    """
    if os.environ.get("NO_COLOR"):
        _switch_off_styles()
    _open_closed_streams()
    original = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = out, errors = _Stream(original[0]), _Stream(original[1])
    try:
        yield
    finally:
        out.flush()
        if out.failure is not None:
            errors.write(f"rockjax: standard output could not be written: {out.failure.strerror}\n")
        errors.flush()
        sys.stdout, sys.stderr = original
        if out.failure is not None:
            raise SystemExit(1)


def _open_closed_streams() -> None:
    """Open the null device for standard streams that the parent process has closed.

    Otherwise the next opened file would get the descriptor of a closed stream, and text that libraries print
    to this stream would end up in the file.
    """
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest free descriptor
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115


def _switch_off_styles() -> None:
    """Switch off all styles of help: under NO_COLOR, rich keeps bold and dim text."""
    with contextlib.suppress(ImportError):
        from typer import rich_utils

        rich_utils.COLOR_SYSTEM = None
