"""Partial results of an interrupted run.

They are stored in a netCDF file, which has a group for each podium with results. The results of a podium may
be incomplete.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from rockjax._files import write_dataset

if TYPE_CHECKING:
    import xarray


def path_of(output: str | Path) -> Path:
    """Return the path of the file with partial results; `output` is the prefix of the files of the run."""
    return Path(f"{output}.partial.nc")


def save(path: Path, datasets: Sequence[xarray.Dataset | None]) -> Path:
    """Save the datasets of the podiums atomically, and return the path. None stands for a podium without
    results."""
    import xarray

    root = xarray.Dataset(attrs={"title": "Interrupted run", "datasets": len(datasets)})
    groups = {f"dataset-{k}": data for k, data in enumerate(datasets) if data is not None}
    return write_dataset(path, root, groups)


def load(path: Path, count: int) -> list[xarray.Dataset | None]:
    """Load the datasets of the podiums of an interrupted run. A dataset may be incomplete. None stands for a
    podium without results.

    Raises `ValueError` if the file does not exist, cannot be read or was not saved for `count` podiums.
    """
    import netCDF4
    import xarray

    if not path.exists():
        raise ValueError(f"--resume needs {path}, which does not exist; leave out --resume")
    try:
        with netCDF4.Dataset(path) as file:
            groups, saved_count = set(file.groups), int(file.getncattr("datasets"))
    except (OSError, AttributeError, RuntimeError) as error:
        raise ValueError(f"{path} is not the file of an interrupted run: {error}") from None
    if saved_count != count:
        raise ValueError(
            f"{path} has results of {saved_count} podiums, but this run has {count}; resume with the options "
            "of the interrupted run"
        )
    group_names = [f"dataset-{k}" for k in range(count)]
    return [
        _restore_attrs(xarray.load_dataset(path, group=group, engine="netcdf4")) if group in groups else None
        for group in group_names
    ]


def _restore_attrs(data: xarray.Dataset) -> xarray.Dataset:
    """Return the dataset with attributes that are Python numbers instead of the NumPy scalars of netCDF."""
    data.attrs = {
        name: value.item() if isinstance(value, np.generic) else value for name, value in data.attrs.items()
    }
    return data
