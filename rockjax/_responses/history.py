"""The motion between the nodes of a history, and the balance of energy along it."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int

from rockjax._checks import concrete
from rockjax._engine.coefficients import SLIP, Coefficients, coefficients
from rockjax._engine.energy import energy
from rockjax._engine.flat import Nodes
from rockjax._engine.model import acceleration, beam, drift_weights, floor_accelerations, shear
from rockjax._engine.runge_kutta import step
from rockjax._engine.tableaus import tableau_for
from rockjax._excitations.base import AbstractExcitation
from rockjax._excitations.ground import GroundMotion
from rockjax._excitations.sampled import common_size
from rockjax._programs.program import KeptProgram
from rockjax._responses.work import damper_power, power, restoring_moment
from rockjax._structures import Podium
from rockjax._tree import Module
from rockjax._types import Value, Vector

POINTS = 10  # Gauss–Legendre points on one step; their error is far below that of the step itself


class Energies(Module):
    """Balance of energy, per N m_c [m²/s²].

    initial + input = mechanical + impacts + damping + dampers + residual:

    - `mechanical`: kinetic energy relative to the ground, strain energy, gravity and tendons, Eqs. (16)–(19);
      `initial`: at the start
    - `input`: work of the ground since the start, −∫ü_g[(½+γ)u̇_b + η u̇_t] dt
    - `impacts`: lost at the impacts since the start, Eqs. (26), (27)
    - `damping`: lost in the damper of the superstructure since the start, ∫2ζω_s η (u̇_t − u̇_b)² dt
    - `dampers`: lost in the dampers that restrain the columns since the start, ∫(C/m_c)|ℓ̇|^(1+ν) dt
    - `residual`: remainder of the balance; its size measures the error of the history
    """

    mechanical: Float[Array, "*times"]
    input: Float[Array, "*times"]
    impacts: Float[Array, "*times"]
    damping: Float[Array, "*times"]
    dampers: Float[Array, "*times"]
    initial: Float[Array, ""]

    @property
    def residual(self) -> Float[Array, "*times"]:
        return self.initial + self.input - self.mechanical - self.impacts - self.damping - self.dampers


# Podium, excitation, nodes, end, the method between the nodes, and the tolerance if restrainers depend on
# it.
Solved = tuple[Podium, AbstractExcitation, Nodes, Value, Any, Any]


class _Sample(NamedTuple):
    """Inputs of a quantity of the history."""

    sigma: Value
    ground: Value
    x: Vector
    v: Vector


def _quantities(c: Coefficients, sigma: Value, ground: Value, x: Vector, v: Vector) -> dict[str, Any]:
    """Return every quantity of a history at one instant, by name.

    - `c`: coefficients; `sigma`: mode, 0 in full contact, ±1 while rocking; `ground`: ground acceleration
    - `x`, `v`: displacements and velocities
    """
    a = acceleration(c, sigma, ground, x, v)
    none = 0.0 * x[0]  # NaN outside the scene
    found = {
        "theta": x[0],
        "theta_dot": v[0],
        "u_t": none if c.vibration is None else x[1],
        "u_t_dot": none if c.vibration is None else v[1],
        "deformation": none if c.vibration is None else x[1] - beam(c, sigma, x[0], v[0])[0],
        "base_shear": shear(c, sigma, ground, x, v, a),
        "mechanical_energy": energy(c, sigma, x, v),
        "mode": sigma + none,
        "restoring_moment": restoring_moment(c, sigma, ground, x, v),
    }
    if c.modal is not None and c.modal.floors is not None:
        weights = drift_weights(c.modal.floors)
        found["drift"] = jnp.sum(weights * found["deformation"][None, :], axis=-1)
        found["floor_acceleration"] = floor_accelerations(c, sigma, ground, x, v, a)
    return found


# A few fixed sizes, so that histories of many lengths share programs: for a few times, for the times and
# impacts of a dataset, and for nodes.
FEW_TIMES, TIMES, NODES = 16, (8192, 4), (8192, 4)


def filled(t, left):
    """Return times (n,) and flags (n,), padded by repeating the last."""
    if concrete(t) is None or not t.size:
        return t, left
    padding = (FEW_TIMES if t.size <= FEW_TIMES else common_size(t.size, *TIMES)) - t.size
    return tuple(np.pad(np.asarray(y), (0, padding), mode="edge") for y in (t, left))


def padded(nodes: Nodes) -> Nodes:
    if any(isinstance(y, Tracer) for y in jax.tree.leaves(nodes)) or nodes.t.ndim != 1:
        return nodes
    padding = common_size(nodes.t.size, *NODES) - nodes.t.size
    longer = lambda y: np.pad(np.asarray(y), [(0, padding), *[(0, 0)] * (y.ndim - 1)], mode="edge")
    filled = jax.tree.map(lambda y: longer(y) if jnp.ndim(y) else y, nodes)
    return filled._replace(
        t=np.pad(np.asarray(nodes.t), (0, padding), constant_values=np.inf),
        impact_time=np.pad(np.asarray(nodes.impact_time), (0, padding), constant_values=np.nan),
    )


def sample(
    c: Coefficients, excitation: AbstractExcitation, nodes: Nodes, method, k: Int[Array, ""], t: Value
) -> _Sample:
    """Return the state at time t by one step of the method from node k."""
    sigma, start = nodes.sigma[k], nodes.t[k]
    piece = nodes.piece[k]
    if c.vibration is None:  # full contact is one step, over many pieces
        piece = jnp.where(sigma == 0, excitation.locate(t), piece)
    ground_at = excitation.piece(piece)

    def field(t, x, v):
        return acceleration(c, sigma, ground_at(t), x, v)

    x, v = tuple(y[k] for y in nodes.x), tuple(y[k] for y in nodes.v)
    tab = tableau_for(method, c.vibration is not None or c.restraint is not None)
    trial = step(tab, field, start, t - start, x, v, field(start, x, v))
    return _Sample(sigma, ground_at(t), trial.x, trial.v)


def node_before(nodes: Nodes, t: Value, left: Bool[Array, ""]) -> Int[Array, ""]:
    """Return the node from which the motion at t starts; if `left`, the one before a node at t itself."""
    passed = jnp.where(
        left, jnp.searchsorted(nodes.t, t, side="left"), jnp.searchsorted(nodes.t, t, side="right")
    )
    return jnp.clip(passed - 1, 0, nodes.used - 1)


def constants(
    podium: Podium, excitation: AbstractExcitation, rtol: Value | None, joints: bool = False
) -> Coefficients:
    """Return the constants of the equations along a history; with `joints` those of forces in the joints."""
    vertical = isinstance(excitation, GroundMotion)
    return coefficients(podium, SLIP if rtol is None else rtol, vertical, joints)


@KeptProgram
def ground_acceleration(excitation: AbstractExcitation, t):
    return excitation(t)


@KeptProgram
def quantities_at(scene: Solved, t, left) -> dict[str, Array]:
    """Return all quantities at times t (n,), just before them where `left` (n,)."""
    podium, excitation, nodes, end, method, rtol = scene
    c, nodes = constants(podium, excitation, rtol), jax.tree.map(jnp.asarray, nodes)

    def at(s, left):
        here = sample(c, excitation, nodes, method, node_before(nodes, s, left), s)
        inside = (s >= nodes.t[0]) & (s <= end)
        x, v = (tuple(jnp.where(inside, y, jnp.nan) for y in ys) for ys in (here.x, here.v))
        return _quantities(c, here.sigma, here.ground, x, v)

    return jax.vmap(at)(t, left)


@KeptProgram
def balance(scene: Solved, t, left):
    """Return all samples, the energies at times t, and the first of them at the start.

    Energies are mechanical, input, impacts, damping and, with restrainers, dampers.
    """
    podium, excitation, nodes, end, method, rtol = scene
    c, nodes = constants(podium, excitation, rtol), jax.tree.map(jnp.asarray, nodes)
    size = nodes.t.shape[0]
    # All full steps, and the partial ones from the nodes before t to t. Padded steps have no length.
    every = jnp.arange(size, dtype=nodes.used.dtype)
    k = jnp.where(every < nodes.used, every, 0)
    last = k + 1 >= nodes.used
    stops = jnp.where(last | (every >= nodes.used), nodes.t[k], nodes.t[jnp.minimum(k + 1, size - 1)])
    before = jax.vmap(lambda s, left: node_before(nodes, s, left))(t, left)
    starts, stops = jnp.concatenate([k, before]), jnp.concatenate([stops, t])

    def advance(z, k, stop):
        """Return state, powers and energy at the fraction z of a step."""
        here = sample(
            c, excitation, nodes, method, k, jnp.where(z == 1, stop, nodes.t[k] + z * (stop - nodes.t[k]))
        )
        restraint = c.restraint
        by_dampers = () if restraint is None else (damper_power(c, restraint, here.sigma, here.x, here.v),)
        return here, (*power(c, *here), *by_dampers, energy(c, here.sigma, here.x, here.v))

    # One compiled step serves all of them, because compilation dominates.
    nodes_of_rule, weights = np.polynomial.legendre.leggauss(POINTS)
    places = jnp.asarray(np.append(0.5 + 0.5 * nodes_of_rule, 1.0), t.dtype)
    states, (given, *taken, stored) = jax.vmap(
        lambda k, stop: jax.vmap(lambda z: advance(z, k, stop))(places)
    )(starts, stops)
    lengths = stops - nodes.t[starts]
    given, *taken = (lengths * (y[:, :-1] @ jnp.asarray(0.5 * weights, t.dtype)) for y in (given, *taken))
    mechanical = stored[:, -1]
    leaving = jax.vmap(lambda sigma, *y: energy(c, sigma, y[: len(nodes.x)], y[len(nodes.x) :]))(
        nodes.sigma, *nodes.x, *nodes.v
    )
    struck = jnp.isfinite(nodes.impact_time)
    at_impacts = jnp.cumsum(jnp.where(struck, jnp.roll(mechanical[:size], 1) - leaving, 0.0))
    given, *taken = (y[size:] + (jnp.cumsum(y[:size]) - y[:size])[before] for y in (given, *taken))
    samples = jax.vmap(lambda here: _quantities(c, *here))(jax.tree.map(lambda y: y[size:, -1], states))
    inside = (t >= nodes.t[0]) & (t <= end)
    parts = samples, mechanical[size:], given, at_impacts[before], *taken

    def inside_only(y):
        return jnp.where(inside.reshape(-1, *(1,) * (y.ndim - 1)), y, jnp.nan)

    return *jax.tree.map(inside_only, parts), leaving[0]
