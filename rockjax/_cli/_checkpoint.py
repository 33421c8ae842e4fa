"""Partial results of an interrupted run: one netCDF file with a group for each podium."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from rockjax._files import write_atomically

if TYPE_CHECKING:
    import xarray


def path_of(output: str | Path) -> Path:
    """Return the path of the partial results of the run that writes OUTPUT.nc."""
    return Path(f"{output}.partial.nc")


def save(path: Path, datasets: Sequence[xarray.Dataset | None]) -> Path:
    """Save datasets, some of them None, atomically, and return the path."""
    import xarray

    def write(name: str) -> None:
        xarray.Dataset(attrs={"title": "Interrupted run", "datasets": len(datasets)}).to_netcdf(
            name, engine="netcdf4"
        )
        for k, data in enumerate(datasets):
            if data is not None:
                data.to_netcdf(name, mode="a", group=f"dataset-{k}", engine="netcdf4")

    return write_atomically(path, write)


def load(path: Path, count: int) -> list[xarray.Dataset | None]:
    """Load the saved datasets, None for those that were not finished.

    Raises `ValueError` if there is no such file, or it belongs to another run.
    """
    import netCDF4
    import xarray

    if not path.exists():
        raise ValueError(f"there is nothing to resume: {path} does not exist")
    try:
        with netCDF4.Dataset(path) as file:
            groups, expected = set(file.groups), int(file.getncattr("datasets"))
    except (OSError, AttributeError, RuntimeError) as error:
        raise ValueError(f"{path}: is not the file of an interrupted run: {error}") from None
    if expected != count:
        raise ValueError(
            f"{path}: belongs to a run over {expected} podiums, this one has {count}; use the same flags"
        )
    names = [f"dataset-{k}" for k in range(count)]
    return [
        _restore_attrs(xarray.load_dataset(path, group=name, engine="netcdf4")) if name in groups else None
        for name in names
    ]


def _restore_attrs(data: xarray.Dataset) -> xarray.Dataset:
    """Convert attributes back from the NumPy scalars of netCDF to Python numbers."""
    data.attrs = {
        name: value.item() if isinstance(value, np.generic) else value for name, value in data.attrs.items()
    }
    return data
