"""The base of all classes whose numbers JAX sees."""

from __future__ import annotations

from typing import TYPE_CHECKING

import equinox as eqx


class Module(eqx.Module):
    """Equinox's module with the methods of any other class.

    Equinox makes a pytree of a method whenever it is looked up, so that it can be an argument of a compiled
    function. That takes .05 ms, which small batches feel, and nothing here needs it.
    """

    if not TYPE_CHECKING:
        __getattribute__ = object.__getattribute__
