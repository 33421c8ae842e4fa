"""The certificate: when energy proves that a wanted output cannot change any more."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from rockjax._excitations.base import Shaking
from rockjax._excitations.ground import PairLookahead
from rockjax._types import Flag, Index, Value

from .coefficients import Coefficients
from .energy import energy, energy_after, potential, vertical_impulse
from .model import horizontal, restraint_at_most
from .state import LoopState, Plan, Scene, present


def certificate(scene: Scene, plan: Plan, state: LoopState, piece: Index, ground: Value | Shaking) -> Flag:
    """Whether everything that is wanted stands, whatever the rest of the excitation does.

    The energy can never exceed `energy_after` again. If that is less than the potential at the recorded peak
    (or at the top of the well, where the peak is past it), the rotation stays under the record. In full
    contact only the oscillator holds energy; where its bound and the rest of the ground's acceleration
    together stay under Eq. (9), the columns never lift again. Deformation and shear have bounds of their own.
    Vertical motion lifts with all its impulse while the columns rock, and takes off weight, (C19), (C20).
    """
    scene, state = jax.lax.stop_gradient((scene, state))
    c = scene.c
    x, v, t, sigma = state.x, state.v, state.t, state.sigma
    impulse = scene.lookahead.impulse(t, piece)
    to_come = scene.lookahead.peak(t, piece, horizontal(ground))
    now = energy(c, sigma, x, v)
    most = energy_after(c, now, impulse)
    one = jnp.ones_like(t)
    # Restrainers move the top of the well; what counts as overturned may come before it.
    well = jnp.minimum(c.well, scene.overturn_angle) if c.restrainers else c.alpha
    vertical = 0.0
    if isinstance(scene.lookahead, PairLookahead):
        vertical = scene.lookahead.vertical_peak(t, piece)
        counts = vertical_impulse(c, _steepest(c, well))
        most = energy_after(c, now, impulse + counts * scene.lookahead.vertical_impulse(t, piece))
    stays_inside = (jnp.abs(x[0]) <= well) & (most < potential(c, one, well))
    stays_under = stays_inside
    if plan.rotation:
        stays_under &= most < potential(c, one, jnp.minimum(state.peak, well))
    if plan.margin:
        stays_under &= most < (1 - present(state.margin)) * potential(c, one, scene.overturn_angle)
    if not plan.elastic:  # at rest it goes to its next uplift at once, and knows by itself that there is none
        if plan.shear:
            # |ü_b| ≤ 2R(|θ̈| + θ̇²), Eq. (14), with |sin ψ| ≤ sin α inside the well.
            steepest = _steepest(c, well)
            weight = c.gravity if isinstance(vertical, float) else c.gravity * (1 + vertical / c.g)
            angular = (weight * steepest + c.ground * to_come) / c.inertia + 2 * most / c.spin
            if c.restrainers:
                angular += restraint_at_most(c, well, jnp.sqrt(2 * most / c.spin)) / c.inertia
            stays_under &= to_come + c.two_R * angular < present(state.shear) * c.g
        return stays_under & (not plan.impacts)
    # At rest on both edges only the top mass takes energy from the ground: C² = η/2.
    contact = jnp.where(
        sigma == 0, (jnp.sqrt(jnp.maximum(now, 0.0)) + jnp.sqrt(c.eta / 2) * impulse) ** 2, jnp.inf
    )
    demand = to_come + c.demand / jnp.sqrt(jnp.maximum(c.eta, jnp.finfo(t.dtype).tiny)) * jnp.sqrt(
        2 * jnp.where(sigma == 0, contact, 0.0) * (c.omega2 + c.damping**2)
    )
    if not isinstance(vertical, float):
        demand = demand + c.tilt * vertical
    rests = (sigma == 0) & (demand < c.uplift)
    stands = rests | (stays_under & (not plan.impacts))
    most = jnp.where(rests, contact, most)
    if plan.deformation:
        stands &= 0.5 * c.eta * c.omega2 * present(state.deformation) ** 2 > most
    if plan.shear:
        # max of ω²d + 2ζω(u̇_t − u̇_b) at given energy, by Cauchy–Schwarz; at rest u̇_b = 0.
        eta = jnp.maximum(c.eta, jnp.finfo(t.dtype).tiny)
        beam = jnp.where(rests, 0.0, (c.damping * c.two_R) ** 2 / c.spin)
        stands &= present(state.shear) * c.g > jnp.sqrt(2 * most * ((c.omega2 + c.damping**2) / eta + beam))
    return stands


def _steepest(c: Coefficients, well: Value) -> Value:
    """The largest |sin ψ| up to the top of the well."""
    return jnp.maximum(c.sin_alpha, jnp.sin(well - c.alpha)) if c.restrainers else c.sin_alpha
