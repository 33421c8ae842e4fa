"""Ensembles of records: incremental dynamic analysis with every boundary, and the distribution of least
scales."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float

from rockjax._batch.batch import peak_responses
from rockjax._boundaries.boundary import check_search, overturning_boundary, positive_limit
from rockjax._boundaries.crossings import precompile_scan, scan
from rockjax._boundaries.implicit import log_sensitivities
from rockjax._boundaries.margin import DEFAULT_WIDTH
from rockjax._checks import as_float, as_strings, require, require_instance
from rockjax._lognormal import Lognormal, fit_capacities
from rockjax._machine.memory import FEWER_LINES, require_memory
from rockjax._machine.threads import TABLES, import_in_background
from rockjax._motions.convert import AnyMotions, as_records
from rockjax._motions.provenance import record_coords
from rockjax._motions.records import RecordPairs, Records
from rockjax._options import Options
from rockjax._parameters.sensitivities import check_parameters
from rockjax._responses.arguments import check_single, check_types
from rockjax._responses.datasets import describe_options, describe_podium
from rockjax._responses.peak import data_variables
from rockjax._structures import Podium

from .spectra import boundary_axis

if TYPE_CHECKING:
    import xarray

# The options of single scenes, so that programs are shared. Methods of lower order have cheaper steps, but
# take as long for ten times the error if something vibrates.
ENSEMBLE = Options()


class Measure(NamedTuple):
    """An intensity measure of unscaled records; it is proportional to the scale.

    - `name`: such as "PGA" or "Sa(0.5 s)"; `units`: such as "m s-2"
    - `values`: of each record, shape (k,), > 0
    """

    name: str
    values: Float[ArrayLike, " k"]
    units: str


def pga(records: Records | RecordPairs) -> Measure:
    """Return the peak ground acceleration of each record [m/s²]."""
    return Measure("PGA", np.asarray(records.sizes()).max(axis=1), "m s-2")


def record_labels(owner: str, records: Records | RecordPairs, names: Sequence[str] | None) -> list:
    """Return the label of each record: its name, or numbers from 1."""
    count = len(records)
    labels = list(range(1, count + 1)) if names is None else list(as_strings(owner, "names", names))
    if len(labels) != count or len(set(labels)) != count:
        raise ValueError(f"{owner}: names must be {count} different ones, got {names!r}")
    return labels


def _levels(owner: str, intensity) -> np.ndarray:
    """Return ascending levels of intensity, checked."""
    levels = np.asarray(as_float(intensity, f"{owner}: intensity"))
    if levels.ndim != 1 or levels.size == 0 or np.any(np.diff(levels) <= 0):
        raise ValueError(f"{owner}: intensity must be a 1-D array of ascending levels, got {intensity!r}")
    require(owner, "intensity", levels, lambda v: v > 0, "finite and > 0")
    return levels


def _record_variables(boundaries, impacts, certain, unit, measure_attrs: dict[str, str]) -> dict[str, Any]:
    """Return the variables over `record`: boundaries, their certain width, and the unscaled intensity.

    `measure_attrs` are the attributes of the measure.
    """
    name = measure_attrs["long_name"]
    return {
        "capacity": ("record", boundaries[:, 0], measure_attrs | {"long_name": f"least overturning {name}"}),
        "boundaries": (
            ("record", "boundary"),
            boundaries,
            measure_attrs | {"long_name": f"{name} where the verdict changes"},
        ),
        "certain_width": (
            "record",
            certain,
            measure_attrs | {"long_name": f"no wider interval of {name} below the capacity overturns"},
        ),
        "boundary_impacts": (
            ("record", "boundary"),
            impacts,
            {"units": "1", "long_name": "impacts before overturning"},
        ),
        "measure": ("record", unit, measure_attrs | {"long_name": f"{name} of the unscaled record"}),
    }


def incremental_dynamic_analysis(
    podium: Podium,
    records: AnyMotions,
    intensity,
    *,
    measure: Measure | Literal["PGA", "scale"] = "PGA",
    names: Sequence[str] | None = None,
    sensitivities: Sequence[str] = (),
    width: float = DEFAULT_WIDTH,
    resolution: int = 128,
    options: Options = ENSEMBLE,
    progress: Any = False,
) -> xarray.Dataset:
    """Compute peak responses to a suite of records at rising intensity, and every intensity at which the
    outcome changes (host).

    - `podium`: podium of single numbers
    - `records`: `Motions`, `Records`, or a list of motions or records; with vertical motions
      (`Motions.paired`, or a list of [`rockjax.GroundMotion`][] of records) both are scaled, and the measure
      is of the horizontal one
    - `intensity`: levels, shape (m,), > 0 and ascending, in units of `measure`: each record is scaled to all
      of them
    - `measure`: `"PGA"` [m/s²], `"scale"` for factors on the records, or a [`rockjax.Measure`][]
    - `names`: of each record, by default those of the motions, or numbers
    - `sensitivities`: parameters y for which d ln(capacity)/d ln y is computed, as in
      [`rockjax.overturning_spectrum`][]
    - `width`: every interval of overturning intensities below the capacity that is wider than this share of
      the highest level is found, in (0, 0.1]; the spacing of the scenes follows from derivatives by the
      intensity, with up to 1/`width` places from the first that lifts the columns
    - `resolution`: number of places up to the highest level at which further boundaries, above the capacity,
      are searched
    - `options`: with `overturn_ratio` < 1 the limit state is a rotation of that ratio instead of overturning
    - `progress`: `True` for progress bars, or anything with `update(number_of_scenes)`

    Returns a Dataset over `record` and `intensity` with the scalars of [`rockjax.Peak`][] as variables. Over
    `record` alone there are `capacity`, the least intensity that overturns (NaN if none up to the highest
    level does), `boundaries` (further dim `boundary`): survive → overturn → survive …, `certain_width`, the
    widest interval of intensities below the capacity that may overturn unseen, and `sensitivity` (further dim
    `parameter`). Boundaries are exact to about 1e-9. Above the capacity, rocking through many impacts creates
    windows of survival within windows without limit; there all boundaries that `resolution` resolves are
    listed. Raises `ValueError` for invalid inputs.
    """
    owner = "incremental_dynamic_analysis"
    check_types(owner, podium, options)
    given = records
    records, own_names = as_records(owner, given)
    labels = record_labels(owner, records, own_names if names is None else names)
    levels = _levels(owner, intensity)
    check_single(owner, podium)
    check_search(owner, width, resolution)
    check_parameters(owner, podium, sensitivities)
    measure = _measure(owner, measure, records)
    unit = np.asarray(measure.values, float)
    count = len(records)
    require_memory(owner, count * (levels.size + resolution + 1), advice=FEWER_LINES)

    def plane(x, y):
        which = np.asarray(x).astype(np.int32)
        # In NumPy; otherwise every shape would compile another program.
        return podium, records.chosen(which, y / unit[which])

    import_in_background(*TABLES)
    lines = np.arange(count), (0.0, float(levels[-1]))
    precompile_scan(plane, *lines, options, width)
    peaks = peak_responses(*plane(lines[0][:, None], levels), options=options, progress=progress)
    # Above the first boundary of a long record their number grows with the resolution, without limit.
    found = scan(plane, *lines, resolution, options, progress, refine="below", width=width, dips=False)
    boundaries, impacts = found.crossings.table(count)
    measure_attrs = {"units": measure.units, "long_name": measure.name}
    import xarray

    data = xarray.Dataset(
        data_variables(peaks, options.outputs, ("record", "intensity"))
        | _record_variables(boundaries, impacts, found.certain, unit, measure_attrs),
        coords={
            "record": ("record", labels, {"long_name": "record"}),
            **record_coords(records, given),
            "intensity": ("intensity", levels, measure_attrs),
            "boundary": boundary_axis(boundaries),
        },
        attrs={
            "title": "Incremental dynamic analysis",
            "kind": "incremental-dynamic-analysis",
            "measure": measure.name,
            "scenes": levels.size * count + found.scenes,
            **describe_podium(podium),
            **describe_options(options),
        },
    )
    if sensitivities:
        which, table = np.arange(count, dtype=np.int32), records.common_form()
        slopes = log_sensitivities(
            podium, boundaries[:, 0] / unit, {"which": which}, tuple(sensitivities), options, records=table
        )
        data["sensitivity"] = (
            ("parameter", "record"),
            slopes,
            {"units": "1", "long_name": f"d ln a/d ln y of the least overturning {measure.name} a"},
        )
        data = data.assign_coords(parameter=list(sensitivities))
    return data


def _measure(owner: str, measure: Measure | str, records: Records | RecordPairs) -> Measure:
    if isinstance(measure, str):
        measures = {
            "PGA": lambda: pga(records),
            "scale": lambda: Measure("scale", np.ones(len(records)), "1"),
        }
        if measure not in measures:
            raise ValueError(f"{owner}: measure must be 'PGA', 'scale' or a rockjax.Measure, got {measure!r}")
        measure = measures[measure]()
    require_instance(owner, "measure", measure, Measure, "'PGA', 'scale' or a rockjax.Measure")
    if np.shape(measure.values) != (len(records),):
        raise ValueError(
            f"{owner}: measure must hold a value for each of "
            f"{len(records)} records, got shape {np.shape(measure.values)}"
        )
    require(
        owner, f"measure {measure.name}", measure.values, lambda v: v > 0, "finite and > 0 for every record"
    )
    return measure


def overturning_distribution(
    podium: Podium,
    records: AnyMotions,
    *,
    max_scale: float = 10.0,
    measure: Float[ArrayLike, " k"] | None = None,
    options: Options = ENSEMBLE,
    width: float = DEFAULT_WIDTH,
    resolution: int = 128,
) -> Lognormal:
    """Return median and dispersion of the least overturning scale of a suite; differentiable.

    Works under `jit`, `vmap` and `grad` with respect to every number of `podium`. Records that no scale up to
    `max_scale` overturns count as beyond it, with derivative zero. NaN if fewer than two records overturn. On
    the host [`rockjax.incremental_dynamic_analysis`][] finds the same capacities on all cores.

    - `podium`: podium of single numbers
    - `records`: `Motions`, `Records`, or a list of motions or records
    - `max_scale`: end of the search for each record, > 0 [–]
    - `measure`: intensity of the unscaled records, (k,); the result is in its units, else in scales
    - `options`, `width`, `resolution`: as for [`rockjax.overturning_boundary`][]
    """
    owner = "overturning_distribution"
    check_types(owner, podium, options)
    positive_limit(owner, "max_scale", max_scale)
    records, _ = as_records(owner, records)
    unit = jnp.ones(len(records)) if measure is None else as_float(measure, f"{owner}: measure")

    def least(which):
        motion = records.pick(which)
        return overturning_boundary(
            podium, motion, max_scale=max_scale, options=options, width=width, resolution=resolution
        ).scale

    scale = jax.vmap(least)(jnp.arange(len(records), dtype=jnp.int32))
    return fit_capacities(scale * unit, max_scale * unit)
