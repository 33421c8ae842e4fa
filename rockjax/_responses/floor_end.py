"""Bounds of what floors still do after the end of a scene, (L16), (L17)."""

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
    """A scene at its end.

    - `rests`: the columns rest for good and the ground has come to rest
    - `modes`: ∫|ü_i + ü_g| of each mode that is left then [m/s]; inf without damping
    - `speed`, `impact_speed`: |u̇_b|, and that before the next impact, of rigid columns in free rocking; inf
      if nothing is known [m/s]
    - `restitution`: e, between 0 and 1
    """

    rests: Any
    modes: Any
    speed: Any
    impact_speed: Any
    restitution: Any


@StoredProgram
def ending(scene: history.Solved, t) -> Ending:
    """Return what bounds the floors after the end t of a scene [s]."""
    podium, excitation, nodes, _, method, rtol = scene
    c, nodes = history.constants(podium, excitation, rtol), jax.tree.map(jnp.asarray, nodes)
    here = history.sample(c, excitation, nodes, method, history.node_before(nodes, t, jnp.zeros((), bool)), t)
    x, v, sigma = here.x, here.v, here.sigma
    over, inf = t >= excitation.support[1], jnp.full_like(t, jnp.inf)
    e = jnp.clip(c.restitution, 0.0, 1.0)
    if c.vibration is not None:
        modes = c.vibration
        omega = jnp.sqrt(modes.omega2)
        zeta = 0.5 * modes.damping / omega
        s = jnp.sqrt(jnp.maximum(1 - zeta**2, 0.0))
        z = jnp.hypot(v[1] + zeta * omega * x[1], s * omega * x[1])
        # |2ζωu̇ + ω²u| ≤ ω|z|e^(−ζωt)/s of each mode on columns in full contact.
        forces = jnp.where(s > 0, omega * z / jnp.where(s > 0, s, 1.0), jnp.inf)
        stays = weighted(modes.demand, jnp.where(z > 0, forces, 0.0)) < c.uplift
        left = jnp.where(zeta > 0, forces / jnp.where(zeta > 0, zeta * omega, 1.0), jnp.inf)
        left = jnp.atleast_1d(jnp.where(z > 0, left, 0.0))
        return Ending(over & (sigma == 0) & stays, left, inf, inf, e)
    speed = jnp.abs(beam(c, sigma, x[0], v[0])[1])
    # ν² = θ̇² + 2J (cos ψ − cos α), from the energy that is left, (L17).
    nu = jnp.sqrt(v[0] ** 2 + 2 * potential(c, sigma, x[0]) * c.gravity / (c.weight * c.inertia))
    known = over & (c.restraint is None) & (c.sin_alpha < c.cos_alpha)
    none = jnp.zeros((0,), t.dtype)
    before = jnp.where(known, c.two_R * c.cos_alpha * nu, inf)
    return Ending(over & (sigma == 0), none, jnp.where(known, speed, inf), before, e)


def remaining(
    found: Ending, weights: np.ndarray, damping: np.ndarray, is_vertical: bool
) -> np.ndarray | float:
    """Return V, the bound of ∫|a| + Σ|Δv| after the end, of each oscillator [m/s], (L16), (L17).

    - `found`: the end of the scene
    - `weights`: W_i of the floor, shape (modes,)
    - `damping`: ζ of the oscillators
    """
    if found.rests:
        moves = weights != 0
        return 0.0 if is_vertical else float(np.abs(weights[moves]) @ np.asarray(found.modes)[moves])
    if is_vertical:
        return np.inf
    speed, impact_speed, e = (float(y) for y in (found.speed, found.impact_speed, found.restitution))
    of_all = speed + 2 * impact_speed / (1 - e) if e < 1 else np.inf
    s = np.sqrt(1 - damping**2)
    kick, decay = np.exp(-damping / s * np.arccos(damping)), np.exp(-np.pi * damping / s)
    of_any = 2 * kick * (speed + impact_speed) / np.where(damping > 0, 1 - decay, np.nan)
    return np.fmin(of_all, np.where(damping > 0, of_any, np.inf))
