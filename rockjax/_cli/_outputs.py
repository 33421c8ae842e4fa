"""Output files: `--output` is a prefix, a folder or a name with a format, checked before computing."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

PICTURES = (".png", ".pdf", ".svg", ".eps", ".jpg", ".jpeg", ".tif", ".tiff", ".webp")
DATA = (".nc", ".json")  # formats of data that commands write; these suffixes are removed from the prefix
# Formats that are not written: a name with such a suffix is an error rather than a prefix.
UNSUPPORTED = (
    ".csv",
    ".txt",
    ".xlsx",
    ".h5",
    ".mat",
    ".npy",
    ".npz",
    ".parquet",
    ".zarr",
    ".gif",
    ".mp4",
    ".toml",
)


class Outputs(NamedTuple):
    """The files of one run: PREFIX.nc, PREFIX.png, PREFIX-NAME.png, with the pictures in their format."""

    prefix: Path
    format: str = ".png"

    def data(self, suffix: str = ".nc") -> Path:
        return Path(f"{self.prefix}{suffix}")

    def picture(self, name: str = "") -> Path:
        return Path(f"{self.prefix}{'-' if name else ''}{name}{self.format}")

    def check(self, pictures: Iterable[str] = (), suffix: str = ".nc") -> Outputs:
        """Return these outputs. Raises `OSError` with the cause if a file cannot be written."""
        for path in (self.data(suffix), *map(self.picture, pictures)):
            require_writable(path)
        return self


def parse_outputs(text: str, name: str) -> Outputs:
    """Return the outputs of `--output`; in a folder their prefix is `name`.

    A folder exists or ends in a slash. The suffix of a picture is the format of all pictures. Raises
    `ValueError` for unsupported suffixes.
    """
    output = Path(os.path.expanduser(text))
    if output.is_dir() or text.endswith(("/", os.sep)):
        return Outputs(output / name)
    suffix = output.suffix.lower()
    if suffix in UNSUPPORTED:
        raise ValueError(
            f"--output {output}: {suffix} is not written here; data go to .nc, pictures to "
            f"{', '.join(PICTURES)}: "
            "give one of these, a prefix or a folder"
        )
    if suffix in PICTURES:
        return Outputs(output.with_suffix(""), suffix)
    return Outputs(output.with_suffix("") if suffix in DATA else output)


def store_path(output: Path) -> Path:
    """Return the zarr store of `--output`. Raises `ValueError` or `OSError` if it cannot be one."""
    output = Path(os.path.expanduser(output))
    suffix = output.suffix.lower()
    if suffix in (*PICTURES, *DATA, *UNSUPPORTED) and suffix != ".zarr":
        raise ValueError(
            f"--output {output}: a sweep is written as a zarr store, a folder such as study.zarr"
        )
    if output.is_dir() and suffix != ".zarr" and not (output / "zarr.json").exists():
        output /= "rockjax-sweep.zarr"
    require_writable(output / "zarr.json")
    return output


def require_writable(path: Path) -> None:
    """Raise `OSError` if a file cannot be written, tested with a temporary file beside it."""
    if path.is_dir():
        raise OSError(f"{path} could not be written: it is a folder")
    folder = path.parent
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise OSError(f"{path} could not be written: {error.strerror}") from None
