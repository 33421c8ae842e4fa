"""Batches of scenes: broadcast arguments, with every distinct row stored once."""

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

SORTED = 4096  # scenes; larger batches gain little from sorting, which shortens the end of a batch
WIDE = 64  # own numbers in one leaf, above which a scene (with its record) is not moved between lanes


class Numbers(NamedTuple):
    """Numbers of the scenes in a chunk: first, first + stride, …, `scenes` of them."""

    first: Any
    stride: Any
    scenes: Any

    def of(self, place):
        return self.first + self.stride * place

    def dealt(self, devices: int) -> Numbers:
        """Return the numbers for each device, in arrays, with scenes dealt out in turn."""
        device = np.arange(devices)
        share = np.maximum(0, -(-(self.scenes - device) // devices))
        return Numbers(self.of(device), self.stride * devices, share)


NOTHING = Numbers(0, 1, 0)


class SceneBatch(NamedTuple):
    """The leaves of (podium, excitation, initial, t_end), some of them with a row for every scene."""

    leaves: list[Any]
    # Row of each leaf for every scene of the grid; None for a leaf common to all.
    rows: list[np.ndarray | None]
    structure: Any
    total: int
    order: np.ndarray | None = None  # place in the grid of the first, second, … scene; None for grid order

    @property
    def axes(self) -> tuple[int | None, ...]:
        return tuple(None if rows is None else 0 for rows in self.rows)

    @property
    def podium(self) -> Podium:
        """Podium of all scenes; numbers that differ are rows."""
        return jax.tree.unflatten(self.structure, self.leaves)[0]

    @property
    def quick(self) -> bool:
        """True if scenes take only a few steps: the podium is rigid, and the motion is a pulse."""
        podium, excitation, *_ = jax.tree.unflatten(self.structure, self.leaves)
        return isinstance(excitation, AbstractPulse) and not podium.vibrates

    @property
    def numbers(self) -> int:
        """Largest number of values in one leaf that belong to a single scene."""
        return max(y[0].size for y, rows in zip(self.leaves, self.rows, strict=True) if rows is not None)

    @property
    def wide(self) -> bool:
        return self.numbers > WIDE

    def in_grid(self, which: np.ndarray) -> np.ndarray:
        """Return the places of scenes in the grid, in C order."""
        return which if self.order is None else self.order[which]

    def part(self, numbers: Numbers, size: int, devices: int = 1) -> list[Any]:
        """Return the leaves of some scenes, dealt out to the devices in turn.

        The parts of the devices follow each other, each padded to the compiled size with copies that never
        run.
        """
        place = np.arange(size)
        if devices > 1:
            place = (np.arange(devices)[:, None] + devices * place).ravel()
        which = numbers.of(np.where(place < numbers.scenes, place, 0))
        which = self.in_grid(np.minimum(which, self.total - 1))
        return [
            y if rows is None else y[_picked(rows, which)]
            for y, rows in zip(self.leaves, self.rows, strict=True)
        ]


def _picked(rows: np.ndarray, which: np.ndarray) -> np.ndarray:
    """Return some of the rows, by their places in C order, as `rows.flat[which]`, which is slower for
    contiguous rows."""
    return rows.reshape(-1)[which] if rows.flags.c_contiguous else rows.flat[which]


def broadcast(
    owner: str, podiums: Podium, excitations: AbstractExcitation, initial: State, t_end
) -> tuple[SceneBatch, tuple[int, ...]]:
    """Return all scenes of the arguments, and the shape of their grid.

    - `owner`: name for error messages
    - `podiums`, `excitations`: structures and ground motions
    - `initial`, `t_end`: initial states, and ends of the scenes [s] or None

    Raises `ValueError`, in the name of `owner`, for arrays that do not broadcast or are empty.
    """
    excitations = excitations.common_form()
    arguments = podiums.split(), excitations, as_start(owner, initial, podiums), as_end(owner, t_end)
    leaves, structure = jax.tree.flatten(arguments)
    outer, shape = axes_of(owner, leaves, own_dimensions(structure, excitations))
    if not any(outer):
        outer[0], leaves[0] = (1,), leaves[0][None]  # one scene is a batch of one
    rows: list[np.ndarray | None] = []
    for k, batch in enumerate(outer):
        if not batch:
            rows.append(None)
            continue
        # A row is stored once, however many scenes share it.
        index = np.arange(math.prod(batch), dtype=np.int32).reshape(batch)
        rows.append(index if batch == shape else np.broadcast_to(index, shape or batch))
        leaves[k] = np.asarray(leaves[k]).reshape(-1, *leaves[k].shape[len(batch) :])
    total = math.prod(shape)
    return SceneBatch(leaves, rows, structure, total, _order(excitations, shape)), shape


def _order(excitations: AbstractExcitation, shape: tuple[int, ...]) -> np.ndarray | None:
    """Return the scenes of a grid ordered by the strength of their motions, weak ones first; None for large
    grids or equal strengths.

    Motions that just lift the columns rock them longest, and strong ones overturn them soon. With strong
    motions last, few lanes stay idle beside a few long scenes at the end.
    """
    if math.prod(shape) > SORTED:
        return None
    strength = excitations.strength()
    if strength is None or np.size(strength) == 1:
        return None
    return np.argsort(np.broadcast_to(strength, shape), axis=None, kind="stable")


def axes_of(
    owner: str, leaves: Sequence[Any], own: Sequence[int]
) -> tuple[list[tuple[int, ...]], tuple[int, ...]]:
    """Return the axes of the grid that each leaf has, and the shape of the grid.

    Raises `ValueError`, in the name of `owner`, for arrays that do not broadcast or are empty.
    """
    outer = [y.shape[: y.ndim - n] for y, n in zip(leaves, own, strict=True)]
    try:
        shape = np.broadcast_shapes(*outer)
    except ValueError as error:
        raise ValueError(f"{owner}: the arrays in the arguments do not broadcast: {error}") from None
    if 0 in shape:
        raise ValueError(f"{owner}: the arrays in the arguments hold no scene, their shape is {shape}")
    return outer, shape


def own_dimensions(structure, excitations: AbstractExcitation) -> list[int]:
    """Return the number of axes of each leaf that belong to one scene: those of a record's samples, else
    none."""
    if not excitations.own_dimensions:
        return [0] * structure.num_leaves
    podium, motion, *rest = jax.tree.unflatten(structure, [0] * structure.num_leaves)
    for name, dimensions in excitations.own_dimensions.items():
        *path, field = name.split(".")
        object.__setattr__(functools.reduce(getattr, path, motion), field, dimensions)
    return jax.tree.leaves((podium, motion, *rest))
