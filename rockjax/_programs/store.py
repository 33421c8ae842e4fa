"""The folder of stored programs: its path, its permissions and its size limit.

Stored programs are executed, so the folder is used only if it belongs to this user and no other user can
write to it (on Windows, the system protects the user's folders). Files are written atomically and contain a
checksum. When a program is stored and the folder then exceeds the size limit, the least recently used files
are deleted.
"""

from __future__ import annotations

import contextlib
import hashlib
import logging
import os
import stat
import tempfile
from pathlib import Path
from typing import NamedTuple

from rockjax._machine.environment import switched_off

LIMIT = 2048  # default size limit of the folder [MiB]
_DIGEST_SIZE = 32  # size of the checksum [bytes]
_LOG = logging.getLogger("rockjax")


class Entry(NamedTuple):
    """A file of the folder."""

    path: Path
    size: int  # [bytes]
    used: float  # time of the last use [s since 1970]


def enabled() -> bool:
    """Return whether the store is enabled. The environment variable `ROCKJAX_CACHE=off` disables it."""
    return not switched_off("ROCKJAX_CACHE")


def root() -> Path:
    """Return the cache folder: `ROCKJAX_CACHE_DIR` if this variable is set, otherwise the folder `rockjax` in
    `XDG_CACHE_HOME` or, if this variable is not set either, in the platform's folder for caches."""
    if chosen := os.environ.get("ROCKJAX_CACHE_DIR"):
        return Path(chosen).expanduser()
    if shared := os.environ.get("XDG_CACHE_HOME"):
        return Path(shared) / "rockjax"
    from platformdirs import user_cache_path

    return user_cache_path("rockjax", appauthor=False)


def folder() -> Path:
    """Return the folder of stored programs."""
    return root() / "programs"


def limit() -> int:
    """Return the size limit of the folder [bytes].

    The environment variable `ROCKJAX_CACHE_SIZE` sets the limit in MiB. Raises `ValueError` if its value is
    not a finite number ≥ 0.
    """
    text = os.environ.get("ROCKJAX_CACHE_SIZE", "").strip()
    try:
        size = float(text) if text else float(LIMIT)
    except ValueError:
        size = -1.0
    if not 0 <= size < float("inf"):
        raise ValueError(f"ROCKJAX_CACHE_SIZE must be a size in MiB, a finite number ≥ 0, got {text!r}")
    return int(size * 2**20)


def _reason_unsafe(path: Path) -> str | None:
    """Return the reason why a folder or file is not trusted; None if it is trusted. Raises `OSError` if its
    permissions cannot be read."""
    if not hasattr(os, "geteuid"):
        return None  # Windows, where access lists protect the user's folders
    status = path.stat()
    if status.st_uid != os.geteuid():
        return f"{path} belongs to another user"
    if status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        return f"other users can write to {path}; remove the permission with chmod go-w"
    return None


def reason_unused() -> str | None:
    """Return the reason why programs are not stored; None if they are. Programs in a folder that can be read
    but not written are still loaded."""
    if not enabled():
        return "ROCKJAX_CACHE is off"
    try:
        unsafe = _reason_unsafe(folder())
    except FileNotFoundError:
        return None  # the first program creates the folder
    except OSError as error:
        return f"{folder()}: {error.strerror}"
    usable = os.access(folder(), os.R_OK | os.W_OK | os.X_OK)
    return unsafe or (None if usable else f"{folder()} cannot be written")


def _file(key: str) -> Path:
    return folder() / (hashlib.sha256(key.encode()).hexdigest() + ".program")


def _digest(key: str, data: bytes) -> bytes:
    return hashlib.sha256(key.encode() + b"\0" + data).digest()


def read(key: str) -> bytes | None:
    """Return the data stored under a key; None if its file is missing, damaged or not trusted."""
    file = _file(key)
    try:
        unsafe = _reason_unsafe(file.parent) or _reason_unsafe(file)
        content = b"" if unsafe else file.read_bytes()
    except FileNotFoundError:
        return None
    except OSError as error:
        unsafe, content = str(error), b""
    if unsafe:
        _LOG.debug("no stored programs are read: %s", unsafe)
        return None
    data = content[_DIGEST_SIZE:]
    if content[:_DIGEST_SIZE] != _digest(key, data):
        _LOG.debug("%s is damaged", file)
        discard(key)
        return None
    with contextlib.suppress(OSError):  # the folder may be read-only
        os.utime(file)  # records the last use
    return data


def write(key: str, data: bytes) -> None:
    """Store data under a key, and delete the least recently used files until the folder is within the size
    limit.

    Data whose file would exceed the limit are not stored. Raises `OSError` on failure, such as a full disk or
    a folder that other users can write to, and `ValueError` for an invalid limit.
    """
    path, limit_bytes = folder(), limit()
    path.parent.mkdir(parents=True, exist_ok=True)
    path.mkdir(mode=0o700, exist_ok=True)
    if unsafe := _reason_unsafe(path):
        raise PermissionError(unsafe)
    if len(data) + _DIGEST_SIZE > limit_bytes:
        return
    handle, temporary = tempfile.mkstemp(prefix=".", suffix=".part", dir=path)  # only this user may read it
    try:
        with os.fdopen(handle, "wb") as opened:
            opened.write(_digest(key, data) + data)
        os.replace(temporary, _file(key))
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
    stored = entries()
    size = sum(entry.size for entry in stored)
    for entry in stored:
        if size > limit_bytes:
            size -= entry.size
            entry.path.unlink(missing_ok=True)


def discard(key: str) -> None:
    """Delete the data stored under a key, if possible."""
    with contextlib.suppress(OSError):
        _file(key).unlink(missing_ok=True)


def entries() -> list[Entry]:
    """Return all files of the folder, the least recently used first."""
    stored = []
    for path in folder().glob("*"):  # includes partial files of killed processes
        with contextlib.suppress(OSError):  # another process may have deleted the file
            status = path.stat()
            stored.append(Entry(path, status.st_size, status.st_mtime))
    return sorted(stored, key=lambda entry: entry.used)


def clear() -> int:
    """Delete all files of the folder and return their number. Raises `OSError` if a file cannot be
    deleted."""
    stored = entries()
    for entry in stored:
        entry.path.unlink(missing_ok=True)
    return len(stored)
