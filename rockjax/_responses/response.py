"""Time histories: the motion at any time, and what follows from it."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from rockjax._checks import as_float, concrete
from rockjax._engine.flat import Nodes
from rockjax._engine.model import (
    Coefficients,
    Value,
    Vector,
    acceleration,
    beam,
    coefficients,
    energy,
    power,
    restoring_moment,
)
from rockjax._engine.runge_kutta import step, tableau
from rockjax._excitations.base import AbstractExcitation
from rockjax._options import Options
from rockjax._results import RESULTS, AbstractPeak, State
from rockjax._structures import Elastic, Podium

if TYPE_CHECKING:
    import xarray

# Gauss–Legendre on one step of the history, on [0, 1]: far below the error of the step itself.
_PLACES, _WEIGHTS = (0.5 * y for y in np.polynomial.legendre.leggauss(10))
_PLACES = 0.5 + _PLACES


class Energies(eqx.Module):
    """Where the energy is and went, per N m_c [m²/s²]: initial + input = mechanical + impacts + damping + residual.

    - `mechanical`: kinetic energy relative to the ground, strain energy and gravity, Eqs. (16)–(19); `initial`: at the start
    - `input`: work of the ground since the start, −∫ü_g[(½+γ)u̇_b + η u̇_t] dt
    - `impacts`: lost at the impacts since the start, Eqs. (26), (27)
    - `damping`: lost in the damper since the start, ∫2ζω_s η (u̇_t − u̇_b)² dt
    - `residual`: what the solution leaves open; its size measures the error of the whole history
    """

    mechanical: Float[Array, "*times"]
    input: Float[Array, "*times"]
    impacts: Float[Array, "*times"]
    damping: Float[Array, "*times"]
    initial: Float[Array, ""]

    @property
    def residual(self) -> Float[Array, "*times"]:
        return self.initial + self.input - self.mechanical - self.impacts - self.damping


class Response(AbstractPeak):
    """Time history of one scene: everything in [`rockjax.Peak`][], and the motion itself.

    `response(t)` is the state at any times within the scene, with the accuracy of the solve: one step of the method from
    the nearest node before. At an impact it is the state after it, with `left=True` the one before. All methods that take
    times give NaN before the start and after the end of the scene. A rigid scene that has settled is at rest for good, so
    it has no end.

    - `impact_times`: when the columns struck the ground, ascending, padded with NaN under `jit` [s]
    - `times`: nodes of the history, padded with inf under `jit` [s]
    """

    impact_times: Float[Array, " impacts"]
    podium: Podium
    excitation: AbstractExcitation
    nodes: Nodes
    options: Options

    @property
    def times(self) -> Float[Array, " nodes"]:
        return self.nodes.t

    @property
    def span(self) -> tuple[float, float]:
        """Start and end of what there is to show (host) [s]; to the end of the motion where a rigid scene rests before."""
        start, end = float(self.times[0]), float(self.stats.end_time)
        if not isinstance(self.podium.superstructure, Elastic) and bool(self.result == RESULTS.settled):
            end = max(end, float(self.excitation.support[1]))
        return start, end if end > start else start + 1 / float(self.podium.p)

    def __call__(self, t: Float[ArrayLike, "*times"], left: bool = False) -> State:
        """State at times t [s]."""
        return State(*self._map(t, _state, left))

    def deformation(self, t: Float[ArrayLike, "*times"]) -> Float[Array, "*times"]:
        """Deformation of the superstructure u_t − u_b [m]; 0 without an elastic one."""
        return self._map(t, _deformation)

    def energy(self, t: Float[ArrayLike, "*times"]) -> Float[Array, "*times"]:
        """Mechanical energy relative to the ground per N m_c [m²/s²], Eqs. (16)–(19)."""
        return self._map(t, _energy)

    def mode(self, t: Float[ArrayLike, "*times"]) -> Float[Array, "*times"]:
        """σ of the automaton: 0 in full contact, ±1 while rocking, with the sign of the rotation [–]."""
        return self._map(t, _mode)

    def restoring_moment(self, t: Float[ArrayLike, "*times"]) -> Float[Array, "*times"]:
        """The moment that holds the frame up, over its value at uplift [–].

        In full contact −q/q_up, Eq. (9): between −1 and 1. While rocking the moment of the ground's vertical forces,
        (sin ψ/sin α)[1 + (2γ+2η+½)/(2γ+2η+1) v̈_b/g], Eqs. (13), (15): near σ − θ/α, less what falls with the frame.
        """
        return self._map(t, restoring_moment)

    def energies(self, t: Float[ArrayLike, "*times"]) -> Energies:
        """The balance of energy at times t [s], integrated over every step of the history."""
        t = as_float(t)
        _, energies = self._history(t.ravel(), jnp.zeros(t.size, bool))
        return jax.tree.map(lambda y: y.reshape(t.shape) if y.ndim else y, energies)

    def dataset(self, t: Float[ArrayLike, " times"] | None = None) -> xarray.Dataset:
        """The history as data (host): states, deformation, ground acceleration, mode, moment and energies at times t.

        By default 4001 times over the `span` of the scene. The scalars of [`rockjax.Peak`][] are variables without a dim,
        impacts have the dim `impact`, with the rates of rotation before and after. Every variable has `units` and
        `long_name`; parameters, tolerances and versions are in the attributes. Raises `ValueError` for times that are not
        1-D.
        """
        from .datasets import history

        if t is None:
            t = np.linspace(*self.span, 4001)
        t = np.asarray(t, float)
        if t.ndim != 1:
            raise ValueError(f"Response.dataset: t must be a 1-D array of times, got shape {t.shape}")
        struck = np.asarray(self.impact_times)
        struck = struck[np.isfinite(struck)]
        # The states before the impacts in the same go.
        times, left = np.append(t, struck), np.arange(t.size + struck.size) >= t.size
        samples, energies = self._history(times, left)
        before = samples["theta_dot"][t.size :]
        after = self.nodes.v[0][np.isfinite(self.nodes.impact_time)]
        samples, energies = jax.tree.map(lambda y: np.asarray(y)[: t.size] if y.ndim else np.asarray(y), (samples, energies))
        impacts = {"impact_times": struck, "theta_dot_before": before, "theta_dot_after": after}
        return history(self, t, samples, energies, impacts)

    def _map(self, t: Float[ArrayLike, "*times"], quantity: Callable, left: bool = False) -> Any:
        t = as_float(t)
        times, flags = _filled(t.ravel(), jnp.full(t.size, left))
        values = _along(self._scene(), times, flags, quantity)
        return jax.tree.map(lambda y: y[: t.size].reshape(t.shape), values)

    def _history(self, t, left) -> tuple[dict, Energies]:
        """All samples and energies at times t (n,), or before them where `left` (n,)."""
        size = t.size
        times, flags = _filled(t, left)
        samples, *parts, initial = _balance(self._scene(), times, flags)
        samples, parts = jax.tree.map(lambda y: y[:size], (samples, parts))
        return samples, Energies(*parts, initial=initial)

    def _scene(self) -> _Scene:
        # The segments engine may have any solver; its nodes are bridged by an explicit one.
        explicit = (self.options if self.options.engine == "flat" else Options(method="dopri8")).solver
        at_rest = (self.result == RESULTS.settled) & (not isinstance(self.podium.superstructure, Elastic))
        end = jnp.where(at_rest, jnp.inf, self.stats.end_time)
        return self.podium, self.excitation, _padded(self.nodes), end, explicit


_Scene = tuple[Podium, AbstractExcitation, Nodes, Value, Any]  # and its end, and the method between the nodes


class _Sample(NamedTuple):
    """What a quantity is computed from."""

    sigma: Value
    ground: Value
    x: Vector
    v: Vector


def _state(c: Coefficients, sigma: Value, ground: Value, x: Vector, v: Vector):
    del sigma, ground
    zero = 0.0 * x[0]  # NaN where there is no state
    return x[0], v[0], x[1] if c.elastic else zero, v[1] if c.elastic else zero


def _deformation(c: Coefficients, sigma: Value, ground: Value, x: Vector, v: Vector):
    del ground
    return x[1] - beam(c, sigma, x[0], v[0])[0] if c.elastic else 0.0 * x[0]


def _energy(c: Coefficients, sigma: Value, ground: Value, x: Vector, v: Vector):
    del ground
    return energy(c, sigma, x, v)


def _mode(c: Coefficients, sigma: Value, ground: Value, x: Vector, v: Vector):
    del c, ground, v
    return sigma + 0.0 * x[0]


def _samples(c: Coefficients, sigma: Value, ground: Value, x: Vector, v: Vector):
    """All of them in one program."""
    theta, theta_dot, u_t, u_t_dot = _state(c, sigma, ground, x, v)
    return {
        "theta": theta,
        "theta_dot": theta_dot,
        "u_t": u_t,
        "u_t_dot": u_t_dot,
        "deformation": _deformation(c, sigma, ground, x, v),
        "mode": _mode(c, sigma, ground, x, v),
        "restoring_moment": restoring_moment(c, sigma, ground, x, v),
    }


def _room(size: int, least: int) -> int:
    """What is missing to a power of two: so that histories of many lengths share their programs."""
    return (1 << max(least, (size - 1).bit_length())) - size if size else 0


def _filled(t, left):
    """Times (n,) and flags (n,), with the last repeated."""
    more = _room(t.size, 4)
    if concrete(t) is None or not more:
        return t, left
    return np.pad(np.asarray(t), (0, more), mode="edge"), np.pad(np.asarray(left), (0, more), mode="edge")


def _padded(nodes: Nodes) -> Nodes:
    if any(isinstance(y, Tracer) for y in jax.tree.leaves(nodes)) or nodes.t.ndim != 1:
        return nodes
    more = _room(nodes.t.size, 10)
    filled = jax.tree.map(lambda y: np.pad(np.asarray(y), (0, more), mode="edge") if jnp.ndim(y) else y, nodes)
    return filled._replace(
        t=np.pad(np.asarray(nodes.t), (0, more), constant_values=np.inf),
        impact_time=np.pad(np.asarray(nodes.impact_time), (0, more), constant_values=np.nan),
    )


def _sample(c: Coefficients, excitation: AbstractExcitation, nodes: Nodes, solver, k: Int[Array, ""], t: Value) -> _Sample:
    """One step of the method from node k to the time t."""
    sigma, start = nodes.sigma[k], nodes.t[k]
    piece = nodes.piece[k]
    if not c.elastic:  # full contact is one leap, over many pieces
        piece = jnp.where(sigma == 0, excitation.locate(t), piece)
    ground = excitation.piece(piece)

    def field(t, x, v):
        return acceleration(c, sigma, ground(t), x, v)

    x, v = tuple(y[k] for y in nodes.x), tuple(y[k] for y in nodes.v)
    trial = step(tableau(solver), field, start, t - start, x, v, field(start, x, v))
    return _Sample(sigma, ground(t), trial.x, trial.v)


def _before(nodes: Nodes, t: Value, left: Bool[Array, ""]) -> Int[Array, ""]:
    """The node from which the motion at t starts; where `left`, the one before a node at t itself."""
    passed = jnp.where(left, jnp.searchsorted(nodes.t, t, side="left"), jnp.searchsorted(nodes.t, t, side="right"))
    return jnp.clip(passed - 1, 0, nodes.used - 1)


@eqx.filter_jit
def _along(scene: _Scene, t, left, quantity):
    podium, excitation, nodes, end, solver = scene
    c, nodes = coefficients(podium), jax.tree.map(jnp.asarray, nodes)

    def at(s, left):
        here = _sample(c, excitation, nodes, solver, _before(nodes, s, left), s)
        inside = (s >= nodes.t[0]) & (s <= end)
        x, v = (tuple(jnp.where(inside, y, jnp.nan) for y in ys) for ys in (here.x, here.v))
        return quantity(c, here.sigma, here.ground, x, v)

    return jax.vmap(at)(t, left)


@eqx.filter_jit
def _balance(scene: _Scene, t, left):
    """All samples, the energies (mechanical, input, impacts, damping) at times t, and the first of them at the start."""
    podium, excitation, nodes, end, solver = scene
    c, nodes = coefficients(podium), jax.tree.map(jnp.asarray, nodes)
    size = nodes.t.shape[0]
    # All steps to their ends, and from the nodes before t to t. Padding has no length.
    k = jnp.where(jnp.arange(size) < nodes.used, jnp.arange(size), 0)
    last = k + 1 >= nodes.used
    stops = jnp.where(last | (jnp.arange(size) >= nodes.used), nodes.t[k], nodes.t[jnp.minimum(k + 1, size - 1)])
    before = jax.vmap(lambda s, left: _before(nodes, s, left))(t, left)
    starts, stops = jnp.concatenate([k, before]), jnp.concatenate([stops, t])

    def advance(z, k, stop):
        """State, powers and energy at the part z of a step."""
        here = _sample(c, excitation, nodes, solver, k, jnp.where(z == 1, stop, nodes.t[k] + z * (stop - nodes.t[k])))
        return here, (*power(c, *here), _energy(c, *here))

    # One program of the step for all of them: compiling it is what takes time.
    places = jnp.asarray(np.append(_PLACES, 1.0), t.dtype)
    states, (given, taken, held) = jax.vmap(lambda k, stop: jax.vmap(lambda z: advance(z, k, stop))(places))(starts, stops)
    lengths = stops - nodes.t[starts]
    given, taken = (lengths * (y[:, :-1] @ jnp.asarray(_WEIGHTS, t.dtype)) for y in (given, taken))
    mechanical = held[:, -1]
    leaving = jax.vmap(lambda sigma, *y: energy(c, sigma, y[: len(nodes.x)], y[len(nodes.x) :]))(
        nodes.sigma, *nodes.x, *nodes.v
    )
    struck = jnp.isfinite(nodes.impact_time)
    lost = jnp.cumsum(jnp.where(struck, jnp.roll(mechanical[:size], 1) - leaving, 0.0))
    given, taken = (y[size:] + (jnp.cumsum(y[:size]) - y[:size])[before] for y in (given, taken))
    samples = jax.vmap(lambda here: _samples(c, *here))(jax.tree.map(lambda y: y[size:, -1], states))
    inside = (t >= nodes.t[0]) & (t <= end)
    parts = samples, mechanical[size:], given, lost[before], taken
    return *jax.tree.map(lambda y: jnp.where(inside, y, jnp.nan), parts), leaving[0]
