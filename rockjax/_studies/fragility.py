"""Ensembles of records: incremental dynamic analysis with every boundary, and fragility curves."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float

from rockjax._batch.batch import peak_responses
from rockjax._boundaries.boundary import PAST, check_search, overturning_boundary
from rockjax._boundaries.branches import LANES
from rockjax._boundaries.crossings import scan
from rockjax._boundaries.verdict import NARROWEST, boundary_residual, has_margin, margin_options
from rockjax._checks import require
from rockjax._engine.solve import solve
from rockjax._motions.record import Record
from rockjax._motions.records import Records
from rockjax._options import Options
from rockjax._responses.datasets import describe_options, describe_podium
from rockjax._responses.peak import peak_variables
from rockjax._results import REST
from rockjax._structures import Podium

from .lognormal import Lognormal, fit_capacities, fit_counts
from .sensitivities import along_boundary, check_parameters, varied

if TYPE_CHECKING:
    import xarray

# The samples set the steps: the cheapest steps serve, and a sharp tolerance is free.
ENSEMBLE = Options(rtol=1e-9, atol=1e-11, method="tsit5")


class Measure(NamedTuple):
    """An intensity measure of records as they are, unscaled; it grows in proportion to the scale.

    - `name`: such as "PGA" or "Sa(0.5 s)"; `units`: such as "m s-2"
    - `values`: of each record, shape (k,), > 0
    """

    name: str
    values: Float[ArrayLike, " k"]
    units: str


def pga(records: Records) -> Measure:
    """Peak ground acceleration of each record [m/s²]."""
    return Measure("PGA", np.asarray(jnp.max(records.sizes(), axis=1)), "m s-2")


def incremental_dynamic_analysis(
    podium: Podium,
    records: Records | Sequence[Record],
    intensity,
    *,
    measure: Measure | Literal["PGA", "scale"] = "PGA",
    names: Sequence[str] | None = None,
    sensitivities: Sequence[str] = (),
    width: float = NARROWEST,
    resolution: int = 128,
    options: Options = ENSEMBLE,
    progress: Any = False,
) -> xarray.Dataset:
    """Peak responses to a suite of records at rising intensity, and every intensity where its verdict changes (host).

    - `records`: a `Records`, or single records; `names`: of each, by default numbers
    - `intensity`: levels, shape (m,), > 0 and ascending, in units of `measure`: each record is scaled to all of them
    - `measure`: `"PGA"` [m/s²], `"scale"` for factors on the records, or a [`rockjax.Measure`][]
    - `sensitivities`: parameters y of which d ln(capacity)/d ln y is wanted, as in [`rockjax.overturning_spectrum`][]
    - `width`: every interval of overturning intensities below the capacity that is wider than this share of the highest
      level is found, in (0, 0.1]; a record is looked at in up to 1/`width` places from the first that lifts the columns
    - `resolution`: places up to the highest level at which further boundaries, above the capacity, are looked for
    - `options`: with `overturn_ratio` < 1 the limit state is a rotation of that ratio instead of overturning

    Returns a Dataset over `record` and `intensity` with the scalars of [`rockjax.Peak`][] as variables. Over `record` alone
    there are `capacity`, the least intensity that overturns (NaN where none up to the highest level does), `boundaries`
    (further dim `boundary`): survive → overturn → survive …, `certain_width`, the widest interval of intensities below the
    capacity that may overturn unseen, and `sensitivity` (further dim `parameter`). Boundaries are exact to about 1e-9. Above
    the capacity rocking through many impacts makes windows of survival within windows without end: there all that
    `resolution` shows are listed. Raises `ValueError` for inputs that make no sense.
    """
    import xarray

    owner = "incremental_dynamic_analysis"
    records = records if isinstance(records, Records) else Records.of(records)
    levels = np.asarray(intensity, float)
    if levels.ndim != 1 or levels.size == 0 or np.any(np.diff(levels) <= 0):
        raise ValueError(f"{owner}: intensity must be a 1-D array of ascending levels, got {intensity!r}")
    require(owner, "intensity", levels, lambda v: v > 0, "finite and > 0")
    if any(jnp.ndim(y) for y in jax.tree.leaves(podium)):
        raise ValueError(f"{owner}: podium must hold single numbers; call it once for each podium")
    check_search(owner, width, resolution)
    check_parameters(owner, podium, sensitivities)
    measure = _measure(owner, measure, records)
    unit = np.asarray(measure.values, float)
    count = len(records)
    labels = list(names) if names is not None else list(range(1, count + 1))
    if len(labels) != count or len(set(labels)) != count:
        raise ValueError(f"{owner}: names must be {count} different ones, got {names!r}")

    def plane(x, y):
        which = np.asarray(x).astype(np.int32)
        # In NumPy: every shape would be another program otherwise.
        return podium, dataclasses.replace(records, which=which, scale=y / unit[which])

    peaks = peak_responses(*plane(np.arange(count)[:, None], levels), options=options, progress=progress)
    # Above the first boundary of a long record there is no end of them: the closer one looks, the more.
    top = float(levels[-1])
    found = scan(plane, np.arange(count), (0.0, top), resolution, options, progress, look_closer="below", width=width)
    places, impacts = found.crossings.table(count)
    of = {"units": measure.units, "long_name": measure.name}
    data = xarray.Dataset(
        {name: (("record", "intensity"), y, attributes) for name, y, attributes in peak_variables(peaks, options.outputs)}
        | {
            "capacity": ("record", places[:, 0], of | {"long_name": f"least overturning {measure.name}"}),
            "boundaries": (("record", "boundary"), places, of | {"long_name": f"{measure.name} where the verdict changes"}),
            "certain_width": (
                "record",
                found.certain,
                of | {"long_name": f"no wider interval of {measure.name} below the capacity overturns"},
            ),
            "boundary_impacts": (("record", "boundary"), impacts, {"units": "1", "long_name": "impacts before overturning"}),
            "measure": ("record", unit, of | {"long_name": f"{measure.name} of the unscaled record"}),
        },
        coords={
            "record": ("record", labels, {"long_name": "record"}),
            "intensity": ("intensity", levels, of),
            "boundary": ("boundary", np.arange(1, places.shape[1] + 1), {"long_name": "boundaries from below"}),
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
        slopes = _sensitivities(podium, records, places[:, 0] / unit, tuple(sensitivities), options)
        data["sensitivity"] = (
            ("parameter", "record"),
            slopes,
            {"units": "1", "long_name": f"d ln a/d ln y of the least overturning {measure.name} a"},
        )
        data = data.assign_coords(parameter=list(sensitivities))
    return data


def _measure(owner: str, measure: Measure | str, records: Records) -> Measure:
    if isinstance(measure, str):
        known = {"PGA": lambda: pga(records), "scale": lambda: Measure("scale", np.ones(len(records)), "1")}
        if measure not in known:
            raise ValueError(f"{owner}: measure must be 'PGA', 'scale' or a rockjax.Measure, got {measure!r}")
        measure = known[measure]()
    if np.shape(measure.values) != (len(records),):
        raise ValueError(
            f"{owner}: measure must hold a value for each of {len(records)} records, got shape {np.shape(measure.values)}"
        )
    require(owner, f"measure {measure.name}", measure.values, lambda v: v > 0, "finite and > 0 for every record")
    return measure


def _sensitivities(podium: Podium, records: Records, scale, names: tuple[str, ...], options: Options) -> np.ndarray:
    """d ln a/d ln y at boundaries `scale` (k,) of each record: (names, k); NaN where `scale` is."""
    result = np.full((len(names), scale.size), np.nan)
    at = np.flatnonzero(np.isfinite(scale))
    for start in range(0, at.size, LANES):
        part = at[start : start + LANES]
        filled = np.concatenate([part, np.repeat(part[-1:], LANES - part.size)]).astype(np.int32)
        found = _along(podium, records, filled, scale[filled], options, names, has_margin(options))
        result[:, part] = np.asarray(found)[: part.size].T
    return result


@functools.partial(jax.jit, static_argnames=("names", "margin"))
def _along(podium: Podium, records: Records, which, scale, options: Options, names: tuple[str, ...], margin: bool):
    def one(which, scale):
        def past(logs):
            factor = jnp.exp(logs)
            motion = records.pick(which).scaled(scale * (1 + PAST) * factor[0])
            structure = varied(podium, names, factor[1:])
            (floats, _), _ = solve(structure, motion, REST, None, margin_options(options, margin))
            return boundary_residual(floats, margin)

        return along_boundary(past, len(names), scale.dtype)

    return jax.vmap(one)(which, scale)


def overturning_distribution(
    podium: Podium,
    records: Records,
    *,
    max_scale: float = 10.0,
    measure: Float[ArrayLike, " k"] | None = None,
    options: Options = ENSEMBLE,
    width: float = NARROWEST,
    resolution: int = 128,
) -> Lognormal:
    """Median and dispersion of the least overturning scale of a suite; differentiable.

    Works under `jit`, `vmap` and `grad` with respect to every number of `podium`. Records that no scale up to `max_scale`
    overturns count as beyond it, with derivative zero. NaN where fewer than two records overturn. On the host
    [`rockjax.incremental_dynamic_analysis`][] finds the same capacities on all cores.

    - `measure`: intensity of the unscaled records; the result is in its units, else in scales
    """
    unit = jnp.ones(len(records)) if measure is None else jnp.asarray(measure, float)

    def least(which):
        motion = records.pick(which)
        return overturning_boundary(podium, motion, max_scale=max_scale, options=options, width=width).scale

    scale = jax.vmap(least)(jnp.arange(len(records), dtype=jnp.int32))
    return fit_capacities(scale * unit, max_scale * unit)


def fragility(
    analysis: xarray.Dataset,
    *,
    method: Literal["capacities", "stripes"] = "capacities",
    at=None,
    confidence: float = 0.9,
    resamples: int = 1000,
    seed: int = 0,
) -> xarray.Dataset:
    """A lognormal fragility curve from an incremental dynamic analysis, by maximum likelihood (host).

    - `method`: `"capacities"` fits the least overturning intensities, records that never overturn being censored at the
      highest level; `"stripes"` fits the counts of overturned records at the levels, survivals above the first overturning
      included
    - `at`: intensities of the curve, by default 200 up to the highest level
    - `confidence`, `resamples`, `seed`: bands by bootstrap over the records, percentiles of the resampled fits

    Returns a Dataset with the scalars `median_capacity` and `dispersion`; `interval` of both (dims `quantity`, `bound`);
    `probability`, `lower`, `upper` over `at`; `observed` over `intensity`, the share of overturned records; `resampled`
    (dims `quantity`, `resample`), NaN where a resample had no fit; and where the analysis has sensitivities,
    `median_sensitivity` and `dispersion_sensitivity` over `parameter` = d ln(median)/d ln y and d(dispersion)/d ln y.
    Raises `ValueError` where no curve fits, and says why.
    """
    import xarray

    owner = "fragility"
    if method not in ("capacities", "stripes"):
        raise ValueError(f"{owner}: method must be 'capacities' or 'stripes', got {method!r}")
    if analysis.attrs.get("kind") != "incremental-dynamic-analysis":
        raise ValueError(f"{owner}: analysis must come from rockjax.incremental_dynamic_analysis")
    if not 0 < confidence < 1:
        raise ValueError(f"{owner}: confidence must be in (0, 1), got {confidence!r}")
    if not isinstance(resamples, int) or resamples < 1:
        raise ValueError(f"{owner}: resamples must be a whole number ≥ 1, got {resamples!r}")
    capacity, levels = analysis["capacity"].values, analysis["intensity"].values
    overturned = analysis["overturned"].values
    count = capacity.size
    capacity = np.where(np.isnan(capacity), np.inf, capacity)
    limit = np.full(count, levels[-1])
    weights = np.random.default_rng(seed).multinomial(count, np.full(count, 1 / count), size=resamples).astype(float)
    if method == "capacities":
        fit = _fit_capacities(capacity, limit, np.ones(count))
        again = _resampled_capacities(capacity, limit, weights)
    else:
        trials = np.full(levels.size, float(count))
        fit = _fit_counts(levels, overturned.sum(axis=0).astype(float), trials)
        again = _resampled_counts(levels, weights @ overturned, trials)
    if not np.isfinite(fit.median):
        raise ValueError(f"{owner}: {_why_not(method, capacity, overturned, levels)}")
    x = np.linspace(0, levels[-1], 201)[1:] if at is None else np.asarray(at, float)
    require(owner, "at", x, lambda v: v > 0, "finite and > 0")
    curve = np.asarray(fit.probability(jnp.asarray(x)))
    each = np.asarray(Lognormal(*(y[:, None] for y in again)).probability(jnp.asarray(x)[None]))
    tails = 100 * np.array([(1 - confidence) / 2, (1 + confidence) / 2])
    band = np.nanpercentile(each, tails, axis=0)
    resampled = np.stack([np.asarray(y) for y in again])
    of = {"units": analysis["intensity"].attrs["units"]}
    one = {"units": "1"}
    name = analysis.attrs["measure"]
    data = xarray.Dataset(
        {
            "median_capacity": ((), float(fit.median), of | {"long_name": f"median overturning {name}"}),
            "dispersion": ((), float(fit.dispersion), one | {"long_name": "standard deviation of its logarithm"}),
            "interval": (
                ("quantity", "bound"),
                np.nanpercentile(resampled, tails, axis=1).T,
                {"long_name": f"{confidence:.0%} confidence interval"},
            ),
            "probability": ("at", curve, one | {"long_name": "probability of overturning"}),
            "lower": ("at", band[0], one | {"long_name": f"lower bound of the {confidence:.0%} band"}),
            "upper": ("at", band[1], one | {"long_name": f"upper bound of the {confidence:.0%} band"}),
            "observed": ("intensity", overturned.mean(axis=0), one | {"long_name": "share of overturned records"}),
            "capacity": analysis["capacity"],
            "resampled": (("quantity", "resample"), resampled, {"long_name": "fits of resampled records"}),
        },
        coords={
            "at": ("at", x, of | {"long_name": name}),
            "intensity": analysis["intensity"],
            "quantity": ["median_capacity", "dispersion"],
            "bound": ["lower", "upper"],
        },
        attrs=analysis.attrs
        | {"title": "Fragility", "kind": "fragility", "method_of_fit": method, "confidence": confidence, "seed": seed},
    )
    if "sensitivity" in analysis and method == "capacities":
        known = np.isfinite(capacity)
        moved = analysis["sensitivity"].values[:, known] * capacity[known]  # d(capacity)/d ln y
        of_median, of_dispersion = (np.asarray(slope)[known] for slope in _slopes(capacity, limit))
        data["median_sensitivity"] = ("parameter", moved @ of_median, one | {"long_name": "d ln(median)/d ln y"})
        data["dispersion_sensitivity"] = ("parameter", moved @ of_dispersion, one | {"long_name": "d(dispersion)/d ln y"})
        data = data.assign_coords(parameter=analysis["parameter"])
    return data


_fit_capacities = jax.jit(fit_capacities)
_resampled_capacities = jax.jit(jax.vmap(fit_capacities, (None, None, 0)))
_fit_counts = jax.jit(fit_counts)
_resampled_counts = jax.jit(jax.vmap(fit_counts, (None, 0, None)))


@jax.jit
def _slopes(capacity, limit):
    """d ln(median)/d capacity and d dispersion/d capacity, zero for what is censored."""
    known = jnp.isfinite(capacity)

    def fit(values):
        found = fit_capacities(jnp.where(known, values, jnp.inf), limit)
        return jnp.stack([jnp.log(found.median), found.dispersion])

    return jnp.where(known[None], jax.jacrev(fit)(jnp.where(known, capacity, limit)), 0.0)


def _why_not(method: str, capacity: np.ndarray, overturned: np.ndarray, levels: np.ndarray) -> str:
    known = capacity[np.isfinite(capacity)]
    if method == "capacities":
        if known.size < 2:
            return f"{known.size} of {capacity.size} records overturn up to {levels[-1]:g}; raise the highest intensity"
        return f"the capacities of the {known.size} records that overturn do not differ; use other records"
    if not overturned.any():
        return f"no record overturns at the levels up to {levels[-1]:g}; raise the highest intensity"
    return (
        "the levels are too far apart: a dispersion needs overturned and surviving records at two levels or more; add some"
    )
