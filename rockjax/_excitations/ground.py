"""Ground that moves vertically as well: two excitations as one.

A piece of the pair is a piece of each, numbered together; where breakpoints of both fall on one time, both go
on to their next pieces at once. The columns lift where one of two combined signals, ±ü_g − K v̈_g, exceeds a
level (C10): lookaheads find its roots.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from rockjax._checks import concrete, shown, single
from rockjax._types import Index, Number, Value

from .base import AbstractExcitation, AbstractLookahead, Shaking

PARTS = "horizontal", "vertical"
MOST_PIECES = 2**31  # numbered by one integer of both components
TOUCH = 1e-9  # of the time scale of the motion: excursions above a level that are shorter are below rounding
CAUTION = 1 - 1e-6  # of the level from which on the horizontal motion is looked at closely


def _component(name: str) -> Callable[[Any], AbstractExcitation]:
    def convert(value: Any) -> AbstractExcitation:
        motion = value.record() if callable(getattr(value, "record", None)) else value
        if isinstance(motion, GroundMotion):
            raise ValueError(f"GroundMotion: {name} must be one component, got a GroundMotion")
        if not isinstance(motion, AbstractExcitation):
            raise ValueError(f"GroundMotion: {name} must be a rockjax motion, got {shown(value)}")
        return motion

    return convert


class GroundMotion(AbstractExcitation):
    """A horizontal and a vertical ground motion as one.

    - `horizontal`: ü_g, any motion; `vertical`: v̈_g, upwards positive, any motion [m/s²]

    `scaled(f)` scales both. Its support is the union of theirs, and each is zero outside its own. Called, it
    is the horizontal acceleration. g + v̈_g must be positive at all times, or joints could open vertically,
    which is not in the model: `ValueError` for a single scene of concrete numbers, else the result
    `weightless`. Raises `ValueError` for components that are no single motions.
    """

    horizontal: AbstractExcitation = eqx.field(converter=_component("horizontal"))
    vertical: AbstractExcitation = eqx.field(converter=_component("vertical"))

    def __check_init__(self):
        if self.horizontal.most_pieces * self.vertical.most_pieces >= MOST_PIECES:
            raise ValueError(
                "GroundMotion: horizontal and vertical have too many samples together, "
                f"{self.horizontal.most_pieces} and {self.vertical.most_pieces}; resample one of them"
            )

    @property
    def support(self) -> tuple[Number, Number]:
        (start, end), (other_start, other_end) = self.horizontal.support, self.vertical.support
        return jnp.minimum(start, other_start), jnp.maximum(end, other_end)

    @property
    def shorter(self) -> Number:
        """The duration of the shorter component, of those that have one [s]."""
        long = [end - start for start, end in (self.horizontal.support, self.vertical.support)]
        long = [jnp.where(duration > 0, duration, jnp.inf) for duration in long]
        shorter = jnp.minimum(*long)
        return jnp.where(jnp.isfinite(shorter), shorter, 0.0)

    @property
    def breakpoints(self) -> Float[Array, "*batch n"]:
        both = [motion.breakpoints for motion in (self.horizontal, self.vertical)]
        batch = jnp.broadcast_shapes(*(y.shape[:-1] for y in both))
        times = jnp.concatenate([jnp.broadcast_to(y, (*batch, y.shape[-1])) for y in both], axis=-1)
        times = jnp.sort(times, axis=-1)
        again = jnp.concatenate(
            [jnp.zeros_like(times[..., :1], bool), times[..., 1:] == times[..., :-1]], axis=-1
        )[..., : times.shape[-1]]
        return jnp.sort(jnp.where(again, jnp.inf, times), axis=-1)

    @property
    def most_pieces(self) -> int:
        return self.horizontal.most_pieces * self.vertical.most_pieces

    @property
    def last_piece(self) -> Any:
        return self._together(self.horizontal.last_piece, self.vertical.last_piece)

    @property
    def own_dimensions(self) -> dict[str, int]:
        return {
            f"{name}.{field}": dimensions
            for name in PARTS
            for field, dimensions in getattr(self, name).own_dimensions.items()
        }

    def scaled(self, factor) -> Self:
        return dataclasses.replace(
            self, horizontal=self.horizontal.scaled(factor), vertical=self.vertical.scaled(factor)
        )

    def strength(self) -> np.ndarray | None:
        return self.horizontal.strength()

    def common_form(self) -> Self:
        horizontal, vertical = self.horizontal.common_form(), self.vertical.common_form()
        if horizontal.most_pieces * vertical.most_pieces >= MOST_PIECES:
            return self  # very long ones: as they are
        return dataclasses.replace(self, horizontal=horizontal, vertical=vertical)

    def _together(self, i: Any, j: Any) -> Any:
        return i * self.vertical.most_pieces + j

    def parts(self, index: Index) -> tuple[Index, Index]:
        """The pieces of both components."""
        return index // self.vertical.most_pieces, index % self.vertical.most_pieces

    def piece(self, index: Index) -> Callable[[Value], Shaking]:  # pyright: ignore[reportIncompatibleMethodOverride]
        i, j = self.parts(index)
        horizontal, vertical = self.horizontal.piece(i), self.vertical.piece(j)
        return lambda t: Shaking(horizontal(t), vertical(t))

    def breakpoint(self, index: Index) -> Value:
        first, other = self._ends(index)
        return jnp.where(first <= other, first, other)

    def _ends(self, index: Index) -> tuple[Value, Value]:
        i, j = self.parts(index)
        return self.horizontal.breakpoint(i), self.vertical.breakpoint(j)

    def locate(self, t: Value) -> Index:
        return self._together(self.horizontal.locate(t), self.vertical.locate(t))

    def past(self, index: Index, passed: Array) -> Index:
        i, j = self.parts(index)
        first, other = jax.lax.stop_gradient(self._ends(index))
        on = lambda flag: (passed & flag).astype(index.dtype)
        return self._together(i + on(first <= other), j + on(other <= first))

    def before(self, index: Index, by: Any = 1) -> Index:
        i, j = self.parts(index)
        none = -jnp.inf
        first = jnp.where(i > 0, self.horizontal.breakpoint(i - 1), none)
        other = jnp.where(j > 0, self.vertical.breakpoint(j - 1), none)
        back = lambda flag, k: (flag & (k > 0) & (jnp.asarray(by) != 0)).astype(index.dtype)
        return self._together(i - back(first >= other, i), j - back(other >= first, j))

    def tie(self, index: Index) -> tuple[Value, Index]:
        """Return how far the horizontal breakpoint moves past the vertical one of the same piece end (zero in
        value), and the piece between them."""
        i, j = self.parts(index)
        first, other = self._ends(index)
        tied = jax.lax.stop_gradient((first == other) & jnp.isfinite(first))
        moves = [jnp.where(tied, y, 0.0) for y in (first, other)]
        moves = [y - jax.lax.stop_gradient(y) for y in moves]
        return moves[0] - moves[1], self._together(i + 1, j)

    def __call__(self, t):
        """Horizontal ground acceleration ü_g(t) [m/s²]; that of `vertical` is v̈_g(t)."""
        return self.horizontal(t)

    @staticmethod
    def in_proportion(pulse: Callable[[Any, Any], AbstractExcitation], ratio: float) -> Proportional:
        """A function (a_p, T_p) → pair for spectra: a pulse, and `ratio` times the same as its vertical
        motion."""
        return Proportional(pulse, ratio)

    def lookahead(self, threshold: Value | None, tilt: Value | None = None) -> PairLookahead:
        """With `tilt`, K of the combined signals, exceedances are those of max_± (±ü_g − K v̈_g)."""
        motion: GroundMotion = jax.lax.stop_gradient(self)
        vertical = motion.vertical.lookahead(None)
        if threshold is None or tilt is None:
            return PairLookahead(motion, motion.horizontal.lookahead(threshold), vertical, None, None, None)
        threshold, tilt = jax.lax.stop_gradient((threshold, tilt))
        fall = jnp.minimum(motion.vertical.lowest()[0], 0.0)
        doubtful = jnp.maximum(CAUTION * (threshold + tilt * fall), jnp.finfo(threshold.dtype).tiny)
        curvature = motion.horizontal.curvature() + tilt * motion.vertical.curvature()
        horizontal = motion.horizontal.lookahead(doubtful)
        return PairLookahead(motion, horizontal, vertical, threshold, tilt, curvature)


@dataclasses.dataclass(frozen=True)
class Proportional:
    """Pulses with a vertical component in proportion, v̈_g = `ratio` ü_g."""

    pulse: Callable[[Any, Any], AbstractExcitation]
    ratio: float

    def __post_init__(self):
        single("GroundMotion.in_proportion", "ratio", self.ratio, math.isfinite, "finite")

    @property
    def __name__(self) -> str:
        return f"{getattr(self.pulse, '__name__', repr(self.pulse))} with vertical ratio {self.ratio:g}"

    def __call__(self, a_p, T_p) -> GroundMotion:
        return GroundMotion(self.pulse(a_p, T_p), self.pulse(self.ratio * a_p, T_p))


class OfAmplitude(AbstractExcitation):
    """The motions of a function (a_p, T_p) → excitation as one whose scale is a_p: itself it is that of 1."""

    T_p: Number
    pulse: Callable[[Any, Any], AbstractExcitation] = eqx.field(static=True)

    def scaled(self, factor) -> AbstractExcitation:  # pyright: ignore[reportIncompatibleMethodOverride]
        return self.pulse(factor, self.T_p)

    @property
    def support(self) -> tuple[Number, Number]:
        return self.scaled(1.0).support

    @property
    def breakpoints(self) -> Float[Array, "*batch n"]:
        return self.scaled(1.0).breakpoints

    def piece(self, index: Index) -> Callable[[Value], Value]:
        return self.scaled(1.0).piece(index)

    def lookahead(self, threshold: Value | None) -> AbstractLookahead:
        return self.scaled(1.0).lookahead(threshold)


class PairLookahead(AbstractLookahead):
    """Bounds of the rest of both components; those of a single component are of the horizontal one."""

    motion: GroundMotion
    horizontal: AbstractLookahead
    vertical: AbstractLookahead
    threshold: Value | None
    tilt: Value | None
    curvature: Value | None  # of the combined signals

    def impulse(self, t: Value, piece: Index) -> Value:
        return self.horizontal.impulse(t, self.motion.parts(piece)[0])

    def peak(self, t: Value, piece: Index, now: Value) -> Value:
        return self.horizontal.peak(t, self.motion.parts(piece)[0], now)

    def highest_time(self, start: Value, end: Value) -> Value:
        return self.horizontal.highest_time(start, end)

    def vertical_impulse(self, t: Value, piece: Index) -> Value:
        """An upper bound of ∫|v̈_g| dt from t on [m/s]."""
        return self.vertical.impulse(t, self.motion.parts(piece)[1])

    def vertical_peak(self, t: Value, piece: Index) -> Value:
        """An upper bound of |v̈_g| from t on [m/s²]."""
        own = self.motion.parts(piece)[1]
        return self.vertical.peak(t, own, jnp.abs(self.motion.vertical.piece(own)(t)))

    def next_exceedance(self, t: Value, piece: Index) -> Value:
        """Steps that cannot jump over a crossing: from one place where the horizontal motion is large enough
        to another, along the parabolas of greatest curvature through value and slope of both signals."""
        del piece
        level, tilt, curvature = self.threshold, self.tilt, self.curvature
        assert level is not None
        assert tilt is not None
        assert curvature is not None
        motion, begin, resolution = self.motion, t, 8 * jnp.finfo(t.dtype).eps
        curved = curvature > 0
        scale = jnp.where(curved, jnp.sqrt(level / jnp.where(curved, curvature, 1.0)), 0.0)
        start, end = motion.support

        def safe(spare: Value, slope: Value) -> Value:
            """Until a signal that is `spare` below the level can reach it."""
            root = jnp.sqrt(slope**2 + 2 * curvature * jnp.maximum(spare, 0.0))
            rising, bend = slope + root > 0, jnp.where(curved, curvature, 1.0)
            up = 2 * spare / jnp.where(rising, slope + root, 1.0)
            return jnp.where(
                slope > 0,
                up,
                jnp.where(curved, (root - slope) / bend, jnp.where(rising, up, jnp.inf)),
            )

        def advance(carry):
            _, t, _ = carry
            near = self.horizontal.next_exceedance(t, motion.horizontal.locate(t))
            comes = jnp.isfinite(near)
            s = jnp.where(comes, near, t)
            here = motion.locate(s)
            now, rate = jax.jvp(motion.piece(here), (s,), (jnp.ones_like(s),))
            sides = [(level - (side * now.horizontal - tilt * now.vertical)) for side in (1.0, -1.0)]
            slopes = [side * rate.horizontal - tilt * rate.vertical for side in (1.0, -1.0)]
            digit = resolution * jnp.maximum(jnp.abs(s), end - start)
            least = jnp.maximum(TOUCH * scale, digit)
            step = jnp.maximum(jnp.minimum(*map(safe, sides, slopes)), least)
            spare = jnp.minimum(*sides)
            found = comes & (spare < 0)
            # Back to where it was crossed, unless it began there or the ground jumped.
            slope = jnp.where(sides[0] < sides[1], *slopes)
            back = s + jnp.where(slope > 0, spare / jnp.where(slope > 0, slope, 1.0), 0.0)
            last = motion.before(here)
            jumped = jnp.where(last == here, -jnp.inf, motion.breakpoint(last))
            floor = jnp.maximum(jnp.maximum(begin, s - 2 * least), jnp.minimum(jumped, s))
            # Past where it looked in any case: what is worked out twice may differ in the last digit,
            # breakpoints as well as comparisons.
            on = jnp.maximum(jnp.minimum(s + step, motion.breakpoint(here)), s + digit)
            return jnp.maximum(back, floor), jnp.where(comes, on, jnp.inf), found

        t, _, found = jax.lax.while_loop(
            lambda carry: ~carry[2] & jnp.isfinite(carry[1]), advance, (t, t, jnp.zeros((), bool))
        )
        return jnp.where(found, t, jnp.inf)


def check_weight(owner: str, motion: AbstractExcitation, g: Number) -> None:
    """Raise `ValueError` unless g + v̈_g is positive at all times, where numbers are concrete and single."""
    if not isinstance(motion, GroundMotion) or any(map(jnp.ndim, motion.vertical.support)) or jnp.ndim(g):
        return
    # In the common form: JAX compiles what it does here for every number of samples.
    low, when = (concrete(y) for y in motion.vertical.common_form().lowest())
    gravity = concrete(g)
    if low is None or when is None or gravity is None or low.ndim or gravity + low > 0:
        return
    raise ValueError(
        f"{owner}: g + v̈_g must be positive at all times, got {float(gravity):g} {float(low):+.6g} m/s² "
        f"at t = {float(when):.6g} s: joints could open vertically, which is not in the model"
    )
