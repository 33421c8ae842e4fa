"""What is being compiled at present, for progress bars."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

_PRESENT: list[str] = []


@contextlib.contextmanager
def compiling(what: str) -> Iterator[None]:
    """Name what is compiled inside, such as "the program of a history"."""
    _PRESENT.append(what)
    try:
        yield
    finally:
        _PRESENT.remove(what)


def present_compilation() -> str | None:
    """Return the name of what is being compiled, of several the latest; None where nothing is."""
    names = _PRESENT[-1:]  # another thread may take it away
    return names[0] if names else None
