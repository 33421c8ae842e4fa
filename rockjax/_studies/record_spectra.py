"""Effect of records on columns of different sizes: closeness to overturning, and displacement.

A scene is one podium under one scaled record.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import ArrayLike, Float

from rockjax import _results as results
from rockjax._batch.batch import peak_responses
from rockjax._boundaries.boundary import check_limit, check_search
from rockjax._boundaries.crossings import precompile_scan, scan
from rockjax._boundaries.margin import DEFAULT_WIDTH
from rockjax._checks import as_axis, require
from rockjax._machine.threads import TABLE_MODULES, import_in_background
from rockjax._motions.convert import AnyMotions, as_records
from rockjax._motions.provenance import record_coords
from rockjax._options import Options
from rockjax._parameters.registry import as_variable
from rockjax._responses.arguments import check_single, check_types
from rockjax._responses.datasets import describe_options, describe_podium
from rockjax._structures import Podium

from .fragility import DEFAULT_OPTIONS, record_labels

if TYPE_CHECKING:
    import xarray


SIZE_ATTRIBUTES = ("R_m", "p_rad_s")  # attributes of a podium that depend on its size


def record_spectrum(
    podium: Podium,
    records: AnyMotions,
    p: Float[ArrayLike, " n"],
    *,
    max_scale: float = 10.0,
    names: Sequence[str] | None = None,
    width: float = DEFAULT_WIDTH,
    resolution: int = 128,
    options: Options = DEFAULT_OPTIONS,
    progress: Any = False,
) -> xarray.Dataset:
    """Compute the effect of records on structures that differ only in the size of their columns.

    - `podium`: podium with scalar parameters; its `R` is replaced by the value that follows from `p`
    - `records`: `Motions`, `Records`, or a list of motions or records
    - `p`: frequency parameters √(3g/4R), shape (n,), > 0, ascending [rad/s]
    - `max_scale`: largest factor on the records in the search for overturning, > 0 [–]
    - `names`: names of the records; by default the names of the motions, or integers from 1
    - `width`: the search for the least overturning factor is designed to find every interval of overturning
      factors that is wider than this share of `max_scale`, in (0, 0.1]
    - `resolution`: number of equal intervals between 0 and `max_scale`; the search starts with the ends of
      these intervals
    - `options`: options of the scenes; the output `"peak_rotation"` is added to `options.outputs`
    - `progress`: `True` for progress bars, or any object with a method `update(number_of_scenes)`

    Returns a Dataset over `record` and `p`:

    - `demand`: PGA of the record divided by the least PGA that overturns the structure [–]. This is 1 divided
      by the least overturning factor on the record; NaN if no factor up to `max_scale` is found that
      overturns the structure
    - `certain_width`: largest width of an interval of overturning factors below the least one (or below
      `max_scale`) that the search may have missed [–]. It is large if scenes of the search did not finish
    - `peak_rotation`, `overturned`: max|θ|/α, and whether the structure overturns, under the unscaled record
    - `result`: result of the scene under the unscaled record. If the scene did not finish, `peak_rotation`
      and `top_displacement` are NaN
    - `top_displacement`: max|u_b| = 2R (sin α − sin(α − max|θ|)), Eq. (13) of docs/model.md, the largest
      displacement of the column tops relative to the ground under the unscaled record [m]; NaN where the
      structure overturns. Far from overturning, this displacement is almost independent of the size

    Raises `ValueError` for invalid inputs, and `RuntimeError` if for some record and size no scene finishes.
    """
    owner = "record_spectrum"
    check_types(owner, podium, options)
    motions = records
    records, own_names = as_records(owner, motions)
    count, labels = len(records), record_labels(owner, records, own_names if names is None else names)
    sizes = as_axis(owner, "p", p, ascending=True)
    require(owner, "p", sizes, lambda v: v > 0, "finite and > 0 rad/s")
    check_single(owner, podium)
    check_limit(owner, "max_scale", max_scale)
    check_search(owner, width, resolution)
    R = 0.75 * float(podium.g) / sizes**2  # Eq. (25)

    def plane(x, y):
        """Return the scenes of the cells with the indices x, with the records scaled by y. A cell is a pair
        of a record and a size; the size varies fastest."""
        record, size = np.divmod(np.asarray(x).astype(np.int32), sizes.size)
        return podium.replace(R=R[size]), records.pick_scaled(record, y)

    import_in_background(*TABLE_MODULES)
    cells = np.arange(count * sizes.size)
    scale_range = (0.0, float(max_scale))
    precompile_scan(plane, cells, scale_range, options, width)
    options = _with_rotation(options)
    peaks = peak_responses(*plane(cells, np.ones(cells.size)), options=options, progress=progress)
    search = scan(
        plane, cells, scale_range, resolution, options, progress, first_only=True, width=width, dips=False
    )
    least_scale = search.crossings.table(cells.size)[0][:, 0]
    shape = (count, sizes.size)
    code = np.asarray(results.code_of(peaks.result), np.int8).reshape(shape)
    rotation = np.where(results.did_not_finish(code), np.nan, np.asarray(peaks.peak_rotation).reshape(shape))
    overturned = np.asarray(peaks.overturned).reshape(shape)
    alpha = float(podium.alpha)
    displacement = np.where(overturned, np.nan, 2 * R * (np.sin(alpha) - np.sin(alpha * (1 - rotation))))
    import xarray

    dims = ("record", "p")
    demand, certain_width = (1 / least_scale).reshape(shape), search.certain_width.reshape(shape)
    undetected = "largest width of an undetected interval that overturns"
    return xarray.Dataset(
        {
            "demand": as_variable(dims, demand, "1", "PGA divided by least overturning PGA"),
            "certain_width": as_variable(dims, certain_width, "1", undetected),
            "peak_rotation": as_variable(dims, rotation, "1", "max|θ|/α"),
            "overturned": (dims, overturned, {"long_name": "overturned"}),
            "result": as_variable(dims, code, "1", "result of the scene", **results.FLAGS),
            "top_displacement": as_variable(dims, displacement, "m", "max|u_b|"),
        },
        coords={
            "record": ("record", labels, {"long_name": "record"}),
            **record_coords(records, motions),
            "p": as_variable("p", sizes, "rad s-1", "frequency parameter p"),
            "R": as_variable("p", R, "m", "half diagonal of a column R"),
        },
        attrs={
            "title": "Spectra of records",
            "kind": "record-spectrum",
            "max_scale": scale_range[1],
            "scenes": cells.size + search.scenes,
            **{k: y for k, y in describe_podium(podium).items() if k not in SIZE_ATTRIBUTES},
            **describe_options(options),
        },
    )


def _with_rotation(options: Options) -> Options:
    """Return options whose outputs include the peak rotation."""
    if "peak_rotation" in [output.name for output in options.requested]:
        return options
    return options.replace(outputs=(*options.outputs, "peak_rotation"))
