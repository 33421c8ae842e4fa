"""A tree of arrays as a few of them.

To pass an array to a compiled program, or to take one from it, costs some µs; in a small batch the hundred
arrays of lanes and answers would take longer than its scenes.
"""

from __future__ import annotations

import functools
import math
from typing import Any, NamedTuple, Self

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

Shape = tuple[int, ...]


class Form(NamedTuple):
    """What a packed tree was."""

    structure: Any
    leaves: tuple[tuple[str, Shape], ...]  # type and shape of each


@jax.tree_util.register_pytree_node_class
class Packed:
    """An array of all numbers of each type in a tree, one leaf after another; a pytree of these arrays."""

    def __init__(self, arrays: tuple[Any, ...], form: Form):
        self.arrays, self.form = arrays, form
        self._tree: Any = None

    def tree_flatten(self) -> tuple[tuple[Any, ...], Form]:
        return self.arrays, self.form

    @classmethod
    def tree_unflatten(cls, form: Form, arrays: Any) -> Self:
        return cls(tuple(arrays), form)

    def tree(self) -> Any:
        """The tree: of NumPy arrays, views where the numbers are on the host, or of traced ones."""
        if self._tree is None:
            self._tree = self._unpacked()
        return self._tree

    def _unpacked(self) -> Any:
        traced = any(isinstance(y, Tracer) for y in self.arrays)
        arrays = self.arrays if traced else [np.asarray(y) for y in self.arrays]
        leaves = [arrays[k][start:end].reshape(shape) for k, start, end, shape in _places(self.form.leaves)]
        return jax.tree.unflatten(self.form.structure, leaves)


def packed(tree: Any) -> Packed:
    """A tree of NumPy arrays, or of traced ones, in a few arrays."""
    leaves, structure = jax.tree.flatten(tree)
    form = Form(structure, tuple((np.dtype(y.dtype).str, y.shape) for y in leaves))
    xp: Any = np if all(isinstance(y, np.ndarray | np.generic) for y in leaves) else jnp
    kinds = _kinds(form.leaves)
    of_kind = lambda kind: [
        xp.ravel(y) for y, (name, _) in zip(leaves, form.leaves, strict=True) if name == kind
    ]
    return Packed(tuple(xp.concatenate(of_kind(kind)) for kind in kinds), form)


def on_host(tree: Any) -> Any:
    """A tree that may be packed, of NumPy arrays."""
    return tree.tree() if isinstance(tree, Packed) else jax.tree.map(np.asarray, tree)


def _kinds(leaves: tuple[tuple[str, Shape], ...]) -> list[str]:
    return sorted({kind for kind, _ in leaves})


@functools.lru_cache(maxsize=256)
def _places(leaves: tuple[tuple[str, Shape], ...]) -> list[tuple[int, int, int, Shape]]:
    """(array, start, end, shape) of each leaf."""
    kinds = _kinds(leaves)
    filled, places = [0] * len(kinds), []
    for kind, shape in leaves:
        k = kinds.index(kind)
        start = filled[k]
        filled[k] += math.prod(shape)
        places.append((k, start, filled[k], shape))
    return places
