"""`rockjax cache`."""

from __future__ import annotations

import time
from typing import Annotated

from rockjax._problem.models import OUTPUT

from ._options import option
from ._run import Console, command


@command(jax=False)
def cache(
    console: Console,
    clear: Annotated[bool, option("--clear", panel=OUTPUT, help="Remove all stored programs.")] = False,
) -> None:
    """Show or clear the cache of compiled programs: folder, number of programs and size.

    Later processes load these programs instead of compiling them. The environment variable ROCKJAX_CACHE_DIR
    sets the folder, and ROCKJAX_CACHE_SIZE sets the largest size of the cache in MiB. ROCKJAX_CACHE=off
    switches the cache off.

    \b
    Examples:
      rockjax cache
      rockjax cache --clear
    """
    from rockjax._programs import store

    folder = store.folder()
    if clear:
        removed = store.clear()
        console.say(f"removed {removed} programs from {folder}")
        console.json_object |= {"removed": removed}
    entries = store.entries()
    size, limit = sum(entry.size for entry in entries) / 2**20, store.limit() / 2**20
    reason_unused = store.reason_unused()
    console.say(f"{len(entries)} programs, {size:.1f} of at most {limit:.0f} MiB, in {folder}")
    if entries and not clear:
        days = (time.time() - entries[0].used) / 86400
        console.say(f"the least recently used program was used {days:.1f} days ago")
    if reason_unused:
        console.say(f"the cache is not in use: {reason_unused}")
    console.json_object |= {
        "folder": str(folder),
        "programs": len(entries),
        "MiB": round(size, 1),
        "in_use": reason_unused is None,
    }
