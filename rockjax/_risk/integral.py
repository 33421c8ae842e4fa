"""The integral ∫ F(x) |dλ(x)| of a fragility F over a hazard curve λ, in closed form on every segment.

A hazard curve is linear in ln x, ln λ between its points, and its first and last segment continue outside. On
a segment λ = k₀ x^(−k), and for a lognormal F = Φ(z), z = (ln x − ln m)/β,

    ∫ F |dλ| = [−F λ] + k₀ m^(−k) e^(k²β²/2) [Φ(z + kβ)].

All functions here use jax.numpy, and are differentiable in every number.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax.scipy.stats import norm
from jaxtyping import Array, ArrayLike, Float


class Contributions(NamedTuple):
    """Contributions of the pieces of a hazard curve to ∫ F |dλ| [1/year]."""

    below: Float[Array, ""]  # from below the first given point
    between: Float[Array, " pieces"]  # from between neighbouring points
    above: Float[Array, ""]  # from above the last given point

    @property
    def total(self) -> Float[Array, ""]:
        return self.below + jnp.sum(self.between) + self.above


class Limits(NamedTuple):
    """Intensities at which a fragility curve is cut off or held constant; None for no limit.

    P(x) = 0 up to `zero_below`; P(x) = P(`constant_below`) below that, P(`constant_above`) above that. At
    most one of the first two is given.
    """

    zero_below: Float[ArrayLike, ""] | None = None
    constant_below: Float[ArrayLike, ""] | None = None
    constant_above: Float[ArrayLike, ""] | None = None


def segment_slopes(log_x: Float[Array, " n"], log_rate: Float[Array, " n"]) -> Float[Array, " n-1"]:
    """Return k ≥ 0 of each segment λ = k₀ x^(−k)."""
    return -jnp.diff(log_rate) / jnp.diff(log_x)


def log_rate_at(
    log_x: Float[Array, " n"], log_rate: Float[Array, " n"], s: Float[Array, "*m"]
) -> Float[Array, "*m"]:
    """Return ln λ at s = ln x, on straight lines in the logarithms; the outer segments continue."""
    i = jnp.clip(jnp.searchsorted(log_x, s) - 1, 0, log_x.size - 2)
    return log_rate[i] - segment_slopes(log_x, log_rate)[i] * (s - log_x[i])


def _log_difference(low: Array, high: Array) -> Array:
    """Return ln[Φ(high) − Φ(low)] for low < high, from the tail in which both are small; infinite ends are
    allowed."""
    flip = low + high > 0
    a, b = jnp.where(flip, -high, low), jnp.where(flip, -low, high)
    larger, smaller = norm.logcdf(b), norm.logcdf(a)
    gap = smaller - larger
    # Neighbours as close as rounding have no resolvable difference.
    return larger + jnp.log(-jnp.expm1(jnp.where(gap < 0, gap, -1e-300)))


def integrate_lognormal(
    log_x: Float[Array, " n"],
    log_rate: Float[Array, " n"],
    median: Float[Array, ""],
    dispersion: Float[Array, ""],
    limits: Limits = Limits(),
) -> Contributions:
    """Return the contributions to ∫ F |dλ| for F = Φ(ln(x/median)/dispersion), within limits.

    - `log_x`, `log_rate`: ln x and ln λ of the points of the hazard curve, ascending in x, (n,)
    - `median`: median of the fragility, > 0 [unit of x]; `dispersion`: its β, > 0 [–]
    - `limits`: intensities at which F is cut off or held constant

    If F stays > 0 at low intensities, it counts from the first given point on, because rates grow without
    bound below it.
    """
    k = segment_slopes(log_x, log_rate)
    zero, floor, last = (None if x is None else jnp.log(x) for x in limits)
    first = floor if zero is None else zero
    ends = [x for x in (first, last) if x is not None]
    if not ends:
        return _unlimited(log_x, log_rate, k, median, dispersion)
    points = jnp.sort(jnp.concatenate([log_x, jnp.stack(ends)]))
    middle = 0.5 * (points[:-1] + points[1:])
    segment = jnp.clip(jnp.searchsorted(log_x, middle) - 1, 0, log_x.size - 2)

    def rate(s):
        return jnp.exp(log_rate_at(log_x, log_rate, s))

    def share(s):
        return norm.cdf((s - jnp.log(median)) / dispersion)

    parts = _unlimited(points, log_rate_at(log_x, log_rate, points), k[segment], median, dispersion)
    below, pieces, above, constant = parts.below, parts.between, parts.above, jnp.zeros(())
    if first is not None:
        below, pieces = jnp.zeros(()), jnp.where(middle > first, pieces, 0.0)
    if floor is not None:
        constant += share(floor) * jnp.maximum(rate(log_x[0]) - rate(floor), 0.0)
    if last is not None:
        beyond = rate(jnp.maximum(last, log_x[-1]))
        above, pieces = share(last) * beyond, jnp.where(middle < last, pieces, 0.0)
        constant += share(last) * (rate(last) - beyond)
    lower, upper = middle < log_x[0], middle > log_x[-1]
    return Contributions(
        below + jnp.sum(jnp.where(lower, pieces, 0.0)),
        jnp.append(jnp.where(lower | upper, 0.0, pieces), constant),
        above + jnp.sum(jnp.where(upper, pieces, 0.0)),
    )


def _unlimited(
    log_x: Float[Array, " n"],
    log_rate: Float[Array, " n"],
    k: Float[Array, " n-1"],
    median: Float[Array, ""],
    dispersion: Float[Array, ""],
) -> Contributions:
    """Return the contributions to ∫ F |dλ| without limits; k of each segment."""
    z = (log_x - jnp.log(median)) / dispersion
    share, rate = norm.cdf(z), jnp.exp(log_rate)
    # ln(k₀ m^(−k) e^(k²β²/2)), k₀ from the left end of the segment.
    level = log_rate[:-1] + k * (log_x[:-1] - jnp.log(median)) + 0.5 * (k * dispersion) ** 2
    shift = k * dispersion
    between = (
        jnp.exp(level + _log_difference(z[:-1] + shift, z[1:] + shift))
        - (share * rate)[1:]
        + (share * rate)[:-1]
    )
    below = jnp.exp(level[0] + norm.logcdf(z[0] + shift[0])) - share[0] * rate[0]
    above = jnp.exp(level[-1] + norm.logsf(z[-1] + shift[-1])) + share[-1] * rate[-1]
    return Contributions(
        jnp.maximum(below, 0.0), jnp.maximum(between, 0.0), jnp.where(k[-1] > 0, above, share[-1] * rate[-1])
    )


def integrate_piecewise_linear(
    log_x: Float[Array, " n"], log_rate: Float[Array, " n"], x: Float[Array, " m"], share: Float[Array, " m"]
) -> Contributions:
    """Return the contributions to ∫ F |dλ| for an F that is linear between points, zero below and constant
    above them.

    - `log_x`, `log_rate`: ln x and ln λ of the points of the hazard curve, ascending in x, (n,)
    - `x`: points of F, ascending, > 0, (m,); `share`: F there, (m,); `share[0]` must be 0

    Contributions from above the last of `x` count as above the given points.
    """
    k, points = segment_slopes(log_x, log_rate), jnp.exp(log_x)
    ends = jnp.sort(jnp.concatenate([points, x]))
    left, right = ends[:-1], ends[1:]
    middle = 0.5 * (left + right)
    i = jnp.clip(jnp.searchsorted(log_x, jnp.log(middle)) - 1, 0, k.size - 1)
    j = jnp.clip(jnp.searchsorted(x, middle) - 1, 0, x.size - 2)
    within = (middle > x[0]) & (middle < x[-1])
    slope = jnp.where(within, jnp.diff(share)[j] / jnp.diff(x)[j], 0.0)
    offset = jnp.where(within, share[j] - slope * x[j], jnp.where(middle < x[0], 0.0, share[-1]))
    pieces = _linear_piece(left, right, k[i], jnp.exp(log_rate[i] + k[i] * log_x[i]), offset, slope)
    below, above = middle < points[0], middle > jnp.minimum(points[-1], x[-1])
    last = jnp.exp(log_rate_at(log_x, log_rate, jnp.log(ends[-1]))) * share[-1]
    return Contributions(
        jnp.sum(jnp.where(below, pieces, 0.0)),
        jnp.where(below | above, 0.0, pieces),
        last + jnp.sum(jnp.where(above, pieces, 0.0)),
    )


def _linear_piece(a, b, k, k_0, offset, slope):
    """Return ∫ (offset + slope·x) k k₀ x^(−k−1) dx from a to b > a > 0."""
    constant = offset * k_0 * (a**-k - b**-k)
    exponent, width = 1 - k, jnp.log(b / a)
    growth = jnp.where(
        jnp.abs(exponent) < 1e-12,
        width,
        jnp.expm1(exponent * width) / jnp.where(exponent == 0, 1.0, exponent),
    )
    return constant + slope * k * k_0 * a**exponent * growth
