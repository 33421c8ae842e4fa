"""Fragility curves: lognormal distributions fitted to records.

The data are capacities (least overturning intensities), or counts of overturned records at levels of
intensity. A record overturns at a level if the record, scaled to this level, overturns the podium.
"""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.special import ndtr

from rockjax._checks import as_axis, require_number, require_positive
from rockjax._lognormal import Lognormal, fit_capacities, fit_counts
from rockjax._parameters.registry import as_variable
from rockjax._programs.program import StoredProgram
from rockjax._results import explain_failures, outcomes

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
    """Fit a lognormal fragility curve to an incremental dynamic analysis, by maximum likelihood.

    - `analysis`: result of [`rockjax.incremental_dynamic_analysis`][]
    - `method`: `"capacities"` fits the capacities of the records, their least overturning intensities. If a
      record does not overturn, its capacity is only known to be above the highest level (censored). If the
      scene at a level below its capacity did not finish, the capacity is only known to be above the last
      level before this scene. A record whose scene at the lowest level did not finish is left out, with a
      `RuntimeWarning`.
      `"stripes"` fits the counts of overturned records at each level. A record that survives a level above
      its capacity counts as a survival there, and a scene that did not finish does not count. The default is
      `"capacities"`; with `limit` it is `"stripes"`, the only method that is then valid
    - `at`: intensities at which the curve is evaluated, shape (x,), > 0; by default 200 equally spaced
      values up to the highest level
    - `confidence`: confidence level of the intervals and the band, in (0, 1); None omits intervals and band
    - `limit`: a limit state in addition to overturning, as (name, value) with the name of a peak of the
      analysis, such as `("peak_friction", 0.3)` or `("least_axial_force", 0.0)`. A scene fails if the podium
      overturns, or if the peak exceeds the value; with a peak named `least_…`, if the peak is below the
      value. If the peak has several modes, stories or joints, the worst one counts. The `options` of the
      analysis must request the output that contains this peak

    Returns a Dataset:

    - `median_capacity`, `dispersion`: median of the curve, in the unit of the intensity, and its dispersion
      [–], the standard deviation of the logarithm
    - `interval` (dims `quantity`, `bound`): confidence intervals of median and dispersion, with the numbers
      of records as attributes
    - `probability`, `lower`, `upper` (dim `at`): the curve, and the ends of its confidence band
    - `observed` (dim `intensity`): share of records that overturn (with `limit`, fail), among the records
      whose scenes finished
    - `capacity` (dim `record`): capacities; NaN for records that do not overturn. With `limit`, the lowest
      levels at which the records fail; NaN for records that do not fail
    - `median_sensitivity`, `dispersion_sensitivity` (dim `parameter`): d ln(median)/d ln y and
      d(dispersion)/d ln y for the parameters y of the analysis; only if the analysis has sensitivities and
      `method` is `"capacities"`

    Intervals of `"capacities"` use the profile likelihood of lognormal capacities. Without censored records
    they are exact for median and dispersion. With censored records, the probability that an interval contains
    the true value differs from `confidence`, in tests by up to 0.07 (docs/fragility.md). Intervals of
    `"stripes"` come from the jackknife, which repeats the fit without each record in turn. A `RuntimeWarning`
    is issued for intervals from fewer than five records; with `"capacities"`, only records that overturn
    count.

    Raises `ValueError` for invalid arguments, and if the data do not determine a curve or its intervals.
    """
    _check(analysis, method, confidence)
    if limit is None:
        method = method or "capacities"
    elif method == "capacities":
        raise ValueError(
            'fragility: method must be "stripes" with a limit, because capacities refer to overturning'
        )
    else:
        method = "stripes"
        analysis = _with_limit(analysis, limit)
    data = _Outcomes.from_analysis(analysis)
    is_known = np.ones(data.capacity.size, bool)
    if method == "capacities":
        is_known = np.isfinite(data.capacity) | (data.censor_limit > 0)
        data = data._replace(capacity=data.capacity[is_known], censor_limit=data.censor_limit[is_known])
        _warn_of_unknown_capacities(analysis, is_known)
    fit = _fit(method, data, analysis)
    x = checked_intensities("fragility", at, data.levels)
    curve = _dataset(analysis, fit, x, method)
    if confidence is not None:
        _add_intervals(curve, method, data, fit, confidence)
    if "sensitivity" in analysis and method == "capacities":
        has_capacity = np.isfinite(data.capacity)
        # d(capacity)/d ln y, shape (parameters, records with a capacity)
        log_slopes = analysis["sensitivity"].values[:, is_known][:, has_capacity]
        capacity_slopes = log_slopes * data.capacity[has_capacity]
        fit_slopes = _slopes_of_fit(data.capacity, data.censor_limit)
        long_names = {
            "median_sensitivity": "d ln(median)/d ln y",
            "dispersion_sensitivity": "d(dispersion)/d ln y",
        }
        for (name, long_name), slope in zip(long_names.items(), fit_slopes, strict=True):
            values = capacity_slopes @ np.asarray(slope)[has_capacity]
            curve[name] = as_variable("parameter", values, "1", long_name)
        curve = curve.assign_coords(parameter=analysis["parameter"])
    return curve


def checked_intensities(owner: str, at, levels: np.ndarray) -> np.ndarray:
    """Return the intensities `at`, by default 200 equally spaced values up to the highest level.

    Raises `ValueError` unless `at` is a one-dimensional array of values > 0.
    """
    x = as_axis(owner, "at", np.linspace(0, levels[-1], 201)[1:] if at is None else at)
    require_positive(owner, at=x)
    return x


class _Outcomes(NamedTuple):
    """Capacities and outcomes of the records of an analysis.

    - `capacity`: least overturning intensity of each record, shape (n,); inf if it is above the highest level
      or above a level whose scene did not finish. With a limit state, the lowest level at which the record
      fails
    - `censor_limit`: lower bounds of the capacities that are inf, shape (n,): the highest level up to which
      all scenes of the record finished; 0 if the scene at the lowest level did not finish
    - `levels`: levels of intensity, shape (m,)
    - `overturned`: 1 where a record overturns or fails, 0 where it does neither, and NaN where the scene did
      not finish, shape (n, m)
    """

    capacity: np.ndarray
    censor_limit: np.ndarray
    levels: np.ndarray
    overturned: np.ndarray

    @classmethod
    def from_analysis(cls, analysis: xarray.Dataset) -> _Outcomes:
        capacity, levels = analysis["capacity"].values, analysis["intensity"].values
        capacity = np.where(np.isnan(capacity), np.inf, capacity)
        overturned = outcomes(analysis).values
        finished = np.logical_and.accumulate(np.isfinite(overturned), axis=1).sum(axis=1)
        first_unfinished = np.append(levels, np.inf)[finished]
        capacity = np.where(capacity > first_unfinished, np.inf, capacity)
        return cls(capacity, np.append(0.0, levels)[finished], levels, overturned)

    @property
    def events(self) -> np.ndarray:
        """Number of records that overturn or fail at each level, shape (m,)."""
        return np.nansum(self.overturned, axis=0)

    @property
    def trials(self) -> np.ndarray:
        """Number of records whose scenes finished at each level, shape (m,)."""
        return np.isfinite(self.overturned).sum(axis=0).astype(float)


def _with_limit(analysis: xarray.Dataset, limit: tuple[str, float]) -> xarray.Dataset:
    """Return the analysis with outcomes and capacities that include a limit state, `limit` of `fragility`.

    Raises `ValueError` if the analysis has no peak of this name, or if the value is not a finite number.
    """
    peaks = [
        str(name)
        for name, y in analysis.data_vars.items()
        if {"record", "intensity"} <= set(y.dims)
        and str(name).startswith(("peak_", "least_"))
        and not str(name).endswith(("_time", "_error"))  # properties of a peak
        and y.notnull().any()  # peaks that the structure does not have are NaN
    ]
    if not (isinstance(limit, tuple) and len(limit) == 2 and limit[0] in peaks):
        raise ValueError(
            f"fragility: limit must be (name, value) with one of the peaks of the analysis {peaks}, got "
            f"{limit!r}; for another peak, request its output in the options of the analysis"
        )
    name, value = limit
    value = require_number("fragility", f"limit {name}", value, np.isfinite, "a finite number")
    peak = analysis[name]
    beyond = peak < value if name.startswith("least_") else peak > value
    failed = beyond.any(set(beyond.dims) - {"record", "intensity"}) | analysis["overturned"]
    failed = failed.transpose(*analysis["overturned"].dims)
    levels = analysis["intensity"]
    changed = analysis.assign(
        overturned=failed.assign_attrs(long_name=f"the podium overturned, or {name} is beyond {value:g}"),
        capacity=levels.where(failed).min("intensity"),
    )
    comparison = "<" if name.startswith("least_") else ">"
    return changed.assign_attrs(limit_state=f"{name} {comparison} {value:g}")


def _check(analysis: xarray.Dataset, method: str | None, confidence: float | None) -> None:
    """Raise `ValueError` for invalid arguments of `fragility`."""
    owner = "fragility"
    if method not in (None, "capacities", "stripes"):
        raise ValueError(f"{owner}: method must be 'capacities' or 'stripes', got {method!r}")
    if getattr(analysis, "attrs", {}).get("kind") != "incremental-dynamic-analysis":
        raise ValueError(
            f"{owner}: analysis must come from rockjax.incremental_dynamic_analysis, got "
            f"{_describe_type(analysis)}"
        )
    check_confidence(owner, confidence)


def _warn_of_unknown_capacities(analysis: xarray.Dataset, is_known: np.ndarray) -> None:
    """Warn of the records that a fit of capacities leaves out. `is_known`: for each record, whether its
    capacity or a lower bound of its capacity is known."""
    if not is_known.all():
        names = ", ".join(map(str, analysis["record"].values[~is_known]))
        warnings.warn(
            f"fragility: record {names} is left out of the fit, because the scene at the lowest intensity "
            f"{analysis['intensity'].values[0]:g} did not finish. "
            f"{_failures(analysis, (~is_known, 0))}",
            RuntimeWarning,
            stacklevel=3,
        )


def check_confidence(owner: str, confidence: float | None) -> None:
    """Raise `ValueError` unless a confidence level is in (0, 1) or None."""
    if confidence is not None and not (isinstance(confidence, int | float) and 0 < confidence < 1):
        raise ValueError(
            f"{owner}: confidence must be in (0, 1), or None for no intervals, got {confidence!r}"
        )


def _failures(analysis: xarray.Dataset, index: Any = ...) -> str:
    """Return the result of `explain_failures` for some scenes, or "" if the analysis has no results."""
    return explain_failures(analysis["result"].values[index]) if "result" in analysis else ""


def _describe_type(value) -> str:
    kind = getattr(value, "attrs", {}).get("kind")
    return f"a dataset of kind {kind!r}" if kind else f"a {type(value).__name__}"


def _fit(method: str, data: _Outcomes, analysis: xarray.Dataset) -> Lognormal:
    """Return the fitted curve. Raises `ValueError` if the likelihood has no maximum.

    - `method`, `data`: method of the fit, and outcomes of the records; `analysis`: the analysis
    """
    if method == "capacities":
        fit = _fit_capacities(data.capacity, data.censor_limit)
    else:
        fit = _fit_counts(data.levels, data.events, data.trials)
    if not np.isfinite(fit.median):
        limit_state = analysis.attrs.get("limit_state")
        note = "" if limit_state is None else f" (records with {limit_state} count as overturned)"
        raise ValueError(f"fragility: {_explain_failure(method, data, _failures(analysis))}{note}")
    return fit


def _dataset(analysis: xarray.Dataset, fit: Lognormal, x: np.ndarray, method: str) -> xarray.Dataset:
    """Return the dataset of a fitted curve.

    - `analysis`: the analysis; `fit`: the curve; `method`: the method of the fit
    - `x`: intensities at which the curve is evaluated, shape (x,)
    """
    import xarray

    units, measure = analysis["intensity"].attrs["units"], analysis.attrs["measure"]
    event = analysis.attrs.get("limit_state", "overturning")

    observed = np.asarray(outcomes(analysis).mean("record"))
    probability = np.asarray(fit.probability(x))
    return xarray.Dataset(
        {
            "median_capacity": as_variable((), float(fit.median), units, f"median {measure} of {event}"),
            "dispersion": as_variable((), float(fit.dispersion), "1", "standard deviation of the logarithm"),
            "probability": as_variable("at", probability, "1", f"probability of {event}"),
            "observed": as_variable("intensity", observed, "1", f"share of records with {event}"),
            "capacity": analysis["capacity"],
        },
        coords={"at": as_variable("at", x, units, measure), "intensity": analysis["intensity"]},
        attrs=analysis.attrs | {"title": "Fragility", "kind": "fragility", "method_of_fit": method},
    )


def _add_intervals(
    curve: xarray.Dataset, method: str, data: _Outcomes, fit: Lognormal, confidence: float
) -> None:
    """Add intervals and band to the dataset of a curve, in place; warn of too few records.

    - `curve`, `fit`, `method`: dataset of the curve, the curve, and the method of the fit
    - `data`: outcomes of the records; `confidence`: in (0, 1)
    """
    records = data.capacity.size
    has_event = np.isfinite(data.capacity) if method == "capacities" else (data.overturned == 1).any(axis=1)
    overturning_records = int(has_event.sum())
    count = overturning_records if method == "capacities" else records
    if count < MIN_RECORDS:
        qualifier = " that overturn" if method == "capacities" else ""
        message = (
            f"fragility: the intervals rest on only {count} records{qualifier}; with fewer than "
            f"{MIN_RECORDS} they depend more on the assumed lognormal form than on the records; use more "
            "records, or confidence=None for the curve alone"
        )
        warnings.warn(message, RuntimeWarning, stacklevel=3)
    find_intervals = _intervals_of_capacities if method == "capacities" else _intervals_of_stripes
    bounds, probit = find_intervals(data, fit, curve["at"].values, confidence)
    interval_attrs = {
        "long_name": f"{confidence:.0%} confidence interval",
        "records": records,
        "overturning_records": overturning_records,
    }
    curve["interval"] = (("quantity", "bound"), bounds, interval_attrs)
    for name, band in zip(("lower", "upper"), ndtr(probit), strict=True):
        curve[name] = as_variable("at", band, "1", f"{name} bound of the {confidence:.0%} band")
    curve.coords["quantity"] = ["median_capacity", "dispersion"]
    curve.coords["bound"] = ["lower", "upper"]
    curve.attrs["confidence"] = confidence


def _intervals_of_capacities(
    data: _Outcomes, fit: Lognormal, x: np.ndarray, confidence: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return profile-likelihood bounds of median and dispersion, and of the probit Φ⁻¹(probability).

    - `data`, `fit`: outcomes of the records, and the fitted curve
    - `x`: intensities, shape (x,); `confidence`: in (0, 1)

    The axes of the results are (median or dispersion, lower or upper), and (lower or upper, x).
    """
    median, dispersion = float(fit.median), float(fit.dispersion)
    intervals = profile_intervals(
        Capacities.from_values(data.capacity, data.censor_limit), median, dispersion, x, confidence
    )
    return np.exp(np.stack([intervals.log_median, intervals.log_dispersion])), intervals.probit


def _intervals_of_stripes(
    data: _Outcomes, fit: Lognormal, x: np.ndarray, confidence: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return jackknife bounds from counts, with arguments and results as for `_intervals_of_capacities`.
    Raises `ValueError` if a fit that omits one record does not determine the dispersion."""
    # Each row omits one record.
    reduced_counts = data.events - np.nan_to_num(data.overturned)
    reduced_trials = data.trials - np.isfinite(data.overturned)
    reduced_fits = fit_each_counts(data.levels, reduced_counts, reduced_trials)
    undetermined = int(np.sum(~np.isfinite(reduced_fits.median)))
    if undetermined:
        raise ValueError(
            f"fragility: the intervals need {len(reduced_counts)} fits that each omit one record, but "
            f"{undetermined} of these fits do not determine the dispersion; use more "
            "records or closer levels, or confidence=None for the curve alone"
        )
    return stripe_bounds(fit, reduced_fits, x, confidence)


def stripe_bounds(
    fit: Lognormal, reduced_fits: Lognormal, x: np.ndarray, confidence: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return jackknife bounds of a curve fitted to counts, in the shapes of `_intervals_of_capacities`.

    - `fit`: curve of all n records; `reduced_fits`: curves of all records except one, arrays of shape (n,)
    - `x`: intensities, shape (x,), > 0; `confidence`: in (0, 1)
    """

    def estimates(fits: Lognormal) -> np.ndarray:
        median, dispersion = (np.asarray(y)[..., None] for y in fits)
        return np.concatenate([np.log(median), np.log(dispersion), np.log(x / median) / dispersion], axis=-1)

    bounds = jackknife_intervals(estimates(fit), estimates(reduced_fits), confidence)
    return np.exp(bounds[:, :2]).T, bounds[:, 2:]


_fit_capacities = StoredProgram(fit_capacities)
_fit_counts = StoredProgram(fit_counts)
fit_each_counts = StoredProgram(jax.vmap(fit_counts, (None, 0, 0)), name="counts resampled")


@StoredProgram
def _slopes_of_fit(capacity, censor_limit):
    """Return the derivatives of ln(median) and dispersion with respect to each capacity, shape (2, n).

    Censored records have the `capacity` inf and the derivatives 0. `censor_limit` contains the lower bounds
    of their capacities, shape (n,).
    """
    has_capacity = jnp.isfinite(capacity)

    def fit(values):
        fitted = fit_capacities(jnp.where(has_capacity, values, jnp.inf), censor_limit)
        return jnp.stack([jnp.log(fitted.median), fitted.dispersion])

    finite = jnp.where(has_capacity, capacity, censor_limit)
    return jnp.where(has_capacity[None], jax.jacrev(fit)(finite), 0.0)


def _explain_failure(method: str, data: _Outcomes, failures: str) -> str:
    """Return the reason why no curve can be fitted, and the cure.

    - `method`, `data`: method of the fit, and outcomes of the records
    - `failures`: result of `explain_failures` for all scenes; "" if all finished
    """
    capacities, total = data.capacity[np.isfinite(data.capacity)], data.overturned.shape[0]
    if method == "capacities":
        if capacities.size < 2 and failures:
            return (
                f"only {capacities.size} of {total} records overturn below the first intensity at which a "
                f"scene did not finish, but a fit needs two. {failures}"
            )
        if capacities.size < 2:
            return (
                f"only {capacities.size} of {total} records overturn up to the highest intensity "
                f"{data.levels[-1]:g}, but a fit needs two; raise the highest intensity"
            )
        return f"the capacities of the {capacities.size} records that overturn are equal; use other records"
    is_counted, cure = data.trials > 0, "use other levels or other records"
    share, levels = (data.events / np.maximum(data.trials, 1))[is_counted], data.levels[is_counted]
    if failures and (not share.any() or share.min() == 1):
        return f"{'all' if share.any() else 'no'} finished scenes overturn. {failures}"
    if not share.any():
        return f"no record overturns at the levels up to {data.levels[-1]:g}; raise the highest intensity"
    if share.min() == 1:
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
    log_levels = np.log(levels)
    trend = "falls" if share @ (log_levels - log_levels.mean()) < 0 else "hardly rises"
    return (
        f"the share of overturned records {trend} with the intensity, from {share[0]:.0%} at {levels[0]:g} "
        f"to {share[-1]:.0%} at {levels[-1]:g}, but a lognormal curve must rise; {cure}"
    )
