"""The parameters of a grid of scenes as arrays, and the arguments of the solver for a part of the grid.

A scene is one structure under one ground motion. A leaf is an array of a JAX pytree.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple, Self

import jax
import numpy as np

from rockjax._batch.scenes import axes_of, own_dimensions

ARGUMENT_NAMES = ("structures", "excitations", "initial", "t_end")
Arguments = tuple[Any, Any, Any, Any]  # (structures, excitations, initial, t_end)


class SceneArrays(NamedTuple):
    """The leaves of (structures, excitations, initial, t_end) of a grid of scenes.

    - `arrays`: leaves by name, as arrays or objects that can be sliced like arrays. The first axes of a leaf
      are the axes of the grid, each of full length or of length 1. A leaf that all scenes share has no axes
      of the grid. The last axes belong to a single scene, such as the axis of a record's samples
    - `skeleton`: (structures, excitations, initial, t_end) with names in place of the leaves
    - `shape`: number of scenes along each axis of the grid
    """

    arrays: Mapping[str, Any]
    skeleton: Arguments
    shape: tuple[int, ...]

    @classmethod
    def from_arguments(cls, owner: str, structures, excitations, initial, t_end) -> Self:
        """Collect the leaves of the arguments of a batch of scenes.

        - `owner`: name of the public function, for error messages
        - `structures`, `excitations`, `initial`, `t_end`: arguments whose arrays broadcast to the shape of
          the grid

        Raises `ValueError` for arrays that do not broadcast or contain no scene.
        """
        arguments = (structures, excitations, initial, t_end)
        paths, treedef = jax.tree_util.tree_flatten_with_path(arguments)
        names = [ARGUMENT_NAMES[path[0].idx] + jax.tree_util.keystr(path[1:]) for path, _ in paths]
        leaves = [np.asarray(y) for _, y in paths]
        batch_shapes, shape = axes_of(owner, leaves, own_dimensions(treedef, excitations))
        if not shape:  # a single scene becomes a grid of shape (1,)
            shape, batch_shapes[0], leaves[0] = (1,), (1,), leaves[0][None]
        arrays = {
            name: y.reshape((1,) * (len(shape) - len(batch)) + y.shape) if batch else y
            for name, y, batch in zip(names, leaves, batch_shapes, strict=True)
        }
        return cls(arrays, jax.tree.unflatten(treedef, names), shape)

    @property
    def size(self) -> int:
        """Number of scenes."""
        return int(np.prod(self.shape, dtype=np.int64))

    def _scene_ndims(self) -> dict[str, int]:
        """Return, by name, how many axes of each leaf belong to a single scene and not to the grid."""
        ndims = own_dimensions(jax.tree.structure(self.skeleton), self.skeleton[1])
        return dict(zip(jax.tree.leaves(self.skeleton), ndims, strict=True))

    def _has_grid_axes(self, name: str, ndim: int) -> bool:
        return self.arrays[name].ndim > ndim

    def _arguments(self, select) -> Arguments:
        """Return the arguments, with `select` applied to every leaf that has axes of the grid."""
        values = [
            np.asarray(
                select(self.arrays[name], ndim) if self._has_grid_axes(name, ndim) else self.arrays[name][...]
            )
            for name, ndim in self._scene_ndims().items()
        ]
        return jax.tree.unflatten(jax.tree.structure(self.skeleton), values)

    def in_box(self, box: tuple[slice, ...]) -> Arguments:
        """Return the arguments of the scenes in a box: a slice of each axis of the grid."""

        def select(y, ndim: int):
            axes = y.shape[: y.ndim - ndim]
            return y[tuple(span if n > 1 else slice(0, 1) for span, n in zip(box, axes, strict=True))]

        return self._arguments(select)

    def at(self, scenes: np.ndarray) -> Arguments:
        """Return the arguments of the scenes with these flat indices, as a batch of shape (scenes,)."""
        indices = np.unravel_index(scenes, self.shape)

        def select(y, ndim: int):
            axes = y.shape[: y.ndim - ndim]
            return y[tuple(j if n > 1 else np.zeros_like(j) for j, n in zip(indices, axes, strict=True))]

        return self._arguments(select)

    def varying(self) -> dict[str, np.ndarray]:
        """Return the scalar parameters that vary between scenes, with the axes of the grid."""
        return {
            name: self.arrays[name]
            for name, ndim in self._scene_ndims().items()
            if ndim == 0 and self._has_grid_axes(name, ndim)
        }

    def common(self) -> dict[str, np.ndarray]:
        """Return the scalar parameters that all scenes share."""
        return {
            name: self.arrays[name]
            for name, ndim in self._scene_ndims().items()
            if ndim == 0 and not self._has_grid_axes(name, ndim)
        }
