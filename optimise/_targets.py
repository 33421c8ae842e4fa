"""Targets of a design, with margins that are ≥ 0 where the target holds.

A margin is dimensionless and differentiable; near 0 it is the relative distance to the limit.
"""

from __future__ import annotations

import abc
from typing import Any, ClassVar, Self, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.stats import norm
from jaxtyping import Array, Float

import rockjax as rj
from rockjax.internal import DEFAULT_WIDTH, Module, concrete, fit_capacities

from ._suite import Margins, Suite

Name = str | None
Searched = TypeVar("Searched", bound="AbstractTarget")

WIDTH_WHILE_SEARCHING = 1e-3  # of the range of scales: ten times faster, and designs are verified


class AbstractTarget(Module):
    """Base class of targets. Subclasses implement the abstract methods."""

    name: eqx.AbstractVar[Name]

    @abc.abstractmethod
    def margins(self, podium: rj.Podium, options: rj.Options) -> Margins:
        """Return the margins (k,) at a podium, ≥ 0 where the target holds [–]; traceable, differentiable."""

    @abc.abstractmethod
    def describe(self) -> str:
        """Return the target in words; also its default name."""

    def while_searching(self) -> Self:
        """Return a cheaper target for the search, of the same pytree structure."""
        return self

    @property
    def scenes(self) -> int:
        """Scenes simulated for one evaluation; the search of an overturning acceleration counts as one."""
        return 0


class AbstractResponses(Module):
    """Base class of items that read peak responses; items with one suite share the simulations."""

    suite: eqx.AbstractVar[Suite]
    outputs: ClassVar[Any]  # tuple of outputs as in `rockjax.Options`
    until_overturning: ClassVar[bool] = False  # whether it reads peaks that end at overturning

    @abc.abstractmethod
    def read(self, peaks: rj.Peak, options: rj.Options) -> Margins:
        """Return the values or margins (k,), from the responses with these `outputs`."""


class AbstractResponseTarget(AbstractTarget, AbstractResponses):
    """A target on the peak responses to a suite."""

    def margins(self, podium: rj.Podium, options: rj.Options) -> Margins:
        return self.read(self.suite.responses(podium, options, self.outputs), options)

    @property
    def scenes(self) -> int:
        return len(self.suite)


def severity(peaks: rj.Peak, options: rj.Options) -> Margins:
    """Return the peak rotation over α; beyond overturning it increases with the negative margin [–]."""
    return jnp.where(peaks.overturned, options.overturn_ratio - peaks.margin, peaks.peak_rotation)


def check_limit(owner: str, name: str, value, below: float = np.inf) -> None:
    """Raise `ValueError` unless all numbers are finite, > 0 and < `below`.

    - `owner`, `name`: class and argument, for the error
    - `value`: number or array; `below`: exclusive upper limit
    """
    number = concrete(value)
    if number is None or not np.all(np.isfinite(number) & (number > 0) & (number < below)):
        accepted = "> 0" if below == np.inf else f"in (0, {below:g})"
        raise ValueError(f"{owner}: {name} must be finite and {accepted}, got {name} = {value!r}")


class NoOverturning(AbstractResponseTarget):
    """No motion overturns the columns. The margin is the overturning margin M itself.

    - `excitations`: a motion or a list of them; `name`: in reports
    """

    suite: Suite
    name: Name = eqx.field(static=True)
    outputs: ClassVar[tuple[str, ...]] = ("margin",)

    def __init__(self, excitations, name: Name = None):
        self.suite, self.name = Suite.of(excitations, type(self).__name__), name

    def read(self, peaks: rj.Peak, options: rj.Options) -> Margins:
        return peaks.margin

    def describe(self) -> str:
        return "no overturning"


class OverturningAcceleration(AbstractTarget):
    """Pulses need at least the amplitude `at_least` to overturn the columns.

    - `at_least`: in m/s², or with `ratio=True` in multiples of g tan α, > 0
    - `pulse`: class of the pulse, e.g. `rockjax.Ricker`; `T_p`: one or several periods, > 0 [s]
    - `max_acceleration_ratio`: largest amplitude searched, over g tan α [–]; if no amplitude up to there
      overturns, the margin is that of the largest, with zero derivative
    - `width`: a verified design misses no overturning window below a_ov wider than this share of the range
      [–]

    The margin is a_ov/at_least − 1 for every period. Raises `ValueError` for limits outside the range.
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
        check_limit("OverturningAcceleration", "width", width, below=0.1)
        check_limit("OverturningAcceleration", "at_least", at_least)
        check_limit("OverturningAcceleration", "T_p", T_p)
        if not (isinstance(pulse, type) and issubclass(pulse, rj.AbstractPulse)):
            raise ValueError(
                f"OverturningAcceleration: pulse must be a class such as rockjax.Ricker, got {pulse!r}"
            )
        check_limit("OverturningAcceleration", "max_acceleration_ratio", max_acceleration_ratio)
        if ratio and not at_least < max_acceleration_ratio:
            raise ValueError(
                f"OverturningAcceleration: at_least = {at_least} must be below max_acceleration_ratio = "
                f"{max_acceleration_ratio}; raise the latter"
            )
        self.at_least, self.pulse, self.ratio, self.name = float(at_least), pulse, ratio, name
        self.T_p = jnp.atleast_1d(jnp.asarray(T_p, float)).ravel()
        self.max_acceleration_ratio, self.width = float(max_acceleration_ratio), float(width)

    def margins(self, podium: rj.Podium, options: rj.Options) -> Margins:
        unit = podium.g * jnp.tan(podium.alpha)

        def least(T_p):
            return rj.overturning_acceleration(
                podium,
                self.pulse,
                T_p,
                max_acceleration_ratio=self.max_acceleration_ratio,
                options=options,
                width=self.width,
            )

        found = jax.vmap(least)(self.T_p)
        end = jax.lax.stop_gradient(self.max_acceleration_ratio * unit)
        found = jnp.where(found < jnp.inf, found, end)
        level = self.at_least * (
            jnp.where(found < end, unit, jax.lax.stop_gradient(unit)) if self.ratio else 1.0
        )
        return found / level - 1

    def describe(self) -> str:
        unit = "g tan α" if self.ratio else "m/s²"
        return f"overturning a_p ≥ {self.at_least:g} {unit}"

    def while_searching(self) -> Self:
        return _coarser(self)

    @property
    def scenes(self) -> int:
        return len(self.T_p)


def _coarser(target: Searched) -> Searched:
    """Return the target with coarser resolution of overturning windows."""
    return eqx.tree_at(
        lambda t: t.width, target, replace_fn=lambda width: jnp.maximum(width, WIDTH_WHILE_SEARCHING)
    )


class AbstractScaleTarget(AbstractTarget):
    """Base class of targets on the least factors at which the motions of a suite overturn the columns.

    `accepts_fresh_samples`: whether it refers to a distribution of the factors and so accepts `FreshSamples`.
    """

    max_scale: eqx.AbstractVar[Any]
    width: eqx.AbstractVar[Any]
    suite: eqx.AbstractVar[Suite]
    accepts_fresh_samples: ClassVar[bool] = False

    @abc.abstractmethod
    def margins_of_scales(self, scales: Float[Array, " k"]) -> Margins:
        """Return the margins from the least factors (k,), inf where no factor up to `max_scale` overturns."""

    def margins(self, podium: rj.Podium, options: rj.Options) -> Margins:
        return self.margins_of_scales(self.least_scales(podium, options))

    def while_searching(self) -> Self:
        return _coarser(self)

    def least_scales(self, podium: rj.Podium, options: rj.Options) -> Float[Array, " k"]:
        """Return the least overturning factor of every motion (k,), inf where none up to `max_scale` does."""

        def least(motion):
            return rj.overturning_scale(
                podium, motion, max_scale=self.max_scale, options=options, width=self.width
            )

        return self.suite.map_motions(least)

    @property
    def scenes(self) -> int:
        return len(self.suite)


def _scale_range(owner: str, at_least, max_scale, width) -> tuple[float, float]:
    """Return `at_least`, and `max_scale` or its default."""
    check_limit(owner, "width", width, below=0.1)
    check_limit(owner, "at_least", at_least)
    max_scale = 3.0 * at_least if max_scale is None else max_scale
    check_limit(owner, "max_scale", max_scale)
    if not at_least < max_scale:
        raise ValueError(f"{owner}: max_scale = {max_scale} must exceed at_least = {at_least}; raise it")
    return float(at_least), float(max_scale)


class OverturningScale(AbstractScaleTarget):
    """Every motion must be scaled by at least `at_least` to overturn the columns.

    - `at_least`: > 0 [–]; `excitations`: a motion or a list of them (records, pulses, wavelets)
    - `max_scale`: largest factor searched, by default 3 times `at_least` [–]; if no factor up to there
      overturns, the margin is that of the largest, with zero derivative
    - `width`: a verified design misses no overturning window wider than this share of `max_scale` [–]

    The margin is scale/at_least − 1 for every motion. Raises `ValueError` for limits outside the range.
    """

    at_least: Any
    max_scale: Any
    width: Any
    suite: Suite
    name: Name = eqx.field(static=True)

    def __init__(
        self, at_least, excitations, *, max_scale=None, width: float = DEFAULT_WIDTH, name: Name = None
    ):
        self.at_least, self.max_scale = _scale_range("OverturningScale", at_least, max_scale, width)
        self.width = float(width)
        self.suite, self.name = Suite.of(excitations, type(self).__name__), name

    def margins_of_scales(self, scales: Float[Array, " k"]) -> Margins:
        return jnp.where(scales < jnp.inf, scales, self.max_scale) / self.at_least - 1

    def describe(self) -> str:
        return f"overturning scale ≥ {self.at_least:g}"


class MedianCapacity(AbstractScaleTarget):
    """The median of the scales that overturn the columns, over a suite, is at least `at_least`.

    - `at_least`: > 0 [–]; `suite`: two motions or more, or `FreshSamples`
    - `max_scale`: largest factor searched, by default 3 times `at_least` [–]; motions that do not overturn
      the columns up to there count as censored
    - `width`: a verified design misses no overturning window wider than this share of `max_scale` [–]

    The median is that of the lognormal distribution fitted by maximum likelihood, as in
    [`rockjax.fragility`][]. The margin is median/at_least − 1; where fewer than two motions overturn it is
    that of `max_scale`, with zero derivative. Raises `ValueError` for limits outside the range.
    """

    at_least: Any
    max_scale: Any
    width: Any
    suite: Suite
    name: Name = eqx.field(static=True)
    accepts_fresh_samples: ClassVar[bool] = True

    def __init__(self, at_least, suite, *, max_scale=None, width: float = DEFAULT_WIDTH, name: Name = None):
        self.at_least, self.max_scale = _scale_range("MedianCapacity", at_least, max_scale, width)
        self.width = float(width)
        self.suite, self.name = Suite.of(suite, type(self).__name__, "suite"), name
        if len(self.suite) < 2:
            raise ValueError("MedianCapacity: suite must hold two motions or more, got one")

    def margins_of_scales(self, scales: Float[Array, " k"]) -> Margins:
        median = fit_capacities(scales, jnp.full_like(scales, self.max_scale)).median
        return (jnp.where(jnp.isnan(median), self.max_scale, median) / self.at_least - 1)[None]

    def describe(self) -> str:
        return f"median overturning scale ≥ {self.at_least:g}"


class OverturningProbability(AbstractResponseTarget):
    """At a given intensity at most the share `at_most` of a suite overturns the columns.

    - `at_most`: 0 < at_most < 1 [–]; `suite`: the motions; `intensity`: factor on all of them [–]
    - `smoothing`: bandwidth h of the smoothed probability P = mean Φ(−M/h) over the overturning margins M [–]

    The share of n motions changes in jumps of 1/n and has no useful derivative; P is smooth. The margin is
    the `at_most`-quantile m of the smoothed margins, mean Φ((m − M)/h) = at_most. It has the sign of
    at_most − P and varies also where P is flat at 0 or 1. Motions within h of overturning bias P; `exact`
    counts.
    """

    at_most: Any
    smoothing: Any
    suite: Suite
    name: Name = eqx.field(static=True)
    outputs: ClassVar[tuple[str, ...]] = ("margin",)

    def __init__(self, at_most, suite, intensity=1.0, smoothing=0.05, *, name: Name = None):
        check_limit("OverturningProbability", "at_most", at_most, below=1)
        check_limit("OverturningProbability", "intensity", intensity)
        check_limit("OverturningProbability", "smoothing", smoothing)
        self.at_most, self.smoothing, self.name = float(at_most), float(smoothing), name
        self.suite = Suite.of(suite, type(self).__name__, "suite").scaled(float(intensity))

    def read(self, peaks: rj.Peak, options: rj.Options) -> Margins:
        return _smoothed_quantile(peaks.margin, self.at_most, self.smoothing)[None]

    def smoothed(self, podium: rj.Podium, options: rj.Options = rj.Options()) -> float:
        """Return P = mean Φ(−M/h) at a podium (host) [–]."""
        return float(jnp.mean(norm.cdf(-self.suite.margins(podium, options) / self.smoothing)))

    def exact(self, podium: rj.Podium, options: rj.Options = rj.Options()) -> float:
        """Return the share of the suite that overturns a podium (host) [–]."""
        return float(np.mean(self.suite.margins(podium, options) < 0))

    def describe(self) -> str:
        return f"overturning probability ≤ {self.at_most:g} (h = {self.smoothing:g})"


def _smoothed_quantile(values: Margins, share, width) -> Float[Array, ""]:
    """Solve mean Φ((m − values)/width) = share for m; differentiable by the implicit function theorem."""
    constant = jax.lax.stop_gradient(values)

    def halve(_, bracket):
        low, high = bracket
        middle = 0.5 * (low + high)
        below = jnp.mean(norm.cdf((middle - constant) / width)) < share
        return jnp.where(below, middle, low), jnp.where(below, high, middle)

    half_width = -width * norm.ppf(jnp.minimum(share, 1 - share))
    bracket = (jnp.min(constant) - half_width, jnp.max(constant) + half_width)
    root = jax.lax.stop_gradient(jax.lax.fori_loop(0, 60, halve, bracket)[1])
    weights = norm.pdf((root - constant) / width)
    weights = weights / jnp.sum(weights)
    return root + jnp.sum(jax.lax.stop_gradient(weights) * (values - constant))
