"""The folder of kept programs: where it is, who may write to it, and how large it grows.

What is in it is run, so it is used only where it belongs to this user and nobody else can write to it.
Entries are written whole or not at all, carry a checksum, and are taken away, the longest unused first, where
they grow beyond the limit. Whatever goes wrong here raises nothing but `OSError` and `Damaged`, and nothing
is lost by it but time.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import stat
import tempfile
from pathlib import Path
from typing import NamedTuple

from rockjax._machine.environment import switched_off

SUFFIX = ".program"
LIMIT = 2048  # MiB
_MAGIC = b"rockjax program 1\n"
_STALE = 3600.0  # s: what a process that was killed has left half-written


class Damaged(Exception):
    """An entry is not what was written."""


class Entry(NamedTuple):
    """One kept program: its file, its size [bytes], and when it was last used [s since 1970]."""

    path: Path
    size: int
    used: float


def enabled() -> bool:
    """Whether programs are kept: not with `ROCKJAX_CACHE=off`."""
    return not switched_off("ROCKJAX_CACHE")


def path() -> Path:
    """`ROCKJAX_CACHE_DIR`, or `rockjax` in the user's cache folder (`XDG_CACHE_HOME`, or what the platform
    has for it)."""
    chosen = os.environ.get("ROCKJAX_CACHE_DIR")
    if chosen:
        return Path(chosen).expanduser()
    shared = os.environ.get("XDG_CACHE_HOME")
    if shared:
        return Path(shared) / "rockjax"
    from platformdirs import user_cache_path

    return user_cache_path("rockjax", appauthor=False)


def limit() -> int:
    """The size that the folder may grow to [bytes]: `ROCKJAX_CACHE_SIZE` in MiB.

    Raises `ValueError` where that is no number ≥ 0.
    """
    text = os.environ.get("ROCKJAX_CACHE_SIZE", "").strip()
    try:
        size = float(text) if text else float(LIMIT)
    except ValueError:
        size = -1.0
    if not 0 <= size < float("inf"):
        raise ValueError(f"ROCKJAX_CACHE_SIZE must be a size in MiB, a number ≥ 0, got {text!r}")
    return int(size * 2**20)


def why_unsafe(folder: Path) -> str | None:
    """Why nothing is read from a folder or file; None where it can be trusted. Raises `OSError` where it is
    not there."""
    if not hasattr(os, "geteuid"):
        return None  # Windows: the user's folders have access lists of their own
    found = folder.stat()
    if found.st_uid != os.geteuid():
        return f"{folder} belongs to another user"
    if found.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        return f"others can write to {folder}; chmod go-w makes it usable"
    return None


def why_unused(folder: Path) -> str | None:
    """Why no program is kept in a folder; None where there may be."""
    if not enabled():
        return "ROCKJAX_CACHE is off"
    try:
        unsafe = why_unsafe(folder)
    except FileNotFoundError:
        return None  # it is made when it is needed
    except OSError as error:
        return f"{folder}: {error.strerror}"
    return unsafe or (
        None if os.access(folder, os.R_OK | os.W_OK | os.X_OK) else f"{folder} cannot be written"
    )


def _ready(folder: Path) -> None:
    """The folder, made where it is not there yet, for this user only. Raises `OSError` where it cannot be
    used."""
    if not folder.is_dir():
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=0o700, exist_ok=True)
    unsafe = why_unsafe(folder)
    if unsafe:
        raise PermissionError(unsafe)


def _file(folder: Path, key: str) -> Path:
    return folder / (hashlib.sha256(key.encode()).hexdigest() + SUFFIX)


def read(folder: Path, key: str) -> bytes | None:
    """What is kept under a key, None where there is nothing.

    Raises `OSError` for a folder or file that cannot be trusted or read, `Damaged` for an entry that is not
    whole.
    """
    name = _file(folder, key)
    try:
        unsafe = why_unsafe(folder)
        with name.open("rb") as file:
            unsafe = unsafe or why_unsafe(name)
            if unsafe:
                raise PermissionError(unsafe)
            content = file.read()
    except FileNotFoundError:
        return None
    head, checksum, about = len(_MAGIC), 32, key.encode()
    body = content[head + checksum :]
    if not content.startswith(_MAGIC) or hashlib.sha256(body).digest() != content[head : head + checksum]:
        raise Damaged(f"{name} is damaged")
    size = int.from_bytes(body[:8], "little")
    if body[8 : 8 + size] != about:
        raise Damaged(f"{name} holds another program")
    with contextlib.suppress(OSError):  # a folder that can only be read
        os.utime(name)  # used just now
    return body[8 + size :]


def write(folder: Path, key: str, data: bytes) -> None:
    """Keep data under a key, and make room. Raises `OSError` where that is not possible, as with a full
    disk."""
    _ready(folder)
    about = key.encode()
    body = len(about).to_bytes(8, "little") + about + data
    if len(body) > limit():
        return
    handle, temporary = tempfile.mkstemp(prefix=".", suffix=".part", dir=folder)  # for this user only
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(_MAGIC + hashlib.sha256(body).digest() + body)
        os.replace(temporary, _file(folder, key))
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
    _make_room(folder)


def discard(folder: Path, key: str) -> None:
    """Take an entry away, where that is possible."""
    with contextlib.suppress(OSError):
        _file(folder, key).unlink(missing_ok=True)


def entries(folder: Path) -> list[Entry]:
    """All kept programs, the one unused for longest first."""
    found = []
    for name in folder.glob("*" + SUFFIX) if folder.is_dir() else ():
        try:
            about = name.stat()
        except OSError:
            continue  # another process has just taken it away
        found.append(Entry(name, about.st_size, about.st_mtime))
    return sorted(found, key=lambda entry: entry.used)


def clear(folder: Path) -> int:
    """Take all kept programs away; how many there were. Raises `OSError` for one that cannot be."""
    found = entries(folder)
    for entry in found:
        entry.path.unlink(missing_ok=True)
    _sweep_up(folder, 0.0)
    return len(found)


def _make_room(folder: Path) -> None:
    found = entries(folder)
    size, most = sum(entry.size for entry in found), limit()
    while found and size > most:
        oldest = found.pop(0)
        size -= oldest.size
        oldest.path.unlink(missing_ok=True)
    if len(found) % 8 == 0:
        _sweep_up(folder, _STALE)


def _sweep_up(folder: Path, age: float) -> None:
    """Half-written files of processes that were killed."""
    import time

    for name in folder.glob(".*.part") if folder.is_dir() else ():
        try:
            if time.time() - name.stat().st_mtime >= age:
                name.unlink(missing_ok=True)
        except OSError:
            continue
