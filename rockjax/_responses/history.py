"""The motion at any time of a scene, from the nodes of its history, and the balance of energy.

The nodes are the ends of the accepted steps. Equations with a number alone are in docs/model.md, and (C1) is
in docs/control.md.
"""

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
from rockjax._engine.model import acceleration, beam, floor_accelerations, shear
from rockjax._engine.runge_kutta import step
from rockjax._engine.tableaus import tableau_for
from rockjax._excitations.base import AbstractExcitation
from rockjax._excitations.ground import GroundMotion
from rockjax._excitations.sampled import common_size
from rockjax._outputs.drift import drift_weights
from rockjax._programs.program import StoredProgram
from rockjax._responses.work import damper_power, power, restoring_moment
from rockjax._structures import Podium
from rockjax._tree import Module
from rockjax._types import Value, Vector

POINTS = 10  # Gauss–Legendre points in each step; the quadrature error is far below the error of the step


class Energies(Module):
    """Balance of energy: initial + input = mechanical + impacts + damping + dampers + residual.

    All energies are divided by the mass N m_c of the N columns [m²/s²]. The ground has the accelerations ü_g
    (horizontal) and v̈_g (vertical). Relative to the ground, the beam moves by u_b horizontally and by v_b
    vertically, Eq. (13) of docs/model.md. The superstructure has the displacement u_t, the mass ratio η, the
    frequency ω_s and the damping ratio ζ; γ is the mass ratio of the beam. Each column has a damper with the
    force C|ℓ̇|^ν, with the elongation ℓ of (C1) in docs/control.md. The energy of the N dampers is also
    divided by N m_c, so N cancels.

    - `mechanical`: kinetic energy relative to the ground, strain energy of the superstructure, and potential
      energy of gravity and tendons, Eqs. (16) to (19)
    - `initial`: the mechanical energy at the start
    - `input`: work of the ground since the start, −∫{ü_g[(½+γ)u̇_b + η u̇_t] + v̈_g w v̇_b} dt with w = ½+γ+η
    - `impacts`: energy lost at impacts since the start, Eqs. (26), (27)
    - `damping`: energy lost in the damper of the superstructure since the start, ∫2ζω_s η (u̇_t − u̇_b)² dt
    - `dampers`: energy lost in the dampers of the columns since the start, ∫(C/m_c)|ℓ̇|^(1+ν) dt
    - `residual`: remainder of the balance, a measure of the error of the history
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


# A solved scene: podium; excitation; nodes; time up to which the nodes give the motion [s]; method for the
# motion between the nodes; and `rtol`, None if there are no restrainers. The time is the end of the scene, or
# inf if a podium with a rigid superstructure or none has come to rest for good.
Solved = tuple[Podium, AbstractExcitation, Nodes, Value, Any, Any]


class _Instant(NamedTuple):
    """Contact mode, ground acceleration, positions (θ, then u_i of the modes) and velocities at one time."""

    sigma: Value
    ground: Value
    x: Vector
    v: Vector


def _quantities(c: Coefficients, sigma: Value, ground: Value, x: Vector, v: Vector) -> dict[str, Any]:
    """Return all quantities of a history at one time, by name.

    - `c`: constants of the podium; `sigma`: contact mode σ ∈ {−1, 0, 1}
    - `ground`: ü_g, or ü_g and v̈_g [m/s²]
    - `x`, `v`: positions and velocities; NaN outside the scene
    """
    a = acceleration(c, sigma, ground, x, v)
    zero = 0.0 * x[0]  # NaN outside the scene
    quantities = {
        "theta": x[0],
        "theta_dot": v[0],
        "u_t": zero if c.vibration is None else x[1],
        "u_t_dot": zero if c.vibration is None else v[1],
        "deformation": zero if c.vibration is None else x[1] - beam(c, sigma, x[0], v[0])[0],
        "base_shear": shear(c, sigma, ground, x, v, a),
        "mechanical_energy": energy(c, sigma, x, v),
        "mode": sigma + zero,
        "restoring_moment": restoring_moment(c, sigma, ground, x, v),
    }
    if c.modal is not None and c.modal.floors is not None:
        weights = drift_weights(c.modal.floors)
        quantities["drift"] = jnp.sum(weights * quantities["deformation"][None, :], axis=-1)
        quantities["floor_acceleration"] = floor_accelerations(c, sigma, ground, x, v, a)
    return quantities


# Arrays are padded to one of a few lengths, so that histories share compiled programs. An array of times is
# padded to the length FEW_TIMES or, if it is longer, to `common_size(count, *TIMES)`. Arrays of nodes are
# padded to `common_size(count, *NODES)`.
FEW_TIMES, TIMES, NODES = 16, (8192, 4), (8192, 4)


def pad_times(t, left):
    """Pad times t (n,) and flags `left` (n,) to one of a few lengths by repeating the last entries. Traced
    and empty times are not padded."""
    if concrete(t) is None or not t.size:
        return t, left
    padding = (FEW_TIMES if t.size <= FEW_TIMES else common_size(t.size, *TIMES)) - t.size
    return tuple(np.pad(np.asarray(y), (0, padding), mode="edge") for y in (t, left))


def pad_nodes(nodes: Nodes) -> Nodes:
    """Pad nodes to one of a few sizes. Traced nodes and batches stay as they are."""
    if any(isinstance(y, Tracer) for y in jax.tree.leaves(nodes)) or nodes.t.ndim != 1:
        return nodes
    padding = common_size(nodes.t.size, *NODES) - nodes.t.size
    pad = lambda y: np.pad(np.asarray(y), [(0, padding), *[(0, 0)] * (y.ndim - 1)], mode="edge")
    padded_nodes = jax.tree.map(lambda y: pad(y) if jnp.ndim(y) else y, nodes)
    return padded_nodes._replace(
        t=np.pad(np.asarray(nodes.t), (0, padding), constant_values=np.inf),
        impact_time=np.pad(np.asarray(nodes.impact_time), (0, padding), constant_values=np.nan),
        event_time=np.pad(np.asarray(nodes.event_time), (0, padding), constant_values=np.inf),
    )


def sample(
    c: Coefficients, excitation: AbstractExcitation, nodes: Nodes, method, k: Int[Array, ""], t: Value
) -> _Instant:
    """Return the motion at time t, by one step of the integration method from node k.

    - `c`, `excitation`, `nodes`, `method`: constants, ground motion, nodes and method of the scene
    - `k`: index of the node before t, from `node_before`
    - `t`: time [s]
    """
    sigma, start = nodes.sigma[k], nodes.t[k]
    piece = nodes.piece[k]
    # Without a vibrating superstructure, one step in full contact may cover many pieces of the ground motion.
    # The piece that contains t is then used.
    if c.vibration is None:
        piece = jnp.where(sigma == 0, excitation.locate(t), piece)
    ground_at = excitation.piece(piece)

    def field(t, x, v):
        return acceleration(c, sigma, ground_at(t), x, v)

    x, v = tuple(y[k] for y in nodes.x), tuple(y[k] for y in nodes.v)
    tableau = tableau_for(method, c.vibration is not None or c.restraint is not None)
    trial = step(tableau, field, start, t - start, x, v, field(start, x, v))
    return _Instant(sigma, ground_at(t), trial.x, trial.v)


def node_before(nodes: Nodes, t: Value, left: Bool[Array, ""]) -> Int[Array, ""]:
    """Return the index of the last node at or before t or, with `left`, of the last node before t."""
    count = jnp.where(
        left, jnp.searchsorted(nodes.t, t, side="left"), jnp.searchsorted(nodes.t, t, side="right")
    )
    return jnp.clip(count - 1, 0, nodes.used - 1)


def constants(
    podium: Podium, excitation: AbstractExcitation, rtol: Value | None, joints: bool = False
) -> Coefficients:
    """Return the constants of the equations of motion.

    - `podium`, `excitation`: structure and ground motion of the scene
    - `rtol`: relative tolerance of the scene. Forces of restrainers with an infinite slope at θ̇ = 0 are
      smoothed below |θ̇|/(pα) = 10 `rtol`. None without restrainers
    - `joints`: whether to include the constants of joint forces
    """
    vertical = isinstance(excitation, GroundMotion)
    return coefficients(podium, SLIP if rtol is None else rtol, vertical, joints)


@StoredProgram
def ground_acceleration(excitation: AbstractExcitation, t):
    """Return the ground acceleration at times t [m/s²]."""
    return excitation(t)


@StoredProgram
def quantities_at(scene: Solved, t, left) -> dict[str, Array]:
    """Return the quantities of `_quantities` at times t (n,) [s], or just before them where `left` (n,)."""
    podium, excitation, nodes, end, method, rtol = scene
    c, nodes = constants(podium, excitation, rtol), jax.tree.map(jnp.asarray, nodes)

    def at_time(time, is_left):
        instant = sample(c, excitation, nodes, method, node_before(nodes, time, is_left), time)
        is_inside = (time >= nodes.t[0]) & (time <= end)
        x, v = (tuple(jnp.where(is_inside, y, jnp.nan) for y in ys) for ys in (instant.x, instant.v))
        return _quantities(c, instant.sigma, instant.ground, x, v)

    return jax.vmap(at_time)(t, left)


@StoredProgram
def balance(scene: Solved, t, left):
    """Return quantities and energies at times t (n,) [s], or just before them where `left` (n,).

    The result is a tuple. First is the dict of `_quantities`. Then follow the fields `mechanical`, `input`,
    `impacts`, `damping` and (only with restrainers) `dampers` of `Energies`, shape (n,). Last is `initial`, a
    scalar.
    """
    podium, excitation, nodes, end, method, rtol = scene
    c, nodes = constants(podium, excitation, rtol), jax.tree.map(jnp.asarray, nodes)
    size = nodes.t.shape[0]
    # The powers are integrated over all steps between nodes, and over the partial step to each time t from
    # the node before it. Steps from the last node and from unused nodes have the length zero.
    indices = jnp.arange(size, dtype=nodes.used.dtype)
    k = jnp.where(indices < nodes.used, indices, 0)
    is_last = k + 1 >= nodes.used
    stops = jnp.where(is_last | (indices >= nodes.used), nodes.t[k], nodes.t[jnp.minimum(k + 1, size - 1)])
    before = jax.vmap(lambda time, is_left: node_before(nodes, time, is_left))(t, left)
    starts, stops = jnp.concatenate([k, before]), jnp.concatenate([stops, t])

    def advance(fraction, node, stop):
        """Return motion, powers and energy at a fraction of the step from a node to the time `stop`."""
        start = nodes.t[node]
        time = jnp.where(fraction == 1, stop, start + fraction * (stop - start))
        instant = sample(c, excitation, nodes, method, node, time)
        sigma, _, x, v = instant
        dampers = () if c.restraint is None else (damper_power(c, c.restraint, sigma, x, v),)
        return instant, (*power(c, *instant), *dampers, energy(c, sigma, x, v))

    # All points are computed by one vectorised step, because compiling a step takes most of the time.
    abscissae, weights = np.polynomial.legendre.leggauss(POINTS)
    fractions = jnp.asarray(np.append(0.5 + 0.5 * abscissae, 1.0), t.dtype)
    instants, (*powers, energies) = jax.vmap(
        lambda node, stop: jax.vmap(lambda fraction: advance(fraction, node, stop))(fractions)
    )(starts, stops)
    lengths = stops - nodes.t[starts]
    work = [lengths * (y[:, :-1] @ jnp.asarray(0.5 * weights, t.dtype)) for y in powers]
    mechanical = energies[:, -1]
    after_nodes = jax.vmap(lambda sigma, *y: energy(c, sigma, y[: len(nodes.x)], y[len(nodes.x) :]))(
        nodes.sigma, *nodes.x, *nodes.v
    )
    is_impact = jnp.isfinite(nodes.impact_time)
    dissipated_at_impacts = jnp.cumsum(
        jnp.where(is_impact, jnp.roll(mechanical[:size], 1) - after_nodes, 0.0)
    )
    input_work, *dissipated = (y[size:] + (jnp.cumsum(y[:size]) - y[:size])[before] for y in work)
    at_t = jax.tree.map(lambda y: y[size:, -1], instants)
    samples = jax.vmap(lambda instant: _quantities(c, *instant))(at_t)
    is_inside = (t >= nodes.t[0]) & (t <= end)
    terms = samples, mechanical[size:], input_work, dissipated_at_impacts[before], *dissipated

    def inside_only(y):
        return jnp.where(is_inside.reshape(-1, *(1,) * (y.ndim - 1)), y, jnp.nan)

    return *jax.tree.map(inside_only, terms), after_nodes[0]
