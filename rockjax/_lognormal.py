"""Lognormal distributions by maximum likelihood: from capacities, some of them censored, and from counts.

Both are smooth in the data, so a fitted median has derivatives with respect to every capacity, by the
implicit function theorem at the maximum.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.stats import norm
from jaxtyping import Array, ArrayLike, Bool, Float
from scipy.special import ndtr

from rockjax._checks import array_module

MIN_DISPERSION = 1e-4  # least dispersion that counts as a fit
# Greatest dispersion that counts as a fit: the 84 % fractile would be e⁶ = 400 times the 16 % fractile.
MAX_DISPERSION = 3.0
MIN_RISE = 1e-9  # least rise of the shares over the levels that is not rounding


class Lognormal(NamedTuple):
    """Lognormal distribution: ln x is normal with mean ln(`median`) and standard deviation `dispersion`; NaN
    if the data do not determine them."""

    median: Float[Array, ""]
    dispersion: Float[Array, ""]

    def probability(self, x: Float[ArrayLike, "*n"]) -> Float[Array, "*n"]:
        """Return P(capacity ≤ x)."""
        numpy = array_module(self, x)
        z = numpy.divide(numpy.log(numpy.divide(x, self.median)), self.dispersion)
        return ndtr(z) if numpy is np else norm.cdf(z)


def fit_capacities(
    capacity: Float[Array, " n"], limit: Float[Array, " n"], weights: Float[Array, " n"] | None = None
) -> Lognormal:
    """Fit a lognormal distribution to capacities; those that are not finite are only known to lie above their
    `limit`.

    - `capacity`: capacities, inf where censored, (n,); `limit`: lower bound of the censored ones, (n,)
    - `weights`: number of times that each counts, (n,), or None for once

    Without censored capacities, median and dispersion are those of the logarithms (with n, not n − 1). At
    least two different capacities are needed. Works under `jit`, `vmap`, `grad` with respect to `capacity`.
    """
    is_observed = jnp.isfinite(capacity)
    w = jnp.ones_like(capacity) if weights is None else weights
    log = jnp.log(jnp.where(is_observed, capacity, limit))
    w_observed = jnp.where(is_observed, w, 0.0)
    total = jnp.sum(w_observed)
    mean = jnp.sum(w_observed * log) / total
    spread = jnp.sqrt(jnp.sum(w_observed * (log - mean) ** 2) / total)
    fits = spread > MIN_DISPERSION

    def loss(y, data):
        log, w = data
        z = (log - y[0]) / jnp.exp(y[1])
        likelihood = jnp.where(is_observed, norm.logpdf(z) - y[1], norm.logsf(z))
        return -jnp.sum(w * likelihood) / jnp.sum(w)

    y, good = _minimise(loss, jnp.stack([mean, jnp.log(spread)]), (log, w), fits)
    return _where_good(good, jnp.exp(y[0]), jnp.exp(y[1]))


def fit_counts(x: Float[Array, " m"], events: Float[Array, " m"], trials: Float[Array, " m"]) -> Lognormal:
    """Fit a lognormal distribution to counts at levels (multiple stripes): binomial, with a probit in ln x.

    - `x`: levels, > 0, (m,); `events`: number of events of `trials` at each level, (m,)

    NaN if the likelihood has no maximum: if all events lie above all others, any dispersion small enough
    fits; if the share does not rise with the level, any that is large enough. The same holds for a dispersion
    above `MAX_DISPERSION`.
    """
    log = jnp.log(x)
    some, spared = events > 0, events < trials
    lowest = jnp.min(jnp.where(some, log, jnp.inf))
    highest = jnp.max(jnp.where(spared, log, -jnp.inf))
    # In offset and slope of the probit the likelihood is concave: its maximum has a slope > 0 exactly if the
    # likelihood rises with the slope from the best curve of slope 0.
    centre = jnp.sum(trials * log) / jnp.sum(trials)
    rise = jnp.sum(events * (log - centre)) / (jnp.sum(trials) * (log[-1] - log[0]))
    fits = jnp.any(some) & jnp.any(spared) & (lowest < highest) & (rise > MIN_RISE)

    def loss(y, data):
        z = y[0] + y[1] * (log - centre)
        events, trials = data
        likelihood = events * norm.logcdf(z) + (trials - events) * norm.logsf(z)
        return -jnp.sum(likelihood) / jnp.sum(trials)

    share = (events + 0.5) / (trials + 1.0)
    slope, offset = jnp.polyfit(log - centre, norm.ppf(share), 1)
    y, good = _minimise(loss, jnp.stack([offset, slope]), (events, trials), fits)
    good = good & (y[1] * MAX_DISPERSION > 1)
    slope = jnp.where(good, y[1], 1.0)
    return _where_good(good, jnp.exp(centre - y[0] / slope), 1 / slope)


def _where_good(good: Bool[Array, ""], median: Float[Array, ""], dispersion: Float[Array, ""]) -> Lognormal:
    return Lognormal(jnp.where(good, median, jnp.nan), jnp.where(good, dispersion, jnp.nan))


def _minimise(misfit, start, data, fits: Bool[Array, ""]) -> tuple[Float[Array, " n"], Bool[Array, ""]]:
    """Return the place at which the gradient of a misfit is zero, and whether there is one."""
    import optimistix as optx  # slow to import, and needed only when a fit is traced

    constant = jax.lax.stop_gradient

    # Solvers and their derivatives raise if there is no solution, so they get another problem to solve.
    def loss(y, data):
        return jnp.where(fits, misfit(y, data), 0.5 * jnp.sum(y**2))

    start = jnp.where(fits, start, 0.0)
    near = optx.minimise(
        loss, optx.BFGS(1e-8, 1e-8), constant(start), constant(data), max_steps=200, throw=False
    )
    gradient = jax.grad(loss)
    # Newton's method refines the result and provides the derivatives.
    found = optx.root_find(gradient, optx.Newton(1e-12, 1e-12), near.value, data, max_steps=20, throw=False)
    y, residual = found.value, gradient(constant(found.value), constant(data))
    good = fits & jnp.all(jnp.abs(residual) < 1e-8) & jnp.all(jnp.isfinite(y))
    return y, good
