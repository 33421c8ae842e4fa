"""Seismic hazard curves: the mean annual rate at which an intensity is exceeded."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Self

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from rockjax._checks import as_number, concrete, require
from rockjax._parameters.registry import as_variable
from rockjax._tree import Module
from rockjax._units import INTENSITY_UNITS, in_si

from .integral import log_rate_at

if TYPE_CHECKING:
    import xarray


class Hazard(Module):
    """A hazard curve λ(x): the mean annual rate at which the intensity x is exceeded [1/year].

    Between the points of the curve, ln λ is linear in ln x. Beyond them, the first and the last segment are
    extrapolated.

    - `intensity`: intensities x₁ < … < x_n of the points, shape (n,), n ≥ 2, > 0 [`units`]
    - `annual_rate`: rates λ₁ ≥ … ≥ λ_n > 0 of the points, shape (n,) [1/year]
    - `measure`: name of the intensity measure, as in [`rockjax.Measure`][]: `"PGA"`, `"PGV"`, `"Sa(1 s)"` …
    - `units`: units of the intensity: `"m s-2"`, `"m s-1"`, `"g"` …. A hazard and a fragility that are
      combined must have the same units; `in_si` converts the hazard

    Raises `ValueError` for other shapes, for values that are not finite and > 0, for intensities that do not
    ascend, and for rates that increase.
    """

    intensity: Float[Array, " n"] = eqx.field(converter=as_number("Hazard: intensity"))
    annual_rate: Float[Array, " n"] = eqx.field(converter=as_number("Hazard: annual_rate"))
    measure: str = eqx.field(static=True, default="PGA", kw_only=True)
    units: str = eqx.field(static=True, default="m s-2", kw_only=True)

    def __check_init__(self):
        shape = self.intensity.shape
        if len(shape) != 1 or shape[0] < 2 or self.annual_rate.shape != shape:
            raise ValueError(
                "Hazard: intensity and annual_rate must have equal length ≥ 2, "
                f"got shapes {shape} and {self.annual_rate.shape}"
            )
        require("Hazard", "intensity", self.intensity, lambda v: v > 0, "finite and > 0")
        require("Hazard", "annual_rate", self.annual_rate, lambda v: v > 0, "finite and > 0")
        x, rate = concrete(self.intensity), concrete(self.annual_rate)
        if x is not None and np.any(np.diff(x) <= 0):
            i = int(np.argmax(np.diff(x) <= 0))
            raise ValueError(f"Hazard: intensity must ascend, got {x[i]:g} before {x[i + 1]:g}")
        if rate is not None and np.any(np.diff(rate) > 0):
            i = int(np.argmax(np.diff(rate) > 0))
            raise ValueError(
                f"Hazard: annual_rate must not increase with the intensity, got "
                f"{rate[i]:g} before {rate[i + 1]:g} per year"
            )

    def __call__(self, x: Float[Array, "*m"]) -> Float[Array, "*m"]:
        """Return λ(x) [1/year] at intensities x > 0 [`units`]."""
        return jnp.exp(log_rate_at(*self.logarithms, jnp.log(jnp.asarray(x, float))))

    @property
    def logarithms(self) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
        """ln x and ln λ of the points, shape (n,) each."""
        return jnp.log(self.intensity), jnp.log(self.annual_rate)

    def intensity_at(self, annual_rate) -> Float[Array, "*m"]:
        """Return the intensities that are exceeded at the given annual rates, in the same shape [`units`].

        - `annual_rate`: rates, > 0, a number or an array of any shape [1/year]

        Raises `ValueError` for rates that are not finite and > 0, and for a curve with the same rate at two
        points, because such a curve has no inverse.
        """
        rate = np.asarray(annual_rate, float)
        require("Hazard.intensity_at", "annual_rate", rate, lambda v: v > 0, "finite and > 0")
        log_x, log_rate = (np.asarray(y) for y in self.logarithms)
        if np.any(np.diff(log_rate) == 0):
            raise ValueError(
                "Hazard.intensity_at: the curve has points with equal annual_rate, where it has no inverse; "
                "leave out all but one of them"
            )
        i = np.clip(np.searchsorted(-log_rate, -np.log(rate)) - 1, 0, log_x.size - 2)
        slope = np.diff(log_x)[i] / np.diff(log_rate)[i]
        return jnp.asarray(np.exp(log_x[i] + slope * (np.log(rate) - log_rate[i])))

    def in_si(self) -> Hazard:
        """Return the curve with intensities in SI units, which are the units of the fragilities of rockjax.

        Raises `ValueError` if `units` is not a known unit.
        """
        factor_and_units = in_si(self.units)
        if factor_and_units is None:
            raise ValueError(
                f"Hazard.in_si: units must be one of {', '.join(INTENSITY_UNITS)}, got {self.units!r}"
            )
        factor, units = factor_and_units
        return Hazard(self.intensity * factor, self.annual_rate, measure=self.measure, units=units)

    @classmethod
    def from_file(cls, path: str | Path, *, site: int | None = None) -> Self:
        """Read a hazard curve from a file, in SI units.

        - `path`: a hazard-curve CSV of OpenQuake (`lon,lat,depth,poe-0.1,…`); or a table of two columns. One
          column has the intensities, and its heading gives measure and unit (`PGA [g]`, `Sa(1 s), %g`). The
          other column states how often each intensity is exceeded. Its heading is `annual_rate`,
          `return period [years]`, or a probability of exceedance with its investigation time, such as
          `PoE in 50 years` or `annual probability of exceedance`. A probability p in t years becomes the rate
          −ln(1 − p)/t; points with p = 0 or 1 are left out
        - `site`: index of the curve in an OpenQuake file with several sites, from 0; None for a file with one
          curve

        Raises `ValueError` for headings that are not understood (the message quotes them), for probabilities
        without an investigation time, for other files, and for invalid curves.
        """
        from .files import read_hazard

        arguments = read_hazard(path, site)
        try:
            return cls(**arguments)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None

    def dataset(self) -> xarray.Dataset:
        """Return the points as a dataset."""
        import xarray

        rate, points = np.asarray(self.annual_rate), np.asarray(self.intensity)
        return xarray.Dataset(
            {"annual_rate": as_variable("intensity", rate, "year-1", "mean annual rate of exceedance")},
            coords={"intensity": as_variable("intensity", points, self.units, self.measure)},
            attrs={"title": "Hazard curve", "kind": "hazard", "measure": self.measure},
        )

    def __repr__(self):
        x, rate = concrete(self.intensity), concrete(self.annual_rate)
        if x is None or rate is None:
            return f"Hazard({self.measure} [{self.units}], {self.intensity.shape[0]} points)"
        return (
            f"Hazard: {self.measure} from {x[0]:.3g} to {x[-1]:.3g} {self.units}, "
            f"exceeded {rate[0]:.3g} to {rate[-1]:.3g} times a year, {x.size} points"
        )
