"""Sampled ground motions: ü_g is linear between samples, and zero before the first and after the last sample.
At the first and the last sample ü_g may jump.

A table is an array with the samples of one or several motions. Each motion has a row, padded with zeros.
`base.py` defines pieces, breakpoints and lookaheads.
"""

from __future__ import annotations

import abc
import dataclasses
import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, Int

from rockjax._checks import array_module
from rockjax._types import Index, Value

from .base import AbstractExcitation, AbstractLookahead, size_on

# Smallest padded size, and the ratio of successive sizes. Single records have few sizes, because each size
# needs a compiled program. The sizes of tables lie closer together, because padding applies to every row.
RECORD_SIZES, TABLE_SIZES = (8192, 4), (2048, 2)


def common_size(count: int, least: int, ratio: int) -> int:
    """Return the smallest size ≥ `count` that is `least` times a power of `ratio`. Samples are padded to such
    sizes, since each size needs a compiled program. A scene with padding takes little longer."""
    size = least
    while size < count:
        size *= ratio
    return size


def pad_samples(samples, *sizes: int):
    """Pad samples with zeros, so that the last axes have the lengths `sizes`."""
    counts_and_sizes = zip(samples.shape[samples.ndim - len(sizes) :], sizes, strict=True)
    padding = [(0, 0)] * (samples.ndim - len(sizes)) + [(0, size - count) for count, size in counts_and_sizes]
    # NumPy is used because JAX would compile for every length.
    return jnp.pad(samples, padding) if isinstance(samples, Tracer) else np.pad(np.asarray(samples), padding)


class Sampling(NamedTuple):
    """Sampling parameters: scalars for one motion, arrays for a batch."""

    start: Any  # time of the first sample [s]
    dt: Any  # sampling interval [s]
    count: Any  # number of samples
    scale: Any  # factor on the samples [–]


class AbstractSampled(AbstractExcitation):
    """Base class of sampled motions."""

    @property
    @abc.abstractmethod
    def sampling(self) -> Sampling:
        """Start, interval, number and scale of the samples."""

    @property
    @abc.abstractmethod
    def table(self) -> Float[Array, "*table n"]:
        """Array with the unscaled samples [m/s²] along the last axis, of one or several motions."""

    @abc.abstractmethod
    def samples_at(self, table: Float[Array, "*table n"], i: Index) -> Value:
        """Return element i of the row that belongs to this motion in an array. The array has as many rows as
        the table of samples; the rows may have another length."""

    def row_counts(self) -> Int[Array, "*rows 1"]:
        """Return the number of samples in each row of the table."""
        return jnp.asarray(self.sampling.count)[..., None]

    @abc.abstractmethod
    def magnitudes(self) -> Float[Array, "*table n"]:
        """Return the absolute values of the unscaled samples [m/s²]; the padding is zero."""

    def strength(self) -> np.ndarray:
        row_peak: Any = np.abs(self.table).max(axis=-1)
        return np.abs(np.multiply(self.select_rows(row_peak), self.sampling.scale))

    @property
    def support(self) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
        return self.sampling.start, self.sample_time(self.sampling.count - 1)

    def sample_time(self, sample: Index | int) -> Value:
        """Return the time of a sample [s]."""
        start, dt, _, _ = self.sampling
        numpy = array_module(start, dt, sample)
        return numpy.add(start, numpy.multiply(numpy.asarray(sample, dt.dtype), dt))

    @property
    def last_piece(self) -> Any:
        return self.sampling.count

    @property
    def most_pieces(self) -> int:
        return self.table.shape[-1] + 1

    def breakpoint(self, index: Index) -> Value:
        return jnp.where(index < self.sampling.count, self.sample_time(index), jnp.inf)

    def locate(self, t: Value) -> Index:
        start, dt, count, _ = self.sampling
        # Rounding may make the guess wrong by one, so the guess is compared with the times of samples.
        guess = jnp.clip(jnp.floor((t - start) / dt), -1, jnp.asarray(count - 1, dt.dtype)).astype(jnp.int32)
        guess = jnp.where(self.breakpoint(guess + 1) <= t, guess + 1, guess)
        guess = jnp.where((guess >= 0) & (self.breakpoint(guess) > t), guess - 1, guess)
        return guess + 1

    def piece(self, index: Index) -> Callable[[Value], Value]:
        _, dt, count, scale = self.sampling
        is_inside = (index > 0) & (index < count)
        i = jnp.clip(index - 1, 0, count - 2)
        a0, a1 = self.samples_at(self.table, i), self.samples_at(self.table, i + 1)
        a0, slope = (jnp.where(is_inside, scale * a, 0.0) for a in (a0, (a1 - a0) / dt))
        t0 = self.sample_time(i)
        return lambda t: a0 + slope * (t - t0)

    def at_most(self, piece: Index, t: Value, ahead: Value, now: Value) -> Value:
        # The motion is linear within a piece, so |ü_g| is largest at one end of the interval.
        return jnp.maximum(now, jnp.abs(self.piece(piece)(t + ahead)))

    def curvature(self) -> Value:
        return jnp.zeros_like(self.sampling.dt)

    def lowest(self) -> tuple[Value, Value]:
        # The padding is zero, like the motion outside its samples, so it does not falsify the minimum.
        scale, table = self.sampling.scale, self.table
        indices = jnp.argmin(table, axis=-1), jnp.argmax(table, axis=-1)
        low, high = (jnp.take_along_axis(table, k[..., None], axis=-1)[..., 0] for k in indices)
        low, high, index_of_low, index_of_high = (self.select_rows(y) for y in (low, high, *indices))
        is_positive = scale > 0  # a negative scale makes the largest sample the minimum
        sample = jnp.where(is_positive, index_of_low, index_of_high)
        return scale * jnp.where(is_positive, low, high), self.sample_time(sample)

    def select_rows(self, rows: Array) -> Array:
        """Return the elements of this motion, or of the motions of a batch, from an array with one element
        for each row of the table."""
        return rows

    def lookahead(self, threshold: Value | None) -> AbstractLookahead:
        record: AbstractSampled = jax.lax.stop_gradient(self)
        magnitudes = record.magnitudes()
        # Trapezoids give an upper bound, because they exceed the integral of |ü_g| where ü_g changes sign.
        areas = 0.5 * (magnitudes[..., 1:] + magnitudes[..., :-1])
        areas = jnp.concatenate([areas, jnp.zeros_like(magnitudes[..., :1])], axis=-1)
        # The sums start at the last sample, so that padding does not change their rounding.
        counts = record.row_counts()
        samples = jnp.arange(magnitudes.shape[-1], dtype=counts.dtype)
        samples = samples.reshape((1,) * (magnitudes.ndim - 1) + (-1,))
        mirrored = counts - 1 - samples
        reverse_rows = lambda y: jnp.take_along_axis(y, jnp.clip(mirrored, 0), axis=-1)
        remaining_integral = reverse_rows(
            jnp.cumsum(jnp.where(mirrored >= 0, reverse_rows(areas), 0.0), axis=-1)
        )
        remaining_integral = jnp.where(mirrored >= 0, remaining_integral, 0.0)
        remaining_peak = jax.lax.cummax(magnitudes, axis=magnitudes.ndim - 1, reverse=True)
        if threshold is None:
            return SampledLookahead(record, None, remaining_integral, remaining_peak, None)
        return SampledLookahead(
            record,
            jax.lax.stop_gradient(threshold),
            remaining_integral,
            remaining_peak,
            _tree_of_maxima(magnitudes),
        )


class SampledLookahead(AbstractLookahead):
    """Lookahead of a sampled motion, from sums and maxima over its samples. Samples, sums and maxima are
    stored without the factor `Sampling.scale`."""

    record: AbstractSampled
    threshold: Value | None
    # Upper bound of ∫|ü_g| dt from sample i on, divided by the sampling interval; zero in the padding.
    remaining_integral: Float[Array, "*table n"]
    remaining_peak: Float[Array, "*table n"]  # largest absolute value from sample i on
    tree: Float[Array, "*table m"] | None  # tree of maxima of |samples|; None without threshold
    # Trees of maxima of −samples and of samples, for `highest_time` with a side; None before `with_sides`.
    side_trees: tuple[Float[Array, "*table m"], Float[Array, "*table m"]] | None = None

    def _from_piece(self, table: Float[Array, "*table n"], piece: Index) -> Value:
        """Return the element of a table at the sample where a piece starts, times |scale|; zero after the
        motion."""
        _, _, count, scale = self.record.sampling
        value = jnp.abs(scale) * self.record.samples_at(table, jnp.clip(piece - 1, 0, count - 1))
        return jnp.where(piece < count, value, 0.0)

    # The bounds of `impulse` and `peak` hold from the start of the piece on, and therefore also from t on.
    def impulse(self, t: Value, piece: Index) -> Value:
        return self.record.sampling.dt * self._from_piece(self.remaining_integral, piece)

    def peak(self, t: Value, piece: Index, now: Value) -> Value:
        return self._from_piece(self.remaining_peak, piece)

    def with_sides(self) -> SampledLookahead:
        table = self.record.table
        return dataclasses.replace(self, side_trees=(_tree_of_maxima(-table), _tree_of_maxima(table)))

    def highest_time(self, start: Value, end: Value, side: Value | None = None) -> Value:
        # The motion is linear between samples, so the maximum is at a sample or at an end of the interval.
        record = self.record
        first, last = record.support
        start, end = jnp.clip(start, first, last), jnp.clip(end, first, last)
        sample = self._highest_sample(record.locate(start), record.locate(end), side)
        time_of_sample = record.breakpoint(sample)
        times = jnp.stack([jnp.clip(time_of_sample, start, end), start, end])
        return times[jnp.argmax(size_on(side, jnp.stack([record(t) for t in times])))]

    def _highest_sample(self, first: Index, end: Index, side: Value | None) -> Index:
        """Return the sample with the largest |ü_g| among the samples from `first` to `end` − 1; with the
        largest side·ü_g if a side is given. The search uses a tree of maxima (see `_tree_of_maxima`)."""
        tree = self.tree
        assert tree is not None
        leaves = tree.shape[-1] // 2
        levels = leaves.bit_length()
        value_at = self.record.samples_at
        if side is None:
            maximum_of = functools.partial(value_at, tree)
        else:
            assert self.side_trees is not None
            negative, positive = self.side_trees
            is_positive = side * self.record.sampling.scale > 0
            maximum_of = lambda node: jnp.where(
                is_positive, value_at(positive, node), value_at(negative, node)
            )

        def climb(_, carry):
            left, right, best = carry
            # If the parent of a node at an end of the range also covers samples outside the range, the node
            # itself is compared here.
            for edge, node in ((left, left), (right, right - 1)):
                best = jnp.where(
                    (left < right) & (edge % 2 == 1) & (maximum_of(node) > maximum_of(best)), node, best
                )
            return (left + left % 2) // 2, (right - right % 2) // 2, best

        def descend(_, node):
            left, right = 2 * node, 2 * node + 1
            larger = jnp.where(maximum_of(right) > maximum_of(left), right, left)
            return jnp.where(node < leaves, larger, node)

        first = jnp.clip(first, 0, leaves - 1)
        start = leaves + first, leaves + jnp.clip(end, 0, leaves), leaves + first
        best = jax.lax.fori_loop(0, levels, climb, start)[2]
        return (jax.lax.fori_loop(0, levels, descend, best) - leaves).astype(first.dtype)

    def next_exceedance(self, t: Value, piece: Index) -> Value:
        """Return the first time ≥ t at which |ü_g| exceeds the threshold [s]: t itself, or the crossing
        before the next sample above the threshold, or inf if there is no such sample."""
        record, threshold = self.record, self.threshold
        assert threshold is not None
        count = record.sampling.count
        t = jnp.maximum(t, record.breakpoint(jnp.zeros_like(piece)))
        piece = jnp.maximum(piece, 1)
        exceeds_now = (piece < count) & (jnp.abs(record.piece(piece)(t)) > threshold)
        sample = self._next_sample(piece, threshold)
        formula = record.piece(sample)
        start = jnp.maximum(t, record.breakpoint(sample - 1))
        end = record.breakpoint(sample)
        a0, a1 = formula(start), formula(end)
        slope = (a1 - a0) / jnp.where(end > start, end - start, 1.0)
        crossing = start + (threshold - jnp.sign(a1) * a0) / jnp.abs(jnp.where(slope == 0, 1.0, slope))
        crossing = jnp.clip(crossing, start, end)
        # Move to the next floating-point number, at which the threshold is exceeded. The arguments of
        # `nextafter` are held constant, because older versions of JAX cannot differentiate `nextafter`.
        fixed = jax.lax.stop_gradient(crossing)
        crossing += jnp.nextafter(fixed, jax.lax.stop_gradient(end)) - fixed
        return jnp.where(exceeds_now, t, jnp.where(sample < count, crossing, jnp.inf))

    def _next_sample(self, first: Index, threshold: Value) -> Index:
        """Return the index ≥ `first` of the next sample with |ü_g| above the threshold, or the number of
        samples if there is none. The search skips nodes of the tree of maxima that are below the threshold,
        so the number of visited nodes is proportional to the logarithm of the length of the record."""
        tree = self.tree
        assert tree is not None
        leaves = tree.shape[-1] // 2
        _, _, count, scale = self.record.sampling

        def exceeds(node: Index) -> Array:
            return jnp.abs(scale) * self.record.samples_at(tree, node) > threshold

        def advance(carry):
            node, _ = carry
            is_above = exceeds(node)
            # From a node above the threshold, go to its first child. From a left child below the threshold,
            # go to its right neighbour. From a right child below the threshold, go to the right neighbour of
            # its parent.
            next_node = jnp.where(is_above, 2 * node, jnp.where(node % 2 == 1, (node + 1) // 2, node + 1))
            is_found = is_above & (node >= leaves)
            is_last = ~is_above & ((node & (node + 1)) == 0)  # the rightmost node of its level
            return jnp.where(is_found | is_last, node, next_node), is_found | is_last

        # A search that starts after the last sample stops at once.
        start = leaves + jnp.minimum(first, leaves - 1)
        node, _ = jax.lax.while_loop(lambda carry: ~carry[1], advance, (start, first >= count))
        is_found = (node >= leaves) & exceeds(node) & (first < count)
        return jnp.where(is_found, node - leaves, count).astype(first.dtype)


def _tree_of_maxima(values: Float[Array, "*table n"]) -> Float[Array, "*table m"]:
    """Return the tree of maxima along the last axis. Node 1 is the root, and node k is the larger of its
    children 2k and 2k+1. The second half of the array holds the leaves: the values, padded with zeros to a
    power of two. Node 0 is not used."""
    n = values.shape[-1]
    leaves = 1 << (n - 1).bit_length()
    rows = [jnp.pad(values, [(0, 0)] * (values.ndim - 1) + [(0, leaves - n)])]
    while rows[0].shape[-1] > 1:
        rows.insert(0, jnp.maximum(rows[0][..., ::2], rows[0][..., 1::2]))
    return jnp.concatenate([jnp.zeros_like(rows[0]), *rows], axis=-1)
