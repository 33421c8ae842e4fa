"""Check that the results of a batch fit into memory."""

from __future__ import annotations

from pathlib import Path

# Peak memory per scene [bytes], without the scene's parameters. A batch needs 120 bytes. A spectrum needs 160
# bytes, because its dataset is also assembled and written.
BYTES_PER_SCENE = 160
BYTES_PER_SENSITIVITY = 32  # additional memory per scene and sensitivity parameter [bytes]
SYSTEM_ROOT = Path("/")  # root of /proc and /sys

# Advice in error messages.
REQUEST_FEWER_OR_SWEEP = (
    "request fewer, or use rockjax.sweep (on the command line `rockjax sweep`), which solves scenes in "
    "chunks and stores the results on disk"
)
REQUEST_FEWER = "request fewer at a time"


def require_memory(
    owner: str,
    number: int,
    bytes_each: int = BYTES_PER_SCENE,
    noun: str = "scenes",
    advice: str = REQUEST_FEWER_OR_SWEEP,
) -> None:
    """Raise `ValueError` if the results of scenes, or of other items, do not fit into the free memory that
    Linux reports.

    Results below 1 MiB, and other operating systems, are not checked.

    - `owner`: class or function, for the message
    - `number`: number of items
    - `bytes_each`: memory of each item [bytes]
    - `noun`: plural noun for the items, for the message
    - `advice`: advice at the end of the message
    """
    needed, free = number * bytes_each, []
    if needed < 2**20:  # too little to look up the free memory
        return
    try:
        lines = (SYSTEM_ROOT / "proc/meminfo").read_text().splitlines()
        free += [1024 * int(line.split()[1]) for line in lines if line.startswith("MemAvailable:")]
        free.append(_free_in_container())
    except (OSError, ValueError):  # another system, no container, or no limit (the file contains "max")
        pass
    if free and needed > min(free):
        raise ValueError(
            f"{owner}: {number} {noun} need about {readable_bytes(needed)} of memory, but only "
            f"{readable_bytes(max(0, min(free)))} are free; {advice}"
        )


def _free_in_container() -> int:
    """Return the memory limit of a container minus the used memory [bytes]. Cached files that the system can
    drop count as free. Raises `OSError` or `ValueError` without a container or a limit."""
    folder = SYSTEM_ROOT / "sys/fs/cgroup"
    limit, used = (int((folder / f"memory.{name}").read_text()) for name in ("max", "current"))
    try:
        entries = [line.split() for line in (folder / "memory.stat").read_text().splitlines()]
    except OSError:
        entries = []
    return limit - used + sum(int(entry[1]) for entry in entries if entry[0] == "inactive_file")


def readable_bytes(number: float) -> str:
    """Return a size such as "1.5 GiB"."""
    for unit, size in (("TiB", 2**40), ("GiB", 2**30), ("MiB", 2**20)):
        if number >= size:
            return f"{number / size:.3g} {unit}"
    return f"{number / 2**10:.3g} KiB"
