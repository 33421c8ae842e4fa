"""Several records in one table, for batches of scenes. A scene is one structure under one ground motion."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Self, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int

from rockjax._checks import (
    array_module,
    as_array,
    as_number,
    concrete,
    format_value,
    product,
    refuse_gaps,
    require_finite,
    require_finite_samples,
)
from rockjax._excitations.ground import PARTS, GroundMotion
from rockjax._excitations.sampled import TABLE_SIZES, AbstractSampled, Sampling, common_size, pad_samples
from rockjax._types import Index, Value

from .motion import Motion
from .record import Record

MIN_ROWS = 8  # smallest number of rows of a padded table


class Records(AbstractSampled):
    """A batch of records, of any lengths and sampling intervals, in one table.

    `Records.of(records)` returns a batch of k records, shape (k,). `pick(j)` selects record j. If j is an
    array of indices, `pick(j)` is a batch with the shape of j. `scaled(factor)` multiplies the records of the
    batch by `factor`, a number or an array that broadcasts against the batch. Iteration yields the members
    of the batch with their factors. In [`rockjax.peak_responses`][], all scenes share the table, and one
    compiled program serves records of different lengths.

    - `acceleration`: samples, one record in each row, padded with zeros, shape (k, n) [m/s²]
    - `counts`: number of samples in each row, shape (k,)
    - `intervals`: sampling interval of each row, shape (k,) [s]
    - `starts`: time of the first sample of each row, shape (k,) [s]
    - `which`: index of the row for each member of the batch, with the shape of the batch
    - `scale`: factor on the samples for each member of the batch, scalar or with the shape of the batch [–]
    """

    acceleration: Float[Array, "k n"]
    counts: Int[Array, " k"]
    intervals: Float[Array, " k"]
    starts: Float[Array, " k"]
    which: Int[Array, "*batch"] = eqx.field(converter=as_array)
    scale: Float[Array, "*batch"] = eqx.field(converter=as_number("Records: scale"), default=1.0)

    def __check_init__(self):
        # Only NumPy arrays are checked. `of` makes JAX arrays from records that are already checked; other
        # JAX arrays are results of computations.
        if isinstance(self.acceleration, np.ndarray):
            refuse_gaps("Records: acceleration", self.acceleration)
            require_finite_samples("Records", self.acceleration)
        require_finite("Records", scale=self.scale)

    @classmethod
    def of(cls, records: Sequence[Record | Motion]) -> Self:
        """Return single records as a batch. The samples in the table are multiplied by the scales of the
        records. Raises `ValueError` for an empty sequence, for elements of other types, and for batches."""
        if isinstance(records, Record | Motion | str) or not isinstance(records, Iterable):
            raise ValueError(
                "Records: records must be a list of rockjax.Record, or rockjax.Motions, got "
                f"{format_value(records)}"
            )
        singles: list[Any] = [entry.record() if isinstance(entry, Motion) else entry for entry in records]
        if not singles:
            raise ValueError("Records: at least one record is needed, got none")
        for j, record in enumerate(singles):
            if not isinstance(record, Record):
                raise ValueError(f"Records: entry {j} must be a rockjax.Record, got {format_value(record)}")
            if record.acceleration.ndim != 1 or any(
                jnp.ndim(y) for y in (record.dt, record.scale, record.t_start)
            ):
                raise ValueError(
                    f"Records: entry {j} must be a single record, got a batch; pass a list of records"
                )
        counts = np.array([record.acceleration.size for record in singles], np.int32)
        longest = int(counts.max())
        # Unless a record is traced, NumPy is used: outside jit, every jnp operation compiles separately for
        # every length.
        numpy = array_module(singles)
        rows = [
            numpy.pad(
                numpy.multiply(record.scale, record.acceleration), (0, longest - record.acceleration.size)
            )
            for record in singles
        ]
        return cls(
            acceleration=as_array(numpy.stack(rows)),
            counts=as_array(counts),
            intervals=as_array(numpy.stack([record.dt for record in singles])),
            starts=as_array(numpy.stack([record.t_start for record in singles])),
            which=np.arange(len(singles), dtype=np.int32),
        )

    def pick(self, which: Int[ArrayLike, "*batch"]) -> Self:
        """Return the records with the indices `which` as a batch with the shape of `which` and the scale 1.
        Raises `ValueError` for indices that are not whole numbers, and for indices out of range unless they
        are traced."""
        which = which if isinstance(which, jax.Array) else np.asarray(which)
        indices, is_integer = concrete(which), np.issubdtype(which.dtype, np.integer)
        if not is_integer or (indices is not None and not np.all((indices >= 0) & (indices < len(self)))):
            raise ValueError(
                f"Records.pick: which must be whole numbers from 0 to {len(self) - 1}, got "
                f"{format_value(which)}"
            )
        return dataclasses.replace(self, which=which, scale=1.0)

    def __len__(self) -> int:
        return self.counts.shape[0]

    def __iter__(self) -> Iterator[Self]:
        numpy = array_module(self)
        members = numpy.broadcast_arrays(numpy.asarray(self.which), numpy.asarray(self.scale))
        return (self.pick_scaled(j, f) for j, f in zip(*map(numpy.atleast_1d, members), strict=True))

    @property
    def sampling(self) -> Sampling:
        j = self.which
        return Sampling(self.starts[j], self.intervals[j], self.counts[j], self.scale)

    @property
    def breakpoints(self) -> Float[Array, "*batch n"]:
        start, dt, count, _ = (jnp.asarray(y)[..., None] for y in self.sampling)
        i = jnp.arange(self.acceleration.shape[-1], dtype=count.dtype).reshape((1,) * self.which.ndim + (-1,))
        return jnp.where(i < count, start + i.astype(dt.dtype) * dt, jnp.inf)

    def scaled(self, factor) -> Self:
        return dataclasses.replace(self, scale=product(factor, self.scale))

    @property
    def table(self) -> Float[Array, "k n"]:
        return self.acceleration

    def samples_at(self, table: Float[Array, "k n"], i: Index) -> Value:
        return table[self.which, i]

    def select_rows(self, rows: Array) -> Array:
        return rows[self.which]

    def row_counts(self) -> Int[Array, "k 1"]:
        return self.counts[:, None]

    def magnitudes(self) -> Float[Array, "k n"]:
        numpy = array_module(self)
        counts = numpy.asarray(self.counts)[:, None]
        is_sample = numpy.arange(self.acceleration.shape[-1], dtype=counts.dtype)[None] < counts
        return numpy.where(is_sample, numpy.abs(self.acceleration), 0.0)

    def pick_scaled(self, which, scale) -> Self:
        """Return the records with the indices `which`, with the factors `scale` on the samples [–]. The
        indices are not checked, and arrays are not converted: NumPy arrays stay NumPy arrays."""
        return dataclasses.replace(self, which=which, scale=scale)

    def common_form(self) -> Self:
        """Return the table padded to one of a few sizes, so that tables of different sizes share compiled
        programs. No member of the batch refers to an added row."""
        rows = max(MIN_ROWS, 1 << (len(self) - 1).bit_length())
        return dataclasses.replace(
            self,
            acceleration=pad_samples(
                self.acceleration, rows, common_size(self.acceleration.shape[-1], *TABLE_SIZES)
            ),
            counts=_pad_end(self.counts, rows, 2),
            intervals=_pad_end(self.intervals, rows, 1.0),
            starts=_pad_end(self.starts, rows, 0.0),
        )

    @property
    def own_dimensions(self) -> dict[str, int]:
        return {"acceleration": 2, "counts": 1, "intervals": 1, "starts": 1}


class RecordPairs(GroundMotion):
    """A batch of pairs of a horizontal and a vertical record. The horizontal and the vertical table have the
    same number of rows; rows with the same index form a pair. `which`, `scale` and `magnitudes` are those of
    the horizontal records."""

    @classmethod
    def of(cls, pairs: Sequence[GroundMotion]) -> Self:
        """Return single pairs of records as a batch."""
        return cls(*(Records.of([getattr(pair, part) for pair in pairs]) for part in PARTS))

    @property
    def which(self) -> Int[Array, "*batch"]:
        return self._table.which

    @property
    def scale(self) -> Float[Array, "*batch"]:
        return self._table.scale

    def __len__(self) -> int:
        return len(self._table)

    def magnitudes(self) -> Float[Array, "k n"]:
        return self._table.magnitudes()

    @property
    def _table(self) -> Records:
        return cast(Records, self.horizontal)

    def pick(self, which: Int[ArrayLike, "*batch"]) -> Self:
        """Return the pairs with the indices `which`, with the scale 1."""
        return self._map_components(lambda records: records.pick(which))

    def pick_scaled(self, which, scale) -> Self:
        """Return the pairs with the indices `which` and the factors `scale`; see `Records.pick_scaled`."""
        return self._map_components(lambda records: records.pick_scaled(which, scale))

    def _map_components(self, change: Callable[[Records], Records]) -> Self:
        horizontal, vertical = change(self._table), change(cast(Records, self.vertical))
        return dataclasses.replace(self, horizontal=horizontal, vertical=vertical)


def _pad_end(values, size: int, fill: float):
    """Return an array, padded at the end with `fill` to the length `size`."""
    numpy = array_module(values)
    return numpy.concatenate([values, numpy.full(size - values.shape[0], fill, values.dtype)])
