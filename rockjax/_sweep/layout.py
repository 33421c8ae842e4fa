"""Division of a grid of scenes into chunks.

A scene is one structure under one ground motion. A chunk is a batch of scenes that are solved together.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

Box = tuple[slice, ...]  # the part of a grid that a chunk contains: a slice of each axis


class ChunkLayout(NamedTuple):
    """A grid of scenes divided into chunks, which are numbered in C order.

    - `shape`: number of scenes along each axis
    - `chunk_shape`: number of scenes of a chunk along each axis; the last chunk of an axis may be shorter
    """

    shape: tuple[int, ...]
    chunk_shape: tuple[int, ...]

    @classmethod
    def from_chunk_size(cls, shape: Sequence[int], chunk: int) -> ChunkLayout:
        """Return a layout whose chunks have at most `chunk` scenes.

        A chunk contains as many of the last axes in full as possible, a part of the axis before these, and
        one index of each earlier axis.
        """
        chunk_shape, remaining = [], max(1, chunk)
        for n in reversed(shape):
            chunk_shape.append(min(n, remaining))
            remaining = remaining // n if remaining >= n else 1
        return cls(tuple(shape), tuple(reversed(chunk_shape)))

    @property
    def chunks_along(self) -> tuple[int, ...]:
        """Number of chunks along each axis."""
        return tuple(-(-n // b) for n, b in zip(self.shape, self.chunk_shape, strict=True))

    @property
    def chunk_count(self) -> int:
        """Number of chunks."""
        return math.prod(self.chunks_along)

    def box(self, k: int) -> Box:
        """Return the slices of the grid that form chunk k."""
        position = np.unravel_index(k, self.chunks_along)
        starts = [int(j) * b for j, b in zip(position, self.chunk_shape, strict=True)]
        return tuple(
            slice(i, min(i + b, n)) for i, b, n in zip(starts, self.chunk_shape, self.shape, strict=True)
        )

    def sizes(self) -> np.ndarray:
        """Return the number of scenes in every chunk, shape (chunks,)."""
        axis_sizes = [
            np.minimum(b, n - b * np.arange(m))
            for n, b, m in zip(self.shape, self.chunk_shape, self.chunks_along, strict=True)
        ]
        return np.prod(np.meshgrid(*axis_sizes, indexing="ij"), axis=0).reshape(-1)

    def chunk_of(self, scenes: np.ndarray) -> np.ndarray:
        """Return the indices of the chunks that contain the scenes with these flat indices."""
        indices = np.unravel_index(scenes, self.shape)
        return np.ravel_multi_index(
            [j // b for j, b in zip(indices, self.chunk_shape, strict=True)], self.chunks_along
        )
