"""Motions with a polynomial acceleration between breakpoints and velocity jumps at breakpoints, such as the
motions of floors."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Self

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from rockjax._types import Index, Number, Value

from .base import AbstractExcitation, AbstractLookahead

# Degree of the polynomials. The breakpoints of a floor motion are the ends of the solver steps of the podium.
# Over one such step, the error of a polynomial of this degree is below the error of the solver.
DEGREE = 7
# Chebyshev nodes z ∈ [−1, 1], including both ends, and the matrix that maps values at the nodes to
# coefficients of powers of z.
NODES = -np.cos(np.pi * np.arange(DEGREE + 1) / DEGREE)
FROM_VALUES = np.linalg.inv(np.vander(NODES, increasing=True))
POINTS_PER_PIECE = 33  # number of points per piece in the search for the minimum


class PiecewiseMotion(AbstractExcitation):
    """A motion whose acceleration is a polynomial between neighbouring breakpoints. The acceleration is zero
    before the first and after the last finite breakpoint. The velocity of the motion jumps at breakpoints.

    - `times`: breakpoints, ascending; the last ones may be inf [s]
    - `coefficients`: coefficients of the acceleration from each breakpoint to the next, in powers of
      z ∈ [−1, 1] over that interval [m/s²]; rows of intervals without a finite end are not used
    - `jumps`: jump of the velocity at each breakpoint [m/s]
    """

    times: Float[Array, " n"]
    coefficients: Float[Array, " n degree+1"]
    jumps: Float[Array, " n"]

    @classmethod
    def through(cls, times: Array, values: Array, jumps: Array) -> Self:
        """Return the motion whose acceleration has the `values` [m/s²], shape (n, DEGREE + 1), at the `NODES`
        of each interval between breakpoints; the last row is not used."""
        return cls(times, values @ jnp.asarray(FROM_VALUES.T, values.dtype), jumps)

    @property
    def support(self) -> tuple[Number, Number]:
        finite = jnp.isfinite(self.times)
        last = jnp.max(jnp.where(finite, self.times, -jnp.inf))
        return self.times[0], last

    @property
    def breakpoints(self) -> Float[Array, " n"]:
        return self.times

    def breakpoint(self, index: Index) -> Value:
        count = self.times.shape[-1]
        return jnp.where(index < count, self.times[jnp.clip(index, 0, count - 1)], jnp.inf)

    def locate(self, t: Value) -> Index:
        return jnp.searchsorted(self.times, t, side="right").astype(jnp.int32)

    def piece(self, index: Index) -> Callable[[Value], Value]:
        start, end = jax.lax.stop_gradient((self.breakpoint(index - 1), self.breakpoint(index)))
        is_inside = (index > 0) & jnp.isfinite(end)
        middle, half = (jnp.where(is_inside, y, 1.0) for y in (0.5 * (start + end), 0.5 * (end - start)))
        row = self.coefficients[jnp.clip(index - 1, 0, self.times.shape[-1] - 1)]
        row = jnp.where(is_inside, row, 0.0)
        return lambda t: functools.reduce(
            lambda total, k: total * ((t - middle) / half) + row[k], reversed(range(DEGREE)), row[DEGREE]
        )

    def velocity_jump(self, index: Index) -> Value:
        count = self.times.shape[-1]
        return jnp.where(index < count, self.jumps[jnp.clip(index, 0, count - 1)], 0.0)

    def lowest(self) -> tuple[Value, Value]:
        z = jnp.linspace(-1.0, 1.0, POINTS_PER_PIECE, dtype=self.times.dtype)
        values = self.coefficients @ jnp.vander(z, DEGREE + 1, increasing=True).T
        ends = jnp.append(self.times[1:], jnp.inf)
        values = jnp.where(jnp.isfinite(ends)[:, None], values, jnp.inf)
        k = jnp.argmin(values)
        start, end = self.times[k // POINTS_PER_PIECE], ends[k // POINTS_PER_PIECE]
        return values.ravel()[k], start + 0.5 * (1 + z[k % POINTS_PER_PIECE]) * (end - start)

    def lookahead(self, threshold: Value | None) -> AbstractLookahead:
        return NoLookahead()


class NoLookahead(AbstractLookahead):
    """Lookahead of a motion whose later peak and impulse are unknown. Their bounds are inf, so a scene never
    ends early because the remaining motion is too weak."""

    def next_exceedance(self, t: Value, piece: Index) -> Value:
        raise NotImplementedError("a motion without a lookahead has no search for exceedances")

    def impulse(self, t: Value, piece: Index) -> Value:
        return jnp.full_like(t, jnp.inf)

    def peak(self, t: Value, piece: Index, now: Value) -> Value:
        return jnp.full_like(t, jnp.inf)

    def highest_time(self, start: Value, end: Value, side: Value | None = None) -> Value:
        raise NotImplementedError("a motion without a lookahead has no search for maxima")
