"""Targets of a design, with margins that are ≥ 0 where the target holds.

A margin is dimensionless and differentiable; near 0 it is the relative distance to the limit. The overturning
margin of a scene (one structure under one motion) is positive if the columns survive, negative if they
overturn.
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
from rockjax._checks import require
from rockjax.internal import DEFAULT_WIDTH, Module, fit_capacities

from ._suite import Suite, Values

Name = str | None
SearchedTarget = TypeVar("SearchedTarget", bound="AbstractTarget")

WIDTH_WHILE_SEARCHING = 1e-3  # smallest width during a search; verification uses the width of the target


class AbstractTarget(Module):
    """Base class of targets. `name`: name in reports; None for `describe()`."""

    name: eqx.AbstractVar[Name]

    @abc.abstractmethod
    def margins(self, podium: rj.Podium, options: rj.Options) -> Values:
        """Return the margins (k,) at a podium, ≥ 0 where the target holds [–]; traceable, differentiable."""

    @abc.abstractmethod
    def describe(self) -> str:
        """Return a description of the target, which is also its default name."""

    def while_searching(self) -> Self:
        """Return a target with the same pytree structure that is cheaper to evaluate during a search."""
        return self

    @property
    def scenes(self) -> int:
        """Number of scenes of one evaluation; the search for one overturning amplitude counts as one."""
        return 0


class AbstractResponses(Module):
    """Base class of targets and objectives computed from peak responses. Targets and objectives with equal
    suites share their simulations."""

    suite: eqx.AbstractVar[Suite]
    outputs: ClassVar[Any]  # required outputs, a tuple as in `rockjax.Options`
    until_overturning: ClassVar[bool] = False  # whether peaks cover only the time until overturning

    @abc.abstractmethod
    def read(self, peaks: rj.Peak, options: rj.Options) -> Values:
        """Return the margins of a target, or the values of an objective, (k,), from responses with
        `outputs`."""


class AbstractResponseTarget(AbstractTarget, AbstractResponses):
    """A target on peak responses to a suite."""

    def margins(self, podium: rj.Podium, options: rj.Options) -> Values:
        return self.read(self.suite.responses(podium, options, self.outputs), options)

    @property
    def scenes(self) -> int:
        return len(self.suite)


def severity(peaks: rj.Peak, options: rj.Options) -> Values:
    """Return max|θ|/α [–]; where the columns overturn, overturn_ratio − M, where M < 0 is the overturning
    margin. This value increases with the speed of the fall."""
    return jnp.where(peaks.overturned, options.overturn_ratio - peaks.margin, peaks.peak_rotation)


def check_limit(owner: str, name: str, value, below: float = np.inf) -> None:
    """Raise `ValueError` unless all values are known numbers, finite, > 0 and < `below`.

    - `owner`, `name`: class and argument, for the error
    - `value`: number or array; `below`: exclusive upper limit
    """
    if isinstance(value, Tracer):
        raise ValueError(f"{owner}: {name} must be a number, not a traced value; make the target outside jit")
    accepted = "> 0" if below == np.inf else f"in (0, {below:g})"
    require(owner, name, value, lambda v: (v > 0) & (v < below), f"finite and {accepted}")


class NoOverturning(AbstractResponseTarget):
    """No motion overturns the columns. The margin is the overturning margin M.

    - `excitations`: a motion or a list of them; `name`: name in reports
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

    - `at_least`: > 0 [m/s²], or [g tan α] with `ratio=True`
    - `pulse`: class of the pulse, such as `rockjax.Ricker`; `T_p`: one or several periods, > 0 [s]
    - `max_acceleration_ratio`: largest searched amplitude [g tan α], above `at_least`; if no searched
      amplitude overturns, a_ov is this amplitude, a constant
    - `width`: verification finds every overturning window below a_ov that is wider than this fraction of the
      searched range [–]

    The margin is a_ov/at_least − 1 for every period. Raises `ValueError` for arguments out of range.
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
                f"{max_acceleration_ratio}; raise max_acceleration_ratio"
            )
        self.at_least, self.pulse, self.ratio, self.name = float(at_least), pulse, ratio, name
        self.T_p = jnp.atleast_1d(jnp.asarray(T_p, float)).ravel()
        self.max_acceleration_ratio, self.width = float(max_acceleration_ratio), float(width)

    def margins(self, podium: rj.Podium, options: rj.Options) -> Values:
        g_tan_alpha = podium.g * jnp.tan(podium.alpha)

        def least_amplitude(T_p):
            return rj.overturning_acceleration(
                podium,
                self.pulse,
                T_p,
                max_acceleration_ratio=self.max_acceleration_ratio,
                options=options,
                width=self.width,
            )

        amplitudes = jax.vmap(least_amplitude)(self.T_p)
        largest = jax.lax.stop_gradient(self.max_acceleration_ratio * g_tan_alpha)
        amplitudes = jnp.where(amplitudes < jnp.inf, amplitudes, largest)
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


def _with_coarse_width(target: SearchedTarget) -> SearchedTarget:
    """Return the target with a width of at least `WIDTH_WHILE_SEARCHING`."""
    return eqx.tree_at(
        lambda t: t.width, target, replace_fn=lambda width: jnp.maximum(width, WIDTH_WHILE_SEARCHING)
    )


class AbstractScaleTarget(AbstractTarget):
    """Base class of targets on overturning scales, the least factors with which motions overturn the columns.

    `accepts_fresh_samples`: whether the target depends on the distribution of the scales, so that its
    suite may be `FreshSamples`.
    """

    max_scale: eqx.AbstractVar[Any]
    width: eqx.AbstractVar[Any]
    suite: eqx.AbstractVar[Suite]
    accepts_fresh_samples: ClassVar[bool] = False

    @abc.abstractmethod
    def margins_of_scales(self, scales: Float[Array, " k"]) -> Values:
        """Return the margins from overturning scales (k,), which are inf where they exceed `max_scale`."""

    def margins(self, podium: rj.Podium, options: rj.Options) -> Values:
        return self.margins_of_scales(self.least_scales(podium, options))

    def while_searching(self) -> Self:
        return _with_coarse_width(self)

    def least_scales(self, podium: rj.Podium, options: rj.Options) -> Float[Array, " k"]:
        """Return the overturning scales (k,) of the motions, inf where they exceed `max_scale`."""

        def least_scale(motion):
            return rj.overturning_scale(
                podium, motion, max_scale=self.max_scale, options=options, width=self.width
            )

        return self.suite.map_motions(least_scale)

    @property
    def scenes(self) -> int:
        return len(self.suite)


def _scale_range(owner: str, at_least, max_scale, width) -> tuple[float, float]:
    """Return `at_least` and `max_scale`, by default 3 times `at_least`.

    - `owner`: class that error messages name
    - `at_least`, `max_scale`, `width`: as for `OverturningScale`

    Raises `ValueError` for values out of range.
    """
    check_limit(owner, "width", width, below=0.1)
    check_limit(owner, "at_least", at_least)
    max_scale = 3.0 * at_least if max_scale is None else max_scale
    check_limit(owner, "max_scale", max_scale)
    if not at_least < max_scale:
        raise ValueError(
            f"{owner}: max_scale = {max_scale} must exceed at_least = {at_least}; raise max_scale"
        )
    return float(at_least), float(max_scale)


class OverturningScale(AbstractScaleTarget):
    """Every motion must be scaled by at least `at_least` to overturn the columns.

    - `at_least`: > 0 [–]; `excitations`: a motion or a list of them (records, pulses, wavelets)
    - `max_scale`: largest searched factor, by default 3 times `at_least` [–]; if no searched factor
      overturns, the scale is `max_scale`, a constant
    - `width`: verification finds every overturning window wider than this fraction of `max_scale` [–]

    The margin is scale/at_least − 1 for every motion. Raises `ValueError` for arguments out of range.
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

    def margins_of_scales(self, scales: Float[Array, " k"]) -> Values:
        return jnp.where(scales < jnp.inf, scales, self.max_scale) / self.at_least - 1

    def describe(self) -> str:
        return f"overturning scale ≥ {self.at_least:g}"


class MedianCapacity(AbstractScaleTarget):
    """The median scale with which the motions of a suite overturn the columns is at least `at_least`.

    - `at_least`: > 0 [–]; `suite`: two motions or more, or `FreshSamples`
    - `max_scale`: largest searched factor, by default 3 times `at_least` [–]; of a motion that does not
      overturn the columns up to `max_scale`, the fit uses only this fact
    - `width`: verification finds every overturning window wider than this fraction of `max_scale` [–]

    The median belongs to a lognormal distribution fitted by maximum likelihood, as in
    [`rockjax.fragility`][]. If fewer than two motions overturn the columns, the median is `max_scale`,
    a constant. The margin is median/at_least − 1. Raises `ValueError` for arguments out of range.
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

    def margins_of_scales(self, scales: Float[Array, " k"]) -> Values:
        median = fit_capacities(scales, jnp.full_like(scales, self.max_scale)).median
        return (jnp.where(jnp.isnan(median), self.max_scale, median) / self.at_least - 1)[None]

    def describe(self) -> str:
        return f"median overturning scale ≥ {self.at_least:g}"


class OverturningProbability(AbstractResponseTarget):
    """At a given intensity at most the fraction `at_most` of a suite overturns the columns.

    - `at_most`: 0 < at_most < 1 [–]; `suite`: the motions; `intensity`: factor on all motions, > 0 [–]
    - `smoothing`: bandwidth h > 0 of the smoothed probability P = mean Φ(−M/h) over overturning margins M [–]

    The overturned fraction of n motions jumps by 1/n and has no useful derivative; P is smooth. The margin is
    the number m for which mean Φ((m − M)/h) = at_most. It has the sign of at_most − P, and its derivative is
    useful even where P is almost 0 or 1. Motions with |M| < h bias P; `exact` counts overturned scenes
    instead. Raises `ValueError` for arguments out of range.
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

    def read(self, peaks: rj.Peak, options: rj.Options) -> Values:
        return _smoothed_quantile(peaks.margin, self.at_most, self.smoothing)[None]

    def smoothed(self, podium: rj.Podium, options: rj.Options = rj.Options()) -> float:
        """Return P = mean Φ(−M/h) at a podium [–]; outside jit."""
        return float(jnp.mean(norm.cdf(-self.suite.overturning_margins(podium, options) / self.smoothing)))

    def exact(self, podium: rj.Podium, options: rj.Options = rj.Options()) -> float:
        """Return the fraction of the suite that overturns a podium [–]; outside jit."""
        return float(np.mean(self.suite.overturning_margins(podium, options) < 0))

    def describe(self) -> str:
        return f"overturning probability ≤ {self.at_most:g} (h = {self.smoothing:g})"


def _smoothed_quantile(values: Values, share, width) -> Float[Array, ""]:
    """Solve mean Φ((m − values)/width) = share for m; differentiable by the implicit function theorem."""
    constant = jax.lax.stop_gradient(values)

    def halve(_, bracket):
        low, high = bracket
        middle = 0.5 * (low + high)
        is_below = jnp.mean(norm.cdf((middle - constant) / width)) < share
        return jnp.where(is_below, middle, low), jnp.where(is_below, high, middle)

    half_width = -width * norm.ppf(jnp.minimum(share, 1 - share))
    bracket = (jnp.min(constant) - half_width, jnp.max(constant) + half_width)
    root = jax.lax.stop_gradient(jax.lax.fori_loop(0, 60, halve, bracket)[1])
    weights = norm.pdf((root - constant) / width)
    weights = weights / jnp.sum(weights)
    return root + jnp.sum(jax.lax.stop_gradient(weights) * (values - constant))
