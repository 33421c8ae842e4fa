"""Tracing, by one thread after another.

Threads of one interpreter that trace at once delay each other: none gets to compiling, which needs no
interpreter and could go on beside what the others trace.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator

_TURN = threading.RLock()
_OWN = threading.local()


@contextlib.contextmanager
def turn() -> Iterator[None]:
    """Wait for this thread's turn, and have it inside."""
    with _TURN:
        before = is_mine()
        _OWN.turn = True
        try:
            yield
        finally:
            _OWN.turn = before


def is_mine() -> bool:
    """Whether it is this thread's turn: it may not wait then for another one, which may wait for its own."""
    return getattr(_OWN, "turn", False)
