"""Base class of the classes of rockjax whose instances are pytrees of arrays."""

from __future__ import annotations

from typing import TYPE_CHECKING

import equinox as eqx


class Module(eqx.Module):
    """Equinox's module, but with ordinary methods.

    In Equinox, a bound method such as `podium.method` is a pytree. If a field of the podium is an array, this
    pytree is not hashable, so that `jax.jit(podium.method)` fails. Creating the pytree also takes time.
    """

    if not TYPE_CHECKING:
        __getattribute__ = object.__getattribute__
