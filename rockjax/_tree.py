"""Base class of all classes that are pytrees of arrays."""

from __future__ import annotations

from typing import TYPE_CHECKING

import equinox as eqx


class Module(eqx.Module):
    """Equinox's module, but with ordinary methods.

    Equinox returns a pytree for `podium.method`. If a field of the podium is an array, this pytree is not
    hashable, so that `jax.jit(podium.method)` fails; creating the pytree also takes time.
    """

    if not TYPE_CHECKING:
        __getattribute__ = object.__getattribute__
