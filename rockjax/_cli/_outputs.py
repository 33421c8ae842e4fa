"""Paths of output files. `--output` is a prefix, folder or file name. Commands check all paths before they
compute results."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from rockjax._files import require_writable

PICTURES = (".png", ".pdf", ".svg", ".eps", ".jpg", ".jpeg", ".tif", ".tiff", ".webp")
DATA = (".nc", ".json")  # formats of data files
TABLES = (".csv", ".xlsx")  # formats of the tables of `rockjax report`
SINGLE_PICTURE = ("",)  # names of the pictures of a command that draws only OUTPUT.png
# Formats that `--output` does not accept. A name with such a suffix is an error, not a prefix.
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
    """Paths of the files of a run: PREFIX.nc, PREFIX.png, PREFIX-NAME.png.

    - `prefix`: PREFIX, a path
    - `format`: suffix of all pictures
    """

    prefix: Path
    format: str = ".png"

    def data(self, suffix: str = ".nc") -> Path:
        """Return the path of the data file."""
        return Path(f"{self.prefix}{suffix}")

    def picture(self, name: str = "") -> Path:
        """Return the path of a picture."""
        return Path(f"{self.prefix}{'-' if name else ''}{name}{self.format}")

    def check(self, pictures: Iterable[str] = (), suffix: str = ".nc") -> Outputs:
        """Return this object unchanged. Raises `OSError` if the data file, or a picture with a name in
        `pictures`, cannot be written."""
        for path in (self.data(suffix), *map(self.picture, pictures)):
            require_writable(path)
        return self


def parse_outputs(text: str, name: str) -> Outputs:
    """Return the output files for `--output`.

    - `text`: value of `--output`: a folder (existing, or with a final slash), a prefix, or a file name. The
      suffix of a picture sets the format of all pictures
    - `name`: prefix of the files if `text` is a folder

    Raises `ValueError` for unsupported suffixes.
    """
    output = Path(os.path.expanduser(text))
    if output.is_dir() or text.endswith(("/", os.sep)):
        return Outputs(output / name)
    suffix = output.suffix.lower()
    if suffix in UNSUPPORTED:
        raise ValueError(
            f"--output {output}: {suffix} files are not supported; give a prefix, a folder, or a name that "
            f"ends in .nc (data) or {', '.join(PICTURES)} (pictures)"
            + ("; `rockjax report` writes tables (--xlsx FILE, --csv FOLDER)" if suffix in TABLES else "")
        )
    if suffix in PICTURES:
        return Outputs(output.with_suffix(""), suffix)
    return Outputs(output.with_suffix("") if suffix in DATA else output)


def store_path(text: str) -> str | Path:
    """Return the path of the zarr store for `--output`. A zarr store is a folder, or is at a URL.

    A URL is returned unchanged. If `text` is an existing folder that is not a zarr store (no suffix .zarr and
    no file zarr.json), the store is rockjax-sweep.zarr in this folder. Otherwise it is the folder `text`.
    Raises `ValueError` for the suffix of another format, and `OSError` if the store cannot be written.
    """
    if "://" in text:
        return text
    output = Path(os.path.expanduser(text))
    suffix = output.suffix.lower()
    if suffix in (*PICTURES, *DATA, *UNSUPPORTED) and suffix != ".zarr":
        raise ValueError(
            f"--output {output}: a sweep is written to a zarr store; give a folder such as study.zarr"
        )
    if output.is_dir() and suffix != ".zarr" and not (output / "zarr.json").exists():
        output /= "rockjax-sweep.zarr"
    require_writable(output / "zarr.json")
    return output
