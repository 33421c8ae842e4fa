"""The integral ∫ F(x) |dλ(x)| of a fragility F along a hazard curve λ, in closed form on every segment.

The hazard curve λ(x) is the mean annual rate at which the intensity x is exceeded. Between the points of the
curve, ln λ is linear in ln x; the first and the last segment are extrapolated. On a segment, λ = k₀ x^(−k)
with the constants k₀ and k. A lognormal fragility is F = Φ(z), z = (ln x − ln m)/β, with the median m, the
dispersion β and the standard normal distribution function Φ. On a segment,

    ∫ F |dλ| = [−F λ] + k₀ m^(−k) e^(k²β²/2) [Φ(z + kβ)],

where brackets mean the value at the right end of the segment minus the value at the left end.

All functions here use jax.numpy and are differentiable with respect to every array.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax.scipy.stats import norm
from jaxtyping import Array, ArrayLike, Float


class Contributions(NamedTuple):
    """Contributions to ∫ F |dλ| [1/year].

    A piece of the hazard curve is a segment, or a part of a segment if the limits or the points of F divide
    it.

    - `below`: contribution of intensities below the first point of the hazard curve
    - `between`: contribution of each piece; 0 for the pieces that are counted in `below` or `above`
    - `above`: contribution of intensities above the last point
    """

    below: Float[Array, ""]
    between: Float[Array, " pieces"]
    above: Float[Array, ""]

    @property
    def total(self) -> Float[Array, ""]:
        return self.below + jnp.sum(self.between) + self.above


class Limits(NamedTuple):
    """Intensities at which a fragility curve F is cut off or held constant; None for no limit.

    - `zero_below`: F(x) = 0 up to this intensity
    - `constant_below`: below this intensity, F equals its value at this intensity. Must be None if
      `zero_below` is given
    - `constant_above`: above this intensity, F equals its value at this intensity
    """

    zero_below: Float[ArrayLike, ""] | None = None
    constant_below: Float[ArrayLike, ""] | None = None
    constant_above: Float[ArrayLike, ""] | None = None


def segment_slopes(log_x: Float[Array, " n"], log_rate: Float[Array, " n"]) -> Float[Array, " n-1"]:
    """Return the exponent k ≥ 0 of each segment λ = k₀ x^(−k)."""
    return -jnp.diff(log_rate) / jnp.diff(log_x)


def log_rate_at(
    log_x: Float[Array, " n"], log_rate: Float[Array, " n"], s: Float[Array, "*m"]
) -> Float[Array, "*m"]:
    """Return ln λ at s = ln x, by linear interpolation and extrapolation."""
    i = jnp.clip(jnp.searchsorted(log_x, s) - 1, 0, log_x.size - 2)
    return log_rate[i] - segment_slopes(log_x, log_rate)[i] * (s - log_x[i])


def _log_difference(low: Array, high: Array) -> Array:
    """Return ln[Φ(high) − Φ(low)] for low < high, each finite or infinite. If low + high > 0, the equal
    expression ln[Φ(−low) − Φ(−high)] is used, to avoid cancellation."""
    is_upper_tail = low + high > 0
    a, b = jnp.where(is_upper_tail, -high, low), jnp.where(is_upper_tail, -low, high)
    larger, smaller = norm.logcdf(b), norm.logcdf(a)
    difference = smaller - larger
    # A difference that rounds to zero is replaced by −1e-300, so that the result is finite.
    return larger + jnp.log(-jnp.expm1(jnp.where(difference < 0, difference, -1e-300)))


def integrate_lognormal(
    log_x: Float[Array, " n"],
    log_rate: Float[Array, " n"],
    median: Float[Array, ""],
    dispersion: Float[Array, ""],
    limits: Limits = Limits(),
) -> Contributions:
    """Return the contributions to ∫ F |dλ| for F = Φ(ln(x/median)/dispersion), with limits.

    - `log_x`, `log_rate`: ln x and ln λ of the points of the hazard curve, ascending in x, shape (n,) each
    - `median`, `dispersion`: median m, > 0 [unit of x], and dispersion β, > 0 [–], of the fragility
    - `limits`: intensities at which F is cut off or held constant [unit of x]. The part of F that
      `constant_below` holds constant counts only above the first point of the hazard curve, because the
      extrapolated rate grows without bound as x tends to 0
    """
    k = segment_slopes(log_x, log_rate)
    zero_below, constant_below, upper = (None if x is None else jnp.log(x) for x in limits)
    lower = constant_below if zero_below is None else zero_below
    log_limits = [x for x in (lower, upper) if x is not None]
    if not log_limits:
        return _integrate_without_limits(log_x, log_rate, k, median, dispersion)
    points = jnp.sort(jnp.concatenate([log_x, jnp.stack(log_limits)]))
    middle = 0.5 * (points[:-1] + points[1:])
    segment = jnp.clip(jnp.searchsorted(log_x, middle) - 1, 0, log_x.size - 2)

    def rate(s):
        return jnp.exp(log_rate_at(log_x, log_rate, s))

    def F(s):
        return norm.cdf((s - jnp.log(median)) / dispersion)

    below, pieces, above = _integrate_without_limits(
        points, log_rate_at(log_x, log_rate, points), k[segment], median, dispersion
    )
    drops = -jnp.diff(rate(points))
    if lower is not None:
        constant = 0.0 if constant_below is None else F(constant_below) * drops
        below, pieces = jnp.zeros(()), jnp.where(middle > lower, pieces, constant)
    if upper is not None:
        above, pieces = F(upper) * rate(points[-1]), jnp.where(middle < upper, pieces, F(upper) * drops)
    is_below, is_above = middle < log_x[0], middle > log_x[-1]
    return Contributions(
        below + jnp.sum(jnp.where(is_below, pieces, 0.0)),
        jnp.where(is_below | is_above, 0.0, pieces),
        above + jnp.sum(jnp.where(is_above, pieces, 0.0)),
    )


def _integrate_without_limits(
    log_x: Float[Array, " n"],
    log_rate: Float[Array, " n"],
    k: Float[Array, " n-1"],
    median: Float[Array, ""],
    dispersion: Float[Array, ""],
) -> Contributions:
    """Return the contributions to ∫ F |dλ| without limits. `k` is the exponent of each segment; the other
    arguments are as for `integrate_lognormal`."""
    z = (log_x - jnp.log(median)) / dispersion
    F, rate = norm.cdf(z), jnp.exp(log_rate)
    # ln(k₀ m^(−k) e^(k²β²/2)) of each segment; its left end gives k₀.
    log_factor = log_rate[:-1] + k * (log_x[:-1] - jnp.log(median)) + 0.5 * (k * dispersion) ** 2
    shift = k * dispersion
    between = (
        jnp.exp(log_factor + _log_difference(z[:-1] + shift, z[1:] + shift))
        - (F * rate)[1:]
        + (F * rate)[:-1]
    )
    below = jnp.exp(log_factor[0] + norm.logcdf(z[0] + shift[0])) - F[0] * rate[0]
    above = jnp.exp(log_factor[-1] + norm.logsf(z[-1] + shift[-1])) + F[-1] * rate[-1]
    return Contributions(jnp.maximum(below, 0.0), jnp.maximum(between, 0.0), above)


def integrate_piecewise_linear(
    log_x: Float[Array, " n"], log_rate: Float[Array, " n"], x: Float[Array, " m"], share: Float[Array, " m"]
) -> Contributions:
    """Return the contributions to ∫ F |dλ| for a piecewise linear F, which is zero below its first point and
    constant above its last point. Intensities above this point count as `above`, even within or below the
    hazard curve.

    - `log_x`, `log_rate`: ln x and ln λ of the points of the hazard curve, ascending in x, shape (n,) each
    - `x`, `share`: intensities of the points of F, ascending, > 0, and F there, shape (m,) each; `share[0]`
      must be 0
    """
    k, points = segment_slopes(log_x, log_rate), jnp.exp(log_x)
    ends = jnp.sort(jnp.concatenate([points, x]))
    left, right = ends[:-1], ends[1:]
    middle = 0.5 * (left + right)
    i = jnp.clip(jnp.searchsorted(log_x, jnp.log(middle)) - 1, 0, k.size - 1)
    j = jnp.clip(jnp.searchsorted(x, middle) - 1, 0, x.size - 2)
    is_inside = (middle > x[0]) & (middle < x[-1])
    slope = jnp.where(is_inside, jnp.diff(share)[j] / jnp.diff(x)[j], 0.0)
    offset = jnp.where(is_inside, share[j] - slope * x[j], jnp.where(middle < x[0], 0.0, share[-1]))
    pieces = _linear_piece(left, right, k[i], jnp.exp(log_rate[i] + k[i] * log_x[i]), offset, slope)
    is_below = middle < jnp.minimum(points[0], x[-1])
    is_above = middle > jnp.minimum(points[-1], x[-1])
    tail = jnp.exp(log_rate_at(log_x, log_rate, jnp.log(ends[-1]))) * share[-1]
    return Contributions(
        jnp.sum(jnp.where(is_below, pieces, 0.0)),
        jnp.where(is_below | is_above, 0.0, pieces),
        tail + jnp.sum(jnp.where(is_above, pieces, 0.0)),
    )


def _linear_piece(a, b, k, k_0, offset, slope):
    """Return ∫ (offset + slope·x) |dλ| from a to b > a > 0, with λ = k₀ x^(−k), |dλ| = k k₀ x^(−k−1) dx."""
    constant = offset * k_0 * (a**-k - b**-k)
    exponent, width = 1 - k, jnp.log(b / a)
    growth = jnp.where(
        jnp.abs(exponent) < 1e-12,
        width,
        jnp.expm1(exponent * width) / jnp.where(exponent == 0, 1.0, exponent),
    )
    return constant + slope * k * k_0 * a**exponent * growth
