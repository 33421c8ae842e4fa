"""Bounds on the motion of floors after the end of a scene, (L16), (L17)."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rockjax._engine.coefficients import weighted
from rockjax._engine.energy import potential
from rockjax._engine.model import beam
from rockjax._programs.program import StoredProgram

from . import history


class Ending(NamedTuple):
    """Quantities at the end of a scene that bound the motion of floors after it.

    - `rests`: whether the columns rest for good and the ground motion has ended
    - `modes`: bound on ∫|ü_i + ü_g| dt of each mode after the end [m/s]; inf for a mode without damping
    - `speed`: |u̇_b| of a rigid podium that rocks freely [m/s]; inf if there is no bound
    - `impact_speed`: bound on |u̇_b| before the next impact of this podium [m/s]; inf if there is no bound
    - `restitution`: restitution factor e, clipped to [0, 1]
    """

    rests: Any
    modes: Any
    speed: Any
    impact_speed: Any
    restitution: Any


@StoredProgram
def ending(scene: history.Solved, t) -> Ending:
    """Return the quantities that bound the motion of floors after the end t of a scene [s]."""
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
        # On columns in full contact, |2ζωu̇ + ω²u| ≤ ω|z|e^(−ζωt)/s for each mode.
        forces = jnp.where(s > 0, omega * z / jnp.where(s > 0, s, 1.0), jnp.inf)
        stays = weighted(modes.demand, jnp.where(z > 0, forces, 0.0)) < c.uplift
        integrals = jnp.where(zeta > 0, forces / jnp.where(zeta > 0, zeta * omega, 1.0), jnp.inf)
        integrals = jnp.atleast_1d(jnp.where(z > 0, integrals, 0.0))
        return Ending(is_over & (sigma == 0) & stays, integrals, inf, inf, e)
    speed = jnp.abs(beam(c, sigma, x[0], v[0])[1])
    # ν² = θ̇² + 2J (cos ψ − cos α), from the remaining energy, (L17).
    nu = jnp.sqrt(v[0] ** 2 + 2 * potential(c, sigma, x[0]) * c.gravity / (c.weight * c.inertia))
    has_bound = is_over & (c.restraint is None) & (c.sin_alpha < c.cos_alpha)
    no_modes = jnp.zeros((0,), t.dtype)
    impact_speed = jnp.where(has_bound, c.two_R * c.cos_alpha * nu, inf)
    return Ending(is_over & (sigma == 0), no_modes, jnp.where(has_bound, speed, inf), impact_speed, e)


def bound_after_end(
    ending: Ending, weights: np.ndarray, damping: np.ndarray, is_vertical: bool
) -> np.ndarray | float:
    """Bound ∫|a| dt + Σ|Δv| of a floor after the end of a scene, V of (L16), (L17) [m/s].

    - `ending`: the end of the scene
    - `weights`: weights W_i of the modes in the motion of the floor, shape (modes,)
    - `damping`: damping ratios ζ of the n oscillators, shape (n,)
    - `is_vertical`: whether the oscillators move vertically

    The bound is a scalar if the columns rest or the oscillators are vertical, and has shape (n,) otherwise.
    """
    if ending.rests:
        moves = weights != 0
        return 0.0 if is_vertical else float(np.abs(weights[moves]) @ np.asarray(ending.modes)[moves])
    if is_vertical:
        return np.inf
    speed, impact_speed, e = (float(y) for y in (ending.speed, ending.impact_speed, ending.restitution))
    from_impacts = speed + 2 * impact_speed / (1 - e) if e < 1 else np.inf
    s = np.sqrt(1 - damping**2)
    overshoot, decay = np.exp(-damping / s * np.arccos(damping)), np.exp(-np.pi * damping / s)
    from_damping = 2 * overshoot * (speed + impact_speed) / np.where(damping > 0, 1 - decay, np.nan)
    return np.fmin(from_impacts, np.where(damping > 0, from_damping, np.inf))
