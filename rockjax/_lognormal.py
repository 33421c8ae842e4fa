"""Lognormal distributions, and their maximum-likelihood fits to capacities and to counts of events.

A capacity is the intensity at which an event, such as overturning, first occurs under one motion. Counts are
the numbers of motions that cause the event, at several intensity levels. Fits are differentiable with respect
to the data: the implicit function theorem, applied at the maximum of the likelihood, gives the derivatives.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.stats import norm
from jaxtyping import Array, ArrayLike, Bool, Float

from rockjax._checks import array_module

MIN_DISPERSION = 1e-4  # capacities with a smaller dispersion have no fit
# Counts with a larger dispersion have no fit: the 84 % fractile would be e⁶ = 400 times the 16 % fractile.
MAX_DISPERSION = 3.0
MIN_RISE = 1e-9  # a value of `rise` (see `fit_counts`) up to this counts as rounding


class Lognormal(NamedTuple):
    """Lognormal distribution: ln x is normal with mean ln(`median`) and standard deviation `dispersion`.

    Both numbers are NaN if a fit fails.
    """

    median: Float[Array, ""]
    dispersion: Float[Array, ""]

    def probability(self, x: Float[ArrayLike, "*n"]) -> Float[Array, "*n"]:
        """Return the probability P(capacity ≤ x) [–]."""
        xp = array_module(self, x)
        z = xp.divide(xp.log(xp.divide(x, self.median)), self.dispersion)
        if xp is not np:
            return norm.cdf(z)
        from scipy.special import ndtr  # slow to import

        return ndtr(z)


def fit_capacities(capacity: Float[Array, " n"], limit: Float[Array, " n"]) -> Lognormal:
    """Fit a lognormal distribution to capacities. Some capacities may be censored, which means that only
    a lower bound is known.

    - `capacity`: capacities > 0, shape (n,); inf for a censored capacity
    - `limit`: lower bounds of the censored capacities, shape (n,); other elements are ignored

    Without censored capacities, ln(median) is the mean of the logarithms of the capacities, and the
    dispersion is their standard deviation with the divisor n. The result is NaN if fewer than two capacities
    are observed (not censored), if the dispersion of the observed capacities is at most `MIN_DISPERSION`, or
    if the search fails. The function works under `jit`, `vmap` and `grad` with respect to `capacity`.
    """
    is_observed = jnp.isfinite(capacity)
    log = jnp.log(jnp.where(is_observed, capacity, limit))
    _, spread = _moments(log, jnp.where(is_observed, 1.0, 0.0))
    has_fit = spread > MIN_DISPERSION
    # The fit uses (ln x − centre)/scale. `centre` and `scale` are the mean and the standard deviation of ln x
    # with each censored capacity at its bound. The scale of the data then has no effect on the search.
    centre, scale = jax.lax.stop_gradient(_moments(log, jnp.ones_like(log)))
    scale = jnp.where(has_fit, scale, 1.0)

    def loss(y, log):  # y = (mean, ln of the standard deviation) of (ln x − centre)/scale
        z = ((log - centre) / scale - y[0]) / jnp.exp(y[1])
        likelihood = jnp.where(is_observed, norm.logpdf(z) - y[1], norm.logsf(z))
        return -jnp.mean(likelihood)

    y, converged = _minimise(loss, jnp.zeros(2), log, has_fit)
    return _lognormal_where(converged, jnp.exp(centre + scale * y[0]), scale * jnp.exp(y[1]))


def _moments(x: Float[Array, " n"], weight: Float[Array, " n"]) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Return the weighted mean and standard deviation."""
    total = jnp.sum(weight)
    mean = jnp.sum(weight * x) / total
    return mean, jnp.sqrt(jnp.sum(weight * (x - mean) ** 2) / total)


def fit_counts(x: Float[Array, " m"], events: Float[Array, " m"], trials: Float[Array, " m"]) -> Lognormal:
    """Fit a lognormal distribution to counts at several intensity levels (multiple stripes).

    The probability of the event at the level x is Φ(ln(x/median)/dispersion), with the standard normal
    distribution Φ. The fit maximises the binomial likelihood of the counts.

    - `x`: levels, > 0, ascending, shape (m,)
    - `events`: number of motions that cause the event, at each level, shape (m,)
    - `trials`: number of all motions at each level, shape (m,)

    The result is NaN if the likelihood has no maximum, if the dispersion exceeds `MAX_DISPERSION`, or if the
    search fails. The likelihood has no maximum in three cases:

    - All motions or none cause the event.
    - The lowest level with an event is not below the highest level at which a motion does not cause the
      event.
    - The share of events does not increase with the level.
    """
    log = jnp.log(x)
    has_events, has_others = events > 0, events < trials
    lowest = jnp.min(jnp.where(has_events, log, jnp.inf))
    highest = jnp.max(jnp.where(has_others, log, -jnp.inf))
    # With the probability Φ(offset + slope·(ln x − centre)), the log-likelihood is a concave function of
    # offset and slope. The maximum is therefore at a slope > 0 if and only if, at the best curve of slope 0,
    # the log-likelihood increases with the slope. `rise` has the sign of this increase.
    centre = jnp.sum(trials * log) / jnp.sum(trials)
    rise = jnp.sum(events * (log - centre)) / (jnp.sum(trials) * (log[-1] - log[0]))
    has_fit = jnp.any(has_events) & jnp.any(has_others) & (lowest < highest) & (rise > MIN_RISE)

    def loss(y, data):  # y = (offset, slope)
        z = y[0] + y[1] * (log - centre)
        events, trials = data
        likelihood = events * norm.logcdf(z) + (trials - events) * norm.logsf(z)
        return -jnp.sum(likelihood) / jnp.sum(trials)

    # The search starts from a straight line fitted to the probits Φ⁻¹(share of events). Half an event and
    # half a trial without event are added at each level, so that the probits are finite.
    share = (events + 0.5) / (trials + 1.0)
    slope, offset = jnp.polyfit(log - centre, norm.ppf(share), 1)
    y, converged = _minimise(loss, jnp.stack([offset, slope]), (events, trials), has_fit)
    is_valid = converged & (y[1] * MAX_DISPERSION > 1)
    slope = jnp.where(is_valid, y[1], 1.0)
    return _lognormal_where(is_valid, jnp.exp(centre - y[0] / slope), 1 / slope)


def _lognormal_where(
    is_valid: Bool[Array, ""], median: Float[Array, ""], dispersion: Float[Array, ""]
) -> Lognormal:
    """Return the distribution; its parameters are NaN unless `is_valid`."""
    return Lognormal(jnp.where(is_valid, median, jnp.nan), jnp.where(is_valid, dispersion, jnp.nan))


def _minimise(misfit, start, data, has_fit: Bool[Array, ""]) -> tuple[Float[Array, " n"], Bool[Array, ""]]:
    """Return the point at which the gradient of a misfit is zero, and whether the search has found it.

    - `misfit`: (y, data) ↦ misfit, for the parameters y of a distribution, shape (n,)
    - `start`: initial y
    - `data`: pytree of the data
    - `has_fit`: whether the misfit has a minimum
    """
    import optimistix as optx  # slow to import, and needed only when a fit is traced

    constant = jax.lax.stop_gradient

    # If the misfit has no minimum, ½|y|² is minimised instead, because otherwise the solvers would fail.
    def loss(y, data):
        return jnp.where(has_fit, misfit(y, data), 0.5 * jnp.sum(y**2))

    start = jnp.where(has_fit, start, 0.0)
    approximate = optx.minimise(
        loss, optx.BFGS(1e-8, 1e-8), constant(start), constant(data), max_steps=200, throw=False
    )
    gradient = jax.grad(loss)

    def refine(gradient_at, y):
        newton = optx.Newton(1e-12, 1e-12)
        return optx.root_find(lambda y, _: gradient_at(y), newton, y, max_steps=20, throw=False).value

    # Derivatives of the root are NaN if those of the data are; Optimistix would raise an error instead.
    solve = lambda linear, y: jnp.linalg.solve(jax.jacobian(linear)(y), y)
    y = jax.lax.custom_root(lambda y: gradient(y, data), approximate.value, refine, solve)
    residual = gradient(constant(y), constant(data))
    return y, has_fit & jnp.all(jnp.abs(residual) < 1e-8) & jnp.all(jnp.isfinite(y))
