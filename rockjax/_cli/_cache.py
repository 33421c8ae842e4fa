"""`rockjax cache`."""

from __future__ import annotations

import time
from typing import Annotated

from rockjax._problem.models import OUTPUT

from ._options import option
from ._run import Report, command


@command(jax=False)
def cache(
    report: Report,
    clear: Annotated[
        bool, option("--clear", panel=OUTPUT, help="Take away all programs that are kept.")
    ] = False,
) -> None:
    """List or remove the compiled programs that are kept between processes: folder, number and size.

    A program serves all scenes of its kind, whatever their numbers. ROCKJAX_CACHE_DIR names another folder,
    ROCKJAX_CACHE_SIZE its largest size in MiB, and ROCKJAX_CACHE=off keeps none.

    \b
    Examples:
      rockjax cache
      rockjax cache --clear
    """
    from rockjax._programs import store

    place = store.folder()
    if clear:
        removed = store.clear()
        report.say(f"removed {removed} programs from {place}")
        report.facts |= {"removed": removed}
    entries = store.entries()
    size, limit = sum(entry.size for entry in entries) / 2**20, store.limit() / 2**20
    why = store.reason_unused()
    report.say(f"{len(entries)} programs, {size:.1f} of at most {limit:.0f} MiB, in {place}")
    if entries and not clear:
        days = (time.time() - entries[0].used) / 86400
        report.say(f"the one unused for longest was last used {days:.1f} days ago")
    if why:
        report.say(f"not in use: {why}")
    report.facts |= {
        "folder": str(place),
        "programs": len(entries),
        "MiB": round(size, 1),
        "in_use": why is None,
    }
