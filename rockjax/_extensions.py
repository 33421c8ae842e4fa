"""Extensions by other packages: entry points of the group `rockjax.extensions`. An extension is loaded only
when it is used.

For example, the extension `design` implements the command `rockjax design`, and the extension `design-chart`
plots design charts from their files.
"""

from __future__ import annotations

from importlib.metadata import entry_points
from typing import Any

GROUP = "rockjax.extensions"


def extension(name: str) -> Any:
    """Load and return the extension with a name. Raises `ImportError` if no installed package provides it."""
    for entry in entry_points(group=GROUP, name=name):
        return entry.load()
    raise ImportError(
        f"no installed package provides the extension {name!r} ({GROUP}); install rockjax again, for example "
        "with pip install -e ."
    )
