"""Atomic file writes: a file is written under a temporary name in the same folder, and then renamed."""

from __future__ import annotations

import contextlib
import json
import math
import os
import signal
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure


class _NotWritten(OSError):
    """Raised for a file that cannot be written, with the path and the cause in the message."""


def write_atomically(path: str | Path, write: Callable[[str], object]) -> Path:
    """Call `write(temporary_name)`, rename the written file to `path`, and return `path`.

    `~` at the beginning of `path` means the home folder. If anything fails, the temporary file is deleted,
    and a file that already exists at `path` is kept. Raises `OSError`, which names the file and the cause,
    such as a full disk.
    """
    path = Path(os.path.expanduser(path))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # The temporary name keeps the suffix, because writers choose the format by the suffix. The prefix is
        # short, because names have at most 255 bytes.
        handle, name = tempfile.mkstemp(prefix=".rockjax-", suffix=path.suffix, dir=path.parent)
    except OSError as error:
        raise _NotWritten(f"{path} could not be written: {error.strerror}") from error
    os.close(handle)
    try:
        write(name)
        # `mkstemp` creates files that only their owner may read; set the usual permissions.
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(name, 0o666 & ~umask)
        os.replace(name, path)
    except BaseException as error:
        Path(name).unlink(missing_ok=True)
        # `write` may write another file with this function, whose error names that file. netCDF raises
        # RuntimeError.
        if isinstance(error, OSError | RuntimeError) and not isinstance(error, _NotWritten):
            raise _NotWritten(
                f"{path} could not be written: {getattr(error, 'strerror', None) or error}"
            ) from error
        raise
    return path


def require_writable(path: Path) -> None:
    """Raise `OSError` if a file cannot be written to a path.

    The check writes a temporary file into the folder of the path. If this folder does not exist, the check
    uses the nearest folder above it that exists.
    """
    if path.is_dir():
        raise _NotWritten(f"{path} could not be written: it is a folder")
    folder = path.parent
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise _NotWritten(f"{path} could not be written: {error.strerror}") from None


@contextlib.contextmanager
def interruption_delayed() -> Iterator[None]:
    """Delay Ctrl-C until the end of the `with` block. Only the main thread receives Ctrl-C, so the block may
    run in any thread."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    received: list[int] = []
    previous = signal.signal(signal.SIGINT, lambda number, frame: received.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, previous)
        if received:
            signal.raise_signal(signal.SIGINT)


CONVENTIONS = "CF-1.8"  # the earliest version of the CF conventions that has groups and strings


def write_dataset(
    path: str | Path, data: xarray.Dataset, groups: Mapping[str, xarray.Dataset] | None = None
) -> Path:
    """Write a dataset as a netCDF file, and other datasets as groups of this file, atomically. Return the
    path. The attribute `Conventions` is added to `data` if it is missing."""
    from ._machine.threads import wait_for_imports

    wait_for_imports()
    data.attrs.setdefault("Conventions", CONVENTIONS)

    def write(name: str) -> None:
        data.to_netcdf(name, engine="netcdf4")
        for group, group_data in (groups or {}).items():
            group_data.to_netcdf(name, mode="a", group=group, engine="netcdf4")

    return write_atomically(path, write)


def write_figure(path: str | Path, figure: Figure) -> Path:
    """Write a figure atomically, and close it. Return the path."""
    from matplotlib.pyplot import close

    try:
        return write_atomically(path, lambda name: figure.savefig(name, dpi=150))
    finally:
        close(figure)


def as_json(data: Any, ascii: bool = False) -> str:
    """Return numbers, strings, arrays, lists and dicts as JSON. Numbers that are not finite become null. If
    `ascii` is True, all characters that are not ASCII are escaped."""
    return json.dumps(_to_json_types(data), indent=2, ensure_ascii=ascii)


def _to_json_types(y: Any) -> Any:
    """Convert data to types that `json` can write. Numbers that are not finite become None."""
    if isinstance(y, dict):
        return {key: _to_json_types(value) for key, value in y.items()}
    if isinstance(y, list | tuple):
        return [_to_json_types(value) for value in y]
    if hasattr(y, "tolist"):  # arrays and their scalars
        return _to_json_types(y.tolist())
    if isinstance(y, float):
        return y if math.isfinite(y) else None
    return y
