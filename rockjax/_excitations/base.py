"""Excitations: callables t ↦ ü_g with support and breakpoints.

Breakpoints divide an excitation into smooth pieces. The engine never steps across a breakpoint and evaluates
the smooth formula `piece(i)` of piece i, so that jumps and kinks cost no accuracy. `lookahead(threshold)`
bounds the rest of the motion: when |ü_g| next exceeds the threshold, and how large |ü_g| and its integral can
still be.
"""

from __future__ import annotations

import abc
import warnings
from collections.abc import Callable
from typing import Any, NamedTuple, Self

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from rockjax._checks import as_float
from rockjax._programs.program import nans_allowed
from rockjax._text.cards import card, format_call
from rockjax._tree import Module
from rockjax._types import Index, Number, Value

SAMPLES = 4097  # of a motion given by a formula, to find its minimum


class Shaking(NamedTuple):
    """Ground acceleration with a vertical component [m/s²]; without one it is a number."""

    horizontal: Value
    vertical: Value  # upwards


class AbstractLookahead(Module):
    """Bounds of the rest of an excitation, all of them constants for derivatives."""

    @abc.abstractmethod
    def next_exceedance(self, t: Value, piece: Index) -> Value:
        """Return the first time ≥ t at which |ü_g| exceeds the threshold, inf if it never does [s]."""

    @abc.abstractmethod
    def impulse(self, t: Value, piece: Index) -> Value:
        """Return an upper bound of ∫|ü_g| dt from t on [m/s]."""

    @abc.abstractmethod
    def peak(self, t: Value, piece: Index, now: Value) -> Value:
        """Return an upper bound of |ü_g| from t on, given |ü_g(t)| = `now` [m/s²]."""

    @abc.abstractmethod
    def highest_time(self, start: Value, end: Value) -> Value:
        """Return when |ü_g| is largest between two times [s]; needs a threshold. `end` may be inf."""


class AbstractExcitation(Module):
    """Base class of ground motions ü_g(t) [m/s²]. Subclasses implement the abstract methods."""

    def __init_subclass__(cls, **kwargs):
        super().__init_subclass__(**kwargs)
        if "outlook" in cls.__dict__ and "lookahead" not in cls.__dict__:
            words = f"{cls.__name__}.outlook is called lookahead now: rename the method"
            warnings.warn(words, DeprecationWarning, stacklevel=2)
            cls.lookahead = cls.__dict__["outlook"]

    @property
    @abc.abstractmethod
    def support(self) -> tuple[Number, Number]:
        """(t_start, t_end) [s]; outside, ü_g is zero or below rounding."""

    @property
    @abc.abstractmethod
    def breakpoints(self) -> Float[Array, "*batch n"]:
        """Times at which ü_g or a derivative of it jumps, ascending, on the last axis [s]."""

    @abc.abstractmethod
    def piece(self, index: Index) -> Callable[[Value], Value]:
        """Return the formula of ü_g between breakpoints index−1 and index (0 … n), valid at both ends."""

    @abc.abstractmethod
    def lookahead(self, threshold: Value | None) -> AbstractLookahead:
        """Return bounds of the rest; without `threshold`, exceedances are unavailable."""

    def scaled(self, factor) -> Self:
        """Return the motion times a factor."""
        raise NotImplementedError(f"{type(self).__name__} cannot be scaled; give it a method `scaled`")

    def strength(self) -> np.ndarray | None:
        """Return a number in proportion to max|ü_g| of each motion (host), None if not cheaply known."""
        return None

    @property
    def last_piece(self) -> Any:
        """Index of the piece after the last breakpoint."""
        return self.breakpoints.shape[-1]

    @property
    def most_pieces(self) -> int:
        """Largest possible number of pieces, known before tracing."""
        return self.breakpoints.shape[-1] + 1

    def common_form(self) -> AbstractExcitation:
        """Return the motion in a form whose compiled programs serve its whole kind, for any length."""
        return self

    @property
    def own_dimensions(self) -> dict[str, int]:
        """Number of dimensions of fields that are arrays for a single motion; further ones are of a batch."""
        return {}

    def past(self, index: Index, passed: Array) -> Index:
        """Return the next piece if the end of this one is `passed`, else this one."""
        return index + passed.astype(jnp.int32)

    def before(self, index: Index, by: Any = 1) -> Index:
        """Return the piece before one; itself where `by` is 0."""
        return index - by

    def curvature(self) -> Value:
        """Return a bound of |d²ü_g/dt²| between breakpoints [m/s⁴]; needed for components of a pair."""
        raise NotImplementedError(
            f"{type(self).__name__} has no bound of its curvature; give it a method `curvature`, a bound "
            "of |d²ü_g/dt²| between breakpoints"
        )

    def at_most(self, piece: Index, t: Value, ahead: Value, now: Value) -> Value | None:
        """Return a bound of |ü_g| from t to t + `ahead` within a piece [m/s²], or None if unknown.

        - `piece`: index of the piece; `t`: time [s]; `ahead`: duration, not past the end of the piece [s]
        - `now`: |ü_g(t)| [m/s²]
        """
        del piece, t, ahead, now
        return None

    def lowest(self) -> tuple[Value, Value]:
        """Return the least ü_g [m/s²], which may be positive, and its time [s], of a single motion."""
        start, end = self.support
        times = jnp.concatenate(
            [start + (end - start) * jnp.linspace(0.0, 1.0, SAMPLES), jnp.atleast_1d(self.breakpoints)]
        )
        times = jnp.where(jnp.isfinite(times), times, start)
        values = self(times)
        k = jnp.argmin(values)
        # A parabola through the neighbours if all three are on one piece.
        inside = jnp.clip(k, 1, SAMPLES - 2)
        low, mid, high = values[inside - 1], values[inside], values[inside + 1]
        bend = low - 2 * mid + high
        least = mid - (high - low) ** 2 / (8 * jnp.where(bend > 0, bend, 1.0))
        smooth = (inside == k) & (bend > 0) & (self.locate(times[k - 1]) == self.locate(times[k + 1]))
        return jnp.where(smooth, jnp.minimum(least, values[k]), values[k]), times[k]

    def breakpoint(self, index: Index) -> Value:
        """Return the time of breakpoint `index`, inf past the last one [s]."""
        times = self.breakpoints
        result = jnp.asarray(jnp.inf, times.dtype)
        for k in reversed(range(times.shape[-1])):
            result = jnp.where(index == k, times[k], result)
        return result

    def locate(self, t: Value) -> Index:
        """Return the piece that begins at or before t (the right limit at a breakpoint)."""
        return jnp.sum(self.breakpoints <= t).astype(jnp.int32)

    def __call__(self, t: Float[ArrayLike, "*times"]) -> Float[Array, "*times"]:
        """Return ü_g(t) [m/s²]: the right limit at breakpoints, the left limit at the last one."""
        t = as_float(t)

        def at(s):
            piece = self.locate(s)
            last = (piece == self.last_piece) & (self.breakpoint(piece - 1) == s)
            return self.piece(piece - last.astype(piece.dtype))(s)

        with nans_allowed():  # the breakpoint after the last one is inf
            return jax.vmap(at)(t.ravel()).reshape(t.shape)

    def __repr__(self):
        return format_call(self)

    def _repr_html_(self):
        return card(self)


class _Silence(AbstractLookahead):
    def next_exceedance(self, t: Value, piece: Index) -> Value:
        return jnp.full_like(t, jnp.inf)

    def impulse(self, t: Value, piece: Index) -> Value:
        return jnp.zeros_like(t)

    def peak(self, t: Value, piece: Index, now: Value) -> Value:
        return jnp.zeros_like(t)

    def highest_time(self, start: Value, end: Value) -> Value:
        return start


class Rest(AbstractExcitation):
    """No ground motion: free rocking from an initial state."""

    @property
    def support(self) -> tuple[Number, Number]:
        return jnp.zeros(()), jnp.zeros(())

    @property
    def breakpoints(self) -> Float[Array, "*batch n"]:
        return jnp.zeros((0,))

    def piece(self, index: Index) -> Callable[[Value], Value]:
        return jnp.zeros_like

    def lookahead(self, threshold: Value | None) -> AbstractLookahead:
        return _Silence()

    def curvature(self) -> Value:
        return jnp.zeros(())

    def lowest(self) -> tuple[Value, Value]:
        return jnp.zeros(()), jnp.zeros(())

    def scaled(self, factor) -> Self:
        del factor
        return self
