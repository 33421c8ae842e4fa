"""Fragility curves: lognormal distributions fitted to an ensemble, with confidence intervals."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.special import ndtr

from rockjax._checks import require
from rockjax._lognormal import Lognormal, fit_capacities, fit_counts
from rockjax._programs.program import StoredProgram

from .intervals import Capacities, jackknife_intervals, profile_intervals

if TYPE_CHECKING:
    import xarray

MIN_RECORDS = 5  # with fewer records, intervals depend mostly on the assumed form of the distribution


def fragility(
    analysis: xarray.Dataset,
    *,
    method: Literal["capacities", "stripes"] | None = None,
    at=None,
    confidence: float | None = 0.9,
    limit: tuple[str, float] | None = None,
) -> xarray.Dataset:
    """Fit a lognormal fragility curve to an incremental dynamic analysis, by maximum likelihood (host).

    - `analysis`: from [`rockjax.incremental_dynamic_analysis`][]
    - `method`: `"capacities"` fits the least overturning intensities, where records that never overturn are
      censored at the highest level; `"stripes"` fits the counts of overturned records at the levels,
      including survivals above the first overturning. By default `"capacities"`, and `"stripes"` with a
      `limit`, which has no other
    - `at`: intensities of the curve, by default 200 up to the highest level
    - `confidence`: confidence level of the intervals and the band, in (0, 1); None for the curve alone
    - `limit`: (name, value) of a peak of the analysis, such as `("peak_friction", 0.3)` or
      `("least_axial_force", 0.0)`, as the limit state instead of overturning: a scene fails where the peak
      exceeds the value, where a least value is below it, or where it overturns. Of modes, stories, floors or
      joints the worst counts. The analysis needs this output in its `options`

    Returns a Dataset with the scalars `median_capacity` and `dispersion` and, unless `confidence` is None,
    the `interval` of both (dims `quantity`, `bound`; its attributes have the number of records). Over `at`
    there are `probability` and the band from `lower` to `upper`, over `intensity` the share `observed` of
    overturned records. If the analysis has sensitivities and `method` is `"capacities"`,
    `median_sensitivity` and `dispersion_sensitivity` over `parameter` are d ln(median)/d ln y and
    d(dispersion)/d ln y.

    Intervals of `"capacities"` use the profile likelihood of lognormal capacities. Without censored records
    they are exact for median and dispersion; with censored records their coverage is the stated confidence
    within some per cent. Intervals of `"stripes"` come from the jackknife, which omits each record once. A
    `RuntimeWarning` is issued if the intervals rest on fewer than five records: records that overturn for
    `"capacities"`, all records for `"stripes"`.

    Raises `ValueError`, with the reason, if no curve or no interval can be fitted.
    """
    _check(analysis, method, confidence)
    if limit is None:
        method = method or "capacities"
    elif method == "capacities":
        raise ValueError('fragility: with limit use method="stripes": capacities are those of overturning')
    else:
        method = "stripes"
        analysis = _with_limit(analysis, limit)
    data = _Ensemble.of(analysis)
    fit = _fit(method, data)
    x = np.linspace(0, data.levels[-1], 201)[1:] if at is None else np.asarray(at, float)
    if x.ndim != 1 or x.size == 0:
        raise ValueError(f"fragility: at must be a 1-D array of intensities, got shape {x.shape}")
    require("fragility", "at", x, lambda v: v > 0, "finite and > 0")
    curve = _dataset(analysis, fit, x, method)
    if confidence is not None:
        _add_intervals(curve, method, data, fit, confidence)
    if "sensitivity" in analysis and method == "capacities":
        has_capacity, one = np.isfinite(data.capacity), {"units": "1"}
        capacity_changes = (
            analysis["sensitivity"].values[:, has_capacity] * data.capacity[has_capacity]
        )  # d(capacity)/d ln y
        median_slopes, dispersion_slopes = (
            np.asarray(slope)[has_capacity] for slope in _slopes(data.capacity, data.limit)
        )
        curve["median_sensitivity"] = (
            "parameter",
            capacity_changes @ median_slopes,
            one | {"long_name": "d ln(median)/d ln y"},
        )
        curve["dispersion_sensitivity"] = (
            "parameter",
            capacity_changes @ dispersion_slopes,
            one | {"long_name": "d(dispersion)/d ln y"},
        )
        curve = curve.assign_coords(parameter=analysis["parameter"])
    return curve


class _Ensemble(NamedTuple):
    """Capacities and outcomes of the records of an analysis.

    - `capacity`: least overturning intensity of each record (n,), inf if above the highest level
    - `limit`: highest intensity searched for each record (n,)
    - `levels`: levels of intensity (m,); `overturned`: 1 where a record overturns, else 0, (n, m)
    """

    capacity: np.ndarray
    limit: np.ndarray
    levels: np.ndarray
    overturned: np.ndarray

    @classmethod
    def of(cls, analysis: xarray.Dataset) -> _Ensemble:
        capacity, levels = analysis["capacity"].values, analysis["intensity"].values
        capacity = np.where(np.isnan(capacity), np.inf, capacity)
        return cls(
            capacity, np.full(capacity.size, levels[-1]), levels, analysis["overturned"].values.astype(float)
        )

    @property
    def trials(self) -> np.ndarray:
        return np.full(self.levels.size, float(self.capacity.size))


def _with_limit(analysis: xarray.Dataset, limit: tuple[str, float]) -> xarray.Dataset:
    """Return the analysis with the scenes beyond a limit as those that fail."""
    names = [name for name, y in analysis.data_vars.items() if {"record", "intensity"} <= set(y.dims)]
    peaks = [str(name) for name in names if str(name).startswith(("peak_", "least_"))]
    if not (isinstance(limit, tuple) and len(limit) == 2 and limit[0] in peaks):
        raise ValueError(
            f"fragility: limit must be (name, value) with one of the peaks of the analysis {peaks}, got "
            f"{limit!r}; for others name their output in the options of the analysis"
        )
    name, value = limit
    require("fragility", f"limit {name}", value, lambda y: np.ones_like(y, bool), "finite")
    peak = analysis[name]
    beyond = peak < value if name.startswith("least_") else peak > value
    failed = beyond.any(set(beyond.dims) - {"record", "intensity"}) | analysis["overturned"]
    failed = failed.transpose(*analysis["overturned"].dims)
    levels = analysis["intensity"]
    changed = analysis.assign(
        overturned=failed.assign_attrs(long_name=f"whether {name} is beyond {value:g}"),
        capacity=levels.where(failed).min("intensity"),
    )
    sign = "<" if name.startswith("least_") else ">"
    return changed.assign_attrs(limit_state=f"{name} {sign} {value:g}")


def _check(analysis: xarray.Dataset, method: str | None, confidence: float | None) -> None:
    owner = "fragility"
    if method not in (None, "capacities", "stripes"):
        raise ValueError(f"{owner}: method must be 'capacities' or 'stripes', got {method!r}")
    if getattr(analysis, "attrs", {}).get("kind") != "incremental-dynamic-analysis":
        raise ValueError(
            f"{owner}: analysis must come from rockjax.incremental_dynamic_analysis, got "
            f"{_describe_type(analysis)}"
        )
    if confidence is not None and not (isinstance(confidence, int | float) and 0 < confidence < 1):
        raise ValueError(
            f"{owner}: confidence must be in (0, 1), or None for no intervals, got {confidence!r}"
        )


def _describe_type(value) -> str:
    kind = getattr(value, "attrs", {}).get("kind")
    return f"a dataset of kind {kind!r}" if kind else f"a {type(value).__name__}"


def _fit(method: str, data: _Ensemble) -> Lognormal:
    if method == "capacities":
        fit = _fit_capacities(data.capacity, data.limit)
    else:
        fit = _fit_counts(data.levels, data.overturned.sum(axis=0), data.trials)
    if not np.isfinite(fit.median):
        raise ValueError(f"fragility: {_explain_failure(method, data)}")
    return fit


def _dataset(analysis: xarray.Dataset, fit: Lognormal, x: np.ndarray, method: str) -> xarray.Dataset:
    import xarray

    unit_attrs, one, name = (
        {"units": analysis["intensity"].attrs["units"]},
        {"units": "1"},
        analysis.attrs["measure"],
    )
    observed = analysis["overturned"].values.mean(axis=0)
    event = analysis.attrs.get("limit_state", "overturning")
    return xarray.Dataset(
        {
            "median_capacity": (
                (),
                float(fit.median),
                unit_attrs | {"long_name": f"median {name} of {event}"},
            ),
            "dispersion": (
                (),
                float(fit.dispersion),
                one | {"long_name": "standard deviation of the logarithm"},
            ),
            "probability": (
                "at",
                np.asarray(fit.probability(x)),
                one | {"long_name": f"probability of {event}"},
            ),
            "observed": ("intensity", observed, one | {"long_name": f"share of records: {event}"}),
            "capacity": analysis["capacity"],
        },
        coords={"at": ("at", x, unit_attrs | {"long_name": name}), "intensity": analysis["intensity"]},
        attrs=analysis.attrs | {"title": "Fragility", "kind": "fragility", "method_of_fit": method},
    )


def _add_intervals(
    curve: xarray.Dataset, method: str, data: _Ensemble, fit: Lognormal, confidence: float
) -> None:
    records, overturn = data.capacity.size, int(np.isfinite(data.capacity).sum())
    count = overturn if method == "capacities" else records
    if count < MIN_RECORDS:
        qualifier = " that overturn" if method == "capacities" else ""
        message = (
            f"fragility: the intervals rest on only {count} records{qualifier}; with fewer than "
            f"{MIN_RECORDS} they depend on the form of the distribution more than on the records; use more "
            "records, or confidence=None for the curve alone"
        )
        warnings.warn(message, RuntimeWarning, stacklevel=3)
    find_intervals = _intervals_of_capacities if method == "capacities" else _intervals_of_stripes
    bounds, probit = find_intervals(data, fit, curve["at"].values, confidence)
    interval_attrs = {
        "long_name": f"{confidence:.0%} confidence interval",
        "records": records,
        "overturning_records": overturn,
    }
    curve["interval"] = (("quantity", "bound"), bounds, interval_attrs)
    for name, band in zip(("lower", "upper"), ndtr(probit), strict=True):
        curve[name] = ("at", band, {"units": "1", "long_name": f"{name} bound of the {confidence:.0%} band"})
    curve.coords["quantity"] = ["median_capacity", "dispersion"]
    curve.coords["bound"] = ["lower", "upper"]
    curve.attrs["confidence"] = confidence


def _intervals_of_capacities(
    data: _Ensemble, fit: Lognormal, x: np.ndarray, confidence: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return bounds of median and dispersion (2, 2) and of the probit of the curve (2, x), by likelihood."""
    median, dispersion = float(fit.median), float(fit.dispersion)
    intervals = profile_intervals(
        Capacities.of(data.capacity, data.levels[-1]), median, dispersion, x, confidence
    )
    return np.exp(np.stack([intervals.log_median, intervals.log_dispersion])), intervals.probit


def _intervals_of_stripes(
    data: _Ensemble, fit: Lognormal, x: np.ndarray, confidence: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return bounds of median and dispersion (2, 2), and of the probit of the curve (2, x), from counts."""
    reduced_counts = data.overturned.sum(axis=0) - data.overturned  # each row omits one record
    reduced_fits = _fit_each_counts(data.levels, reduced_counts, data.trials - 1)
    undetermined = int(np.sum(~np.isfinite(reduced_fits.median)))
    if undetermined:
        raise ValueError(
            f"fragility: the intervals need a fit without each record, but for {undetermined} of the "
            f"{len(reduced_counts)} records the other counts do not determine the dispersion; use more "
            "records or closer levels, or confidence=None for the curve alone"
        )

    def estimates(fits: Lognormal) -> np.ndarray:
        median, dispersion = (np.asarray(y)[..., None] for y in fits)
        return np.concatenate([np.log(median), np.log(dispersion), np.log(x / median) / dispersion], axis=-1)

    bounds = jackknife_intervals(estimates(fit), estimates(reduced_fits), confidence)
    return np.exp(bounds[:, :2]).T, bounds[:, 2:]


_fit_capacities = StoredProgram(fit_capacities)
_fit_counts = StoredProgram(fit_counts)
_fit_each_counts = StoredProgram(jax.vmap(fit_counts, (None, 0, None)), name="counts resampled")


@StoredProgram
def _slopes(capacity, limit):
    """Return d ln(median)/d capacity and d dispersion/d capacity, zero for censored capacities."""
    has_capacity = jnp.isfinite(capacity)

    def fit(values):
        fitted = fit_capacities(jnp.where(has_capacity, values, jnp.inf), limit)
        return jnp.stack([jnp.log(fitted.median), fitted.dispersion])

    return jnp.where(has_capacity[None], jax.jacrev(fit)(jnp.where(has_capacity, capacity, limit)), 0.0)


def _explain_failure(method: str, data: _Ensemble) -> str:
    """Return why no curve can be fitted, and the cure."""
    capacities, total = data.capacity[np.isfinite(data.capacity)], data.capacity.size
    if method == "capacities":
        if capacities.size < 2:
            return (
                f"{capacities.size} of {total} records overturn up to "
                f"{data.levels[-1]:g}; raise the highest intensity"
            )
        return f"the capacities of the {capacities.size} records that overturn are equal; use other records"
    share, levels, cure = data.overturned.mean(axis=0), data.levels, "take other levels or other records"
    if not share.any():
        return f"no record overturns at the levels up to {levels[-1]:g}; raise the highest intensity"
    if share.all() and share.min() == 1:
        return f"all records overturn at all levels from {levels[0]:g} on; lower the lowest intensity"
    if np.flatnonzero(share)[0] >= np.flatnonzero(share < 1)[-1]:
        return (
            "the levels are too far apart: to determine the dispersion, some but not all records must "
            "overturn at two or more levels; add levels"
        )
    if np.ptp(share) < 1e-9:
        return (
            f"the same share of the records, {share[0]:.0%}, overturns at all levels from {levels[0]:g} to "
            f"{levels[-1]:g}, which does not determine the median; {cure}"
        )
    log = np.log(levels)
    trend = "falls" if share @ (log - log.mean()) < 0 else "hardly rises"
    return (
        f"the share of overturned records {trend} with the intensity, from {share[0]:.0%} at {levels[0]:g} "
        f"to {share[-1]:.0%} at {levels[-1]:g}, but a lognormal curve must rise; {cure}"
    )
