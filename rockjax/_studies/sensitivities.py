"""Logarithmic derivatives of overturning boundaries with respect to named parameters of a podium."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from rockjax import _checks
from rockjax._parameters import variants
from rockjax._parameters.table import clash
from rockjax._structures import Podium


def check_parameters(owner: str, podium: Podium, names: Sequence[str], more: Sequence[str] = ()) -> None:
    """Raise `ValueError` for a name that is no parameter of this podium, nor one of `more`, or for two that
    say the same."""
    names = _checks.texts(owner, "sensitivities", names)
    known = [*variants.parameters_of(podium), *more]
    for name in names:
        if name not in known:
            raise ValueError(f"{owner}: sensitivities must be some of {known} for this podium, got {name!r}")
    twice = clash(names)
    if twice is not None:
        raise ValueError(
            f"{owner}: sensitivities name {twice[0]} and {twice[1]}, of which one at a time can vary"
        )


def varied(podium: Podium, names: Sequence[str], factors: Float[Array, " n"]) -> Podium:
    """The podium with named parameters times factors."""
    return variants.varied(
        podium,
        {name: factor * variants.read(podium, name) for name, factor in zip(names, factors, strict=True)},
    )


def along_boundary(
    footing: Callable[[Float[Array, " n+1"]], Float[Array, ""]], number: int, dtype
) -> Float[Array, " n"]:
    """d ln a/d ln y by the implicit function theorem, NaN where it says nothing.

    `footing` has a zero on the boundary; it is a function of ln a and of `number` logarithms ln y, relative
    to now.
    """
    slope = jax.jacfwd(footing)(jnp.zeros(1 + number, dtype))
    usable = (slope[0] != 0) & jnp.all(jnp.isfinite(slope))
    return jnp.where(usable, -slope[1:] / jnp.where(usable, slope[0], 1.0), jnp.nan)
