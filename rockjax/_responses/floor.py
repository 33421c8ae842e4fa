"""The motion of the deck, of floors and of modal combinations: accelerations, velocity jumps, and pieces.

An impact changes the velocity of the deck in an instant. Accelerations here are those between impacts; the
velocity jumps are apart from them, (L1) to (L3).
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from rockjax._checks import array_module, as_array, as_float, concrete, format_value, require_number
from rockjax._engine.flat import Nodes
from rockjax._engine.model import acceleration, beam, beam_absolute, beam_climb, beam_rise, horizontal
from rockjax._excitations.base import AbstractExcitation, Shaking
from rockjax._motions.record import Record
from rockjax._oscillators import Load
from rockjax._programs.program import StoredProgram, nans_allowed
from rockjax._structures import Podium
from rockjax._structures.contents import DECK, DIRECTIONS
from rockjax._tree import Module
from rockjax._types import Value

from . import history

WHOLE = 1e-12  # 1 − ΣW_i below this is rounding: all of the floor's motion is in the modes

# Degree of the polynomials, their points in a piece, and the largest share of the last Chebyshev polynomial.
DEGREE, ROUGH = 5, 1e-8
ROUNDS = 12  # limit of halvings of a piece
MOTION_PIECES = 64  # least number of pieces of a motion in full contact, which the solver passes in one step
POINTS = 0.5 - 0.5 * np.cos(np.pi * (np.arange(DEGREE + 1) + 0.5) / (DEGREE + 1))
TO_TERMS = np.linalg.inv(np.vander(POINTS, increasing=True)).T  # values at the points → coefficients c_k
TO_LAST = np.linalg.inv(np.polynomial.chebyshev.chebvander(2 * POINTS - 1, DEGREE))[-1]


class Bodies(NamedTuple):
    """Motion of the modes and of the beam: u_i … and u_b along the last axis, and of the beam vertically.

    - `displacement`, `velocity`: relative to the ground, of the modes and of the beam horizontally [m], [m/s]
    - `acceleration`: absolute, of the same [m/s²]
    - `climb`, `rise`: vertical velocity relative to the ground, and absolute acceleration, of the beam
    - `ground`: ground acceleration, horizontal and vertical
    """

    displacement: Array
    velocity: Array
    acceleration: Array
    climb: Array
    rise: Array
    ground: Array

    @property
    def accelerations(self) -> Any:
        """All accelerations, the vertical one of the beam last."""
        return array_module(self.rise).concatenate([self.acceleration, self.rise[:, None]], axis=1)

    @property
    def velocities(self) -> Any:
        """All velocities, the vertical one of the beam last."""
        return array_module(self.climb).concatenate([self.velocity, self.climb[:, None]], axis=1)


def bodies(scene: history.Solved, t, left, node) -> Bodies:
    """Return the motion at times t (n,), just before them where `left` (n,).

    - `scene`: solved scene; `node`: node from which the motion starts (n,); −1 for the one before t
    """
    podium, excitation, nodes, end, method, rtol = scene
    c, nodes = history.constants(podium, excitation, rtol), jax.tree.map(jnp.asarray, nodes)

    def at(t, left, node):
        # Just before a time is one rounding before it: there both nodes and pieces of the motion are others.
        t = jnp.where(left, t - jnp.finfo(t.dtype).eps * jnp.maximum(jnp.abs(t), 1.0), t)
        node = jnp.where(node < 0, history.node_before(nodes, t, jnp.zeros((), bool)), node)
        sigma, ground, x, v = history.sample(c, excitation, nodes, method, node, t)
        a = acceleration(c, sigma, ground, x, v)
        u_b, u_b_dot = beam(c, sigma, x[0], v[0])
        u_g = horizontal(ground)
        v_g = ground.vertical if isinstance(ground, Shaking) else 0.0 * u_g

        def joined(of_modes, of_beam):
            return jnp.concatenate([*map(jnp.atleast_1d, of_modes), of_beam[None]])

        found = Bodies(
            joined(x[1:], u_b),
            joined(v[1:], u_b_dot),
            joined([y + u_g for y in a[1:]], beam_absolute(c, sigma, ground, x, v, a)),
            beam_climb(c, sigma, x[0], v[0]),
            beam_rise(c, sigma, x[0], v[0], a[0]) + v_g,
            jnp.stack([u_g, v_g]),
        )
        inside = (t >= nodes.t[0]) & (t <= end)
        return jax.tree.map(lambda y: jnp.where(inside, y, jnp.nan), found)

    return jax.vmap(at)(t, left, node)


along = StoredProgram(bodies)


@StoredProgram
def landmarks(excitation: AbstractExcitation) -> tuple[Array, tuple[Any, Any]]:
    """Return the breakpoints of a ground motion, and its start and end [s]."""
    return excitation.breakpoints, excitation.support


def evaluated(evaluate: Callable, t: np.ndarray, left: np.ndarray, node: np.ndarray) -> Bodies:
    """Return the motion at times (n,), padded to one of a few sizes for the program `evaluate`."""
    return jax.tree.map(lambda y: np.asarray(y)[: t.size], evaluate(*padded_places(t, left, node)))


def padded_places(t: np.ndarray, left: np.ndarray, node: np.ndarray) -> tuple[Any, Any, np.ndarray]:
    """Return times, flags and nodes (n,), padded to one of a few sizes by repeating the last."""
    times, flags = history.filled(t, left)
    nodes = np.pad(node, (0, times.size - t.size), mode="edge") if t.size else node
    return times, flags, nodes.astype(np.int32)


def floor_weights(owner: str, podium: Podium, level: Any, weights: Any = None) -> Array:
    """Return the weights W_i of the modes in the motion of a floor, (L2), shape (modes,).

    - `owner`: name of the calling function, for messages
    - `level`: "deck" or the number of a story from the bottom
    - `weights`: weights of the modes instead; None for the level

    Raises `ValueError` for a level that is not there, and for weights of another length.
    """
    top = podium.superstructure
    resolved = None if top is None else top.resolved()
    count = 0 if resolved is None else resolved.count
    if weights is not None:
        row = as_float(weights, f"{owner}: weights")
        if row.shape != (count,):
            raise ValueError(
                f"{owner}: weights must hold one number for each of the {count} modes, got shape {row.shape}"
            )
        return row
    if isinstance(level, str) and level == DECK:
        return np.zeros(count)  # pyright: ignore[reportReturnType]
    stories = None if top is None else top.story_weights
    numbers = 0 if stories is None else stories.shape[-2]
    number = level if isinstance(level, int | np.integer) and not isinstance(level, bool) else 0
    if stories is None or not 1 <= number <= numbers:
        if numbers:
            there = f"'deck' or a story from 1 to {numbers}"
        else:
            there = "'deck'" + (", as modes have no stories; or pass weights of the modes" if count else "")
        raise ValueError(f"{owner}: level must be {there}, got level = {format_value(level)}")
    return stories[number - 1]


def with_beam(weights: Any) -> Any:
    """Return weights with that of the beam, 1 − ΣW_i, along the last axis, (L2)."""
    xp = array_module(weights)
    rest = 1 - weights.sum(axis=-1, keepdims=True)
    return xp.concatenate([weights, xp.where(xp.abs(rest) < WHOLE, 0.0, rest)], axis=-1)


class Pieces(NamedTuple):
    """Pieces of a scene in which all accelerations are smooth, and the node from which each starts.

    - `start`, `length`: of the n pieces [s]; `node`: index, shape (n,)
    - `is_impact`: whether an impact is at the start, shape (n,)
    """

    start: np.ndarray
    length: np.ndarray
    node: np.ndarray
    is_impact: np.ndarray

    @property
    def points(self) -> tuple[np.ndarray, np.ndarray]:
        """The times at which polynomials are fitted, and their nodes, shape (n · points,)."""
        t = self.start[:, None] + self.length[:, None] * POINTS
        return t.ravel(), np.repeat(self.node, POINTS.size)

    @property
    def places(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Times, whether just before them, and nodes (−1 for the one before): of the points, and of both
        sides of all starts."""
        (t, node), size = self.points, self.start.size
        left = np.arange(t.size + 2 * size) - t.size
        return (
            np.concatenate([t, self.start, self.start]),
            (left >= 0) & (left < size),
            np.concatenate([node, np.full(2 * size, -1)]),
        )

    def chosen(self, which: np.ndarray) -> Pieces:
        return Pieces(*(y[which] for y in self))


class Motions(NamedTuple):
    """Accelerations in pieces, and velocities at both sides of their starts, of modes and beam. The beam's
    vertical motion comes last.

    - `terms`: coefficients of polynomials of absolute accelerations, shape (n, m+1, bodies)
    - `before`, `after`: velocities relative to the ground at the start of each piece, shape (n, bodies)
    - `jump`: jump of the ground acceleration there, shape (n, 2)
    """

    terms: np.ndarray
    before: np.ndarray
    after: np.ndarray
    jump: np.ndarray


def motions(found: Bodies, pieces: Pieces) -> Motions:
    """Return the motion of modes and beam in pieces, from `found`, that at `pieces.places`."""
    size = pieces.start.size
    count = size * POINTS.size
    values, velocity = found.accelerations[:count], found.velocities[count:]
    terms = np.einsum("npb,pk->nkb", values.reshape(size, POINTS.size, -1), TO_TERMS)
    ground = np.asarray(found.ground)[count:]
    return Motions(terms, velocity[:size], velocity[size:], ground[size:] - ground[:size])


def pieces_of(scene: history.Solved, end: float) -> Pieces:
    """Divide a scene at its events, nodes and breakpoints into pieces on which polynomials are accurate.

    - `scene`: solved scene; `end`: end of the last piece [s]
    """
    nodes = scene[2]
    times, count = np.asarray(nodes.t), int(nodes.used)
    breaks, (first, last) = (jax.tree.map(np.asarray, y) for y in landmarks(scene[1]))
    cuts = np.concatenate([times[:count], breaks, np.linspace(first, last, MOTION_PIECES + 1)])
    cuts = np.unique(np.append(cuts[(cuts >= times[0]) & (cuts < end)], end))
    start, length = cuts[:-1], np.diff(cuts)
    node = np.searchsorted(times[:count], start, side="right") - 1
    left = Pieces(start, length, node, np.isin(start, times[np.isfinite(np.asarray(nodes.impact_time))]))
    done, scale = [], 0.0
    for _ in range(ROUNDS):
        t, node = left.points
        found = evaluated(functools.partial(along, scene), t, np.zeros(t.size, bool), node)
        values = found.accelerations.reshape(left.start.size, POINTS.size, -1)
        scale = np.maximum(scale, np.abs(values).max(axis=(0, 1)))
        rough = (np.abs(np.einsum("npb,p->nb", values, TO_LAST)) > ROUGH * scale).any(axis=1)
        done.append(left.chosen(~rough))
        if not rough.any():
            break
        left = left.chosen(rough)
        half, never = 0.5 * left.length, np.zeros(left.start.size, bool)
        second = Pieces(left.start + half, half, left.node, never)
        left = Pieces(*map(np.concatenate, zip(left._replace(length=half), second, strict=True)))
    else:
        done.append(left)
    joined = Pieces(*map(np.concatenate, zip(*done, strict=True)))
    return joined.chosen(np.argsort(joined.start))


def load_of(pieces: Pieces, found: Motions, weights: np.ndarray) -> Load:
    """Return the acceleration and the velocity jumps of one floor, (L2), (L3).

    - `weights`: weights of modes, beam, and the beam's vertical motion
    """
    of_beam = (found.after - found.before)[:, -2:] @ weights[-2:]  # velocities of modes do not jump
    jumps = np.where(pieces.is_impact, of_beam, 0.0)
    none = np.zeros(pieces.start.size)
    return Load(pieces.start, pieces.length, found.terms @ weights, jumps, none, none)


def in_direction(weights: Any, direction: str) -> Any:
    """Return weights of modes and beam with that of the vertical motion, in which all floors move with the
    beam."""
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

    Accelerations are absolute and do not contain the velocity jumps of impacts, which have no acceleration.
    Methods that take times return NaN outside the scene, and work under `jit`; the peaks and `to_record` are
    for the host.

    - `weights`: W_i of the modes, (L2) [–]; the rest 1 − ΣW_i moves with the deck
    - `level`: "deck", the number of the story, or "weights"
    - `impulse_times`: times of the impacts [s], at which velocities jump; padded with NaN under `jit`
    - `podium`, `excitation`, `nodes`, `end_time`: of the scene
    """

    weights: Float[Array, " modes"]
    impulse_times: Float[Array, " impacts"]
    podium: Podium
    excitation: AbstractExcitation
    nodes: Nodes
    end_time: Float[Array, ""]
    _limit: Float[Array, ""]  # time until which the motion is known: inf if the podium rests for good
    _rtol: Value | None
    _method: Any = eqx.field(static=True)
    level: str | int = eqx.field(static=True)

    @property
    def scene(self) -> history.Solved:
        """The solved scene, as functions of histories take it."""
        return self.podium, self.excitation, self.nodes, self._limit, self._method, self._rtol

    def acceleration(self, t: Float[ArrayLike, "*times"], left: bool = False) -> Float[Array, "*times"]:
        """Return the absolute horizontal acceleration at times t [s], (L1), (L2) [m/s²]; with `left=True`
        just before them, for example before an impact."""
        return self._at(t, left, lambda found: self._combined(found.acceleration))

    def vertical_acceleration(
        self, t: Float[ArrayLike, "*times"], left: bool = False
    ) -> Float[Array, "*times"]:
        """Return the absolute vertical acceleration, upwards, at times t [s], (L1) [m/s²]. All floors have
        that of the deck."""
        return self._at(t, left, lambda found: found.rise)

    def velocity(self, t: Float[ArrayLike, "*times"], left: bool = False) -> Float[Array, "*times"]:
        """Return the horizontal velocity relative to the ground [m/s] at times t [s]."""
        return self._at(t, left, lambda found: self._combined(found.velocity))

    def displacement(self, t: Float[ArrayLike, "*times"]) -> Float[Array, "*times"]:
        """Return the horizontal displacement relative to the ground [m] at times t [s]."""
        return self._at(t, False, lambda found: self._combined(found.displacement))

    @property
    def velocity_jumps(self) -> Float[Array, " impacts"]:
        """Jumps Δv of the horizontal velocity at the impacts, (L3) [m/s]: zero for a floor that moves with
        complete modes only."""
        return self._jumps(lambda found: found.velocity[..., -1] * with_beam(self.weights)[-1])

    @property
    def vertical_velocity_jumps(self) -> Float[Array, " impacts"]:
        """Jumps Δw ≥ 0 of the vertical velocity at the impacts, (L3) [m/s]."""
        return self._jumps(lambda found: found.climb)

    @property
    def peak_acceleration(self) -> float:
        """Peak floor acceleration sup|a| over the scene with one-sided limits at events, without velocity
        jumps (host) [m/s²]."""
        return largest_acceleration(self.load())

    @property
    def peak_velocity_jump(self) -> float:
        """Largest |Δv| of the impacts (host) [m/s]; 0 without any."""
        return float(np.abs(np.asarray(self.velocity_jumps)).max(initial=0.0))

    def last(self, end: float | None = None) -> float:
        """Return the end of the scene [s]; of a rigid podium that rests for good before, `end`, or by default
        the end of the ground motion if that is later (host)."""
        own = float(self.end_time)
        if np.isfinite(self._limit):
            return own
        return max(own, float(np.asarray(landmarks(self.excitation)[1][1]) if end is None else end))

    def load(self, direction: str = "horizontal", end: float | None = None) -> Load:
        """Return acceleration and velocity jumps as polynomials in pieces, (L7) (host).

        - `direction`: "horizontal" or "vertical"
        - `end`: end for a rigid podium that rests for good before, as for `last`
        """
        pieces = pieces_of(self.scene, self.last(end))
        found = motions(evaluated(functools.partial(along, self.scene), *pieces.places), pieces)
        return load_of(pieces, found, in_direction(with_beam(np.asarray(self.weights)), direction))

    def to_record(self, dt: float, direction: str = "horizontal") -> Record:
        """Return the floor's motion as a record, with velocity jumps as large accelerations (host).

        - `dt`: sampling interval, > 0 [s]
        - `direction`: "horizontal" or "vertical"

        Sample k is ∫a ∧(t−t_k) dt + ΣΔv ∧(t_i−t_k), ∧(τ) = max(0, 1−|τ|/dt)/dt. Final velocity and
        displacement are exact, and spectra right to O((dt/T)²). The peak of the samples depends on dt and
        means nothing. The record starts one interval before the scene, and its last sample is zero.
        """
        owner = "FloorMotion.to_record"
        dt = require_number(owner, "dt", dt, lambda v: v > 0, "finite and > 0 s")
        load = self.load(check_direction(owner, direction))
        count = int(np.ceil((load.end - load.start[0]) / dt - 1e-9))
        moved = _moved(load, load.start[0] + dt * np.arange(-2, count + 3))
        return Record(np.diff(moved, 2) / dt**2, dt, 1.0, float(load.start[0]) - dt)

    def __repr__(self) -> str:
        return f"FloorMotion(level={self.level!r})"

    def _combined(self, values: Any) -> Any:
        return values @ with_beam(self.weights)

    def _at(self, t: Any, left: bool, read: Callable[[Bodies], Any]) -> Array:
        t = as_float(t)
        times, flags = history.filled(t.ravel(), np.full(t.size, left))
        found = along(self.scene, times, flags, np.full(times.shape, -1, np.int32))
        with nans_allowed():
            numbers = jax.tree.map(concrete, found)
            host = all(y is not None for y in numbers)
            values = read(numbers if host else found)[: t.size].reshape(t.shape)
            return as_array(values) if host and not isinstance(values, jax.Array) else values

    def _jumps(self, read: Callable[[Bodies], Any]) -> Array:
        times = self.impulse_times
        before, after = (self._at(times, left, read) for left in (True, False))
        xp = array_module(before, after)
        return as_array(xp.subtract(after, before))


def largest_acceleration(load: Load) -> float:
    """Return the largest |a| of a load, at the ends of its pieces or at turning points in between [m/s²]."""
    at_ends = np.concatenate([load.terms[:, 0], load.terms.sum(axis=1)])
    best = float(np.abs(at_ends).max())
    inner = np.abs(load.terms[:, 1:]).sum(axis=1) + np.abs(load.terms[:, 0])
    for terms in load.terms[inner > best]:
        roots = np.polynomial.polynomial.polyroots(np.polynomial.polynomial.polyder(terms))
        places = roots.real[(np.abs(roots.imag) < 1e-7) & (roots.real > 0) & (roots.real < 1)]
        best = max(best, float(np.abs(np.polynomial.polynomial.polyval(places, terms)).max(initial=0.0)))
    return best


def _moved(load: Load, t: np.ndarray) -> np.ndarray:
    """Return ∬a with the velocity jumps at times t, zero until the start [m]."""
    k = np.arange(load.terms.shape[1])
    h = load.length[:, None]
    once = h * load.terms / (k + 1)  # powers τ^(k+1) of the velocity gained in a piece
    gained = load.kick + once.sum(axis=1)
    speed = np.cumsum(gained) - gained + load.kick  # just after the kick
    shifts = speed * load.length + (h * once / (k + 2)).sum(axis=1)
    place = np.cumsum(shifts) - shifts
    which = np.clip(np.searchsorted(load.start, t, side="right") - 1, 0, None)
    tau = np.clip(t - load.start[which], 0.0, load.length[which])
    part = (tau / load.length[which])[:, None]
    twice = (h * once / (k + 2))[which] * part ** (k + 2)
    now = place[which] + speed[which] * tau + twice.sum(axis=1)
    return now + (speed[-1] + once[-1].sum()) * np.maximum(t - load.end, 0.0)
