"""Progress bars of batches and searches."""

from __future__ import annotations

import contextlib
import threading
import weakref
from typing import Any

from tqdm.auto import tqdm  # a widget in notebooks

from ._programs.program import current_compilation

TICK = 1.0  # s: so long a bar may stand without its clock being moved on


def start_clock(shown: Any) -> threading.Event:
    """Move the clock of a bar on until the event that this returns is set, or the bar is dropped."""
    ended, bar_reference = threading.Event(), weakref.ref(shown)

    def tick() -> None:
        while not ended.wait(TICK) and (shown_bar := bar_reference()) is not None:
            shown_bar.refresh()
            del shown_bar

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
        self._ended = start_clock(self)

    def close(self) -> None:
        if hasattr(self, "_ended"):
            self._ended.set()
        super().close()

    def display(self, *arguments: Any, **named: Any) -> Any:
        """Instead of a count of nothing, say what is being compiled and for how long the bar has waited."""
        what = None if self.n else current_compilation()
        self.bar_format = what and f"compiling {what} [{{elapsed}}]"
        return super().display(*arguments, **named)

    def update(self, n: float | None = 1) -> bool | None:
        if not self.disable and self.desc:
            self.set_description_str(None, refresh=False)
            self.unpause()
        return super().update(n)

    def __exit__(self, error_type, error, trace):
        if error_type is None and not self.disable and self.total is not None and 0 < self.n < self.total:
            self.total = self.n
            if (
                widget := getattr(self, "container", None)
            ) is not None:  # of a notebook: description, bar, numbers
                widget.children[1].max = self.n
            self.refresh()
        return super().__exit__(error_type, error, trace)


def bar(total: float | None, unit: str, progress: Any, **settings) -> Any:
    """Return a progress bar as a context: `progress` itself if it has `update`, else a bar, shown if
    `progress` is true."""
    if hasattr(progress, "update"):
        return contextlib.nullcontext(progress)
    if not progress:
        return contextlib.nullcontext(_SilentBar())
    return Bar(total=total, unit=f" {unit}", **settings)


class _SilentBar:
    """A bar that is not shown: to make one that is takes as long as some scenes."""

    n = 0

    def update(self, n: int = 1) -> None:
        self.n += n
