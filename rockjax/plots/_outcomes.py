"""Scenes that survive, overturn or did not finish. For a scene that did not finish, the outcome is unknown,
and its peaks are zero, NaN or partial."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap

if TYPE_CHECKING:
    import xarray


def survives(dataset: xarray.Dataset) -> xarray.DataArray:
    """Return for each scene of a dataset whether it finished without overturning."""
    return _outcomes(dataset) == 0


def is_unfinished(dataset: xarray.Dataset) -> xarray.DataArray:
    """Return for each scene of a dataset whether it did not finish."""
    return _outcomes(dataset).isnull()


def _outcomes(dataset: xarray.Dataset) -> xarray.DataArray:
    from rockjax._results import outcomes  # imports JAX, which other plots do not need

    return outcomes(dataset)


def hatch_unfinished(dataset: xarray.Dataset, ax: Axes) -> None:
    """Hatch the cells of a rocking spectrum whose scenes did not finish."""
    cells = is_unfinished(dataset).transpose("acceleration_ratio", "frequency_ratio").values
    if cells.any():
        ax.pcolor(
            dataset["frequency_ratio"].values,
            dataset["acceleration_ratio"].values,
            np.ma.masked_where(~cells, cells),
            shading="nearest",
            cmap=ListedColormap(["white"]),
            hatch="////",
            edgecolor="0.6",
            linewidth=0.0,
            label="did not finish",
        )
