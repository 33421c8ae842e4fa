"""Stored answers of the scenes of a report, which a repeated report does not solve again."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from rockjax._responses.datasets import describe_versions

if TYPE_CHECKING:
    import xarray


def fingerprint(*values: Any) -> str:
    """Return a hash of pytrees of numbers and of other values by their `repr`. Equal hashes mean equal
    answers."""
    entries: list[str] = [json.dumps(describe_versions(), sort_keys=True)]
    for value in values:
        leaves, structure = jax.tree.flatten(value)
        entries.append(str(structure))
        for leaf in leaves:
            if isinstance(leaf, bool | int | float | np.ndarray | np.generic | jax.Array):
                array = np.ascontiguousarray(leaf)
                entries.append(f"{array.dtype.str}{array.shape}{hashlib.sha256(array.tobytes()).hexdigest()}")
            else:
                entries.append(repr(leaf))
    return hashlib.sha256("\n".join(entries).encode()).hexdigest()


class Store:
    """Datasets by name, each with a fingerprint of its inputs.

    - `path`: file that keeps them, or None
    """

    def __init__(self, path: Path | None = None):
        self.path, self.computed = path, 0
        self.data: dict[str, xarray.Dataset] = {}
        for candidate in () if path is None else (path, _partial(path)):
            self._load(candidate)

    def _load(self, path: Path) -> None:
        """Read the datasets of an earlier run. A file that is damaged, or not of a report, is ignored."""
        if not path.exists():
            return
        import xarray

        try:
            groups = xarray.open_groups(path, engine="netcdf4")
            for name, data in groups.items():
                if "fingerprint" in data.attrs:
                    self.data[name.strip("/").replace("/", ".")] = data.load()
                data.close()
        except (OSError, ValueError, KeyError):
            self.data = {}

    def get(self, name: str, mark: str, compute: Callable[[], xarray.Dataset]) -> xarray.Dataset:
        """Return a dataset; compute it if it is not stored with this fingerprint.

        - `name`: name of the dataset, with "." between its parts; `mark`: its fingerprint
        - `compute`: function that computes it
        """
        stored = self.data.get(name)
        if stored is not None and stored.attrs["fingerprint"] == mark:
            return stored
        data = compute()
        data.attrs["fingerprint"] = mark
        self.data[name] = data
        self.computed += 1
        if self.path is not None:
            self._write(_partial(self.path))
        return data

    def save(self) -> Path | None:
        """Write all datasets to the file, and remove that of an interrupted run. Return the path."""
        if self.path is None:
            return None
        if self.computed or not self.path.exists():
            self._write(self.path)
        _partial(self.path).unlink(missing_ok=True)
        return self.path

    def _write(self, path: Path) -> None:
        import xarray

        from rockjax._files import write_dataset

        root = xarray.Dataset(attrs={"title": "Scenes of a report", "kind": "report"})
        write_dataset(path, root, {name.replace(".", "/"): data for name, data in self.data.items()})


def _partial(path: Path) -> Path:
    return path.with_suffix(".partial.nc")
