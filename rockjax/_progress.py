"""Progress bars of batches and searches."""

from __future__ import annotations

import contextlib
from typing import Any

from tqdm import tqdm


class Bar(tqdm):
    """A bar that does not count the time before its first update, when programs are compiled or loaded."""

    def __init__(self, **settings):
        super().__init__(desc="preparing", **settings)

    def update(self, n: float | None = 1) -> bool | None:
        if not self.disable and self.desc:
            self.set_description_str(None, refresh=False)
            self.unpause()
        return super().update(n)


def bar(total: float | None, unit: str, progress: Any, **settings) -> Any:
    """What can be updated, to be used as a context: `progress` itself if it can, else a bar, shown if it is true."""
    if hasattr(progress, "update"):
        return contextlib.nullcontext(progress)
    return Bar(total=total, unit=f" {unit}", disable=not progress, **settings)
