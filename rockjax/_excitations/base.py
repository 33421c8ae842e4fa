"""Base classes of excitations. An excitation is a ground motion: a callable that maps the time t to the
ground acceleration ü_g, with a support (start and end) and breakpoints.

Breakpoints are the times at which ü_g, one of its derivatives with respect to t, or the velocity of the
ground jumps. They divide an excitation into smooth pieces. No step of the engine crosses a breakpoint. Within
piece i, the engine evaluates the smooth formula `piece(i)`, so jumps and kinks of ü_g cause no error.

`lookahead(threshold)` answers questions about the remaining motion: when |ü_g| next exceeds the threshold,
how large |ü_g| can still become, and how large the integral of |ü_g| over the remaining time can be.
"""

from __future__ import annotations

import abc
from collections.abc import Callable
from typing import Any, NamedTuple, Self

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from rockjax._checks import as_float
from rockjax._programs.program import nans_allowed
from rockjax._text.representations import PrintedModule
from rockjax._tree import Module
from rockjax._types import Index, Number, Value

SAMPLES = 4097  # number of samples in the default search for the minimum of a motion


class Shaking(NamedTuple):
    """Horizontal and vertical ground acceleration [m/s²], or the jumps of the horizontal and vertical ground
    velocity [m/s]. Motions without a vertical component return a scalar instead."""

    horizontal: Value  # ü_g
    vertical: Value  # v̈_g, upwards positive


class AbstractLookahead(Module):
    """Exceedances and bounds of the remaining excitation, held constant under differentiation
    (`stop_gradient`).

    The methods use the threshold that was given to `AbstractExcitation.lookahead`. Their argument `piece` is
    the index of the piece at time t.
    """

    @abc.abstractmethod
    def next_exceedance(self, t: Value, piece: Index) -> Value:
        """Return the first time ≥ t at which |ü_g| exceeds the threshold [s], or inf if there is none."""

    @abc.abstractmethod
    def impulse(self, t: Value, piece: Index) -> Value:
        """Return an upper bound of ∫|ü_g| dt from t on [m/s]."""

    @abc.abstractmethod
    def peak(self, t: Value, piece: Index, now: Value) -> Value:
        """Return an upper bound of |ü_g| from t on [m/s²]; `now` is |ü_g(t)|."""

    @abc.abstractmethod
    def highest_time(self, start: Value, end: Value, side: Value | None = None) -> Value:
        """Return the time between `start` and `end` at which |ü_g| is largest [s]. If a `side` of ±1 is
        given, return the time at which side·ü_g is largest.

        `end` may be inf. The lookahead must have been created with a threshold. If a side is given, the
        lookahead must be the result of `with_sides`.
        """

    def with_sides(self) -> AbstractLookahead:
        """Return this lookahead with the data that `highest_time` needs for a side."""
        return self


class AbstractExcitation(PrintedModule):
    """Base class of ground motions ü_g(t) [m/s²]. Subclasses implement the abstract methods."""

    @property
    @abc.abstractmethod
    def support(self) -> tuple[Number, Number]:
        """(t_start, t_end) [s]; outside this interval, ü_g is zero or smaller than rounding."""

    @property
    @abc.abstractmethod
    def breakpoints(self) -> Float[Array, "*batch n"]:
        """Times that separate the pieces (see the docstring of the module), ascending along the last axis
        [s]; the last ones may be inf."""

    @abc.abstractmethod
    def piece(self, index: Index) -> Callable[[Value], Value]:
        """Return the formula t ↦ ü_g of a piece; the formula is valid at both ends of the piece.

        Breakpoints and pieces are numbered from 0. For n breakpoints, `index` is from 0 to n. The piece
        reaches from breakpoint `index` − 1 to breakpoint `index`; the first piece has no start, and the last
        piece has no end. The pieces of a `GroundMotion` are numbered differently.
        """

    @abc.abstractmethod
    def lookahead(self, threshold: Value | None) -> AbstractLookahead:
        """Return the lookahead for a threshold of |ü_g| [m/s²]. With None, `next_exceedance` and
        `highest_time` are unavailable."""

    def scaled(self, factor) -> Self:
        """Return the motion with its accelerations multiplied by a factor [–]."""
        raise NotImplementedError(f"{type(self).__name__} cannot be scaled; define its method `scaled`")

    def strength(self) -> np.ndarray | None:
        """Return a NumPy array with a number for each motion of a batch, roughly proportional to max|ü_g|.
        Batches solve scenes with small numbers first. Return None if the class has no quick formula."""
        return None

    @property
    def last_piece(self) -> Any:
        """Index of the piece after the last breakpoint."""
        return self.breakpoints.shape[-1]

    @property
    def most_pieces(self) -> int:
        """Upper bound of the number of pieces, known at compilation."""
        return self.breakpoints.shape[-1] + 1

    def common_form(self) -> AbstractExcitation:
        """Return the same motion in a form for which fewer programs are compiled. For example, samples are
        padded to a few common lengths."""
        return self

    @property
    def own_dimensions(self) -> dict[str, int]:
        """Dict with the fields that are arrays even in a single motion: name of the field ↦ number of
        dimensions of the array. In a batch of motions, such a field has further leading dimensions."""
        return {}

    def past(self, index: Index, passed: Array) -> Index:
        """Return the index of the piece after piece `index`, if the flag `passed` is True because piece
        `index` has ended; otherwise return `index`."""
        return index + passed.astype(jnp.int32)

    def before(self, index: Index, by: Any = 1) -> Index:
        """Return the index of the previous piece if `by` is 1, or `index` if `by` is 0."""
        return index - by

    def velocity_jump(self, index: Index) -> Value | Shaking | None:
        """Return the jump of the ground's velocity at the end of a piece [m/s]; None for a class of motions
        without velocity jumps."""
        del index
        return None

    def curvature(self) -> Value:
        """Return an upper bound of |d²ü_g/dt²| between breakpoints [m/s⁴]. Components of a `GroundMotion`
        need this method."""
        raise NotImplementedError(
            f"{type(self).__name__} cannot be a component of a GroundMotion; define its method "
            "`curvature`, which returns an upper bound of |d²ü_g/dt²| between breakpoints"
        )

    def at_most(self, piece: Index, t: Value, ahead: Value, now: Value) -> Value | None:
        """Return an upper bound of |ü_g| from t to t + `ahead` within a piece [m/s²]; None if the class has
        no formula for it.

        - `piece`: index of the piece
        - `t`: time [s]
        - `ahead`: duration [s]; t + `ahead` must not be after the end of the piece
        - `now`: |ü_g(t)| [m/s²]
        """
        del piece, t, ahead, now
        return None

    def longest_step(self) -> Number:
        """Return the longest step that resolves the motion [s], or 0 for a motion without duration.

        In full contact of a rigid podium no error estimate limits the steps, and the uplift demand is
        approximated by a quintic polynomial through both ends of a step. The default is a sixteenth of the
        duration. Motions with several oscillations return less. For two components, the result is the
        smaller of their two values; a component without duration is ignored.
        """
        start, end = self.support
        return (end - start) / 16

    def lowest(self) -> tuple[Value, Value]:
        """Return the minimum of ü_g [m/s²], which may be positive, and its time [s], for a single motion.

        By default, ü_g is sampled at `SAMPLES` equally spaced times and at the breakpoints. The returned time
        is the time of the smallest sample. Where ü_g is smooth, a parabola through this sample and its
        neighbours refines the value, but not the time.
        """
        start, end = self.support
        times = jnp.concatenate(
            [start + (end - start) * jnp.linspace(0.0, 1.0, SAMPLES), jnp.atleast_1d(self.breakpoints)]
        )
        times = jnp.where(jnp.isfinite(times), times, start)
        values = self(times)
        k = jnp.argmin(values)
        # Minimum of the parabola through the sample and its neighbours, if all three are on one piece.
        inner = jnp.clip(k, 1, SAMPLES - 2)
        before, mid, after = values[inner - 1], values[inner], values[inner + 1]
        second_difference = before - 2 * mid + after
        minimum = mid - (after - before) ** 2 / (8 * jnp.where(second_difference > 0, second_difference, 1.0))
        is_on_one_piece = self.locate(times[k - 1]) == self.locate(times[k + 1])
        is_smooth = (inner == k) & (second_difference > 0) & is_on_one_piece
        return jnp.where(is_smooth, jnp.minimum(minimum, values[k]), values[k]), times[k]

    def breakpoint(self, index: Index) -> Value:
        """Return the time of a breakpoint [s]; inf for an index after the last one."""
        times = self.breakpoints
        result = jnp.asarray(jnp.inf, times.dtype)
        for k in reversed(range(times.shape[-1])):
            result = jnp.where(index == k, times[k], result)
        return result

    def locate(self, t: Value) -> Index:
        """Return the index of the piece at t; at a breakpoint, the piece that starts there."""
        return jnp.sum(self.breakpoints <= t).astype(jnp.int32)

    def __call__(self, t: Float[ArrayLike, "*times"]) -> Float[Array, "*times"]:
        """Return ü_g(t) [m/s²]. At a breakpoint this is the limit from the right, but at the last breakpoint
        the limit from the left."""
        t = as_float(t)

        def evaluate(s):
            piece = self.locate(s)
            is_last = (piece == self.last_piece) & (self.breakpoint(piece - 1) == s)
            return self.piece(piece - is_last.astype(piece.dtype))(s)

        with nans_allowed():  # an inf from `breakpoint` is no error
            return jax.vmap(evaluate)(t.ravel()).reshape(t.shape)


class _RestLookahead(AbstractLookahead):
    """Lookahead of a motion that is always zero."""

    def next_exceedance(self, t: Value, piece: Index) -> Value:
        return jnp.full_like(t, jnp.inf)

    def impulse(self, t: Value, piece: Index) -> Value:
        return jnp.zeros_like(t)

    def peak(self, t: Value, piece: Index, now: Value) -> Value:
        return jnp.zeros_like(t)

    def highest_time(self, start: Value, end: Value, side: Value | None = None) -> Value:
        return start


class Rest(AbstractExcitation):
    """No ground motion (ü_g = 0), for free rocking from an initial state."""

    @property
    def support(self) -> tuple[Number, Number]:
        return jnp.zeros(()), jnp.zeros(())

    @property
    def breakpoints(self) -> Float[Array, "*batch n"]:
        return jnp.zeros((0,))

    def piece(self, index: Index) -> Callable[[Value], Value]:
        return jnp.zeros_like

    def lookahead(self, threshold: Value | None) -> AbstractLookahead:
        return _RestLookahead()

    def curvature(self) -> Value:
        return jnp.zeros(())

    def lowest(self) -> tuple[Value, Value]:
        return jnp.zeros(()), jnp.zeros(())

    def scaled(self, factor) -> Self:
        del factor
        return self


def size_on(side: Value | None, values: Array) -> Array:
    """Return |values|, or side·values if a side is given."""
    return jnp.abs(values) if side is None else side * values
