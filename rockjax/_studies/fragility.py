"""Incremental dynamic analysis of records, and the distribution of their least overturning scale factors.

A scene is one podium under one scaled record. Its outcome is survival or overturning.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float

from rockjax._batch.batch import peak_responses
from rockjax._boundaries.boundary import check_limit, check_search, overturning_boundary
from rockjax._boundaries.crossings import precompile_scan, scan
from rockjax._boundaries.implicit import log_sensitivities
from rockjax._boundaries.margin import DEFAULT_WIDTH
from rockjax._checks import as_axis, as_float, as_strings, require, require_instance, require_positive
from rockjax._lognormal import Lognormal, fit_capacities
from rockjax._machine.memory import REQUEST_FEWER, require_memory
from rockjax._machine.threads import TABLE_MODULES, import_in_background
from rockjax._motions.convert import AnyMotions, as_records
from rockjax._motions.intensity import measure_by_label
from rockjax._motions.motion import Motions
from rockjax._motions.provenance import record_coords
from rockjax._motions.records import RecordPairs, Records
from rockjax._options import Options
from rockjax._parameters.registry import as_variable
from rockjax._parameters.sensitivities import check_parameters
from rockjax._responses.arguments import check_single, check_types
from rockjax._responses.datasets import describe_options, describe_podium
from rockjax._responses.peak import data_variables
from rockjax._structures import Podium, g_tan_alpha
from rockjax._units import unit_of_measure

from .spectra import boundary_axis

if TYPE_CHECKING:
    import xarray

# These are also the default options of `peak_responses`, so the analyses reuse its compiled programs.
DEFAULT_OPTIONS = Options()


class Measure(NamedTuple):
    """An intensity measure that is proportional to the scale of a record.

    - `name`: name, such as "PGA" or "Sa(0.5 s)"
    - `values`: intensities of the k unscaled records, shape (k,), > 0
    - `units`: unit of the values, such as "m s-2"
    """

    name: str
    values: Float[ArrayLike, " k"]
    units: str


def pga(records: Records | RecordPairs) -> Measure:
    """Return the peak ground acceleration of records as an intensity measure [m/s²]."""
    return Measure("PGA", np.asarray(records.magnitudes()).max(axis=1), "m s-2")


DEFAULT_MAX_RATIO = 6.0  # PGA/(g tan α) at the default highest level, for the median motion of a suite


def measure_of(name: str, period: float | None, suite: Motions) -> Measure:
    """Return an intensity measure, evaluated for each motion of a suite.

    - `name`: "PGA", "PGV", "Sa", or "scale" for the factor on the motions
    - `period`: period for "Sa" [s]; otherwise None
    - `suite`: the motions
    """
    if name == "scale":
        return Measure(name, np.ones(len(suite)), unit_of_measure(name))
    label = f"Sa({period:g} s)" if name == "Sa" else name
    values = np.array([measure_by_label("fragility", motion, label) for motion in suite])
    return Measure(label, values, unit_of_measure(name))


def levels_of(
    podium: Podium, suite: Motions, measure: Measure, ends: tuple[float, float] | None, count: int
) -> np.ndarray:
    """Return equally spaced levels of intensity, shape (count,), in the unit of the measure.

    - `podium`, `suite`, `measure`: structure, ground motions and intensity measure
    - `ends`: lowest and highest level. If None, the highest level is 6 g tan α times the median ratio of
      `measure` to PGA in the suite, and the lowest level is the highest divided by `count`
    - `count`: number of levels; a single level is the highest one
    """
    if ends is None:
        pga_of_suite = np.array([motion.pga for motion in suite])
        highest = (
            DEFAULT_MAX_RATIO
            * float(g_tan_alpha(podium.alpha, podium.g))
            * float(np.median(np.asarray(measure.values) / pga_of_suite))
        )
        ends = highest / count, highest
    return np.linspace(*ends, count) if count > 1 else np.array(ends[1:])


def record_labels(owner: str, records: Records | RecordPairs, names: Sequence[str] | None) -> list:
    """Return the labels of records: their names, or integers from 1 if `names` is None.

    - `owner`: name of the calling function, for messages
    - `records`: the records
    - `names`: a name for each record, or None

    Raises `ValueError` unless there is one name for each record, and all names are different.
    """
    count = len(records)
    labels = list(range(1, count + 1)) if names is None else list(as_strings(owner, "names", names))
    if len(labels) != count or len(set(labels)) != count:
        raise ValueError(f"{owner}: names must be {count} different strings, got {names!r}")
    return labels


def _record_variables(boundaries, impacts, certain_width, measure: Measure) -> dict[str, Any]:
    """Return the variables of an incremental dynamic analysis that do not depend on the intensity.

    - `boundaries`: intensities at which the outcome changes, shape (records, boundaries)
    - `impacts`: number of impacts before overturning at each boundary, shape (records, boundaries)
    - `certain_width`: largest width of an overturning interval below the capacity that the search may have
      missed, shape (records,)
    - `measure`: intensity measure
    """
    name, units, dims = measure.name, measure.units, ("record", "boundary")
    undetected = f"largest width of an undetected interval of {name} that overturns"
    values = np.asarray(measure.values, float)
    return {
        "capacity": as_variable("record", boundaries[:, 0], units, f"least overturning {name}"),
        "boundaries": as_variable(dims, boundaries, units, f"{name} at changes of the outcome"),
        "certain_width": as_variable("record", certain_width, units, undetected),
        "boundary_impacts": as_variable(dims, impacts, "1", "impacts before overturning"),
        "measure": as_variable("record", values, units, f"{name} of the unscaled record"),
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
    options: Options = DEFAULT_OPTIONS,
    progress: Any = False,
) -> xarray.Dataset:
    """Compute peak responses to scaled records, and the intensities at which the outcome changes between
    survival and overturning.

    - `podium`: podium with scalar parameters
    - `records`: `Motions`, `Records`, or a list of motions or records. Vertical components, of
      `Motions.paired` or of [`rockjax.GroundMotion`][], are scaled like the horizontal components. The
      measure refers to the horizontal components
    - `intensity`: levels of intensity to which each record is scaled, shape (m,), > 0 and ascending, in the
      unit of `measure`
    - `measure`: intensity measure: `"PGA"` [m/s²], `"scale"` for factors on the records, or a
      [`rockjax.Measure`][]
    - `names`: names of the records; by default the names of the motions, or integers from 1
    - `sensitivities`: parameters y of the podium for which d ln(capacity)/d ln y is computed
    - `width`: the search for the capacity is designed to find every interval of overturning intensities that
      is wider than this share of the highest level, in (0, 0.1]
    - `resolution`: number of equal intervals between 0 and the highest level; the search starts with the ends
      of these intervals. More intervals show more boundaries above the capacity
    - `options`: options of the scenes. With `overturn_ratio` < 1 the limit state is |θ|/α = `overturn_ratio`
      instead of overturning
    - `progress`: `True` for progress bars, or any object with a method `update(number_of_scenes)`

    Returns a Dataset. The answers that every scene has, such as `overturned`, and the answers that
    `options.outputs` requests (see [`rockjax.Peak`][]) have the dims `record` and `intensity`. The following
    variables do not depend on the intensity; their first dim is `record`:

    - `capacity`: the least intensity at which the record overturns the podium; NaN if there is none up to the
      highest level
    - `boundaries` (additional dim `boundary`): intensities at which the outcome changes, ascending, padded
      with NaN. With the default options their relative error is about 1e-9. Above the capacity, the number of
      boundaries grows with `resolution` without limit, because rocking through many impacts creates ever
      narrower survival windows
    - `boundary_impacts` (additional dim `boundary`): number of impacts before overturning, in a scene on the
      overturned side of the boundary; −1 where there is no boundary
    - `certain_width`: largest width of an interval of overturning intensities below the capacity that the
      search may have missed
    - `measure`: intensity of the unscaled record
    - `sensitivity` (additional dim `parameter`): d ln(capacity)/d ln y

    Raises `ValueError` for invalid inputs, and `RuntimeError` if for some record no scene of the search
    finishes.
    """
    owner = "incremental_dynamic_analysis"
    check_types(owner, podium, options)
    motions = records
    records, own_names = as_records(owner, motions)
    labels = record_labels(owner, records, own_names if names is None else names)
    levels = as_axis(owner, "intensity", intensity, ascending=True)
    require_positive(owner, intensity=levels)
    check_single(owner, podium)
    check_search(owner, width, resolution)
    check_parameters(owner, podium, sensitivities)
    measure = checked_measure(owner, measure, records)
    unscaled = np.asarray(measure.values, float)
    count = len(records)
    require_memory(owner, count * (levels.size + resolution + 1), advice=REQUEST_FEWER)

    def plane(x, y):
        """Return the scenes of records with the indices x, scaled to intensities y."""
        record_index = np.asarray(x).astype(np.int32)
        # NumPy is used here, because JAX would compile a program for every shape.
        return podium, records.pick_scaled(record_index, y / unscaled[record_index])

    import_in_background(*TABLE_MODULES)
    indices, y_range = np.arange(count), (0.0, float(levels[-1]))
    precompile_scan(plane, indices, y_range, options, width)
    peaks = peak_responses(*plane(indices[:, None], levels), options=options, progress=progress)
    # With `refine_curved=True` the search would look for ever narrower survival windows above the capacity.
    search = scan(
        plane, indices, y_range, resolution, options, progress, refine_curved=False, width=width, dips=False
    )
    boundaries, impacts = search.crossings.table(count)
    import xarray

    data = xarray.Dataset(
        data_variables(peaks, options.outputs, ("record", "intensity"))
        | _record_variables(boundaries, impacts, search.certain_width, measure),
        coords={
            "record": ("record", labels, {"long_name": "record"}),
            **record_coords(records, motions),
            "intensity": as_variable("intensity", levels, measure.units, measure.name),
            "boundary": boundary_axis(boundaries),
        },
        attrs={
            "title": "Incremental dynamic analysis",
            "kind": "incremental-dynamic-analysis",
            "measure": measure.name,
            "scenes": levels.size * count + search.scenes,
            **describe_podium(podium),
            **describe_options(options),
        },
    )
    if sensitivities:
        record_index, table = np.arange(count, dtype=np.int32), records.common_form()
        slopes = log_sensitivities(
            podium,
            boundaries[:, 0] / unscaled,
            {"which": record_index},
            tuple(sensitivities),
            options,
            records=table,
        )
        long_name = f"d ln a/d ln y of the least overturning {measure.name} a"
        data["sensitivity"] = as_variable(("parameter", "record"), slopes, "1", long_name)
        data = data.assign_coords(parameter=list(sensitivities))
    return data


def checked_measure(owner: str, measure: Measure | str, records: Records | RecordPairs) -> Measure:
    """Return the intensity measure of records. Raises `ValueError` for an unknown or invalid measure."""
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
            f"{owner}: measure must have one value for each of the {len(records)} records, got shape "
            f"{np.shape(measure.values)}"
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
    options: Options = DEFAULT_OPTIONS,
    width: float = DEFAULT_WIDTH,
    resolution: int = 128,
) -> Lognormal:
    """Return the differentiable median and dispersion of the least overturning scale factors of records.

    The function works under `jit`, `vmap` and `grad` with respect to the parameters of `podium`. A lognormal
    distribution is fitted to the least overturning factors of the records. If no factor up to `max_scale`
    overturns the podium, the record is censored: its least factor is only known to be above `max_scale`. If
    scenes below the least factor of a record did not finish, this factor is only known to be above the
    `finished_to` of [`rockjax.Boundary`][]. The result is NaN if fewer than two records overturn the podium,
    if the least factors (with `measure`, the least intensities) of these records are equal, or if no scene of
    a record finishes. Outside jit, [`rockjax.incremental_dynamic_analysis`][] finds the same least factors on
    all cores.

    - `podium`: podium with scalar parameters
    - `records`: `Motions`, `Records`, or a list of motions or records
    - `max_scale`: end of the search for each record, > 0 [–]
    - `measure`: intensities of the k unscaled records, > 0, shape (k,). The result is then the distribution
      of the least overturning intensities, in the unit of `measure`. By default all intensities are 1, and
      the median is a scale factor [–]
    - `options`, `width`, `resolution`: as for [`rockjax.overturning_boundary`][]

    Raises `ValueError` for invalid inputs.
    """
    owner = "overturning_distribution"
    check_types(owner, podium, options)
    check_limit(owner, "max_scale", max_scale)
    records, _ = as_records(owner, records)
    unscaled = jnp.ones(len(records)) if measure is None else as_float(measure, f"{owner}: measure")
    checked_measure(owner, Measure("values", unscaled, "1"), records)

    def find_boundary(record_index):
        motion = records.pick(record_index)
        return overturning_boundary(
            podium, motion, max_scale=max_scale, options=options, width=width, resolution=resolution
        )

    boundary = jax.vmap(find_boundary)(jnp.arange(len(records), dtype=jnp.int32))
    # Scenes that did not finish are ignored if they are closer to the boundary than the resolution `width`.
    is_known = boundary.scale <= boundary.finished_to + width * max_scale
    capacity = jnp.where(is_known, boundary.scale, jnp.inf)
    return fit_capacities(capacity * unscaled, jnp.minimum(boundary.finished_to, max_scale) * unscaled)
