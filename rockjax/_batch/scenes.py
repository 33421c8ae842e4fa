"""Batches of scenes: the arguments of all scenes after broadcasting, stored without repetition.

A scene is one podium under one motion. A chunk is a set of scenes that are prepared together, and a lane
solves one scene of a chunk after another.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from rockjax._excitations.base import AbstractExcitation
from rockjax._excitations.pulses import AbstractPulse
from rockjax._responses.arguments import as_end, as_start
from rockjax._results import State
from rockjax._structures import Podium

MAX_SORTED_SCENES = 4096  # largest batch that is sorted (see `_order`); larger batches would gain little
# If a leaf has more values per scene than this number, such as the samples of a record, each lane solves only
# one scene of a chunk.
MAX_REFILL_VALUES = 64


class SceneIndices(NamedTuple):
    """Indices of the scenes of a chunk in the batch: first, first + stride, …"""

    first: Any  # index of the first scene
    stride: Any  # difference of successive indices
    scenes: Any  # number of scenes

    def at(self, position):
        """Return the index of the scene at a position of the chunk."""
        return self.first + self.stride * position

    def split(self, devices: int) -> SceneIndices:
        """Return the indices for each device, as arrays. Successive scenes go to different devices."""
        device = np.arange(devices)
        scenes_per_device = np.maximum(0, -(-(self.scenes - device) // devices))
        return SceneIndices(self.at(device), self.stride * devices, scenes_per_device)


NO_SCENES = SceneIndices(0, 1, 0)


class SceneBatch(NamedTuple):
    """All scenes of a batch, as leaves of (podium, excitation, initial, t_end). The scenes form a grid with
    the shape to which the arguments broadcast."""

    leaves: list[Any]  # distinct rows along the first axis; a leaf that all scenes share has no axis of rows
    # For each leaf, the index of the row of each scene of the grid; None for a leaf that all scenes share.
    rows: list[np.ndarray | None]
    structure: Any  # tree structure of the leaves
    total: int  # number of scenes
    # Position in the grid of the k-th scene to solve; None if scenes are solved in the order of the grid.
    order: np.ndarray | None = None

    @property
    def axes(self) -> tuple[int | None, ...]:
        """For each leaf, 0 if it has rows, None if all scenes share it."""
        return tuple(None if rows is None else 0 for rows in self.rows)

    @property
    def podium(self) -> Podium:
        """Podium with arrays for parameters that differ between scenes."""
        return jax.tree.unflatten(self.structure, self.leaves)[0]

    @property
    def is_quick(self) -> bool:
        """True if scenes take only a few steps: the superstructure is rigid or absent, and the motion is
        a pulse."""
        podium, excitation, *_ = jax.tree.unflatten(self.structure, self.leaves)
        return isinstance(excitation, AbstractPulse) and not podium.vibrates

    @property
    def values_per_scene(self) -> int:
        """Largest number of values in one leaf that belong to a single scene."""
        return max(y[0].size for y, rows in zip(self.leaves, self.rows, strict=True) if rows is not None)

    @property
    def is_wide(self) -> bool:
        """True if scenes have so much data that a lane solves only one scene of a chunk
        (`MAX_REFILL_VALUES`)."""
        return self.values_per_scene > MAX_REFILL_VALUES

    def in_grid(self, scene_indices: np.ndarray) -> np.ndarray:
        """Return the positions of scenes in the grid, in C order."""
        return scene_indices if self.order is None else self.order[scene_indices]

    def leaves_of_chunk(self, indices: SceneIndices, size: int, devices: int = 1) -> list[Any]:
        """Return the leaves for the scenes of a chunk, in the order of the devices.

        - `indices`: indices of the scenes in the batch
        - `size`: number of rows for each device; unused rows repeat a scene and are not solved
        - `devices`: number of devices. Successive scenes go to different devices
        """
        position = np.arange(size)
        if devices > 1:
            position = (np.arange(devices)[:, None] + devices * position).ravel()
        scene_indices = indices.at(np.where(position < indices.scenes, position, 0))
        grid_positions = self.in_grid(np.minimum(scene_indices, self.total - 1))
        return [
            y if rows is None else y[_take(rows, grid_positions)]
            for y, rows in zip(self.leaves, self.rows, strict=True)
        ]


def _take(rows: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Compute `rows.flat[positions]`, faster than NumPy if `rows` is contiguous."""
    return rows.reshape(-1)[positions] if rows.flags.c_contiguous else rows.flat[positions]


def broadcast(
    owner: str, podiums: Podium, excitations: AbstractExcitation, initial: State, t_end
) -> tuple[SceneBatch, tuple[int, ...]]:
    """Broadcast the arguments. Return all scenes, and the shape of the grid.

    - `owner`: name of the calling function, for messages
    - `podiums`, `excitations`: structures and ground motions
    - `initial`: initial states
    - `t_end`: ends of the scenes [s]; None for the default end of each scene

    Raises `ValueError` for arrays that do not broadcast or are empty.
    """
    excitations = excitations.common_form()
    arguments = podiums.split_rows(), excitations, as_start(owner, initial, podiums), as_end(owner, t_end)
    leaves, structure = jax.tree.flatten(arguments)
    outer, shape = axes_of(owner, leaves, own_dimensions(structure, excitations))
    if not any(outer):
        outer[0], leaves[0] = (1,), leaves[0][None]  # one scene is a batch of one
    rows: list[np.ndarray | None] = []
    for k, leaf_shape in enumerate(outer):
        if not leaf_shape:
            rows.append(None)
            continue
        # Every row is stored once, however many scenes use it.
        index = np.arange(math.prod(leaf_shape), dtype=np.int32).reshape(leaf_shape)
        rows.append(index if leaf_shape == shape else np.broadcast_to(index, shape or leaf_shape))
        leaves[k] = np.asarray(leaves[k]).reshape(-1, *leaves[k].shape[len(leaf_shape) :])
    total = math.prod(shape)
    return SceneBatch(leaves, rows, structure, total, _order(excitations, shape)), shape


def _order(excitations: AbstractExcitation, shape: tuple[int, ...]) -> np.ndarray | None:
    """Return the positions of the scenes in the grid, sorted by the strength of their motions, weak motions
    first. Return None for large grids, for a single strength, and for motions without a strength.

    Scenes under strong motions end early, because the columns overturn soon. Scenes in which the motion just
    lifts the columns take longest. If strong motions come last, few lanes are therefore idle at the end of
    a batch.
    """
    if math.prod(shape) > MAX_SORTED_SCENES:
        return None
    strength = excitations.strength()
    if strength is None or np.size(strength) == 1:
        return None
    return np.argsort(np.broadcast_to(strength, shape), axis=None, kind="stable")


def axes_of(
    owner: str, leaves: Sequence[Any], own: Sequence[int]
) -> tuple[list[tuple[int, ...]], tuple[int, ...]]:
    """Return the lengths of the grid's axes in each leaf, and the shape of the grid.

    - `owner`: name of the calling function, for messages
    - `leaves`: arrays
    - `own`: number of last axes of each array that belong to a single scene

    Raises `ValueError` for arrays that do not broadcast or are empty.
    """
    outer = [y.shape[: y.ndim - n] for y, n in zip(leaves, own, strict=True)]
    try:
        shape = np.broadcast_shapes(*outer)
    except ValueError as error:
        raise ValueError(f"{owner}: the arrays in the arguments do not broadcast: {error}") from None
    if 0 in shape:
        raise ValueError(
            f"{owner}: the arrays in the arguments must not be empty; they broadcast to the shape {shape}"
        )
    return outer, shape


def own_dimensions(structure, excitations: AbstractExcitation) -> list[int]:
    """Return, for each leaf, the number of axes that belong to a single scene, such as the axis of a record's
    samples."""
    if not excitations.own_dimensions:
        return [0] * structure.num_leaves
    # A tree like the arguments, with the number of axes in place of each leaf. The objects in the tree are
    # frozen, so ordinary assignment to their fields is impossible.
    podium, motion, *rest = jax.tree.unflatten(structure, [0] * structure.num_leaves)
    for name, dimensions in excitations.own_dimensions.items():
        *path, field = name.split(".")
        object.__setattr__(functools.reduce(getattr, path, motion), field, dimensions)
    return jax.tree.leaves((podium, motion, *rest))
