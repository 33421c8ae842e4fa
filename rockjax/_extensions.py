"""What packages built on rockjax add to it: entry points of the group `rockjax.extensions`, loaded where they
are used.

rockjax imports none of them: `design` answers the command `rockjax design`, `design-chart` draws the files of
that kind.
"""

from __future__ import annotations

from importlib.metadata import entry_points
from typing import Any

GROUP = "rockjax.extensions"


def extension(name: str) -> Any:
    """What is registered under a name. Raises `ImportError` where no installed package has registered
    anything."""
    for entry in entry_points(group=GROUP, name=name):
        return entry.load()
    raise ImportError(
        f"no installed package offers "
        f"{name!r} ({GROUP}); install rockjax again, such as with pip install -e ."
    )
