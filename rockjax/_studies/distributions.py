"""Distributions of parameters, and random draws of their values."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from rockjax._checks import as_float, format_value
from rockjax._parameters.registry import Range
from rockjax._problem import models


def distribution_of(entry: Any) -> Any:
    """Return the `scipy.stats` distribution of an entry of the table `[ensemble.spread]` of a problem file.
    A number is returned unchanged."""
    from scipy import stats

    if isinstance(entry, models.Uniform):
        return stats.uniform(entry.low, entry.high - entry.low)
    if isinstance(entry, models.LognormalSpread):
        dispersion = entry.dispersion or math.sqrt(math.log1p((entry.cov or 0.0) ** 2))
        return stats.lognorm(dispersion, scale=entry.median)
    if not isinstance(entry, models.Normal):
        return entry
    std = entry.std or (entry.cov or 0.0) * abs(entry.mean)
    low, high = -math.inf if entry.low is None else entry.low, math.inf if entry.high is None else entry.high
    return stats.truncnorm((low - entry.mean) / std, (high - entry.mean) / std, entry.mean, std)


def generator(seed: int, name: str) -> np.random.Generator:
    """Return the random-number generator of a parameter, seeded by `seed` and the parameter's name."""
    return np.random.default_rng([seed, *name.encode()])


def draw(owner: str, name: str, given: Any, n: int, seed: int, allowed: Range) -> np.ndarray:
    """Draw n values of a parameter, shape (n,).

    - `owner`, `name`: names of the calling function and of the parameter, for messages
    - `given`: a frozen distribution of `scipy.stats`, a number, or the draws themselves, shape (n,)
    - `n`, `seed`: number of draws, and seed of the random numbers
    - `allowed`: range of valid values

    Raises `ValueError` if `given` has another type or shape, or if a draw is not finite or outside `allowed`.
    """
    argument = f"{owner}: spread[{name!r}]"
    is_frozen = hasattr(given, "rvs") and hasattr(given, "dist")
    try:
        values = given.rvs(size=n, random_state=generator(seed, name)) if is_frozen else given
        drawn = np.asarray(as_float(values), float)
    except (TypeError, ValueError):
        drawn = None
    if drawn is None or drawn.shape not in ((), (n,)):
        got = format_value(given) if drawn is None else f"an array of shape {drawn.shape}"
        raise ValueError(
            f"{argument} must be a frozen distribution such as scipy.stats.norm(0.15, 0.01), a number, or "
            f"{n} draws, got {got}"
        )
    drawn = np.broadcast_to(drawn, (n,))
    outside = ~(np.isfinite(drawn) & allowed.holds(drawn))
    if outside.any():
        accepted = allowed.text if allowed.text.startswith("in") else f"finite and {allowed.text}"
        raise ValueError(
            f"{argument} must be {accepted.removesuffix(' and ')}, but {outside.sum()} of {n} draws are not "
            f"(the first is {drawn[outside][0]:.6g}); use a truncated distribution (scipy.stats.truncnorm)"
        )
    return drawn
