"""Sampled ground motions."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ._checks import as_float, concrete, finite, positive
from ._excitations import AbstractExcitation, AbstractOutlook

Value = Float[Array, ""]
Index = Int[Array, ""]


class _RecordOutlook(AbstractOutlook):
    record: Record
    threshold: Value | None
    to_come: Float[Array, " n"]  # ∫|ü_g| dt from sample i on
    highest: Float[Array, " n"]  # max|ü_g| from sample i on

    def _from(self, table: Float[Array, " n"], piece: Index) -> Value:
        count = table.shape[0]
        return jnp.where(piece < count, table[jnp.clip(piece - 1, 0, count - 1)], 0.0)

    def impulse(self, t: Value, piece: Index) -> Value:
        return self._from(self.to_come, piece)

    def peak(self, t: Value, piece: Index, now: Value) -> Value:
        return self._from(self.highest, piece)

    def highest_time(self, start: Value, end: Value) -> Value:
        # Linear between samples: at a sample inside, or at an end.
        samples = self.record.breakpoints
        start, end = (jnp.clip(t, samples[0], samples[-1]) for t in (start, end))
        inside = jnp.where((samples >= start) & (samples <= end), jnp.abs(self.record.acceleration), -1.0)
        times = jnp.stack([samples[jnp.argmax(inside)], start, end])
        return times[jnp.argmax(jnp.stack([jnp.abs(self.record(t)) for t in times]))]

    def next_exceedance(self, t: Value, piece: Index) -> Value:
        """Walks from sample to sample; inside a piece the motion is linear and the crossing is a division."""
        record, threshold = self.record, self.threshold
        assert threshold is not None
        count = record.acceleration.shape[0]

        def inspect(carry):
            t, piece, _ = carry
            formula = record.piece(piece)
            end = record.breakpoint(piece)
            a0, a1 = formula(t), formula(end)
            at_once, later = jnp.abs(a0) > threshold, jnp.abs(a1) > threshold
            slope = (a1 - a0) / jnp.where(end > t, end - t, 1.0)
            crossing = t + (threshold - jnp.sign(a1) * a0) / jnp.abs(jnp.where(slope == 0, 1.0, slope))
            crossing = jnp.nextafter(jnp.clip(crossing, t, end), end)  # passed, not touched
            found = at_once | later
            return jnp.where(at_once, t, jnp.where(later, crossing, end)), piece + jnp.where(found, 0, 1), found

        start = (jnp.maximum(t, record.breakpoint(jnp.zeros_like(piece))), jnp.maximum(piece, 1), jnp.zeros((), bool))
        t, _, found = jax.lax.while_loop(lambda c: ~c[2] & (c[1] < count), inspect, start)
        return jnp.where(found, t, jnp.inf)


class Record(AbstractExcitation):
    """A sampled ground motion, linear between samples and zero before the first and after the last, jumps included.

    - `acceleration`: samples of ü_g, shape (n,), n ≥ 2 [m/s²]
    - `dt`: sampling interval, > 0 [s]
    - `scale`: factor on the samples [–]; `t_start`: time of the first sample [s]

    Raises `ValueError` for empty or non-finite records.
    """

    acceleration: Float[Array, "*batch n"] = eqx.field(converter=as_float)
    dt: Float[Array, "*batch"] = eqx.field(converter=as_float)
    scale: Float[Array, "*batch"] = eqx.field(converter=as_float, default=1.0)
    t_start: Float[Array, "*batch"] = eqx.field(converter=as_float, default=0.0)

    def __check_init__(self):
        positive("Record", dt=self.dt)
        finite("Record", scale=self.scale, t_start=self.t_start)
        shape = self.acceleration.shape
        if len(shape) == 0 or shape[-1] < 2:
            raise ValueError(f"Record: acceleration must hold at least two samples, got shape {shape}")
        samples = concrete(self.acceleration)
        if samples is not None and not np.isfinite(samples).all():
            where = np.argwhere(~np.isfinite(samples))[0]
            raise ValueError(f"Record: acceleration must be finite, got {samples[tuple(where)]} at sample {int(where[-1])}")

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
        """The record in a file (host): PEER's .AT2, CSMIP and COSMOS .V2, ESM, K-NET, text, NumPy's .npy.

        - `units`: `"g"`, `"m/s2"`, `"cm/s2"`, `"gal"` or `"mm/s2"`; needed where the file does not say it
        - `dt`: sampling interval [s], where the file has neither it nor times
        - `scale`: factor on the samples [–]
        - `component`: number or name of a channel, where the file has several

        Formats, errors and warnings are those of [`rockjax.read_motion`][], which also keeps what the header says.
        """
        from ._motions import check  # which knows this module
        from ._readers import read

        motion = read(path, units, dt, component)
        check(motion, str(path), stacklevel=3)
        return cls(motion.acceleration, motion.dt, scale)

    @property
    def support(self) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
        return self.t_start, self.t_start + (self.acceleration.shape[-1] - 1) * self.dt

    @property
    def breakpoints(self) -> Float[Array, "*batch n"]:
        return self.t_start[..., None] + jnp.arange(self.acceleration.shape[-1]) * self.dt[..., None]

    @property
    def panels(self) -> tuple[int, tuple[Float[Array, "*batch"], ...]]:
        return 1, (self.dt,)

    def scaled(self, factor) -> Self:
        return dataclasses.replace(self, scale=factor * self.scale)

    def breakpoint(self, index: Index) -> Value:
        return jnp.where(index < self.acceleration.shape[0], self.t_start + index * self.dt, jnp.inf)

    def locate(self, t: Value) -> Index:
        count = self.acceleration.shape[0]
        # Rounding may be one off; the sample times decide.
        guess = jnp.clip(jnp.floor((t - self.t_start) / self.dt), -1, count - 1).astype(jnp.int32)
        guess = jnp.where(self.breakpoint(guess + 1) <= t, guess + 1, guess)
        guess = jnp.where((guess >= 0) & (self.breakpoint(guess) > t), guess - 1, guess)
        return guess + 1

    def piece(self, index: Index) -> Callable[[Value], Value]:
        count = self.acceleration.shape[0]
        inside = (index > 0) & (index < count)
        i = jnp.clip(index - 1, 0, count - 2)
        a0, a1 = self.acceleration[i], self.acceleration[i + 1]
        a0, slope = (jnp.where(inside, self.scale * a, 0.0) for a in (a0, (a1 - a0) / self.dt))
        t0 = self.t_start + i * self.dt
        return lambda t: a0 + slope * (t - t0)

    def outlook(self, threshold: Value | None) -> AbstractOutlook:
        record: Record = jax.lax.stop_gradient(self)
        size = jnp.abs(record.scale * record.acceleration)
        # The trapezoid of |ü_g| is an upper bound where the motion changes sign inside a piece.
        areas = jnp.append(0.5 * record.dt * (size[1:] + size[:-1]), 0.0)
        to_come = jnp.cumsum(areas[::-1])[::-1]
        highest = jax.lax.cummax(size, reverse=True)
        return _RecordOutlook(record, None if threshold is None else jax.lax.stop_gradient(threshold), to_come, highest)
