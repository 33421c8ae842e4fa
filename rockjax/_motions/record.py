"""Sampled ground motions as excitations of scenes. A scene is one structure under one ground motion."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Self

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from rockjax._checks import (
    as_array,
    as_number,
    concrete,
    product,
    require_finite,
    require_finite_samples,
    require_number,
    require_positive,
)
from rockjax._excitations.sampled import (
    RECORD_SIZES,
    TABLE_SIZES,
    AbstractSampled,
    Sampling,
    common_size,
    pad_samples,
)
from rockjax._types import Index, Value
from rockjax._unit_warnings import warn_about_units

from .accelerogram import warn_if_implausible

LATEST_START = 1e5  # |t_start| above which a record causes a warning [s]


class Record(AbstractSampled):
    """A sampled ground motion, linear between samples.

    The motion is zero before the first and after the last sample, and may jump at these two samples.

    - `acceleration`: samples of the ground acceleration ü_g, shape (n,), n ≥ 2 [m/s²]
    - `dt`: sampling interval, > 0 [s]
    - `scale`: factor on the samples [–]
    - `t_start`: time of the first sample [s]

    Raises `ValueError` for dt ≤ 0, for fewer than two samples, for values that are not finite, and for gaps:
    masked samples, and values such as -999 or 999999 that stand for missing samples.
    """

    acceleration: Float[Array, "*batch n"] = eqx.field(converter=as_number("Record: acceleration"))
    dt: Float[Array, "*batch"] = eqx.field(converter=as_number("Record: dt"))
    scale: Float[Array, "*batch"] = eqx.field(converter=as_number("Record: scale"), default=1.0)
    t_start: Float[Array, "*batch"] = eqx.field(converter=as_number("Record: t_start"), default=0.0)

    def __check_init__(self):
        require_positive("Record", dt=self.dt)
        require_finite("Record", scale=self.scale, t_start=self.t_start)
        start = concrete(self.t_start)
        if start is not None and np.any(np.abs(start) > LATEST_START):
            latest = float(np.max(np.abs(start)))
            warn_about_units(
                f"Record: t_start = {latest:.6g} s; times of this size are rounded to "
                f"{np.spacing(latest):.1g} s, which limits the accuracy of events; is it a calendar time? "
                "Subtract the time of the first sample",
                stacklevel=4,
            )
        shape = self.acceleration.shape
        if len(shape) == 0 or shape[-1] < 2:
            raise ValueError(f"Record: acceleration must hold at least two samples, got shape {shape}")
        samples = concrete(self.acceleration)
        if samples is not None:
            require_finite_samples("Record", samples)

    @classmethod
    def from_file(
        cls,
        path: str | Path,
        *,
        units: str | None = None,
        dt: float | None = None,
        scale: float = 1.0,
        component: int | str | None = None,
    ) -> Self:
        """Read a record from a file, in any format of [`rockjax.read_motion`][].

        - `path`: file to read
        - `units`: `"g"`, `"m/s2"`, `"cm/s2"`, `"gal"` or `"mm/s2"`; required if the file does not state
          its unit
        - `dt`: sampling interval [s]; required if the file contains neither the interval nor times
        - `scale`: factor on the samples [–]
        - `component`: number or name of a channel, if the file has several; otherwise None

        Formats, errors and warnings are those of [`rockjax.read_motion`][]. That function also returns the
        contents of the file header.
        """
        # Imported on first use, because `files` imports the readers of all formats.
        from .files import read

        scale = require_number("Record.from_file", "scale", scale, np.isfinite, "finite")
        motion = read(path, units, dt, component)
        warn_if_implausible(motion, str(path), stacklevel=3, unit_from_user=units is not None)
        return cls(motion.acceleration, motion.dt, scale)

    @property
    def sampling(self) -> Sampling:
        return Sampling(self.t_start, self.dt, self.acceleration.shape[-1], self.scale)

    @property
    def breakpoints(self) -> Float[Array, "*batch n"]:
        return (
            self.t_start[..., None]
            + jnp.arange(self.acceleration.shape[-1], dtype=self.dt.dtype) * self.dt[..., None]
        )

    def scaled(self, factor) -> Self:
        return dataclasses.replace(self, scale=product(factor, self.scale))

    @property
    def table(self) -> Float[Array, " n"]:
        return self.acceleration

    def samples_at(self, table: Float[Array, " n"], i: Index) -> Value:
        return table[i]

    def magnitudes(self) -> Float[Array, " n"]:
        return jnp.abs(self.acceleration)

    @property
    def own_dimensions(self) -> dict[str, int]:
        return {"acceleration": 1}

    def common_form(self) -> PaddedRecord:
        """Return the record padded with zeros to one of a few sizes. For batches, the sizes are closer
        together, to save memory."""
        samples = self.acceleration
        count, sizes = samples.shape[-1], RECORD_SIZES if samples.ndim == 1 else TABLE_SIZES
        return PaddedRecord(
            pad_samples(samples, common_size(count, *sizes)),
            self.dt,
            self.scale,
            self.t_start,
            np.int32(count),
        )


class PaddedRecord(Record):
    """A record padded with zeros, so that records of different lengths share compiled programs. The first
    `count` elements of `acceleration` are the samples of the record."""

    count: Int[Array, ""] = eqx.field(converter=as_array, default=0)

    @property
    def sampling(self) -> Sampling:
        return Sampling(self.t_start, self.dt, self.count, self.scale)

    @property
    def breakpoints(self) -> Float[Array, "*batch n"]:
        i = jnp.arange(self.acceleration.shape[-1], dtype=jnp.asarray(self.count).dtype)
        return jnp.where(i < self.count, super().breakpoints, jnp.inf)

    def common_form(self) -> PaddedRecord:
        return self
