"""Base class of all classes that are pytrees of arrays."""

from __future__ import annotations

from typing import TYPE_CHECKING

import equinox as eqx


class Module(eqx.Module):
    """Equinox's module, but with ordinary methods.

    Equinox returns a pytree whenever a method is looked up. This pytree is not hashable if a field of the
    module is an array, so that `jax.jit(podium.method)` fails, and creating the pytree takes time.
    """

    if not TYPE_CHECKING:
        __getattribute__ = object.__getattribute__
