"""Atomic file writes: under a temporary name beside the target, then renamed."""

from __future__ import annotations

import json
import math
import os
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure


def write_atomically(path: str | Path, write: Callable[[str], object]) -> Path:
    """Call `write(temporary_name)`, then move the file to `path`. On any failure nothing is left behind.

    `~` at the beginning of `path` is the home folder. Raises `OSError` that names the file and the cause,
    such as a full disk.
    """
    path = Path(os.path.expanduser(path))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # The suffix stays last: writers choose their format by it. Short: names have at most 255 bytes.
        handle, name = tempfile.mkstemp(prefix=".rockjax-", suffix=path.suffix, dir=path.parent)
    except OSError as error:
        raise OSError(f"{path} could not be written: {error.strerror}") from error
    os.close(handle)
    try:
        write(name)
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(name, 0o666 & ~umask)
        os.replace(name, path)
    except BaseException as error:
        Path(name).unlink(missing_ok=True)
        if isinstance(error, OSError | RuntimeError):  # the latter from the libraries below netCDF
            raise OSError(
                f"{path} could not be written: {getattr(error, 'strerror', None) or error}"
            ) from error
        raise
    return path


CONVENTIONS = "CF-1.8"  # of the units, flags and names in files; the earliest with groups and texts


def write_dataset(
    path: str | Path, data: xarray.Dataset, groups: Mapping[str, xarray.Dataset] | None = None
) -> Path:
    """Write a dataset as netCDF, and others as groups of the same file, atomically."""
    data.attrs.setdefault("Conventions", CONVENTIONS)

    def write(name: str) -> None:
        data.to_netcdf(name, engine="netcdf4")
        for group, group_data in (groups or {}).items():
            group_data.to_netcdf(name, mode="a", group=group, engine="netcdf4")

    return write_atomically(path, write)


def write_figure(path: str | Path, figure: Figure) -> Path:
    """Write a picture atomically and close it."""
    from matplotlib.pyplot import close

    try:
        return write_atomically(path, lambda name: figure.savefig(name, dpi=150))
    finally:
        close(figure)


def as_json(data: Any, ascii: bool = False) -> str:
    """JSON of numbers, texts, arrays, lists and tables; what is not finite is null. `ascii` escapes all other
    characters."""
    return json.dumps(_to_json_types(data), indent=2, ensure_ascii=ascii)


def _to_json_types(y: Any) -> Any:
    if isinstance(y, dict):
        return {key: _to_json_types(value) for key, value in y.items()}
    if isinstance(y, list | tuple):
        return [_to_json_types(value) for value in y]
    if hasattr(y, "tolist"):  # arrays and their scalars
        return _to_json_types(y.tolist())
    if isinstance(y, float):
        return y if math.isfinite(y) else None
    return y
