"""Mean annual frequency of overturning: the integral of a fragility along a hazard curve.

A hazard curve λ(x) is the mean annual rate at which the intensity x of the ground motion is exceeded. A
fragility F(x) is the probability of failure at the intensity x. The levels of an incremental dynamic analysis
are the intensities to which its records are scaled.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from rockjax._checks import as_float, concrete, require, require_positive
from rockjax._lognormal import Lognormal
from rockjax._parameters.registry import as_variable
from rockjax._programs.program import StoredProgram
from rockjax._results import outcomes
from rockjax._studies.curve import checked_intensities

from . import integral
from .hazard import Hazard

if TYPE_CHECKING:
    import xarray

MIN_EXTRAPOLATED = 0.05  # extrapolated share above which `repr` reports it


@dataclasses.dataclass(frozen=True)
class AnnualFrequency:
    """Mean annual frequency of reaching a limit state.

    - `frequency`: mean annual frequency λ_f = ∫ F(x) |dλ(x)|, with the fragility F and the hazard curve λ
      [1/year]
    - `extrapolated`: share of `frequency` that comes from intensities outside the points of the hazard curve
      [–]. For an incremental dynamic analysis, intensities above its highest level count as well
    - `sensitivities`: derivatives of ln λ_f by name. `"median"` is d ln λ_f/d ln m with the median m of the
      fragility, and `"dispersion"` is d ln λ_f/dβ with the dispersion β of the fragility. Further keys are
      the parameters y of the structure whose sensitivities the fragility contains; their values are
      d ln λ_f/d ln y. Empty for an incremental dynamic analysis
    """

    frequency: Float[Array, ""]
    extrapolated: Float[Array, ""]
    sensitivities: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    @property
    def return_period(self) -> Float[Array, ""]:
        """Return period 1/λ_f [years]; inf where the frequency is zero."""
        return jnp.where(self.frequency > 0, 1 / jnp.where(self.frequency > 0, self.frequency, 1.0), jnp.inf)

    def probability(self, years) -> Float[Array, "*n"]:
        """Return the probability 1 − exp(−λ_f t) of at least one occurrence in the time t = `years` ≥ 0 [–].

        Occurrences are assumed to be a Poisson process.
        """
        require("AnnualFrequency.probability", "years", years, lambda v: v >= 0, "finite and >= 0")
        return -jnp.expm1(-self.frequency * jnp.asarray(years, float))

    def __repr__(self):
        frequency = concrete(self.frequency)
        if frequency is None:
            return "AnnualFrequency(traced)"
        share = float(self.extrapolated)
        extrapolation = f"; {share:.0%} of it extrapolated" if share > MIN_EXTRAPOLATED else ""
        period = f"return period {float(self.return_period):.4g} years"
        in_50_years = f"{float(self.probability(50)):.3g} in 50 years"
        return f"AnnualFrequency: {float(frequency):.4g} a year, {period}, {in_50_years}{extrapolation}"


jax.tree_util.register_dataclass(AnnualFrequency, ["frequency", "extrapolated", "sensitivities"], [])


def annual_frequency(curve: Lognormal | xarray.Dataset, hazard: Hazard) -> AnnualFrequency:
    """Return the mean annual frequency of overturning, or of the limit state of a fragility.

    - `curve`: the fragility F, a [`rockjax.Lognormal`][] in the units of the hazard; or a dataset of
      [`rockjax.fragility`][], [`rockjax.read_fragility_model`][], [`rockjax.contents_fragility`][] or
      [`rockjax.incremental_dynamic_analysis`][]
    - `hazard`: a [`rockjax.Hazard`][] of the same intensity measure, in the same units

    Datasets are used as follows:

    - The limits in a dataset of `read_fragility_model` are applied.
    - A dataset of `contents_fragility` must be reduced to one curve: `data.sel(contents=…, damage_state=…)`.
    - For an incremental dynamic analysis, F at a level is the share of records that overturn the columns,
      among the records whose simulation finished. F is linear between the levels. It may decrease with the
      level.

    The integral is evaluated in closed form on every segment of the hazard curve. For a `Lognormal` the
    function works under `jit`, and is differentiable with respect to the median, the dispersion and the
    points of the hazard curve.

    Raises `ValueError` for another type of `curve` or `hazard`, for a dataset with another measure or other
    units than the hazard, and for a median or dispersion that is not a scalar, finite and > 0. Also raises
    `ValueError` for an incremental dynamic analysis with fewer than two levels, with a level at which no
    simulation finished, or with overturning at the lowest level.
    """
    owner = "annual_frequency"
    if not isinstance(hazard, Hazard):
        raise ValueError(f"{owner}: hazard must be a rockjax.Hazard, got {type(hazard).__name__}")
    if isinstance(curve, Lognormal):
        return _frequency_of_lognormal(owner, curve, hazard)
    attributes = getattr(curve, "attrs", {})
    kind: Any = attributes.get("kind")
    is_curve = kind == "fragility" or (kind == "contents-fragility" and not curve["median_capacity"].dims)
    if not is_curve and kind != "incremental-dynamic-analysis":
        raise ValueError(
            f"{owner}: curve must be a rockjax.Lognormal, or a dataset of rockjax.fragility, "
            "rockjax.read_fragility_model or rockjax.incremental_dynamic_analysis, or one curve of "
            "rockjax.contents_fragility (select it by contents and damage_state), got "
            f"{type(curve).__name__}"
        )
    intensity: xarray.DataArray = curve["median_capacity"] if is_curve else curve["intensity"]
    _check_measure(owner, attributes["measure"], intensity.attrs["units"], hazard)
    if is_curve:
        answer = _frequency_of_lognormal(
            owner,
            Lognormal(*(jnp.asarray(float(curve[y])) for y in ("median_capacity", "dispersion"))),
            hazard,
            read_limits(curve),
        )
        slopes = dict(answer.sensitivities)
        return dataclasses.replace(answer, sensitivities=slopes | _structure_sensitivities(curve, slopes))
    return _frequency_of_analysis(owner, curve, hazard)


def _check_measure(owner: str, measure: str, units: str, hazard: Hazard) -> None:
    """Raise `ValueError` unless a hazard has the measure and the units of a curve."""
    if measure != hazard.measure:
        raise ValueError(
            f"{owner}: curve and hazard must have the same intensity measure, got {measure} and "
            f"{hazard.measure}"
        )
    if units != hazard.units:
        raise ValueError(
            f"{owner}: curve and hazard must have the same units, got {units!r} and {hazard.units!r}; "
            "convert the hazard with hazard.in_si()"
        )


def read_limits(curve: xarray.Dataset) -> integral.Limits:
    """Return the limits in the dataset of a fragility curve, as OpenQuake's engine applies them: it first
    clips intensities to the range from `min_intensity` to `max_intensity`, and then sets F = 0 for clipped
    intensities up to `no_damage_limit`. So only the larger one of `min_intensity` and `no_damage_limit` has
    an effect."""
    no_damage, lowest, highest = (
        float(curve[name]) if name in curve else None
        for name in ("no_damage_limit", "min_intensity", "max_intensity")
    )
    has_larger_minimum = (lowest or 0.0) > (no_damage or 0.0)
    return integral.Limits(
        None if has_larger_minimum else no_damage, lowest if has_larger_minimum else None, highest
    )


def _limited_probability(
    curve: Lognormal, x: np.ndarray, limits: integral.Limits, first: float
) -> np.ndarray:
    """Return the values of a fragility curve at intensities x, shape (n,), with limits applied. As in
    `integral.integrate_lognormal`, the fragility is constant from `first`, the first intensity of the hazard
    curve, up to the limit `constant_below`, and 0 below both."""
    low, high = limits.constant_below or 0.0, limits.constant_above or np.inf
    probability = np.asarray(curve.probability(jnp.asarray(np.clip(x, low, high))))
    if limits.constant_below is not None:
        return np.where(x < np.minimum(first, low), 0.0, probability)
    return np.where(x <= (limits.zero_below or 0.0), 0.0, probability)


def _integrate_with_slopes(curve: Lognormal, hazard: Hazard, limits: integral.Limits):
    """Return λ_f, its extrapolated share, and the derivatives of ln λ_f with respect to ln m (`"median"`) and
    β (`"dispersion"`)."""

    def total(log_median, dispersion):
        contributions = integral.integrate_lognormal(
            *hazard.logarithms, jnp.exp(log_median), dispersion, limits
        )
        return contributions.total, contributions

    (frequency, contributions), slopes = jax.value_and_grad(total, (0, 1), has_aux=True)(
        jnp.log(curve.median), curve.dispersion
    )
    is_positive = frequency > 0
    divisor = jnp.where(is_positive, frequency, 1.0)
    extrapolated = jnp.where(is_positive, (contributions.below + contributions.above) / divisor, 0.0)
    return frequency, extrapolated, {"median": slopes[0] / divisor, "dispersion": slopes[1] / divisor}


_frequency_and_slopes = StoredProgram(_integrate_with_slopes)


def _frequency_of_lognormal(
    owner: str, curve: Lognormal, hazard: Hazard, limits: integral.Limits = integral.Limits()
) -> AnnualFrequency:
    """Return the frequency with its sensitivities. Raises `ValueError` unless median and dispersion are
    scalars > 0."""
    require_positive(owner, median=curve.median, dispersion=curve.dispersion)
    curve = Lognormal(*map(as_float, curve))
    if curve.median.ndim or curve.dispersion.ndim:
        raise ValueError(
            f"{owner}: median and dispersion must be scalars, got shapes {curve.median.shape} and "
            f"{curve.dispersion.shape}; use jax.vmap for several curves"
        )
    return AnnualFrequency(*_frequency_and_slopes(curve, hazard, limits))


def _structure_sensitivities(curve: xarray.Dataset, slopes: Mapping[str, Any]) -> dict[str, float]:
    """Return d ln λ_f/d ln y for the parameters y of the structure; empty if a dataset has no sensitivities.
    `slopes` are d ln λ_f/d ln m (`"median"`) and d ln λ_f/dβ (`"dispersion"`). If the dataset has
    `dispersion_sensitivity`, the effect of y on the dispersion is included."""
    if "median_sensitivity" not in curve:
        return {}
    changes = slopes["median"] * curve["median_sensitivity"].values
    if "dispersion_sensitivity" in curve:
        changes = changes + slopes["dispersion"] * curve["dispersion_sensitivity"].values
    return dict(zip(curve["parameter"].values.tolist(), map(float, changes), strict=True))


def _frequency_of_analysis(owner: str, analysis: xarray.Dataset, hazard: Hazard) -> AnnualFrequency:
    """Return the frequency from the shares of records that overturn the columns at the levels of an
    incremental dynamic analysis."""
    levels, overturned_share = analysis["intensity"].values, outcomes(analysis).mean("record").values
    if levels.size < 2:
        raise ValueError(f"{owner}: curve must have at least two levels of intensity, got {levels.size}")
    if np.isnan(overturned_share).any():
        level = levels[np.isnan(overturned_share)][0]
        raise ValueError(
            f"{owner}: no scene finished at the level {level:g}; raise max_steps of the analysis, or use "
            "other levels"
        )
    if overturned_share[0] > 0:
        raise ValueError(
            f"{owner}: {overturned_share[0]:.0%} of the records overturn at the lowest level, {levels[0]:g}, "
            "so the curve is unknown below it; add lower levels, or give the fitted curve of "
            "rockjax.fragility"
        )
    contributions = integral.integrate_piecewise_linear(
        *hazard.logarithms, jnp.asarray(levels), jnp.asarray(overturned_share)
    )
    total, outside = contributions.total, contributions.below + contributions.above
    return AnnualFrequency(total, jnp.where(total > 0, outside / jnp.where(total > 0, total, 1.0), 0.0))


def disaggregation(curve: Lognormal | xarray.Dataset, hazard: Hazard, at=None) -> xarray.Dataset:
    """Return the contribution of each intensity to the annual frequency.

    The contribution is the density F(x) |dλ/d ln x|/λ_f, with the frequency λ_f. Its integral over all ln x
    is 1.

    - `curve`: a [`rockjax.Lognormal`][], or a dataset of [`rockjax.fragility`][] or
      [`rockjax.read_fragility_model`][]
    - `hazard`: a [`rockjax.Hazard`][] of the same intensity measure, in the same units
    - `at`: intensities at which the contribution is computed, > 0, shape (k,), k ≥ 1, in the units of the
      hazard. The default is 400 values with a constant ratio, from min(m, x₁)/1000 to 10 max(m, x_n). Here m
      is the median of the fragility, and x₁ and x_n are the first and the last intensity of the hazard curve

    Returns a dataset over `intensity` with the rate of exceedance `hazard` [1/year], the probability
    `fragility` [–] and the contribution `density` [–]. `density` jumps at the points of the hazard curve. The
    variable `given` over `point` holds the rates at these points [1/year].

    Raises `ValueError` for another type of `curve`, for values in `at` that are not finite and > 0, and in
    the same cases as `annual_frequency`.
    """
    import xarray

    answer, limits = annual_frequency(curve, hazard), integral.Limits()
    if not isinstance(curve, Lognormal):
        if curve.attrs["kind"] != "fragility":
            raise ValueError(
                "disaggregation: curve must be a rockjax.Lognormal, or a dataset of rockjax.fragility or "
                "rockjax.read_fragility_model; rockjax.fragility fits one to an incremental dynamic analysis"
            )
        limits = read_limits(curve)
        curve = Lognormal(*(jnp.asarray(float(curve[y])) for y in ("median_capacity", "dispersion")))
    if at is None:
        low = 1e-3 * min(float(curve.median), float(hazard.intensity[0]))
        at = np.geomspace(low, 10 * max(float(curve.median), float(hazard.intensity[-1])), 400)
    x = checked_intensities("disaggregation", at, np.asarray(hazard.intensity))
    log_x, log_rate = hazard.logarithms
    segment = np.clip(np.searchsorted(np.asarray(log_x), np.log(x)) - 1, 0, log_x.size - 2)
    rate = np.asarray(hazard(jnp.asarray(x)))
    fragility = _limited_probability(curve, x, limits, float(hazard.intensity[0]))
    slope = np.asarray(integral.segment_slopes(log_x, log_rate))[segment]
    density = fragility * slope * rate / float(answer.frequency)

    given, points = np.asarray(hazard.annual_rate), np.asarray(hazard.intensity)
    return xarray.Dataset(
        {
            "density": as_variable("intensity", density, "1", "share of λ_f per unit of ln(intensity)"),
            "hazard": as_variable("intensity", rate, "year-1", "mean annual rate of exceedance"),
            "given": as_variable("point", given, "year-1", "rates at the points of the hazard curve"),
            "fragility": as_variable("intensity", fragility, "1", "probability of overturning"),
        },
        coords={
            "intensity": as_variable("intensity", x, hazard.units, hazard.measure),
            "point": as_variable("point", points, hazard.units, hazard.measure),
        },
        attrs={
            "title": "Risk",
            "kind": "risk",
            "measure": hazard.measure,
            "frequency_per_year": float(answer.frequency),
            "extrapolated": float(answer.extrapolated),
            "median": float(curve.median),
            "dispersion": float(curve.dispersion),
        },
    )
