"""Lognormal distributions by maximum likelihood: from capacities, some of them beyond a limit, and from
counts.

Both are smooth in the data, so a fitted median has derivatives with respect to every capacity: the implicit
function theorem at the maximum.
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

NARROWEST = 1e-4  # a dispersion smaller than that is none


class Lognormal(NamedTuple):
    """ln x is normal with mean ln(`median`) and standard deviation `dispersion`; NaN where the data do not
    say."""

    median: Float[Array, ""]
    dispersion: Float[Array, ""]

    def probability(self, x: Float[ArrayLike, "*n"]) -> Float[Array, "*n"]:
        """P(capacity ≤ x)."""
        numpy = array_module(self, x)
        z = numpy.divide(numpy.log(numpy.divide(x, self.median)), self.dispersion)
        return ndtr(z) if numpy is np else norm.cdf(z)


def fit_capacities(
    capacity: Float[Array, " n"], limit: Float[Array, " n"], weights: Float[Array, " n"] | None = None
) -> Lognormal:
    """The distribution of capacities, those that are not finite being only known to lie above their `limit`.

    Without any of these, median and dispersion are those of the logarithms (with n, not n − 1). `weights`
    count data several times, or not at all. At least two different capacities are needed. Under `jit`,
    `vmap`, `grad` with respect to `capacity`.
    """
    known = jnp.isfinite(capacity)
    w = jnp.ones_like(capacity) if weights is None else weights
    log = jnp.log(jnp.where(known, capacity, limit))
    w_known = jnp.where(known, w, 0.0)
    total = jnp.sum(w_known)
    mean = jnp.sum(w_known * log) / total
    spread = jnp.sqrt(jnp.sum(w_known * (log - mean) ** 2) / total)
    fits = spread > NARROWEST

    def loss(y, data):
        log, w = data
        z = (log - y[0]) / jnp.exp(y[1])
        likelihood = jnp.where(known, norm.logpdf(z) - y[1], norm.logsf(z))
        return -jnp.sum(w * likelihood) / jnp.sum(w)

    return _fitted(loss, jnp.stack([mean, jnp.log(spread)]), (log, w), fits)


def fit_counts(x: Float[Array, " m"], events: Float[Array, " m"], trials: Float[Array, " m"]) -> Lognormal:
    """The distribution behind `events` of `trials` at levels x (multiple stripes): binomial, with a probit in
    ln x.

    Needs levels of overlap: where all events lie above all others, any dispersion small enough fits and the
    result is NaN.
    """
    log = jnp.log(x)
    some, spared = events > 0, events < trials
    lowest = jnp.min(jnp.where(some, log, jnp.inf))
    highest = jnp.max(jnp.where(spared, log, -jnp.inf))
    fits = jnp.any(some) & jnp.any(spared) & (lowest < highest)
    # Where to begin: the levels around which the shares change.
    share = (events + 0.5) / (trials + 1.0)
    slope, offset = jnp.polyfit(log, norm.ppf(share), 1)
    slope = jnp.where(slope > 0.1, slope, 1.0)
    middle = -offset / slope

    def loss(y, data):
        z = (log - y[0]) / jnp.exp(y[1])
        events, trials = data
        likelihood = events * norm.logcdf(z) + (trials - events) * norm.logsf(z)
        return -jnp.sum(likelihood) / jnp.sum(trials)

    start = jnp.stack([jnp.clip(middle, log[0] - 2, log[-1] + 2), -jnp.log(slope)])
    return _fitted(loss, start, (events, trials), fits)


def _fitted(misfit, start, data, fits: Bool[Array, ""]) -> Lognormal:
    """The maximum of a likelihood in (ln median, ln dispersion): where its gradient is zero."""
    import optimistix as optx  # which takes long to import, and is needed only where a fit is traced

    constant = jax.lax.stop_gradient

    # Solvers raise where there is nothing to find, and so do derivatives: they get something else to find.
    def loss(y, data):
        return jnp.where(fits, misfit(y, data), 0.5 * jnp.sum(y**2))

    start = jnp.where(fits, start, 0.0)
    near = optx.minimise(
        loss, optx.BFGS(1e-8, 1e-8), constant(start), constant(data), max_steps=200, throw=False
    )
    gradient = jax.grad(loss)
    # Newton finishes, and gives the derivatives.
    found = optx.root_find(gradient, optx.Newton(1e-12, 1e-12), near.value, data, max_steps=20, throw=False)
    y, residual = found.value, gradient(constant(found.value), constant(data))
    good = fits & jnp.all(jnp.abs(residual) < 1e-8) & jnp.all(jnp.isfinite(y))
    return Lognormal(jnp.where(good, jnp.exp(y[0]), jnp.nan), jnp.where(good, jnp.exp(y[1]), jnp.nan))
