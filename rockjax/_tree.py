"""The base of all classes whose numbers JAX sees."""

from __future__ import annotations

from typing import TYPE_CHECKING

import equinox as eqx


class Module(eqx.Module):
    """Equinox's module with the methods of any other class.

    Equinox makes a pytree of a method whenever it is looked up. Such a method has no hash where a number of
    its module is an array, so that `jax.jit(podium.method)` fails; and each look-up costs time.
    """

    if not TYPE_CHECKING:
        __getattribute__ = object.__getattribute__
