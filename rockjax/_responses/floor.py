"""The motion of floors (the deck, stories, and weighted sums of modes): accelerations and velocity jumps.

At an impact the velocity of the deck (the beam) jumps. The accelerations do not contain the velocity jumps,
which are separate results. The *bodies* are the modes of the superstructure and the beam. The *history* of a
scene is the sequence of its accepted steps; the ends of the steps are the *nodes*. A scene is divided into
*pieces*, in which the accelerations of all bodies are smooth. A *solved scene* is a tuple, `history.Solved`.
A *rigid podium* has a rigid superstructure or none. The equations (L…) are in docs/floors.md and
docs/equations.md.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from rockjax._checks import array_module, as_array, as_float, concrete, format_value, require_number
from rockjax._engine.flat import Nodes
from rockjax._engine.model import (
    acceleration,
    beam,
    beam_absolute_acceleration,
    beam_vertical_acceleration,
    beam_vertical_velocity,
    horizontal,
)
from rockjax._excitations.base import AbstractExcitation, Shaking
from rockjax._motions.record import Record
from rockjax._oscillators import Load
from rockjax._programs.program import StoredProgram, nans_allowed
from rockjax._structures import Podium
from rockjax._structures.contents import DECK, DIRECTIONS
from rockjax._tree import Module
from rockjax._types import Value

from . import history

MIN_BEAM_WEIGHT = 1e-12  # a smaller weight of the beam, |1 − ΣW_i|, counts as zero

DEGREE = 7  # degree of the polynomials of accelerations
# A polynomial is accurate if its last Chebyshev coefficient, divided by the largest acceleration, is at most
# this.
MAX_LAST_COEFFICIENT = 1e-8
MAX_HALVINGS = 12  # largest number of times that a piece is halved
REST_AFTER_END = 0.01  # time p·t for which a resting rigid podium is evaluated after its scene [–]
# A ground motion is divided into at least this many pieces, because a single step in full contact may cover
# the whole motion.
MOTION_PIECES = 64
# Chebyshev points of a piece, at which polynomials are fitted, as fractions z ∈ [0, 1] of the piece.
POINTS = 0.5 - 0.5 * np.cos(np.pi * (np.arange(DEGREE + 1) + 0.5) / (DEGREE + 1))
# Matrix from values at the points to coefficients of z^k.
TO_TERMS = np.linalg.inv(np.vander(POINTS, increasing=True)).T
# Row that maps values at the points to the coefficient of the last Chebyshev polynomial.
TO_LAST = np.linalg.inv(np.polynomial.chebyshev.chebvander(2 * POINTS - 1, DEGREE))[-1]


class Bodies(NamedTuple):
    """Motion of the modes and of the beam at n times.

    - `displacement` [m], `velocity` [m/s]: horizontal motion relative to the ground, first of the modes, then
      of the beam, shape (n, modes + 1)
    - `acceleration`: absolute horizontal acceleration of the same bodies, shape (n, modes + 1) [m/s²]
    - `vertical_velocity`: upward velocity of the beam relative to the ground, shape (n,) [m/s]
    - `vertical_acceleration`: absolute upward acceleration of the beam, shape (n,) [m/s²]
    - `ground`: ground acceleration, horizontal and vertical, shape (n, 2) [m/s²]
    """

    displacement: Array
    velocity: Array
    acceleration: Array
    vertical_velocity: Array
    vertical_acceleration: Array
    ground: Array

    @property
    def accelerations(self) -> Any:
        """Accelerations of the modes and of the beam, then the vertical acceleration of the beam, shape
        (n, modes + 2) [m/s²]."""
        return array_module(self.vertical_acceleration).concatenate(
            [self.acceleration, self.vertical_acceleration[:, None]], axis=1
        )

    @property
    def velocities(self) -> Any:
        """Velocities of the modes and of the beam, then the vertical velocity of the beam, shape
        (n, modes + 2) [m/s]."""
        return array_module(self.vertical_velocity).concatenate(
            [self.velocity, self.vertical_velocity[:, None]], axis=1
        )


def bodies(scene: history.Solved, t, left, node) -> Bodies:
    """Return the motion of modes and beam at given times; NaN outside the scene.

    - `scene`: solved scene
    - `t`: times, shape (n,) [s]
    - `left`: True to return the motion just before the time, shape (n,)
    - `node`: index of the node from which to step to the time, shape (n,); −1 for the last node at or before
      the time (with `left`, before the time)
    """
    podium, excitation, nodes, end, method, rtol = scene
    c, nodes = history.constants(podium, excitation, rtol), jax.tree.map(jnp.asarray, nodes)

    def at(t, left, node):
        # The motion just before t is evaluated one rounding error earlier, so that an event or a breakpoint
        # at t does not affect it.
        t = jnp.where(left, t - jnp.finfo(t.dtype).eps * jnp.maximum(jnp.abs(t), 1.0), t)
        node = jnp.where(node < 0, history.node_before(nodes, t, jnp.zeros((), bool)), node)
        sigma, ground, x, v = history.sample(c, excitation, nodes, method, node, t)
        a = acceleration(c, sigma, ground, x, v)
        u_b, u_b_dot = beam(c, sigma, x[0], v[0])
        u_g = horizontal(ground)
        v_g = ground.vertical if isinstance(ground, Shaking) else 0.0 * u_g

        def joined(of_modes, of_beam):
            return jnp.concatenate([*map(jnp.atleast_1d, of_modes), of_beam[None]])

        motion = Bodies(
            joined(x[1:], u_b),
            joined(v[1:], u_b_dot),
            joined([y + u_g for y in a[1:]], beam_absolute_acceleration(c, sigma, ground, x, v, a)),
            beam_vertical_velocity(c, sigma, x[0], v[0]),
            beam_vertical_acceleration(c, sigma, x[0], v[0], a[0]) + v_g,
            jnp.stack([u_g, v_g]),
        )
        inside = (t >= nodes.t[0]) & (t <= end)
        return jax.tree.map(lambda y: jnp.where(inside, y, jnp.nan), motion)

    return jax.vmap(at)(t, left, node)


bodies_program = StoredProgram(bodies)


@StoredProgram
def breakpoints_and_support(excitation: AbstractExcitation) -> tuple[Array, tuple[Any, Any]]:
    """Return the breakpoints of a ground motion, and its start and end [s]."""
    return excitation.breakpoints, excitation.support


def evaluate_padded(scene: history.Solved, t: np.ndarray, left: np.ndarray, node: np.ndarray) -> Bodies:
    """Return the motion of modes and beam at n times, as `bodies` does. The arguments are padded to one of a
    few sizes, so that few programs are compiled."""
    motion = bodies_program(scene, *pad(t, left, node))
    return jax.tree.map(lambda y: np.asarray(y)[: t.size], motion)


def pad(t: np.ndarray, left: np.ndarray, node: np.ndarray) -> tuple[Any, Any, np.ndarray]:
    """Return the arguments of `bodies`, shape (n,), padded to one of a few sizes: the last entries are
    repeated."""
    times, flags = history.pad_times(t, left)
    nodes = np.pad(node, (0, times.size - t.size), mode="edge") if t.size else node
    return times, flags, nodes.astype(np.int32)


def floor_weights(owner: str, podium: Podium, level: Any, weights: Any = None) -> Array:
    """Return the weights W_i of the modes in the motion of a floor, (L2), shape (modes,).

    - `owner`: name of the calling function, for messages
    - `podium`: the structure
    - `level`: "deck" or the number of a story from the bottom; ignored if `weights` are given
    - `weights`: weights of the modes; None for the weights of the level

    The weight of the beam is 1 − ΣW_i. Raises `ValueError` if the structure does not have the level, or if
    `weights` does not have one value for each mode.
    """
    top = podium.superstructure
    resolved = None if top is None else top.resolved()
    count = 0 if resolved is None else resolved.count
    if weights is not None:
        row = as_float(weights, f"{owner}: weights")
        if row.shape != (count,):
            raise ValueError(
                f"{owner}: weights must have one value for each of the {count} modes, got shape {row.shape}"
            )
        return row
    if isinstance(level, str) and level == DECK:
        return np.zeros(count)  # pyright: ignore[reportReturnType]
    stories = None if top is None else top.story_weights
    story_count = 0 if stories is None else stories.shape[-2]
    number = level if isinstance(level, int | np.integer) and not isinstance(level, bool) else 0
    if stories is None or not 1 <= number <= story_count:
        if story_count:
            valid = f"'deck' or a story from 1 to {story_count}"
        else:
            valid = "'deck'" + (
                ", because modes have no stories (Response.floor and floor_spectrum accept weights instead)"
                if count
                else ""
            )
        raise ValueError(f"{owner}: level must be {valid}, got level = {format_value(level)}")
    return stories[number - 1]


def with_beam(weights: Any) -> Any:
    """Return the weights of the modes followed by the weight of the beam, 1 − ΣW_i, along the last axis,
    (L2)."""
    xp = array_module(weights)
    of_beam = 1 - weights.sum(axis=-1, keepdims=True)
    of_beam = xp.where(xp.abs(of_beam) < MIN_BEAM_WEIGHT, 0.0, of_beam)
    return xp.concatenate([weights, of_beam], axis=-1)


class Pieces(NamedTuple):
    """The n pieces of a scene, in which all accelerations are smooth.

    - `start`, `length`: start and length of each piece, shape (n,) [s]
    - `node`: index of the last node at or before the start of each piece, shape (n,)
    - `is_impact`: True for a piece that starts with an impact, shape (n,)
    """

    start: np.ndarray
    length: np.ndarray
    node: np.ndarray
    is_impact: np.ndarray

    @property
    def points(self) -> tuple[np.ndarray, np.ndarray]:
        """Times at which polynomials are fitted [s], and the index of the node for each time, both of shape
        (n · points,)."""
        t = self.start[:, None] + self.length[:, None] * POINTS
        return t.ravel(), np.repeat(self.node, POINTS.size)

    def select(self, which: np.ndarray) -> Pieces:
        """Return the pieces that `which`, an array of indices or of flags, selects."""
        return Pieces(*(y[which] for y in self))


class PieceMotions(NamedTuple):
    """Motion of modes and beam in n pieces. The vertical motion of the beam counts as the last body.

    - `terms`: coefficients c_k of the absolute accelerations Σ c_k z^k, shape (n, DEGREE + 1, bodies) [m/s²];
      z runs from 0 to 1 over the piece
    - `jumps`: velocity jumps at the start of each piece, shape (n, bodies) [m/s]
    """

    terms: np.ndarray
    jumps: np.ndarray


def terms_of(accelerations: np.ndarray) -> np.ndarray:
    """Return the coefficients c_k of polynomials, shape (n, DEGREE + 1, bodies), from the values of the
    polynomials at `POINTS`, shape (n, points, bodies)."""
    return np.einsum("npb,pk->nkb", accelerations, TO_TERMS)


def before_and_at(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the arguments `t`, `left` and `node` with which `bodies` returns the motion first just before
    the times t (n,), then at the times t; shape (2n,)."""
    return np.tile(t, 2), np.repeat([True, False], t.size), np.full(2 * t.size, -1)


def pieces_of(scene: history.Solved, end: float) -> tuple[Pieces, PieceMotions]:
    """Divide a scene into pieces, and return the pieces and the motion in them.

    The scene is divided at its nodes, at breakpoints of the ground motion, and at the ends of `MOTION_PIECES`
    equal parts of the ground motion. Pieces are then halved until the polynomials are accurate, at most
    `MAX_HALVINGS` times.

    - `scene`: solved scene; `end`: end of the last piece [s]
    """
    nodes = scene[2]
    times, count = np.asarray(nodes.t), int(nodes.used)
    breaks, (first, last) = (jax.tree.map(np.asarray, y) for y in breakpoints_and_support(scene[1]))
    cuts = np.concatenate([times[:count], breaks, np.linspace(first, last, MOTION_PIECES + 1)])
    cuts = np.unique(np.append(cuts[(cuts >= times[0]) & (cuts < end)], end))
    start, length = cuts[:-1], np.diff(cuts)
    node = np.searchsorted(times[:count], start, side="right") - 1
    pending = Pieces(start, length, node, np.isin(start, times[np.isfinite(np.asarray(nodes.impact_time))]))
    parts, scale = [], 0.0
    for halvings in range(MAX_HALVINGS + 1):
        t, node = pending.points
        motion = evaluate_padded(scene, t, np.zeros(t.size, bool), node)
        values = motion.accelerations.reshape(pending.start.size, POINTS.size, -1)
        scale = np.maximum(scale, np.abs(values).max(axis=(0, 1)))
        last_coefficients = np.abs(np.einsum("npb,p->nb", values, TO_LAST))
        is_rough = (last_coefficients > MAX_LAST_COEFFICIENT * scale).any(axis=1) & (halvings < MAX_HALVINGS)
        parts.append((*pending.select(~is_rough), values[~is_rough]))
        if not is_rough.any():
            break
        pending = pending.select(is_rough)
        half, no_impact = 0.5 * pending.length, np.zeros(pending.start.size, bool)
        second = Pieces(pending.start + half, half, pending.node, no_impact)
        pending = Pieces(*map(np.concatenate, zip(pending._replace(length=half), second, strict=True)))
    *fields, values = map(np.concatenate, zip(*parts, strict=True))
    order = np.argsort(fields[0])
    pieces = Pieces(*fields).select(order)
    jumps, impacts = np.zeros((order.size, values.shape[-1])), pieces.start[pieces.is_impact]
    if impacts.size:
        velocities = evaluate_padded(scene, *before_and_at(impacts)).velocities
        jumps[pieces.is_impact] = velocities[impacts.size :] - velocities[: impacts.size]
    return pieces, PieceMotions(terms_of(values[order]), jumps)


def load_of(pieces: Pieces, motion: PieceMotions, weights: np.ndarray) -> Load:
    """Return the accelerations and velocity jumps of one floor as the load of oscillators, (L2), (L3).

    - `pieces`, `motion`: pieces of the scene, and the motion of the bodies in them
    - `weights`: weights of the modes, of the beam, and of the vertical motion of the beam, shape (bodies,)
    """
    of_beam = motion.jumps[:, -2:] @ weights[-2:]  # velocities of modes do not jump
    jumps = np.where(pieces.is_impact, of_beam, 0.0)
    zeros = np.zeros(pieces.start.size)
    return Load(pieces.start, pieces.length, motion.terms @ weights, jumps, zeros, zeros)


def in_direction(weights: Any, direction: str) -> Any:
    """Return the weights of all bodies in the motion of a floor in one direction, shape (bodies,). The last
    weight is that of the vertical motion of the beam. Vertically, all floors move with the beam.

    - `weights`: weights of the modes and the beam, as returned by `with_beam`
    - `direction`: "horizontal" or "vertical"
    """
    xp = array_module(weights)
    if direction == "horizontal":
        return xp.append(weights, 0.0)
    return xp.append(xp.zeros_like(weights), 1.0)


def check_direction(owner: str, direction: Any) -> str:
    if direction not in DIRECTIONS:
        raise ValueError(f"{owner}: direction must be one of {DIRECTIONS}, got {format_value(direction)}")
    return direction


class FloorMotion(Module):
    """Motion of the deck, of a story, or of a weighted sum of modes; from [`rockjax.Response.floor`][].

    Accelerations are absolute and do not contain the velocity jumps at impacts. Methods that take times
    return NaN outside the scene, and work under `jit`. The peaks, `last`, `load` and `to_record` do not work
    under `jit`.

    - `weights`: weights W_i of the modes, (L2) [–]; the weight of the deck is 1 − ΣW_i
    - `level`: "deck", the number of the story, or "weights" for a sum of modes
    - `impulse_times`: times of the impacts [s], at which velocities jump; padded with NaN under `jit`
    - `podium`, `excitation`, `nodes`, `end_time`: structure, ground motion, history and end [s] of the scene

    Equations (L…) are in docs/floors.md.
    """

    weights: Float[Array, " modes"]
    impulse_times: Float[Array, " impacts"]
    podium: Podium
    excitation: AbstractExcitation
    nodes: Nodes
    end_time: Float[Array, ""]
    # Time up to which the motion is known [s]; inf if a rigid podium has come to rest for good.
    _limit: Float[Array, ""]
    _rtol: Value | None
    _method: Any = eqx.field(static=True)
    level: str | int = eqx.field(static=True)

    @property
    def scene(self) -> history.Solved:
        """The solved scene as the tuple that functions of `history.py` take."""
        return self.podium, self.excitation, self.nodes, self._limit, self._method, self._rtol

    def acceleration(self, t: Float[ArrayLike, "*times"], left: bool = False) -> Float[Array, "*times"]:
        """Return the absolute horizontal acceleration at times t [s], (L1), (L2) [m/s²]. With `left=True`,
        return the acceleration just before these times, for example before an impact."""
        return self._at(t, left, lambda motion: self._of_floor(motion.acceleration))

    def vertical_acceleration(
        self, t: Float[ArrayLike, "*times"], left: bool = False
    ) -> Float[Array, "*times"]:
        """Return the absolute vertical acceleration, upwards, at times t [s], (L1) [m/s²], with `left=True`
        just before these times. The deck and all floors have the same vertical acceleration."""
        return self._at(t, left, lambda motion: motion.vertical_acceleration)

    def velocity(self, t: Float[ArrayLike, "*times"], left: bool = False) -> Float[Array, "*times"]:
        """Return the horizontal velocity relative to the ground [m/s] at times t [s], with `left=True` just
        before these times."""
        return self._at(t, left, lambda motion: self._of_floor(motion.velocity))

    def displacement(self, t: Float[ArrayLike, "*times"]) -> Float[Array, "*times"]:
        """Return the horizontal displacement relative to the ground [m] at times t [s]."""
        return self._at(t, False, lambda motion: self._of_floor(motion.displacement))

    @property
    def velocity_jumps(self) -> Float[Array, " impacts"]:
        """Jumps Δv of the horizontal velocity at the impacts, (L3) [m/s]. The jumps are zero if the weights
        W_i sum to 1, as for every story of a building with all modes."""
        return self._jumps(lambda motion: motion.velocity[..., -1] * with_beam(self.weights)[-1])

    @property
    def vertical_velocity_jumps(self) -> Float[Array, " impacts"]:
        """Jumps Δw ≥ 0 of the vertical velocity at the impacts, (L3) [m/s]."""
        return self._jumps(lambda motion: motion.vertical_velocity)

    @property
    def peak_acceleration(self) -> float:
        """Largest horizontal acceleration |a| of the floor in the scene [m/s²], including the values just
        before and just after events, but not the velocity jumps."""
        return largest_acceleration(self.load())

    @property
    def peak_velocity_jump(self) -> float:
        """Largest |Δv| at the impacts [m/s]; 0 if there are none."""
        return float(np.abs(np.asarray(self.velocity_jumps)).max(initial=0.0))

    def last(self, end: float | None = None) -> float:
        """Return the time up to which the motion of the floor can be evaluated [s].

        This time is the end of the scene, except for a rigid podium that rests for good. For such a podium it
        is `end` [s] or, if later, a time shortly after the end of the scene, so that an impact that ends the
        scene is included. `end` is by default the end of the ground motion.
        """
        scene_end = float(self.end_time)
        if np.isfinite(self._limit):
            return scene_end
        if end is None:
            end = float(np.asarray(breakpoints_and_support(self.excitation)[1][1]))
        return max(scene_end + REST_AFTER_END / float(self.podium.p), float(end))

    def load(self, direction: str = "horizontal", end: float | None = None) -> Load:
        """Return the motion as the load of oscillators, (L7): polynomials of the acceleration in pieces of
        the scene, and the velocity jumps between the pieces.

        - `direction`: "horizontal" or "vertical"
        - `end`: end of the last piece [s], as for `last`; it has an effect only for a rigid podium that rests
          for good
        """
        pieces, motion = pieces_of(self.scene, self.last(end))
        return load_of(pieces, motion, in_direction(with_beam(np.asarray(self.weights)), direction))

    def to_record(self, dt: float, direction: str = "horizontal") -> Record:
        """Return the floor's motion as a record. Velocity jumps become large accelerations.

        - `dt`: sampling interval, > 0 [s]
        - `direction`: "horizontal" or "vertical"

        The sampling interval is δ = `dt`, and the sample at the time t_k is
        ∫a ∧(t−t_k) dt + Σ_i Δv_i ∧(t_i−t_k). Here a is the acceleration, Δv_i is the velocity jump of the
        impact at t_i, and the hat function is ∧(τ) = max(0, 1−|τ|/δ)/δ. The final velocity and displacement
        are exact. Spectra at a period T have an error of the order (δ/T)². The peak of the samples depends on
        δ and must not be used. The record starts one interval before the scene and ends with a zero.
        """
        owner = "FloorMotion.to_record"
        dt = require_number(owner, "dt", dt, lambda v: v > 0, "finite and > 0 s")
        load = self.load(check_direction(owner, direction))
        count = int(np.ceil((load.end - load.start[0]) / dt - 1e-9))
        displacement = _displacement(load, load.start[0] + dt * np.arange(-2, count + 3))
        return Record(np.diff(displacement, 2) / dt**2, dt, 1.0, float(load.start[0]) - dt)

    def __repr__(self) -> str:
        return f"FloorMotion(level={self.level!r})"

    def _of_floor(self, values: Any) -> Any:
        """Return the weighted sum of values of modes and beam, (L2)."""
        return values @ with_beam(self.weights)

    def _at(self, t: Any, left: bool, read: Callable[[Bodies], Any]) -> Array:
        t = as_float(t)
        times, flags = history.pad_times(t.ravel(), np.full(t.size, left))
        motion = bodies_program(self.scene, times, flags, np.full(times.shape, -1, np.int32))
        with nans_allowed():
            concrete_motion = jax.tree.map(concrete, motion)
            is_concrete = all(y is not None for y in concrete_motion)
            values = read(concrete_motion if is_concrete else motion)[: t.size].reshape(t.shape)
            return as_array(values) if is_concrete and not isinstance(values, jax.Array) else values

    def _jumps(self, read: Callable[[Bodies], Any]) -> Array:
        times = self.impulse_times
        before, after = (self._at(times, left, read) for left in (True, False))
        xp = array_module(before, after)
        return as_array(xp.subtract(after, before))


def largest_acceleration(load: Load) -> float:
    """Return the largest |a| of a load [m/s²], at an end of a piece or at a turning point inside."""
    at_ends = np.concatenate([load.terms[:, 0], load.terms.sum(axis=1)])
    largest = float(np.abs(at_ends).max())
    # |a| in a piece is at most the sum of its coefficients. Pieces that cannot exceed `largest` are skipped.
    bounds = np.abs(load.terms[:, 1:]).sum(axis=1) + np.abs(load.terms[:, 0])
    for terms in load.terms[bounds > largest]:
        roots = np.polynomial.polynomial.polyroots(np.polynomial.polynomial.polyder(terms))
        turns = roots.real[(np.abs(roots.imag) < 1e-7) & (roots.real > 0) & (roots.real < 1)]
        largest = max(largest, float(np.abs(np.polynomial.polynomial.polyval(turns, terms)).max(initial=0.0)))
    return largest


def _displacement(load: Load, t: np.ndarray) -> np.ndarray:
    """Return the displacement at times t [m], from the acceleration and the velocity jumps. The displacement
    is zero up to the start of the load."""
    k = np.arange(load.terms.shape[1])
    h = load.length[:, None]
    velocity_terms = h * load.terms / (k + 1)  # coefficients of (τ/h)^(k+1)
    displacement_terms = h * velocity_terms / (k + 2)  # coefficients of (τ/h)^(k+2)
    gained = load.kick + velocity_terms.sum(axis=1)
    velocity = np.cumsum(gained) - gained + load.kick  # at the start of each piece, after the velocity jump
    moved = velocity * load.length + displacement_terms.sum(axis=1)
    displacement = np.cumsum(moved) - moved  # at the start of each piece
    piece = np.clip(np.searchsorted(load.start, t, side="right") - 1, 0, None)
    tau = np.clip(t - load.start[piece], 0.0, load.length[piece])
    fraction = (tau / load.length[piece])[:, None]
    inside = (displacement_terms[piece] * fraction ** (k + 2)).sum(axis=1)
    final_velocity = velocity[-1] + velocity_terms[-1].sum()
    return (
        displacement[piece] + velocity[piece] * tau + inside + final_velocity * np.maximum(t - load.end, 0.0)
    )
