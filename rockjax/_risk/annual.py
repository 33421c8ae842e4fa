"""The mean annual frequency of overturning: a fragility over a hazard curve."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from rockjax._checks import as_float, concrete, require
from rockjax._lognormal import Lognormal
from rockjax._programs.program import KeptProgram

from . import integral
from .hazard import Hazard

if TYPE_CHECKING:
    import xarray

MIN_EXTRAPOLATED = 0.05  # least share of the frequency from beyond the given points that `repr` reports


@dataclasses.dataclass(frozen=True)
class AnnualFrequency:
    """Mean annual frequency of reaching a limit state.

    - `frequency`: mean annual frequency λ_f = ∫ F(x) |dλ(x)| [1/year]
    - `extrapolated`: the share of it that comes from intensities outside the points of the hazard curve or,
      for counted stripes, above the highest level [–]
    - `sensitivities`: d ln λ_f/d ln y for y = `median` and for every number of the structure whose effect on
      the curve the fragility contains; d ln λ_f/dβ for y = `dispersion`. Empty for counted stripes
    """

    frequency: Float[Array, ""]
    extrapolated: Float[Array, ""]
    sensitivities: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    @property
    def return_period(self) -> Float[Array, ""]:
        """1/λ_f [years]; inf where the frequency is zero."""
        return jnp.where(self.frequency > 0, 1 / jnp.where(self.frequency > 0, self.frequency, 1.0), jnp.inf)

    def probability(self, years) -> Float[Array, "*n"]:
        """Return P = 1 − exp(−λ_f t), the probability of at least one occurrence in t years of a Poisson
        process [–]."""
        require("AnnualFrequency.probability", "years", years, lambda v: v >= 0, "finite and >= 0")
        return -jnp.expm1(-self.frequency * jnp.asarray(years, float))

    def __repr__(self):
        frequency = concrete(self.frequency)
        if frequency is None:
            return "AnnualFrequency(traced)"
        share = float(self.extrapolated)
        outside = f"; {share:.0%} of it from beyond the given points" if share > MIN_EXTRAPOLATED else ""
        period = f"return period {float(self.return_period):.4g} years"
        in_50_years = f"{float(self.probability(50)):.3g} in 50 years"
        return f"AnnualFrequency: {float(frequency):.4g} a year, {period}, {in_50_years}{outside}"


jax.tree_util.register_dataclass(AnnualFrequency, ["frequency", "extrapolated", "sensitivities"], [])


def annual_frequency(curve: Lognormal | xarray.Dataset, hazard: Hazard) -> AnnualFrequency:
    """Return the mean annual frequency with which a structure overturns, or reaches the limit state of its
    fragility.

    - `curve`: a [`rockjax.Lognormal`][] in the units of the hazard; a dataset of [`rockjax.fragility`][], or
      of [`rockjax.read_fragility_model`][] with its limits; or one of
      [`rockjax.incremental_dynamic_analysis`][], whose counted shares of overturned records are used
      directly, linear between the levels, so that windows of survival count
    - `hazard`: a [`rockjax.Hazard`][] of the same intensity measure, in the same units

    No quadrature: the integral is a closed form on every segment of the hazard curve. For a `Lognormal` the
    function works under `jit` and `grad`, with respect to median, dispersion and the points of the hazard.

    Raises `ValueError` if measure or units differ from those of the hazard, if dispersion or median is not >
    0, and if counted shares do not begin with a level at which all records survive.
    """
    owner = "annual_frequency"
    if not isinstance(hazard, Hazard):
        raise ValueError(f"{owner}: hazard must be a rockjax.Hazard, got {type(hazard).__name__}")
    if isinstance(curve, Lognormal):
        return _frequency_of_lognormal(owner, curve, hazard)
    attributes = getattr(curve, "attrs", {})
    kind: Any = attributes.get("kind")
    if kind not in ("fragility", "incremental-dynamic-analysis"):
        raise ValueError(
            f"{owner}: curve must be a rockjax.Lognormal, or a dataset of rockjax.fragility or "
            f"rockjax.incremental_dynamic_analysis, got {type(curve).__name__}"
        )
    intensity: xarray.DataArray = curve["median_capacity"] if kind == "fragility" else curve["intensity"]
    _check_measure(owner, attributes["measure"], intensity.attrs["units"], hazard)
    if kind == "fragility":
        found = _frequency_of_lognormal(
            owner,
            Lognormal(*(jnp.asarray(float(curve[y])) for y in ("median_capacity", "dispersion"))),
            hazard,
            read_limits(curve),
        )
        return dataclasses.replace(
            found,
            sensitivities=dict(found.sensitivities) | _structure_sensitivities(curve, found.sensitivities),
        )
    return _frequency_of_stripes(owner, curve, hazard)


def _check_measure(owner: str, measure: str, units: str, hazard: Hazard) -> None:
    if measure != hazard.measure:
        raise ValueError(
            f"{owner}: the fragility is over "
            f"{measure}, the hazard over {hazard.measure}; they must be of one measure"
        )
    if units != hazard.units:
        raise ValueError(
            f"{owner}: the fragility is in "
            f"{units!r}, the hazard in {hazard.units!r}; convert it with hazard.in_si()"
        )


def read_limits(curve: xarray.Dataset) -> integral.Limits:
    """Return the limits of an OpenQuake fragility model, in the order in which its engine applies them:
    intensities are first clipped to the range from `min_intensity` to `max_intensity`, then P = 0 up to
    `no_damage_limit`."""
    zero, low, high = (
        float(curve[name]) if name in curve else None
        for name in ("no_damage_limit", "min_intensity", "max_intensity")
    )
    rises_at_once = (low or 0.0) > (zero or 0.0)
    return integral.Limits(None if rises_at_once else zero, low if rises_at_once else None, high)


def _limited_probability(
    curve: Lognormal, x: np.ndarray, limits: integral.Limits, first: float
) -> np.ndarray:
    """Return P at intensities within limits; if P stays > 0 at low intensities, it counts from `first` on."""
    low, high = limits.constant_below or 0.0, limits.constant_above or np.inf
    share = np.asarray(curve.probability(jnp.asarray(np.clip(x, low, high))))
    if limits.constant_below is not None:
        return np.where(x < np.minimum(first, low), 0.0, share)
    return np.where(x <= (limits.zero_below or 0.0), 0.0, share)


def _integrate_with_slopes(curve: Lognormal, hazard: Hazard, limits: integral.Limits):
    def total(log_median, dispersion):
        parts = integral.integrate_lognormal(*hazard.logarithms, jnp.exp(log_median), dispersion, limits)
        return parts.total, parts

    (frequency, parts), slopes = jax.value_and_grad(total, (0, 1), has_aux=True)(
        jnp.log(curve.median), curve.dispersion
    )
    is_positive = frequency > 0
    safe = jnp.where(is_positive, frequency, 1.0)
    share = jnp.where(is_positive, (parts.below + parts.above) / safe, 0.0)
    return frequency, share, {"median": slopes[0] / safe, "dispersion": slopes[1] / safe}


_frequency_and_slopes = KeptProgram(_integrate_with_slopes)


def _frequency_of_lognormal(
    owner: str, curve: Lognormal, hazard: Hazard, limits: integral.Limits = integral.Limits()
) -> AnnualFrequency:
    require(owner, "median", curve.median, lambda v: v > 0, "finite and > 0")
    require(owner, "dispersion", curve.dispersion, lambda v: v > 0, "finite and > 0")
    curve = Lognormal(*map(as_float, curve))
    return AnnualFrequency(*_frequency_and_slopes(curve, hazard, limits))


def _structure_sensitivities(curve: xarray.Dataset, slopes: Mapping[str, Any]) -> dict[str, float]:
    """Return d ln λ_f/d ln y for the numbers of the structure, through the median and, where available,
    through the dispersion."""
    if "median_sensitivity" not in curve:
        return {}
    changes = slopes["median"] * curve["median_sensitivity"].values
    if "dispersion_sensitivity" in curve:
        changes = changes + slopes["dispersion"] * curve["dispersion_sensitivity"].values
    return dict(zip(curve["parameter"].values.tolist(), map(float, changes), strict=True))


def _frequency_of_stripes(owner: str, analysis: xarray.Dataset, hazard: Hazard) -> AnnualFrequency:
    levels, share = analysis["intensity"].values, analysis["overturned"].values.mean(axis=0)
    if levels.size < 2:
        raise ValueError(f"{owner}: needs two levels of intensity or more, got {levels.size}")
    if share[0] > 0:
        raise ValueError(
            f"{owner}: {share[0]:.0%} of the records overturn at the lowest level, {levels[0]:g}; "
            "what happens below it is not known: add lower levels, or give the fitted curve of "
            "rockjax.fragility"
        )
    parts = integral.integrate_piecewise_linear(*hazard.logarithms, jnp.asarray(levels), jnp.asarray(share))
    total = parts.total
    outside = jnp.where(total > 0, (parts.below + parts.above) / jnp.where(total > 0, total, 1.0), 0.0)
    return AnnualFrequency(total, outside)


def disaggregation(curve: Lognormal | xarray.Dataset, hazard: Hazard, at=None) -> xarray.Dataset:
    """Contribution of each intensity to the annual frequency (host).

    It is the density F(x) |dλ/d ln x| divided by the frequency; its integral over ln x is 1.

    - `curve`, `hazard`: as for [`rockjax.annual_frequency`][]; a lognormal curve
    - `at`: intensities, > 0; by default 400 between a thousandth of the smaller and ten times the larger of
      median and points

    Returns a dataset over `intensity` with `density` [–], which jumps where the slope of the hazard curve
    does, `hazard` [1/year] and `fragility` [–]; and the `given` points of the hazard curve over `point`.
    """
    import xarray

    found, limits = annual_frequency(curve, hazard), integral.Limits()
    if not isinstance(curve, Lognormal):
        if curve.attrs["kind"] != "fragility":
            raise ValueError(
                "disaggregation: curve must be lognormal; fit the analysis with rockjax.fragility first"
            )
        limits = read_limits(curve)
        curve = Lognormal(*(jnp.asarray(float(curve[y])) for y in ("median_capacity", "dispersion")))
    if at is None:
        low = 1e-3 * min(float(curve.median), float(hazard.intensity[0]))
        x = np.geomspace(low, 10 * max(float(curve.median), float(hazard.intensity[-1])), 400)
    else:
        x = np.asarray(at, float)
        require("disaggregation", "at", x, lambda v: v > 0, "finite and > 0")
    log_x, log_rate = hazard.logarithms
    i = np.clip(np.searchsorted(np.asarray(log_x), np.log(x)) - 1, 0, log_x.size - 2)
    rate = np.asarray(hazard(jnp.asarray(x)))
    share = _limited_probability(curve, x, limits, float(hazard.intensity[0]))
    density = share * np.asarray(integral.segment_slopes(log_x, log_rate))[i] * rate / float(found.frequency)
    axis_attrs = {"units": hazard.units, "long_name": hazard.measure}
    return xarray.Dataset(
        {
            "density": (
                "intensity",
                density,
                {"units": "1", "long_name": "share of λ_f per unit of ln(intensity)"},
            ),
            "hazard": ("intensity", rate, {"units": "year-1", "long_name": "mean annual rate of exceedance"}),
            "given": (
                "point",
                np.asarray(hazard.annual_rate),
                {"units": "year-1", "long_name": "rates that are given"},
            ),
            "fragility": ("intensity", share, {"units": "1", "long_name": "probability of overturning"}),
        },
        coords={
            "intensity": ("intensity", x, axis_attrs),
            "point": ("point", np.asarray(hazard.intensity), axis_attrs),
        },
        attrs={
            "title": "Risk",
            "kind": "risk",
            "measure": hazard.measure,
            "frequency_per_year": float(found.frequency),
            "extrapolated": float(found.extrapolated),
            "median": float(curve.median),
            "dispersion": float(curve.dispersion),
        },
    )
