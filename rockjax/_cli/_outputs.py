"""Where files go: `--output` is a prefix, a folder or a name with a format, looked at before anything is
computed."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

PICTURES = (".png", ".pdf", ".svg", ".eps", ".jpg", ".jpeg", ".tif", ".tiff", ".webp")
DATA = (".nc", ".json")  # those that the commands write; a name that ends so names the prefix
# What one might expect here and what is not written: a name that ends so is hardly a prefix.
OTHERS = (
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
        """These outputs, if their files can be written. Raises `OSError` that says why not."""
        for path in (self.data(suffix), *map(self.picture, pictures)):
            require_writable(path)
        return self


def outputs(text: str, name: str) -> Outputs:
    """What `--output` means: an existing folder, or one that ends in a slash, is to hold files called `name`.

    The suffix of a picture is the format of all pictures. Raises `ValueError` for suffixes that are not
    written.
    """
    output = Path(os.path.expanduser(text))
    if output.is_dir() or text.endswith(("/", os.sep)):
        return Outputs(output / name)
    suffix = output.suffix.lower()
    if suffix in OTHERS:
        raise ValueError(
            f"--output {output}: {suffix} is not written here; data go to .nc, pictures to "
            f"{', '.join(PICTURES)}: "
            "give one of these, a prefix or a folder"
        )
    if suffix in PICTURES:
        return Outputs(output.with_suffix(""), suffix)
    return Outputs(output.with_suffix("") if suffix in DATA else output)


def store_place(output: Path) -> Path:
    """The zarr store that `--output` means. Raises `ValueError` and `OSError` where there can be none."""
    output = Path(os.path.expanduser(output))
    suffix = output.suffix.lower()
    if suffix in (*PICTURES, *DATA, *OTHERS) and suffix != ".zarr":
        raise ValueError(
            f"--output {output}: a sweep is written as a zarr store, a folder such as study.zarr"
        )
    if output.is_dir() and suffix != ".zarr" and not (output / "zarr.json").exists():
        output /= "rockjax-sweep.zarr"
    require_writable(output / "zarr.json")
    return output


def require_writable(path: Path) -> None:
    """Raise `OSError`, as writing would, where a file cannot be written: looked at by making one and taking
    it away."""
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
