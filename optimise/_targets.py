"""Targets of a design: base classes, and targets on overturning.

A target holds where its margins are ≥ 0. A margin is dimensionless and differentiable. For most targets, a
margin is the relative distance to the limit, at least near 0. A scene is one structure under one motion. The
overturning margin of a scene is positive if the columns survive, negative if they overturn. The overturning
scale of a motion is the least factor with which the motion overturns the columns.
"""

from __future__ import annotations

import abc
from typing import Any, ClassVar, Self, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.scipy.stats import norm
from jaxtyping import Array, Float

import rockjax as rj
from rockjax._boundaries.margin import ROUNDING_ALLOWANCE
from rockjax._checks import require_positive
from rockjax.internal import DEFAULT_WIDTH, Module, as_float, fit_capacities, require_number

from ._suite import Suite, Values

Name = str | None
SearchedTarget = TypeVar("SearchedTarget", bound="AbstractTarget")

# Least `width` (resolution of a search for overturning) while a design is searched. The verification uses the
# `width` of the target.
WIDTH_WHILE_SEARCHING = 1e-3


class AbstractTarget(Module):
    """Base class of targets. `name` is the name in reports; if it is None, reports use `describe()`."""

    name: eqx.AbstractVar[Name]

    @abc.abstractmethod
    def margins(self, podium: rj.Podium, options: rj.Options) -> Values:
        """Return the margins (k,) of a podium [–], which are ≥ 0 where the target holds.

        - `podium`: the structure; `options`: options of the simulations

        Unless a class says otherwise, the method can be traced and differentiated by JAX.
        """

    @abc.abstractmethod
    def describe(self) -> str:
        """Return a description of the target, which is also its default name."""

    def while_searching(self) -> Self:
        """Return a target that is cheaper to evaluate during a search, with the same pytree structure; by
        default this target itself."""
        return self

    @property
    def scenes(self) -> int:
        """Number of scenes of one evaluation; the search for one overturning amplitude counts as one."""
        return 0


class AbstractResponses(Module):
    """Base class of targets and objectives that are computed from peak responses to a suite of motions.
    Targets and objectives with equal suites share their simulations."""

    suite: eqx.AbstractVar[Suite]
    outputs: ClassVar[Any]  # required outputs, a tuple as in `rockjax.Options`
    # Whether `outputs` are peaks that cover only the time until overturning, and therefore underestimate the
    # response if the columns overturn.
    until_overturning: ClassVar[bool] = False

    @abc.abstractmethod
    def read(self, peaks: rj.Peak, options: rj.Options) -> Values:
        """Return the margins (k,) of a target, or the values (k,) of an objective.

        - `peaks`: responses to all motions of the suite, with `outputs`
        - `options`: options of the simulations
        """


class AbstractResponseTarget(AbstractTarget, AbstractResponses):
    """A target on peak responses to a suite."""

    def margins(self, podium: rj.Podium, options: rj.Options) -> Values:
        return self.read(self.suite.responses(podium, options, self.outputs), options)

    @property
    def scenes(self) -> int:
        return len(self.suite)


def severity(peaks: rj.Peak, options: rj.Options) -> Values:
    """Return max|θ|/α [–] for each motion or, if the columns overturn, overturn_ratio − M. M < 0 is the
    overturning margin, so this value increases with the speed of the fall."""
    return jnp.where(peaks.overturned, options.overturn_ratio - peaks.margin, peaks.peak_rotation)


def require_limit(owner: str, name: str, value, below: float = np.inf) -> float:
    """Return `value` as a float. Raises `ValueError`, which names `owner` and `name`, unless it is one
    number, not traced, > 0 and < `below`."""
    if isinstance(value, Tracer):
        raise ValueError(
            f"{owner}: {name} must be a number, not a traced value; create the {owner} outside jit and grad"
        )
    accepted = "> 0" if below == np.inf else f"in (0, {below:g})"
    return require_number(owner, name, value, lambda v: 0 < v < below, f"finite and {accepted}")


class NoOverturning(AbstractResponseTarget):
    """No motion overturns the columns. The margin is the overturning margin M.

    - `excitations`: a motion or a list of motions; `name`: name in reports, None for a description
    """

    suite: Suite
    name: Name = eqx.field(static=True)
    outputs: ClassVar[tuple[str, ...]] = ("margin",)

    def __init__(self, excitations, name: Name = None):
        self.suite, self.name = Suite.of(excitations, type(self).__name__), name

    def read(self, peaks: rj.Peak, options: rj.Options) -> Values:
        return peaks.margin

    def describe(self) -> str:
        return "no overturning"


class OverturningAcceleration(AbstractTarget):
    """Pulses need at least the amplitude `at_least` to overturn the columns: a_ov ≥ at_least.

    a_ov is the least amplitude of a pulse that overturns the columns.

    - `at_least`: > 0 [m/s²], or in units of g tan α [–] if `ratio` is True
    - `pulse`: class of the pulse, such as `rockjax.Ricker`; `T_p`: one or several periods, > 0 [s]
    - `ratio`: whether `at_least` is in units of g tan α
    - `max_acceleration_ratio`: largest searched amplitude, in units of g tan α, > 0 [–]; this amplitude must
      exceed `at_least`. If no searched amplitude overturns the columns, the largest searched amplitude is
      used as a_ov, and the derivatives of the margin are zero. If simulations below a_ov do not finish, the
      margin is NaN
    - `width`: in (0, 0.1) [–]; resolution of the search for a_ov in the verification. The search can miss a
      range of amplitudes that overturn the columns only if the range is narrower than `width` times the
      largest searched amplitude
    - `name`: name in reports; None for a description

    The margin is a_ov/at_least − 1 for every period. Raises `ValueError` for arguments out of range; if
    `ratio` is False, a `max_acceleration_ratio` that is too small is not detected.
    """

    at_least: Any
    T_p: Float[Array, " n"]
    pulse: type[rj.AbstractPulse] = eqx.field(static=True)
    width: Any
    ratio: bool = eqx.field(static=True)
    max_acceleration_ratio: float = eqx.field(static=True)
    name: Name = eqx.field(static=True)

    def __init__(
        self,
        at_least,
        pulse: type[rj.AbstractPulse],
        T_p,
        *,
        ratio: bool = False,
        max_acceleration_ratio: float = 12.0,
        width: float = DEFAULT_WIDTH,
        name: Name = None,
    ):
        owner = type(self).__name__
        self.width = require_limit(owner, "width", width, below=0.1)
        self.at_least = require_limit(owner, "at_least", at_least)
        self.T_p = jnp.atleast_1d(as_float(T_p, f"{owner}: T_p")).ravel()
        require_positive(owner, T_p=self.T_p)
        if not self.T_p.size:
            raise ValueError(f"{owner}: T_p must hold at least one period, got none")
        if not (isinstance(pulse, type) and issubclass(pulse, rj.AbstractPulse)):
            raise ValueError(
                f"OverturningAcceleration: pulse must be a class such as rockjax.Ricker, got {pulse!r}"
            )
        self.max_acceleration_ratio = require_limit(owner, "max_acceleration_ratio", max_acceleration_ratio)
        if ratio and not self.at_least < self.max_acceleration_ratio:
            raise ValueError(
                f"OverturningAcceleration: at_least = {at_least} must be below max_acceleration_ratio = "
                f"{max_acceleration_ratio}; raise max_acceleration_ratio"
            )
        self.pulse, self.ratio, self.name = pulse, ratio, name

    def margins(self, podium: rj.Podium, options: rj.Options) -> Values:
        g_tan_alpha = podium.g * jnp.tan(podium.alpha)

        largest = jax.lax.stop_gradient(self.max_acceleration_ratio * g_tan_alpha)
        amplitudes = jax.vmap(
            lambda T_p: _least_scale(podium, self.pulse(1.0, T_p), largest, self.width, options)
        )(self.T_p)
        amplitudes = jnp.where(amplitudes == jnp.inf, largest, amplitudes)
        # If no amplitude overturns, the derivatives of the margin must be zero with both units of `at_least`.
        limit = self.at_least * (
            jnp.where(amplitudes < largest, g_tan_alpha, jax.lax.stop_gradient(g_tan_alpha))
            if self.ratio
            else 1.0
        )
        return amplitudes / limit - 1

    def describe(self) -> str:
        unit = "g tan α" if self.ratio else "m/s²"
        return f"overturning a_p ≥ {self.at_least:g} {unit}"

    def while_searching(self) -> Self:
        return _with_coarse_width(self)

    @property
    def scenes(self) -> int:
        return len(self.T_p)


def _least_scale(podium: rj.Podium, motion, max_scale, width, options: rj.Options) -> Float[Array, ""]:
    """Return the least factor on a motion that overturns the columns: inf if it exceeds `max_scale`, NaN if
    simulations below it did not finish, so that a lower factor may overturn the columns. Arguments are as for
    `rockjax.overturning_boundary`."""
    boundary = rj.overturning_boundary(podium, motion, max_scale=max_scale, options=options, width=width)
    is_uncertain = boundary.certain_width > ROUNDING_ALLOWANCE * width * max_scale
    return jnp.where(is_uncertain, jnp.nan, boundary.scale)


def _with_coarse_width(target: SearchedTarget) -> SearchedTarget:
    """Return the target with a width of at least `WIDTH_WHILE_SEARCHING`."""
    return eqx.tree_at(
        lambda t: t.width, target, replace_fn=lambda width: jnp.maximum(width, WIDTH_WHILE_SEARCHING)
    )


class AbstractScaleTarget(AbstractTarget):
    """Base class of targets on overturning scales, the least factors with which motions overturn the columns.

    - `max_scale`: largest searched scale; `width`: resolution of the search, as in `OverturningScale`
    - `suite`: the motions
    - `accepts_fresh_samples`: whether the target depends only on the distribution of the overturning scales,
      and not on single motions. The suite may then be `FreshSamples`
    """

    max_scale: eqx.AbstractVar[Any]
    width: eqx.AbstractVar[Any]
    suite: eqx.AbstractVar[Suite]
    accepts_fresh_samples: ClassVar[bool] = False

    @abc.abstractmethod
    def margins_of_scales(self, scales: Float[Array, " k"]) -> Values:
        """Return the margins for overturning scales (k,). Scales above `max_scale` must be given as inf, and
        unknown scales as NaN."""

    def margins(self, podium: rj.Podium, options: rj.Options) -> Values:
        return self.margins_of_scales(self.least_scales(podium, options))

    def while_searching(self) -> Self:
        return _with_coarse_width(self)

    def least_scales(self, podium: rj.Podium, options: rj.Options) -> Float[Array, " k"]:
        """Return the overturning scales (k,) of the motions: inf for scales above `max_scale`, NaN if
        simulations did not finish."""
        return self.suite.map_motions(
            lambda motion: _least_scale(podium, motion, self.max_scale, self.width, options)
        )

    def _fit(self, scales: Float[Array, " k"]) -> rj.Lognormal:
        """Fit a lognormal distribution to overturning scales; NaN if a scale is NaN or no distribution can be
        fitted."""
        fitted = fit_capacities(scales, jnp.full_like(scales, self.max_scale))
        is_known = ~jnp.any(jnp.isnan(scales))
        return rj.Lognormal(*(jnp.where(is_known, y, jnp.nan) for y in fitted))

    @property
    def scenes(self) -> int:
        return len(self.suite)


def _scale_range(owner: str, at_least, max_scale, width) -> tuple[float, float, float]:
    """Return `at_least`, `max_scale` and `width` of `OverturningScale` as floats; a `max_scale` of None
    becomes 3 times `at_least`. Raises `ValueError` for values out of range."""
    width = require_limit(owner, "width", width, below=0.1)
    at_least = require_limit(owner, "at_least", at_least)
    max_scale = 3.0 * at_least if max_scale is None else require_limit(owner, "max_scale", max_scale)
    if not at_least < max_scale:
        raise ValueError(
            f"{owner}: max_scale = {max_scale} must exceed at_least = {at_least}; raise max_scale"
        )
    return at_least, max_scale, width


class OverturningScale(AbstractScaleTarget):
    """Every motion must be scaled by at least `at_least` to overturn the columns.

    The overturning scale of a motion is the least factor with which the motion overturns the columns.

    - `at_least`: > 0 [–]; `excitations`: a motion or a list of motions (records, pulses, wavelets)
    - `max_scale`: largest searched factor, > `at_least` [–]; None for 3 times `at_least`. If no searched
      factor on a motion overturns the columns, `max_scale` is used as the overturning scale of this motion,
      with zero derivatives. If simulations below the overturning scale do not finish, the margin is NaN
    - `width`: in (0, 0.1) [–]; resolution of the search for the overturning scale in the verification. The
      search can miss a range of factors that overturn the columns only if the range is narrower than `width`
      times `max_scale`
    - `name`: name in reports; None for a description

    The margin is (overturning scale)/at_least − 1 for every motion. Raises `ValueError` for arguments out of
    range.
    """

    at_least: Any
    max_scale: Any
    width: Any
    suite: Suite
    name: Name = eqx.field(static=True)

    def __init__(
        self, at_least, excitations, *, max_scale=None, width: float = DEFAULT_WIDTH, name: Name = None
    ):
        owner = type(self).__name__
        self.at_least, self.max_scale, self.width = _scale_range(owner, at_least, max_scale, width)
        self.suite, self.name = Suite.of(excitations, owner), name

    def margins_of_scales(self, scales: Float[Array, " k"]) -> Values:
        return jnp.where(scales == jnp.inf, self.max_scale, scales) / self.at_least - 1

    def describe(self) -> str:
        return f"overturning scale ≥ {self.at_least:g}"


class MedianCapacity(AbstractScaleTarget):
    """The median of the overturning scales of the motions of a suite is at least `at_least`.

    The overturning scale of a motion is the least factor with which the motion overturns the columns.

    - `at_least`: > 0 [–]; `suite`: two motions or more, or `FreshSamples`
    - `max_scale`: largest searched factor, > `at_least` [–]; None for 3 times `at_least`. If a motion does
      not overturn the columns up to `max_scale`, its overturning scale is only known to be larger (censored)
    - `width`: as for [`optimise.OverturningScale`][]. With `FreshSamples`, the design is verified with an
      independent sample, the tolerances of the search for the design, and a `width` of at least 1e-3
    - `name`: name in reports; None for a description

    The median belongs to the lognormal distribution fitted to the overturning scales by maximum likelihood,
    as in [`rockjax.fragility`][]. If no distribution can be fitted, because the overturning scales are equal
    or fewer than two motions overturn the columns, the median is replaced by the geometric mean of the
    overturning scales, with `max_scale` in place of larger ones. The margin is median/at_least − 1; it is NaN
    if simulations did not finish. Raises `ValueError` for arguments out of range.
    """

    at_least: Any
    max_scale: Any
    width: Any
    suite: Suite
    name: Name = eqx.field(static=True)
    accepts_fresh_samples: ClassVar[bool] = True

    def __init__(self, at_least, suite, *, max_scale=None, width: float = DEFAULT_WIDTH, name: Name = None):
        owner = type(self).__name__
        self.at_least, self.max_scale, self.width = _scale_range(owner, at_least, max_scale, width)
        self.suite, self.name = Suite.of(suite, owner, "suite"), name
        if len(self.suite) < 2:
            raise ValueError("MedianCapacity: suite must hold two motions or more, got one")

    def margins_of_scales(self, scales: Float[Array, " k"]) -> Values:
        fitted = self._fit(scales).median
        geometric_mean = jnp.exp(jnp.mean(jnp.log(jnp.minimum(scales, self.max_scale))))
        return (jnp.where(jnp.isnan(fitted), geometric_mean, fitted) / self.at_least - 1)[None]

    def describe(self) -> str:
        return f"median overturning scale ≥ {self.at_least:g}"


class OverturningProbability(AbstractResponseTarget):
    """At most the fraction `at_most` of the motions of a suite overturns the columns.

    - `at_most`: 0 < at_most < 1 [–]; `suite`: a motion or a list of motions
    - `intensity`: factor on all motions, > 0 [–]
    - `smoothing`: bandwidth h > 0 of the smoothed probability P [–]
    - `name`: name in reports; None for a description

    The fraction of n motions that overturns the columns changes by jumps of 1/n and has no useful derivative.
    The target therefore limits the smoothed probability P, the mean of Φ(−M/h) over the motions. M is the
    overturning margin under a motion, and Φ is the standard normal distribution function. The margin of the
    target is the number m for which the mean of Φ((m − M)/h) is `at_most`. The number m has the sign of
    at_most − P, and its derivative is useful even where P is almost 0 or 1. In P, a motion with |M| below
    about 2h counts partly as overturning and partly as surviving. The method `exact` counts overturned scenes
    instead. Raises `ValueError` for arguments out of range.
    """

    at_most: Any
    smoothing: Any
    suite: Suite
    name: Name = eqx.field(static=True)
    outputs: ClassVar[tuple[str, ...]] = ("margin",)

    def __init__(self, at_most, suite, intensity=1.0, smoothing=0.05, *, name: Name = None):
        owner = type(self).__name__
        self.at_most = require_limit(owner, "at_most", at_most, below=1)
        self.smoothing = require_limit(owner, "smoothing", smoothing)
        factor = require_limit(owner, "intensity", intensity)
        self.suite, self.name = Suite.of(suite, owner, "suite").scaled(factor), name

    def read(self, peaks: rj.Peak, options: rj.Options) -> Values:
        return _smoothed_quantile(peaks.margin, self.at_most, self.smoothing)[None]

    def smoothed(self, podium: rj.Podium, options: rj.Options = rj.Options()) -> float:
        """Return the smoothed probability P of a podium [–], NaN if a simulation did not finish; outside
        jit."""
        return float(jnp.mean(norm.cdf(-self.suite.overturning_margins(podium, options) / self.smoothing)))

    def exact(self, podium: rj.Podium, options: rj.Options = rj.Options()) -> float:
        """Return the fraction of the motions that overturn a podium [–], NaN if a simulation did not finish;
        outside jit."""
        margins = self.suite.overturning_margins(podium, options)
        return float(np.mean(np.where(np.isnan(margins), np.nan, margins < 0)))

    def describe(self) -> str:
        return f"overturning probability ≤ {self.at_most:g} (h = {self.smoothing:g})"


def _smoothed_quantile(values: Values, share, bandwidth) -> Float[Array, ""]:
    """Return the number m for which the mean of Φ((m − values)/bandwidth) is `share`, with the standard
    normal distribution function Φ. Derivatives follow from the implicit function theorem."""
    constant = jax.lax.stop_gradient(values)

    def halve(_, bracket):
        low, high = bracket
        middle = 0.5 * (low + high)
        is_below = jnp.mean(norm.cdf((middle - constant) / bandwidth)) < share
        return jnp.where(is_below, middle, low), jnp.where(is_below, high, middle)

    # If all values were equal, m would be at the distance `reach` from this value.
    reach = -bandwidth * norm.ppf(jnp.minimum(share, 1 - share))
    bracket = (jnp.min(constant) - reach, jnp.max(constant) + reach)
    root = jax.lax.stop_gradient(jax.lax.fori_loop(0, 60, halve, bracket)[1])
    weights = norm.pdf((root - constant) / bandwidth)
    weights = weights / jnp.sum(weights)
    return root + jnp.sum(jax.lax.stop_gradient(weights) * (values - constant))
