"""Paths of stores: folders or URLs, and the atomic creation of a folder."""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any


class TakenError(Exception):
    """Raised if another process has already created a store at a path."""


def expand_path(path: str | Path) -> str:
    """Return a path as a string, with `~` expanded and `file://` removed; other URLs are unchanged."""
    expanded = str(path).removeprefix("file://")
    return os.path.expanduser(expanded) if is_local(expanded) else expanded


def is_local(path: str) -> bool:
    return "://" not in path


def require_creatable(path: str | Path) -> None:
    """Raise `OSError` if the folder of a local store cannot be created.

    To find out, this function creates the folder and removes it again. New parent folders remain.
    """
    path = expand_path(path)
    if not is_local(path):
        return
    try:
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        with contextlib.suppress(FileExistsError):  # another process is making the store
            os.mkdir(path)
            with contextlib.suppress(OSError):
                os.rmdir(path)
    except (OSError, ValueError) as error:
        raise OSError(f"{path} could not be written: {getattr(error, 'strerror', None) or error}") from error


def zarr_store(path: str) -> Any:
    """Return the object that zarr and xarray accept as the store at a path.

    A local path becomes a `LocalStore`, because zarr takes a string with `#`, `?` or `:` for a URL.
    """
    if not is_local(path):
        return path
    from zarr.storage import LocalStore

    return LocalStore(path)


@contextlib.contextmanager
def atomic_folder(path: str) -> Iterator[str]:
    """Yield a temporary folder that is renamed to `path` at the end; for a URL, yield the URL itself.

    A store at a URL is complete when the identity of its sweep has been written, which is the last step.
    Raises `OSError` if the folder cannot be written, and `TakenError` if another process has created a store
    at `path` meanwhile.
    """
    if not is_local(path):
        yield path
        return
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    # The name of the target is not a part of the temporary name, which could then exceed 255 bytes.
    temporary = tempfile.mkdtemp(prefix=".sweep-", dir=target.parent)
    try:
        yield temporary
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(temporary, 0o777 & ~umask)
        _rename(temporary, target)
    except BaseException as error:
        _remove(temporary)
        if isinstance(error, OSError):
            raise OSError(f"{path} could not be written: {error.strerror or error}") from error
        raise


def _remove(folder: str) -> None:
    """Remove a folder until it stays absent for 0.25 s, because threads of zarr may create it again."""
    absent_checks = 0
    for _ in range(60):
        shutil.rmtree(folder, ignore_errors=True)
        absent_checks = 0 if os.path.exists(folder) else absent_checks + 1
        if absent_checks == 6:
            return
        time.sleep(0.05)


def _rename(temporary: str, target: Path) -> None:
    """Rename a folder to the target. Raises `TakenError` if the target has been created meanwhile."""
    try:
        os.rename(temporary, target)
    except OSError as error:
        # The error code differs between systems: folder not empty, folder exists or access denied.
        if target.is_dir() and any(target.iterdir()):
            raise TakenError(target) from error
        raise
