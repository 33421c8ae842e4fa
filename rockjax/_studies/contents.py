"""Fragility of blocks on the floors of a podium: a lognormal curve for each block and damage state.

A scene is one podium under one ground motion.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

import jax
import numpy as np
from scipy.special import ndtr

from rockjax import _results as results
from rockjax._batch.batch import peak_responses
from rockjax._checks import as_axis, format_value, require, require_positive
from rockjax._lognormal import Lognormal
from rockjax._machine.memory import require_memory
from rockjax._machine.threads import TABLE_MODULES, import_in_background
from rockjax._motions.convert import AnyMotions, as_records
from rockjax._motions.provenance import record_coords
from rockjax._options import Options
from rockjax._parameters.registry import as_variable
from rockjax._responses.arguments import check_single, check_types
from rockjax._responses.datasets import describe_options, describe_podium
from rockjax._responses.peak import data_variables
from rockjax._structures import Contents, Podium

from .curve import MIN_RECORDS, check_confidence, checked_intensities, fit_each_counts, stripe_bounds
from .fragility import DEFAULT_OPTIONS, Measure, checked_measure, record_labels

if TYPE_CHECKING:
    import xarray

QUANTITIES, BOUNDS = ["median_capacity", "dispersion"], ["lower", "upper"]


def contents_fragility(
    podium: Podium,
    contents: Mapping[str, Contents] | Sequence[Contents] | Contents,
    records: AnyMotions,
    intensity,
    *,
    damage_states: Sequence[float] = (0.0, 0.5, 1.0),
    overturned: Literal["drop", "exceed"] = "drop",
    measure: Measure | Literal["PGA", "scale"] = "PGA",
    names: Sequence[str] | None = None,
    at=None,
    confidence: float | None = 0.9,
    options: Options = DEFAULT_OPTIONS,
    progress: Any = False,
) -> xarray.Dataset:
    """Fit fragility curves of blocks on the floors of a podium, one for each block and damage state.

    Every record is scaled to all levels of `intensity`. Each curve is fitted by maximum likelihood to the
    numbers of records that reach the damage state at the levels (multiple stripes).

    - `podium`: podium with scalar parameters
    - `contents`: dict of name → [`rockjax.Contents`][]; or one `Contents` or a sequence of them, which get
      the names `contents-1`, `contents-2`, …
    - `records`, `intensity`, `measure`, `names`, `progress`: as for
      [`rockjax.incremental_dynamic_analysis`][]
    - `damage_states`: thresholds of max|φ|/α_c, the peak rotation of a block divided by its slenderness,
      ascending, from 0 to the least `overturn_ratio` of the blocks [–]. A block reaches state 0 if it rocks
      at all. A block that overturns reaches every state
    - `overturned`: `"drop"` leaves out scenes in which the podium overturns, so that the curves hold for a
      standing podium; `"exceed"` counts such scenes as reaching every damage state
    - `at`: intensities at which the curves are evaluated, shape (x,), > 0; by default 200 equally spaced
      values up to the highest level
    - `confidence`: confidence level of the intervals and bands, in (0, 1); None omits intervals and bands
    - `options`: options of the scenes

    Returns a Dataset:

    - `median_capacity`, `dispersion` (dims `contents`, `damage_state`): median of each curve, in the unit of
      the intensity, and its dispersion [–], the standard deviation of the logarithm
    - `interval` (dims `contents`, `damage_state`, `quantity`, `bound`): confidence intervals of median and
      dispersion, from the jackknife over records, which repeats the fit without each record in turn
    - `probability`, `lower`, `upper` (dims `contents`, `damage_state`, `at`): the curves, and the ends of
      their confidence bands
    - `counted` (dims `contents`, `intensity`): number of records that count at a level. A record does not
      count where its scene did not finish or is left out
    - `observed` (dims `contents`, `damage_state`, `intensity`): share of the counted records that reach the
      damage state
    - answers of the podium, such as `overturned` (dims `record`, `intensity`), and of the blocks, such as
      `contents_peak_rotation` (dims `record`, `intensity`, `contents`)

    Curves and intervals that the counts do not determine are NaN, and a `RuntimeWarning` names them. Another
    warning is issued for intervals from fewer than five records. A single curve, such as
    `data.sel(contents="cabinet", damage_state=1.0)`, can be passed to [`rockjax.annual_frequency`][].

    Raises `ValueError` for invalid inputs.
    """
    owner = "contents_fragility"
    check_types(owner, podium, options)
    check_single(owner, podium)
    blocks = _blocks_by_name(owner, contents)
    states = _checked_states(owner, damage_states, blocks)
    if overturned not in ("drop", "exceed"):
        raise ValueError(f"{owner}: overturned must be 'drop' or 'exceed', got {overturned!r}")
    check_confidence(owner, confidence)
    motions = records
    records, own_names = as_records(owner, motions)
    labels = record_labels(owner, records, own_names if names is None else names)
    levels = as_axis(owner, "intensity", intensity, ascending=True)
    require_positive(owner, intensity=levels)
    measure = checked_measure(owner, measure, records)
    x = checked_intensities(owner, at, levels)
    require_memory(owner, len(records) * levels.size)
    import_in_background(*TABLE_MODULES)
    record_index = np.arange(len(records), dtype=np.int32)[:, None]
    scaled = records.pick_scaled(record_index, levels / np.asarray(measure.values, float)[record_index])
    block_tuple = tuple(blocks.values())
    peaks = peak_responses(podium, scaled, options=options, progress=progress, on_floors=block_tuple)
    import xarray

    dims, axis = ("record", "intensity"), (measure.units, measure.name)
    overturn_ratios = [float(block.overturn_ratio) for block in block_tuple]
    data = xarray.Dataset(
        data_variables(peaks, options.outputs, dims),
        coords={
            "record": ("record", labels, {"long_name": "record"}),
            **record_coords(records, motions),
            "intensity": as_variable("intensity", levels, *axis),
            "contents": ("contents", list(blocks), {"long_name": "block"}),
            "block": ("contents", list(map(repr, block_tuple)), {"long_name": "parameters of the block"}),
            "contents_overturn_ratio": as_variable(
                "contents", overturn_ratios, "1", "max|φ|/α_c at which the block counts as overturned"
            ),
            "damage_state": as_variable(
                "damage_state", states, "1", "threshold of max|φ|/α_c; state 0: the block rocks"
            ),
            "at": as_variable("at", x, *axis),
        },
        attrs={
            "title": "Fragility of contents",
            "kind": "contents-fragility",
            "measure": measure.name,
            "overturned_scenes": overturned,
            **describe_podium(podium),
            **describe_options(options),
        },
    )
    _add_curves(data, overturned == "exceed", confidence)
    return data


def _blocks_by_name(owner: str, contents: Any) -> dict[str, Contents]:
    """Return the blocks by name. Raises `ValueError` if `contents` is not valid for `contents_fragility`."""
    if isinstance(contents, Contents):
        contents = (contents,)
    if isinstance(contents, Mapping):
        blocks = dict(contents)
    else:
        is_sequence = isinstance(contents, Sequence)
        blocks = {f"contents-{k}": y for k, y in enumerate(contents, 1)} if is_sequence else {}
    are_named = all(isinstance(name, str) for name in blocks)
    if not blocks or not are_named or not all(isinstance(block, Contents) for block in blocks.values()):
        raise ValueError(
            f"{owner}: contents must be one or more rockjax.Contents, or a dict of them by name, got "
            f"{format_value(contents)}"
        )
    if any(np.ndim(y) for y in jax.tree.leaves(list(blocks.values()))):
        raise ValueError(f"{owner}: contents must have scalar parameters; pass one block for each value")
    return blocks


def _checked_states(owner: str, damage_states: Any, blocks: Mapping[str, Contents]) -> np.ndarray:
    """Return the thresholds of damage states as an array; raise `ValueError` unless they ascend and lie
    between 0 and the least `overturn_ratio` of the blocks."""
    states = as_axis(owner, "damage_states", damage_states, ascending=True)
    highest = min(float(block.overturn_ratio) for block in blocks.values())
    in_range = f"from 0 to the overturn_ratio {highest:g} of the contents"
    require(owner, "damage_states", states, lambda v: (v >= 0) & (v <= highest), in_range)
    return states


def _add_curves(data: xarray.Dataset, exceed: bool, confidence: float | None) -> None:
    """Add counts, curves, intervals and bands to the dataset of the peaks, in place. Warn of curves and
    intervals that the counts do not determine.

    - `data`: dataset with the peaks of the podium and the blocks
    - `exceed`: whether scenes in which the podium overturns count as reaching every damage state
    - `confidence`: confidence level; None omits intervals and bands
    """
    levels, x = data["intensity"].values, data["at"].values
    units, name = data["intensity"].attrs["units"], data.attrs["measure"]
    rotation, states = data["contents_peak_rotation"], data["damage_state"]
    reached = (rotation >= states) | data["contents_overturned"]
    reached = reached.where(states > 0, data["contents_uplifted"]).astype(bool)
    podium_stands = ~data["overturned"]
    counted = ~results.did_not_finish(data["contents_result"]) & podium_stands
    if exceed:
        reached, counted = reached | ~podium_stands, counted | ~podium_stands
    reached_dims = ("contents", "damage_state", "record", "intensity")
    counted = counted.transpose("contents", "record", "intensity")
    reached = (reached & counted).transpose(*reached_dims)
    count = counted.sum("record")
    data["counted"] = count.assign_attrs(units="1", long_name="number of counted records")
    share = (reached.sum("record") / count).assign_attrs(
        units="1", long_name="share of the counted records that reach the damage state"
    )
    data["observed"] = share
    shape = rotation.sizes["contents"], states.size
    medians, dispersions = np.full(shape, np.nan), np.full(shape, np.nan)
    intervals, bands = np.full((*shape, 2, 2), np.nan), np.full((*shape, 2, x.size), np.nan)
    curves = np.full((*shape, x.size), np.nan)
    for index in np.ndindex(shape):
        reached_here, counted_here = reached.values[index], counted.values[index[0]]
        fit, reduced_fits = _fit_with_jackknife(
            levels, reached_here.astype(float), counted_here.astype(float)
        )
        medians[index], dispersions[index] = fit
        curves[index] = fit.probability(x)
        if confidence is not None:
            bounds, probit = stripe_bounds(fit, reduced_fits, x, confidence)
            intervals[index], bands[index] = bounds, ndtr(probit)
    dims = ("contents", "damage_state")
    data["median_capacity"] = as_variable(dims, medians, units, f"median {name}")
    data["dispersion"] = as_variable(dims, dispersions, "1", "standard deviation of the logarithm")
    data["probability"] = as_variable((*dims, "at"), curves, "1", "probability of the damage state")
    _warn_of_undetermined(data, confidence, np.isnan(medians), np.isnan(intervals[..., 0, 0]))
    if confidence is None:
        return
    data["interval"] = (
        (*dims, "quantity", "bound"),
        intervals,
        {"long_name": f"{confidence:.0%} confidence interval", "records": data.sizes["record"]},
    )
    data.coords["quantity"], data.coords["bound"] = QUANTITIES, BOUNDS
    for k, bound in enumerate(BOUNDS):
        long_name = f"{bound} bound of the {confidence:.0%} band"
        data[bound] = as_variable((*dims, "at"), bands[..., k, :], "1", long_name)
    data.attrs["confidence"] = confidence


def _fit_with_jackknife(
    levels: np.ndarray, reached: np.ndarray, counted: np.ndarray
) -> tuple[Lognormal, Lognormal]:
    """Return the curve fitted to all records, and the curves fitted to all records except one.

    - `levels`: intensities, shape (m,)
    - `reached`: 1 where a record reaches the damage state, else 0, shape (n, m)
    - `counted`: 1 where a record counts at a level, else 0, shape (n, m)
    """
    # The first sum includes all records; each further sum omits one record.
    leave_one_out = lambda y: y.sum(axis=0) - np.concatenate([np.zeros((1, levels.size)), y])
    fits = jax.tree.map(np.asarray, fit_each_counts(levels, leave_one_out(reached), leave_one_out(counted)))
    return Lognormal(*(y[0] for y in fits)), Lognormal(*(y[1:] for y in fits))


def _warn_of_undetermined(
    data: xarray.Dataset, confidence: float | None, no_curve: np.ndarray, no_interval: np.ndarray
):
    """Warn of curves and intervals that the counts do not determine, and of too few records.

    - `data`: dataset of the curves; `confidence`: confidence level, or None without intervals
    - `no_curve`, `no_interval`: arrays of shape (contents, damage states), True where the curve or its
      interval is missing
    """
    cure = "use more records, or levels at which some but not all records reach the damage state"
    incomplete = no_interval & ~no_curve if confidence is not None else np.zeros_like(no_curve)
    for item, flags in (("curve", no_curve), ("interval", incomplete)):
        if np.any(flags):
            cases = ", ".join(
                f"{data['contents'].values[i]} at {data['damage_state'].values[j]:g}"
                for i, j in np.argwhere(flags)
            )
            message = f"contents_fragility: the counts do not determine the {item} of {cases}; {cure}"
            warnings.warn(message, RuntimeWarning, stacklevel=4)
    count = data.sizes["record"]
    if confidence is not None and count < MIN_RECORDS:
        message = (
            f"contents_fragility: the intervals rest on only {count} records; with fewer than {MIN_RECORDS} "
            "they depend more on the assumed lognormal form than on the records"
        )
        warnings.warn(message, RuntimeWarning, stacklevel=4)
