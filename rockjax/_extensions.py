"""Extensions by packages built on rockjax: entry points of the group `rockjax.extensions`, loaded on use.

rockjax imports none of them: `design` answers the command `rockjax design`, `design-chart` draws the files of
that kind.
"""

from __future__ import annotations

from importlib.metadata import entry_points
from typing import Any

GROUP = "rockjax.extensions"


def extension(name: str) -> Any:
    """Load the extension registered under a name. Raises `ImportError` if no installed package has one."""
    for entry in entry_points(group=GROUP, name=name):
        return entry.load()
    raise ImportError(
        f"no installed package offers "
        f"{name!r} ({GROUP}); install rockjax again, such as with pip install -e ."
    )
