"""Argument checks that run before anything is traced.

Every check looks at concrete numbers only: under `jax.jit`, `jax.vmap` or `jax.grad` the value is a tracer,
nothing can be said about it, and the scene reports through its `result` instead.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array


def as_float(x) -> Array:
    """`x` as an array of the default floating-point type (float64 unless the user switched it off)."""
    if isinstance(x, jax.Array) and x.dtype == jnp.result_type(float):
        return x
    if isinstance(x, (str, bytes)) or x is None:
        raise ValueError(f"expected a number or an array of numbers, got {x!r}")
    return jnp.asarray(x, dtype=jnp.result_type(float))


def check_dtype(owner: str, name: str, tree) -> None:
    """Raise a `ValueError` where a tree holds numbers made under another setting of jax_enable_x64 than holds here."""
    expected = jnp.result_type(float)
    for leaf in jax.tree.leaves(tree):
        if isinstance(leaf, jax.Array) and jnp.issubdtype(leaf.dtype, jnp.floating) and leaf.dtype != expected:
            switch = "on" if expected == jnp.float64 else "off"
            raise ValueError(
                f"{owner}: {name} holds {leaf.dtype} numbers, but jax_enable_x64 is {switch} here, so that all numbers are "
                f"{expected}; create the {name} under the same setting"
            )


def concrete(x) -> np.ndarray | None:
    """The value of `x` as NumPy, or None while it is being traced (or is a placeholder in a pytree)."""
    if isinstance(x, Tracer):
        return None
    try:
        return np.asarray(x, dtype=float)
    except (TypeError, ValueError):
        return None


def require(owner: str, name: str, x, ok: Callable[[np.ndarray], np.ndarray], accepted: str) -> None:
    """Raise a `ValueError` that names argument, value and what is accepted, unless every number in `x` is `ok`."""
    if isinstance(x, str | bytes):
        raise ValueError(f"{owner}: {name} must be {accepted}, got the text {name} = {x!r}")
    value = concrete(x)
    if value is None:
        return
    good = np.isfinite(value) & ok(value)
    if not good.all():
        bad = value if value.ndim == 0 else value[~good].ravel()[0]
        raise ValueError(f"{owner}: {name} must be {accepted}, got {name} = {float(bad)!r}")


def positive(owner: str, **arguments) -> None:
    for name, x in arguments.items():
        require(owner, name, x, lambda v: v > 0, "finite and > 0")


def not_negative(owner: str, **arguments) -> None:
    for name, x in arguments.items():
        require(owner, name, x, lambda v: v >= 0, "finite and >= 0")


def finite(owner: str, **arguments) -> None:
    for name, x in arguments.items():
        require(owner, name, x, np.isfinite, "finite")
