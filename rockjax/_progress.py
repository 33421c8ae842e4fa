"""Progress bars of batches and searches."""

from __future__ import annotations

import contextlib
import threading
import weakref
from typing import Any

from tqdm.auto import tqdm  # a widget in notebooks

from ._programs.program import present_compilation

TICK = 1.0  # s: so long a bar may stand without its clock being moved on


def ticking(shown: Any) -> threading.Event:
    """Move the clock of a bar on until the event that this returns is set, or the bar is dropped."""
    ended, still_there = threading.Event(), weakref.ref(shown)

    def tick() -> None:
        while not ended.wait(TICK) and (bar := still_there()) is not None:
            bar.refresh()
            del bar

    if not shown.disable:
        threading.Thread(target=tick, daemon=True).start()
    return ended


class Bar(tqdm):
    """A bar that does not count the time before its first update, when programs are compiled or loaded.

    Its clock goes on by itself: while a program is compiled nothing else would show that something happens.
    As a context it ends full, unless an exception ends it: what is done in fewer steps than it might have
    taken is done.
    """

    def __init__(self, **settings):
        super().__init__(desc="preparing", **settings)
        self._ended = ticking(self)

    def close(self) -> None:
        if hasattr(self, "_ended"):
            self._ended.set()
        super().close()

    def display(self, *arguments: Any, **named: Any) -> Any:
        """Instead of a count of nothing, say what is being compiled and for how long the bar has waited."""
        what = None if self.n else present_compilation()
        self.bar_format = what and f"compiling {what} [{{elapsed}}]"
        return super().display(*arguments, **named)

    def update(self, n: float | None = 1) -> bool | None:
        if not self.disable and self.desc:
            self.set_description_str(None, refresh=False)
            self.unpause()
        return super().update(n)

    def __exit__(self, kind, error, trace):
        if kind is None and not self.disable and self.total is not None and 0 < self.n < self.total:
            self.total = self.n
            if (
                widget := getattr(self, "container", None)
            ) is not None:  # of a notebook: description, bar, numbers
                widget.children[1].max = self.n
            self.refresh()
        return super().__exit__(kind, error, trace)


def bar(total: float | None, unit: str, progress: Any, **settings) -> Any:
    """Return a progress bar as a context: `progress` itself if it has `update`, else a bar, shown if
    `progress` is true."""
    if hasattr(progress, "update"):
        return contextlib.nullcontext(progress)
    if not progress:
        return contextlib.nullcontext(_Count())
    return Bar(total=total, unit=f" {unit}", **settings)


class _Count:
    """A bar that is not shown: to make one that is takes as long as some scenes."""

    n = 0

    def update(self, n: int = 1) -> None:
        self.n += n
