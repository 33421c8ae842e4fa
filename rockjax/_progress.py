"""Progress bars of batches and searches."""

from __future__ import annotations

import contextlib
from typing import Any

from tqdm.auto import tqdm  # a widget in notebooks


class Bar(tqdm):
    """A bar that does not count the time before its first update, when programs are compiled or loaded.

    As a context it ends full, unless an exception ends it: what is done in fewer steps than it might have taken is done.
    """

    def __init__(self, **settings):
        super().__init__(desc="preparing", **settings)

    def update(self, n: float | None = 1) -> bool | None:
        if not self.disable and self.desc:
            self.set_description_str(None, refresh=False)
            self.unpause()
        return super().update(n)

    def __exit__(self, kind, error, trace):
        if kind is None and not self.disable and self.total is not None and 0 < self.n < self.total:
            self.total = self.n
            if (widget := getattr(self, "container", None)) is not None:  # of a notebook: description, bar, numbers
                widget.children[1].max = self.n
            self.refresh()
        return super().__exit__(kind, error, trace)


def bar(total: float | None, unit: str, progress: Any, **settings) -> Any:
    """What can be updated, to be used as a context: `progress` itself if it can, else a bar, shown if it is true."""
    if hasattr(progress, "update"):
        return contextlib.nullcontext(progress)
    return Bar(total=total, unit=f" {unit}", disable=not progress, **settings)
