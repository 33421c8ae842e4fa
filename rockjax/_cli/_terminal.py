"""Standard streams that tolerate closed pipes, full disks and encodings without Greek letters."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from typing import Any


class _Stream:
    """A standard stream that raises no `OSError`. After a failed write, all further text is dropped.

    `failure` is the error of the failed write, such as a full disk, or None. If a reader such as `head -1`
    has closed the pipe, the text is also dropped, but `failure` is None.
    """

    def __init__(self, stream: Any):
        self._stream = stream
        self._closed = False
        self.failure: OSError | None = None
        # Encodings such as cp1252 have no α; it is printed as an escape sequence. Streams of notebooks and
        # tests cannot be reconfigured.
        with contextlib.suppress(AttributeError, ValueError):
            stream.reconfigure(errors="backslashreplace")

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
            # Python flushes the stream again at exit. The null device lets this succeed.
            with contextlib.suppress(OSError, ValueError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), self._stream.fileno())

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextlib.contextmanager
def terminal() -> Iterator[None]:
    """Return a context in which stdout and stderr are streams that do not fail.

    If stdout could not be written, for example on a full disk, `SystemExit` with status 1 is raised at the
    end of the context. If the environment variable NO_COLOR is set, the help has neither colours nor bold or
    dim text.
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

    Otherwise the next file that is opened would get the descriptor of the closed stream. Text that libraries
    print to the stream would then end up in this file.
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
    """Switch off all styles of the help. NO_COLOR alone does not suffice, because the package rich then still
    prints bold and dim text."""
    with contextlib.suppress(ImportError):
        from typer import rich_utils

        rich_utils.COLOR_SYSTEM = None
