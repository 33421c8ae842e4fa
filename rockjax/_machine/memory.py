"""Whether the answers of a batch fit into the memory, known before it starts."""

from __future__ import annotations

import os
from pathlib import Path

# Of memory that a scene takes until its answers stand, besides its own numbers: 120 were measured for a
# batch, 160 for spectra that are put together and written.
BYTES = 160
BYTES_OF_SLOPES = 32  # of one parameter with respect to which all peaks are differentiated
_LITTLE = 2**20  # bytes
_GROUPS = (("memory.max", "memory.current"), ("memory/memory.limit_in_bytes", "memory/memory.usage_in_bytes"))

# What can be done instead.
SWEEP = (
    "ask for fewer, or use rockjax.sweep (on the command line `rockjax sweep`), which solves them in chunks "
    "and keeps them on disk"
)
FEWER_LINES = "ask for fewer at a time"


def require_memory(
    owner: str, number: int, each: int = BYTES, of: str = "scenes", instead: str = SWEEP
) -> None:
    """Raise `ValueError`, in the name of `owner`, for so many scenes (or something else, of so many bytes
    each) that their answers do not fit into the free memory; `instead` is what can be done."""
    needed = number * each
    if needed < _LITTLE:  # not worth reading what is free
        return
    free = free_memory()
    if free is not None and needed > free:
        raise ValueError(
            f"{owner}: {number} {of} take some {readable_bytes(needed)} of memory, and "
            f"{readable_bytes(free)} are free: {instead}"
        )


def free_memory(system: Path = Path("/")) -> int | None:
    """What this process may still take [bytes], None where the system does not tell."""
    found = []
    try:
        lines = (system / "proc/meminfo").read_text().splitlines()
        found += [1024 * int(line.split()[1]) for line in lines if line.startswith("MemAvailable:")]
    except (OSError, ValueError, IndexError):
        found += _physical()
    for limit, used in _GROUPS:  # of a container
        try:
            folder = system / "sys/fs/cgroup"
            found.append(max(0, int((folder / limit).read_text()) - int((folder / used).read_text())))
        except (OSError, ValueError):  # none, or "max"
            continue
    return min(found, default=None)


def _physical() -> list[int]:
    try:
        return [os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")]
    except (AttributeError, ValueError, OSError):
        return []


def readable_bytes(number: float) -> str:
    for unit, size in (("TiB", 2**40), ("GiB", 2**30), ("MiB", 2**20)):
        if number >= size:
            return f"{number / size:.3g} {unit}"
    return f"{number / 2**10:.3g} KiB"
