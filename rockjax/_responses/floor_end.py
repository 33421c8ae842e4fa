"""Bounds on the motion of floors after the end of a scene, (L16), (L17) of docs/equations.md."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rockjax._checks import array_module
from rockjax._engine.coefficients import weighted
from rockjax._engine.energy import potential
from rockjax._engine.model import beam
from rockjax._programs.program import StoredProgram

from . import history


class Ending(NamedTuple):
    """Quantities at the end of a scene, from which bounds on the later motion of floors follow.

    - `rests`: whether the columns rest for good and the ground motion has ended
    - `modes`: for each mode i, with the displacement u_i relative to the ground, a bound on ∫|ü_i + ü_g| dt
      after the end [m/s]. The bound is valid only if `rests` is True. It is inf for a mode that still
      vibrates with a damping ratio of 0
    - `speed`: horizontal speed |u̇_b| of the beam at the end [m/s]
    - `impact_speed`: bound on |u̇_b| just before the next impact [m/s]
    - `restitution`: restitution factor e, clipped to [0, 1]

    Both speeds are inf unless four conditions hold: the ground motion has ended, no superstructure vibrates,
    there are no restrainers, and tan α < 1.
    """

    rests: Any
    modes: Any
    speed: Any
    impact_speed: Any
    restitution: Any


@StoredProgram
def ending(scene: history.Solved, t) -> Ending:
    """Return the quantities that bound the motion of floors after the end of a scene at time t [s]."""
    podium, excitation, nodes, _, method, rtol = scene
    c, nodes = history.constants(podium, excitation, rtol), jax.tree.map(jnp.asarray, nodes)
    node = history.node_before(nodes, t, jnp.zeros((), bool))
    state = history.sample(c, excitation, nodes, method, node, t)
    x, v, sigma = state.x, state.v, state.sigma
    is_over, inf = t >= excitation.support[1], jnp.full_like(t, jnp.inf)
    e = jnp.clip(c.restitution, 0.0, 1.0)
    if c.vibration is not None:
        modes = c.vibration
        omega = jnp.sqrt(modes.omega2)
        zeta = 0.5 * modes.damping / omega
        s = jnp.sqrt(jnp.maximum(1 - zeta**2, 0.0))
        z = jnp.hypot(v[1] + zeta * omega * x[1], s * omega * x[1])
        # With z of (L5) in docs/floors.md and s = √(1 − ζ²), a mode on columns in full contact has
        # |2ζωu̇ + ω²u| ≤ ω|z|e^(−ζωτ)/s at the time τ after the end, where u is its displacement.
        forces = jnp.where(s > 0, omega * z / jnp.where(s > 0, s, 1.0), jnp.inf)
        stays = weighted(modes.demand, jnp.where(z > 0, forces, 0.0)) < c.uplift
        integrals = jnp.where(zeta > 0, forces / jnp.where(zeta > 0, zeta * omega, 1.0), jnp.inf)
        integrals = jnp.atleast_1d(jnp.where(z > 0, integrals, 0.0))
        return Ending(is_over & (sigma == 0) & stays, integrals, inf, inf, e)
    speed = jnp.abs(beam(c, sigma, x[0], v[0])[1])
    # ν of (L17): the rate |θ̇| just before the next impact, if no energy is lost until then.
    nu = jnp.sqrt(v[0] ** 2 + 2 * potential(c, sigma, x[0]) * c.gravity / (c.weight * c.inertia))
    has_bound = is_over & (c.restraint is None) & (c.sin_alpha < c.cos_alpha)
    no_modes = jnp.zeros((0,), t.dtype)
    impact_speed = jnp.where(has_bound, c.two_R * c.cos_alpha * nu, inf)
    return Ending(is_over & (sigma == 0), no_modes, jnp.where(has_bound, speed, inf), impact_speed, e)


def bound_after_end(ending: Ending, weights: Any, damping: Any, is_vertical: bool) -> Any:
    """Return a bound on ∫|a| dt + Σ|Δv| after the end of a scene, with the acceleration a and the velocity
    jumps Δv of a floor, (L16), (L17) [m/s]. The arguments may be traced.

    - `ending`: quantities at the end of the scene
    - `weights`: weights W_i of the modes in the motion of the floor, shape (modes,)
    - `damping`: damping ratios ζ of the oscillators on the floor, in [0, 1) [–]
    - `is_vertical`: whether the oscillators move vertically

    The result has the shape of `damping`; it is a scalar if the oscillators move vertically. It is inf where
    no bound is known.
    """
    xp = array_module(ending, weights, damping)
    if is_vertical:
        return xp.where(ending.rests, 0.0, xp.inf)
    sizes = xp.abs(weights)
    # A mode without damping has an infinite integral, but does not move a floor in which its weight is 0.
    at_rest = xp.sum(sizes * xp.where(sizes > 0, ending.modes, 0.0))
    e, s = ending.restitution, xp.sqrt(1 - damping**2)
    loss = xp.where(e < 1, 1 - e, 1.0)
    from_impacts = xp.where(e < 1, ending.speed + 2 * ending.impact_speed / loss, xp.inf)
    overshoot, decay = xp.exp(-damping / s * xp.arccos(damping)), xp.exp(-np.pi * damping / s)
    gain = xp.where(damping > 0, 1 - decay, 1.0)
    from_damping = 2 * overshoot * (ending.speed + ending.impact_speed) / gain
    while_rocking = xp.minimum(from_impacts, xp.where(damping > 0, from_damping, xp.inf))
    return xp.where(ending.rests, at_rest, while_rocking)


def ratio_after_end(later: Any, largest: Any) -> Any:
    """Return the bound `later` of displacements after the end of a scene, divided by the `largest`
    displacement before the end. If `largest` is zero, the result is inf, or 0 if `later` is zero too. The
    arguments may be traced."""
    xp = array_module(later, largest)
    ratio = later / xp.where(largest > 0, largest, 1.0)
    return xp.where(largest > 0, ratio, xp.where(later > 0, xp.inf, 0.0))
