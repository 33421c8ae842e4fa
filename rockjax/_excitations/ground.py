"""Ground motions with a vertical component: pairs of two excitations.

`base.py` defines breakpoints, pieces and lookaheads. A piece of the pair combines piece i of the horizontal
component with piece j of the vertical component. The index of the combined piece is i·n + j, where n is the
number of vertical pieces. Where breakpoints of both components coincide, i and j advance together.

Without a vibrating superstructure, the columns lift when one of the combined signals ±ü_g − K v̈_g exceeds
a threshold. K is the factor of v̈_g in (C10) of docs/control.md. The lookahead of the pair finds the time at
which this happens.
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

from rockjax._checks import concrete, format_value, require_number
from rockjax._types import Index, Number, Value

from .base import AbstractExcitation, AbstractLookahead, Shaking

PARTS = "horizontal", "vertical"
MAX_PIECES = 2**31  # limit of the number of pairs of pieces, because their index is a 32-bit integer
# An excursion of a combined signal above the threshold may be missed if it is shorter than this multiple of
# √(threshold/curvature), or shorter than the rounding of time. `curvature` is the bound of the second
# derivatives of the combined signals.
MIN_EXCURSION = 1e-9
# Factor on the level of |ü_g| below which no combined signal can exceed the threshold. It is less than 1 as a
# margin for rounding.
LEVEL_SAFETY = 1 - 1e-6


def _component(name: str) -> Callable[[Any], AbstractExcitation]:
    """Return the converter for the field `name`. The converter accepts motions, and objects whose method
    `record` returns a motion."""

    def convert(value: Any) -> AbstractExcitation:
        motion = value.record() if callable(getattr(value, "record", None)) else value
        if isinstance(motion, GroundMotion):
            raise ValueError(
                f"GroundMotion: {name} must be one component, got a GroundMotion; pass its horizontal or "
                "vertical component"
            )
        if not isinstance(motion, AbstractExcitation):
            raise ValueError(f"GroundMotion: {name} must be a rockjax motion, got {format_value(value)}")
        return motion

    return convert


class GroundMotion(AbstractExcitation):
    """A ground motion with a horizontal and a vertical component.

    - `horizontal`, `vertical`: motions with one component, ü_g and v̈_g (upwards positive) [m/s²]

    `scaled(f)` scales both components. The support reaches from the start of the earlier component to the
    end of the later one. A call returns the horizontal acceleration.

    g + v̈_g must be positive at all times, because otherwise joints could open vertically, which the model
    excludes. If g + v̈_g is not always positive, a single scene whose values are not traced raises
    `ValueError`. Scenes of a batch and traced scenes end with the result `weightless`. Raises `ValueError`
    for arguments that are not motions with one component, and for motions with too many pieces (samples).
    """

    horizontal: AbstractExcitation = eqx.field(converter=_component("horizontal"))
    vertical: AbstractExcitation = eqx.field(converter=_component("vertical"))

    def __check_init__(self):
        if self.most_pieces >= MAX_PIECES:
            raise ValueError(
                "GroundMotion: the product of the numbers of pieces of horizontal and vertical must be "
                f"below 2³¹, got {self.horizontal.most_pieces} and {self.vertical.most_pieces}; "
                "resample one component"
            )

    @property
    def support(self) -> tuple[Number, Number]:
        (start, end), (other_start, other_end) = self.horizontal.support, self.vertical.support
        return jnp.minimum(start, other_start), jnp.maximum(end, other_end)

    def longest_step(self) -> Number:
        lengths = [motion.longest_step() for motion in (self.horizontal, self.vertical)]
        shorter = jnp.minimum(*[jnp.where(length > 0, length, jnp.inf) for length in lengths])
        return jnp.where(jnp.isfinite(shorter), shorter, 0.0)

    @property
    def breakpoints(self) -> Float[Array, "*batch n"]:
        rows = [motion.breakpoints for motion in (self.horizontal, self.vertical)]
        batch = jnp.broadcast_shapes(*(y.shape[:-1] for y in rows))
        times = jnp.concatenate([jnp.broadcast_to(y, (*batch, y.shape[-1])) for y in rows], axis=-1)
        times = jnp.sort(times, axis=-1)
        is_repeated = jnp.concatenate(
            [jnp.zeros_like(times[..., :1], bool), times[..., 1:] == times[..., :-1]], axis=-1
        )[..., : times.shape[-1]]
        return jnp.sort(jnp.where(is_repeated, jnp.inf, times), axis=-1)

    @property
    def most_pieces(self) -> int:
        return self.horizontal.most_pieces * self.vertical.most_pieces

    @property
    def last_piece(self) -> Any:
        return self._combined_index(self.horizontal.last_piece, self.vertical.last_piece)

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
        if horizontal.most_pieces * vertical.most_pieces >= MAX_PIECES:
            return self  # a padded motion would have too many pairs of pieces
        return dataclasses.replace(self, horizontal=horizontal, vertical=vertical)

    def _combined_index(self, i: Any, j: Any) -> Any:
        """Return the index of the pair of pieces i and j."""
        return i * self.vertical.most_pieces + j

    def parts(self, index: Index) -> tuple[Index, Index]:
        """Return the indices of the pieces of both components."""
        return index // self.vertical.most_pieces, index % self.vertical.most_pieces

    def piece(self, index: Index) -> Callable[[Value], Shaking]:  # pyright: ignore[reportIncompatibleMethodOverride]
        i, j = self.parts(index)
        horizontal, vertical = self.horizontal.piece(i), self.vertical.piece(j)
        return lambda t: Shaking(horizontal(t), vertical(t))

    def breakpoint(self, index: Index) -> Value:
        end_i, end_j = self._ends(index)
        return jnp.where(end_i <= end_j, end_i, end_j)

    def _ends(self, index: Index) -> tuple[Value, Value]:
        i, j = self.parts(index)
        return self.horizontal.breakpoint(i), self.vertical.breakpoint(j)

    def locate(self, t: Value) -> Index:
        return self._combined_index(self.horizontal.locate(t), self.vertical.locate(t))

    def past(self, index: Index, passed: Array) -> Index:
        i, j = self.parts(index)
        end_i, end_j = jax.lax.stop_gradient(self._ends(index))
        advances = lambda flag: (passed & flag).astype(index.dtype)
        return self._combined_index(i + advances(end_i <= end_j), j + advances(end_j <= end_i))

    def before(self, index: Index, by: Any = 1) -> Index:
        i, j = self.parts(index)
        start_i = jnp.where(i > 0, self.horizontal.breakpoint(i - 1), -jnp.inf)
        start_j = jnp.where(j > 0, self.vertical.breakpoint(j - 1), -jnp.inf)
        retreats = lambda flag, k: (flag & (k > 0) & (jnp.asarray(by) != 0)).astype(index.dtype)
        return self._combined_index(i - retreats(start_i >= start_j, i), j - retreats(start_j >= start_i, j))

    def velocity_jump(self, index: Index) -> Shaking | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        i, j = self.parts(index)
        horizontal: Any = self.horizontal.velocity_jump(i)
        vertical: Any = self.vertical.velocity_jump(j)
        if horizontal is None and vertical is None:
            return None
        end_i, end_j = self._ends(index)
        return Shaking(
            jnp.where(end_i <= end_j, 0.0 if horizontal is None else horizontal, 0.0),
            jnp.where(end_j <= end_i, 0.0 if vertical is None else vertical, 0.0),
        )

    def tie(self, index: Index) -> tuple[Value, Index]:
        """Return the difference of the two breakpoints that coincide at the end of a piece, and the index of
        the piece between these breakpoints.

        The difference is the time of the horizontal breakpoint minus the time of the vertical breakpoint [s].
        Its value is zero, but its derivatives with respect to parameters are not zero if the two times depend
        differently on the parameters. If no breakpoints coincide, the difference is the constant zero. The
        piece between the breakpoints combines the next horizontal piece with the present vertical piece.
        """
        i, j = self.parts(index)
        end_i, end_j = self._ends(index)
        coincide = jax.lax.stop_gradient((end_i == end_j) & jnp.isfinite(end_i))
        offsets = [jnp.where(coincide, y, 0.0) for y in (end_i, end_j)]
        offsets = [y - jax.lax.stop_gradient(y) for y in offsets]
        return offsets[0] - offsets[1], self._combined_index(i + 1, j)

    def __call__(self, t):
        """Return the horizontal ground acceleration ü_g(t) [m/s²]; `vertical(t)` returns v̈_g(t)."""
        return self.horizontal(t)

    @staticmethod
    def in_proportion(pulse: Callable[[Any, Any], AbstractExcitation], ratio: float) -> Proportional:
        """Return a function (a_p, T_p) ↦ motion with v̈_g = `ratio` · ü_g, for spectra.

        - `pulse`: the function (a_p, T_p) ↦ component, such as a class of pulses
        - `ratio`: finite number [–]
        """
        return Proportional(pulse, ratio)

    def lookahead(self, threshold: Value | None, tilt: Value | None = None) -> PairLookahead:
        """Return the lookahead for a threshold [m/s²] of the combined signals ±ü_g − K v̈_g, with K = `tilt`.
        If `tilt` is None, `threshold` is a threshold of |ü_g|. The method `next_exceedance` of the lookahead
        needs both arguments. The method `highest_time` needs only the threshold."""
        motion: GroundMotion = jax.lax.stop_gradient(self)
        vertical = motion.vertical.lookahead(None)
        if threshold is None or tilt is None:
            return PairLookahead(motion, motion.horizontal.lookahead(threshold), vertical, None, None, None)
        threshold, tilt = jax.lax.stop_gradient((threshold, tilt))
        # A combined signal can exceed the threshold only where |ü_g| exceeds this level.
        min_vertical = jnp.minimum(motion.vertical.lowest()[0], 0.0)
        level = jnp.maximum(LEVEL_SAFETY * (threshold + tilt * min_vertical), jnp.finfo(threshold.dtype).tiny)
        curvature = motion.horizontal.curvature() + tilt * motion.vertical.curvature()
        horizontal = motion.horizontal.lookahead(level)
        return PairLookahead(motion, horizontal, vertical, threshold, tilt, curvature)


class SharedPieces(GroundMotion):
    """A ground motion whose two components have the same breakpoints, such as the motion of a floor. Piece i
    of the pair combines piece i of both components, so the number of pieces is that of one component."""

    @property
    def breakpoints(self) -> Float[Array, "*batch n"]:
        return self.horizontal.breakpoints

    @property
    def most_pieces(self) -> int:
        return self.horizontal.most_pieces

    def _combined_index(self, i: Any, j: Any) -> Any:
        del j
        return i

    def parts(self, index: Index) -> tuple[Index, Index]:
        return index, index


@dataclasses.dataclass(frozen=True)
class Proportional:
    """Function (a_p, T_p) ↦ pulse with a proportional vertical component, v̈_g = `ratio` · ü_g. `pulse` is a
    function (a_p, T_p) ↦ component, proportional to a_p."""

    pulse: Callable[[Any, Any], AbstractExcitation]
    ratio: float

    def __post_init__(self):
        require_number("GroundMotion.in_proportion", "ratio", self.ratio, math.isfinite, "finite")

    @property
    def __name__(self) -> str:
        return f"{getattr(self.pulse, '__name__', repr(self.pulse))} with vertical ratio {self.ratio:g}"

    def __call__(self, a_p, T_p) -> GroundMotion:
        return GroundMotion(self.pulse(a_p, T_p), self.pulse(self.ratio * a_p, T_p))


class ScaledByAmplitude(AbstractExcitation):
    """The excitation `pulse(a_p, T_p)` as a function of a_p alone: `scaled(a_p)` returns the excitation
    with amplitude a_p. Without scaling, a_p is 1.

    - `T_p`: period of the pulse [s]
    - `pulse`: function (a_p, T_p) ↦ excitation, which need not be proportional to a_p
    """

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
    """Bounds of the remaining motion of both components. `impulse`, `peak` and `highest_time` refer to
    the horizontal component."""

    motion: GroundMotion
    horizontal: AbstractLookahead  # lookahead of the horizontal component
    vertical: AbstractLookahead  # lookahead of the vertical component
    # The remaining fields are None if the lookahead was created without threshold or without tilt.
    threshold: Value | None  # threshold of the combined signals [m/s²]
    tilt: Value | None  # K of the combined signals [–]
    curvature: Value | None  # bound of the second derivatives of the combined signals [m/s⁴]

    def impulse(self, t: Value, piece: Index) -> Value:
        return self.horizontal.impulse(t, self.motion.parts(piece)[0])

    def peak(self, t: Value, piece: Index, now: Value) -> Value:
        return self.horizontal.peak(t, self.motion.parts(piece)[0], now)

    def highest_time(self, start: Value, end: Value, side: Value | None = None) -> Value:
        return self.horizontal.highest_time(start, end, side)

    def vertical_impulse(self, t: Value, piece: Index) -> Value:
        """Return an upper bound of ∫|v̈_g| dt from t on [m/s]."""
        return self.vertical.impulse(t, self.motion.parts(piece)[1])

    def vertical_peak(self, t: Value, piece: Index) -> Value:
        """Return an upper bound of |v̈_g| from t on [m/s²]."""
        vertical_piece = self.motion.parts(piece)[1]
        now = jnp.abs(self.motion.vertical.piece(vertical_piece)(t))
        return self.vertical.peak(t, vertical_piece, now)

    def next_exceedance(self, t: Value, piece: Index) -> Value:
        """Return the first time ≥ t at which a combined signal exceeds the threshold [s], or inf if there is
        none.

        The search visits only times at which |ü_g| is large enough for a combined signal to exceed the
        threshold. A step of the search ends where a signal would reach the threshold if its second derivative
        had the largest possible value, so the step passes no crossing. Only steps of the least length may
        pass short excursions above the threshold (see `MIN_EXCURSION`).
        """
        del piece
        threshold, tilt, curvature = self.threshold, self.tilt, self.curvature
        assert threshold is not None
        assert tilt is not None
        assert curvature is not None
        motion, search_start, resolution = self.motion, t, 8 * jnp.finfo(t.dtype).eps
        is_curved = curvature > 0
        scale = jnp.where(is_curved, jnp.sqrt(threshold / jnp.where(is_curved, curvature, 1.0)), 0.0)
        start, end = motion.support

        def safe_time(clearance: Value, slope: Value) -> Value:
            """Return the shortest time in which a signal that is `clearance` below the threshold, and rises
            at the rate `slope`, can reach the threshold."""
            root = jnp.sqrt(slope**2 + 2 * curvature * jnp.maximum(clearance, 0.0))
            rises, safe_curvature = slope + root > 0, jnp.where(is_curved, curvature, 1.0)
            time_up = 2 * clearance / jnp.where(rises, slope + root, 1.0)
            return jnp.where(
                slope > 0,
                time_up,
                jnp.where(is_curved, (root - slope) / safe_curvature, jnp.where(rises, time_up, jnp.inf)),
            )

        def advance(carry):
            _, t, _ = carry
            candidate = self.horizontal.next_exceedance(t, motion.horizontal.locate(t))
            is_reached = jnp.isfinite(candidate)
            s = jnp.where(is_reached, candidate, t)
            current = motion.locate(s)
            shaking, rate = jax.jvp(motion.piece(current), (s,), (jnp.ones_like(s),))
            signs = 1.0, -1.0
            clearances = [threshold - (sign * shaking.horizontal - tilt * shaking.vertical) for sign in signs]
            slopes = [sign * rate.horizontal - tilt * rate.vertical for sign in signs]
            last_digit = resolution * jnp.maximum(jnp.abs(s), end - start)
            min_step = jnp.maximum(MIN_EXCURSION * scale, last_digit)
            step = jnp.maximum(jnp.minimum(*map(safe_time, clearances, slopes)), min_step)
            clearance = jnp.minimum(*clearances)
            is_found = is_reached & (clearance < 0)
            # Go back to the crossing, unless the search began above the threshold or the ground
            # acceleration jumped.
            slope = jnp.where(clearances[0] < clearances[1], *slopes)
            crossing = s + jnp.where(slope > 0, clearance / jnp.where(slope > 0, slope, 1.0), 0.0)
            previous = motion.before(current)
            jump_time = jnp.where(previous == current, -jnp.inf, motion.breakpoint(previous))
            earliest = jnp.maximum(jnp.maximum(search_start, s - 2 * min_step), jnp.minimum(jump_time, s))
            # Advance by at least `last_digit`, because the time of a breakpoint, and the outcome of a
            # comparison, may change by rounding when they are evaluated again.
            next_time = jnp.maximum(jnp.minimum(s + step, motion.breakpoint(current)), s + last_digit)
            return jnp.maximum(crossing, earliest), jnp.where(is_reached, next_time, jnp.inf), is_found

        t, _, is_found = jax.lax.while_loop(
            lambda carry: ~carry[2] & jnp.isfinite(carry[1]), advance, (t, t, jnp.zeros((), bool))
        )
        return jnp.where(is_found, t, jnp.inf)


def check_weight(owner: str, motion: AbstractExcitation, g: Number) -> None:
    """Raise `ValueError` unless g + v̈_g is positive at all times; batches and traced numbers pass."""
    if not isinstance(motion, GroundMotion) or any(map(jnp.ndim, motion.vertical.support)) or jnp.ndim(g):
        return
    # JAX compiles these operations for every number of samples. The common form has only a few such numbers.
    lowest, time = (concrete(y) for y in motion.vertical.common_form().lowest())
    gravity = concrete(g)
    if lowest is None or time is None or gravity is None or lowest.ndim or gravity + lowest > 0:
        return
    raise ValueError(
        f"{owner}: g + v̈_g must be positive at all times, got {float(gravity):g} {float(lowest):+.6g} m/s² "
        f"at t = {float(time):.6g} s: joints could open vertically, which the model "
        "excludes; scale the vertical motion down"
    )
