"""Logarithmic derivatives of overturning boundaries with respect to named parameters of a podium."""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from rockjax._checks import texts
from rockjax._structures import Elastic, GivenRestitution, Podium

PARAMETERS = {
    "alpha": "alpha",
    "R": "R",
    "gamma": "gamma",
    "lam": "lam",
    "eta": "superstructure.eta",
    "T_s": "superstructure.T_s",
    "zeta": "superstructure.zeta",
    "restitution": "restitution.e",
}


def check_parameters(owner: str, podium: Podium, names: Sequence[str], more: Sequence[str] = ()) -> None:
    """Raise `ValueError` for a name that is no parameter of this podium, nor one of `more`."""
    known = ["alpha", "R", "gamma", "lam", *more]
    known += ["eta"] if podium.superstructure is not None else []
    known += ["T_s", "zeta"] if isinstance(podium.superstructure, Elastic) else []
    known += ["restitution"] if isinstance(podium.restitution, GivenRestitution) else []
    for name in texts(owner, "sensitivities", names):
        if name not in known:
            raise ValueError(f"{owner}: sensitivities must be some of {known} for this podium, got {name!r}")


def varied(podium: Podium, names: Sequence[str], factors: Float[Array, " n"]) -> Podium:
    """The podium with named parameters times factors."""
    for name, factor in zip(names, factors, strict=True):
        where = operator.attrgetter(PARAMETERS[name])
        podium = eqx.tree_at(where, podium, replace_fn=lambda y, factor=factor: y * factor)
    return podium


def along_boundary(footing: Callable[[Float[Array, " n+1"]], Float[Array, ""]], number: int, dtype) -> Float[Array, " n"]:
    """d ln a/d ln y by the implicit function theorem, NaN where it says nothing.

    `footing` has a zero on the boundary; it is a function of ln a and of `number` logarithms ln y, relative to now.
    """
    slope = jax.jacfwd(footing)(jnp.zeros(1 + number, dtype))
    usable = (slope[0] != 0) & jnp.all(jnp.isfinite(slope))
    return jnp.where(usable, -slope[1:] / jnp.where(usable, slope[0], 1.0), jnp.nan)
