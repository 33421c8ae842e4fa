"""Progress bars of batches and searches."""

from __future__ import annotations

import contextlib
import threading
import weakref
from typing import Any

from tqdm.auto import tqdm  # a widget in notebooks

from ._programs.program import current_compilation

BAR_LOCK = threading.Lock()  # several threads and batches may update one progress bar
TICK = 1.0  # time between updates of the elapsed time [s]


def start_clock(progress_bar: Any) -> threading.Event:
    """Start a thread that redraws a bar every second, and return the `threading.Event` that ends the thread
    when it is set.

    The thread also ends if the bar is deleted. A disabled bar gets no thread.
    """
    ended, bar_reference = threading.Event(), weakref.ref(progress_bar)

    def tick() -> None:
        while not ended.wait(TICK) and (existing_bar := bar_reference()) is not None:
            existing_bar.refresh()
            del existing_bar

    if not progress_bar.disable:
        threading.Thread(target=tick, daemon=True).start()
    return ended


class Bar(tqdm):
    """A progress bar whose rate excludes the time before the first update. During this time programs are
    compiled or loaded.

    The elapsed time is redrawn every second, also while a program is compiled. If a `with` block ends without
    an exception after at least one update, the bar is drawn full, even if fewer than `total` units were
    needed.
    """

    def __init__(self, **settings):
        super().__init__(desc="preparing", **settings)
        self._ended = start_clock(self)

    def close(self) -> None:
        if hasattr(self, "_ended"):
            self._ended.set()
        super().close()

    def display(self, *arguments: Any, **keywords: Any) -> Any:
        """Display the bar. If a program is being compiled before the first update, display this program and
        the elapsed time instead."""
        program = None if self.n else current_compilation()
        self.bar_format = program and f"compiling {program} [{{elapsed}}]"
        return super().display(*arguments, **keywords)

    def update(self, n: float | None = 1) -> bool | None:
        if not self.disable and self.desc:
            self.set_description_str(None, refresh=False)
            self.unpause()
        return super().update(n)

    def __exit__(self, error_type, error, trace):
        if error_type is None and not self.disable and self.total is not None and 0 < self.n < self.total:
            self.total = self.n
            widget = getattr(self, "container", None)  # only in a notebook; children[1] is the bar
            if widget is not None:
                widget.children[1].max = self.n
            self.refresh()
        return super().__exit__(error_type, error, trace)


def bar(total: float | None, unit: str, progress: Any, **settings) -> Any:
    """Return a context manager for a progress bar.

    - `total`: number of units, or None if it is unknown
    - `unit`: plural noun of the units
    - `progress`: True for a bar; False for none; an object with a method `update` serves as the bar
    - `settings`: further arguments of `tqdm`
    """
    if hasattr(progress, "update"):
        return contextlib.nullcontext(progress)
    if not progress:
        return contextlib.nullcontext(_SilentBar())
    return Bar(total=total, unit=f" {unit}", **settings)


class _SilentBar:
    """A bar that is not shown. Creating it takes much less time than creating a disabled `tqdm`."""

    n = 0

    def update(self, n: int = 1) -> None:
        self.n += n
