"""Target on the mean annual frequency of overturning at a site."""

from __future__ import annotations

from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import rockjax as rj
from rockjax._motions.convert import as_motions
from rockjax._motions.intensity import measure_by_label
from rockjax.internal import (
    DEFAULT_WIDTH,
    AnyMotions,
    require_instance,
    single_motions,
)

from ._fresh import FreshSamples
from ._suite import Suite, Values
from ._targets import AbstractScaleTarget, Name, require_limit


class AnnualFrequency(AbstractScaleTarget):
    """The columns overturn at most `at_most` times a year, on average.

    The overturning intensity of a motion is the least intensity to which the motion must be scaled to
    overturn the columns.

    - `at_most`: largest permitted value of the mean annual frequency of overturning λ_f, > 0 [1/year]
    - `hazard`: the [`rockjax.Hazard`][] of the site in SI units, for the peak ground acceleration PGA, the
      peak ground velocity PGV or the spectral acceleration Sa at a period
    - `suite`: two or more motions, such as records, or `optimise.FreshSamples` of records; intensities are
      measured on the horizontal component
    - `max_intensity`: largest searched intensity [unit of `hazard`]; None for the last point of the hazard.
      If a motion does not overturn the columns up to this intensity, its overturning intensity is only
      known to be larger (censored)
    - `width`: in (0, 0.1) [–]; resolution of the search for overturning intensities in the verification. The
      search can miss a range of intensities at which a motion overturns the columns only if the range is
      narrower than `width` times `max_intensity`. With `FreshSamples`, the design is verified with an
      independent sample, the tolerances of the search for the design, and a `width` of at least 1e-3
    - `name`: name in reports; None for a description

    A lognormal distribution is fitted to the overturning intensities of all motions, as in
    [`rockjax.fragility`][]. [`rockjax.annual_frequency`][] gives λ_f for this distribution. The margin is
    ln(at_most/λ_f). If no distribution can be fitted, because the overturning intensities are equal or fewer
    than two motions overturn the columns, λ_f is replaced by the mean, over the motions, of the annual
    frequency with which the overturning intensity is exceeded. In this mean, `max_intensity` replaces larger
    intensities. If simulations did not finish, the margin is NaN.

    Raises `ValueError` for arguments out of range; for a hazard that is not in SI units, or whose intensity
    measure is not PGA, PGV or Sa; for a suite of one motion; and for a motion of intensity 0. Raises
    `ValueError` also if `max_intensity` is exceeded with an annual frequency of `at_most` or more, because
    λ_f would then be at least `at_most` even if no motion overturned the columns.
    """

    at_most: Any
    hazard: rj.Hazard
    max_scale: Any
    width: Any
    suite: Suite
    name: Name = eqx.field(static=True)
    accepts_fresh_samples: ClassVar[bool] = True

    def __init__(
        self,
        at_most,
        hazard: rj.Hazard,
        suite: AnyMotions | FreshSamples,
        *,
        max_intensity=None,
        width: float = DEFAULT_WIDTH,
        name: Name = None,
    ):
        owner = type(self).__name__
        self.at_most = require_limit(owner, "at_most", at_most)
        self.width = require_limit(owner, "width", width, below=0.1)
        require_instance(owner, "hazard", hazard, rj.Hazard, "a rockjax.Hazard")
        if hazard.units != hazard.in_si().units:
            raise ValueError(
                f"{owner}: the hazard must be in SI units, got {hazard.units!r}; convert it with "
                "hazard.in_si()"
            )
        highest = float(hazard.intensity[-1]) if max_intensity is None else max_intensity
        highest = require_limit(owner, "max_intensity", highest)
        exceedance_rate = float(hazard(jnp.asarray(highest)))
        if exceedance_rate >= self.at_most:
            raise ValueError(
                f"{owner}: max_intensity = {highest:g} {hazard.units} is exceeded {exceedance_rate:.3g} "
                f"times a year; this must be below at_most = {self.at_most:g}; give a higher max_intensity"
            )
        unscaled = suite.records(owner) if isinstance(suite, FreshSamples) else suite
        motions = as_motions(owner, unscaled, "suite")
        if len(motions) < 2:
            raise ValueError(f"{owner}: suite must hold two motions or more, got one")
        intensities = [measure_by_label(f"{owner}: hazard", motion, hazard.measure) for motion in motions]
        if min(intensities) == 0:
            raise ValueError(
                f"{owner}: motion {int(np.argmin(intensities)) + 1} of the suite has {hazard.measure} = 0; "
                "leave it out"
            )
        self.hazard, self.max_scale, self.name = hazard, highest, name
        # Motions are scaled to unit intensity, so that their scale factors are intensities.
        members = single_motions(owner, unscaled, "suite").members
        scaled = [motion.scaled(1 / x) for motion, x in zip(members, intensities, strict=True)]
        members_or_samples = suite.of_records(scaled) if isinstance(suite, FreshSamples) else scaled
        self.suite = Suite.of(members_or_samples, owner, "suite")

    def distribution(self, podium: rj.Podium, options: rj.Options = rj.Options()) -> rj.Lognormal:
        """Fit a lognormal distribution to the overturning intensities, in the unit of the hazard.

        The parameters of the distribution are NaN if simulations did not finish or no distribution can be
        fitted, for example because fewer than two motions overturn the columns.
        """
        return self._fit(self.least_scales(podium, options))

    def frequency(self, podium: rj.Podium, options: rj.Options = rj.Options()) -> Float[Array, ""]:
        """Return the mean annual frequency of overturning λ_f [1/year].

        If no distribution can be fitted, return the mean that the description of the class defines; NaN if
        simulations did not finish.
        """
        return self._frequency(self.least_scales(podium, options))

    def _frequency(self, scales: Float[Array, " k"]) -> Float[Array, ""]:
        fitted = self._fit(scales)
        is_fitted = ~jnp.isnan(fitted.median)
        curve = rj.Lognormal(*(jnp.where(is_fitted, y, 1.0) for y in fitted))
        mean_rate = jnp.mean(self.hazard(jnp.minimum(scales, self.max_scale)))
        return jnp.where(is_fitted, rj.annual_frequency(curve, self.hazard).frequency, mean_rate)

    def margins_of_scales(self, scales: Float[Array, " k"]) -> Values:
        return jnp.log(self.at_most / self._frequency(scales))[None]

    def describe(self) -> str:
        return f"overturning at most {self.at_most:g} times a year"
