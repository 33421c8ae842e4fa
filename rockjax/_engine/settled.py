"""The certificate: when energy proves that a requested output cannot change any more."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from rockjax._excitations.base import Shaking
from rockjax._excitations.ground import PairLookahead
from rockjax._types import Flag, Flags, Index, Value, Values

from .coefficients import Coefficients, Several, Vibration, present, summed, weighted
from .energy import energy, energy_after, potential, vertical_impulse
from .model import drift_weights, horizontal, restraint_at_most
from .state import LoopState, Plan, Scene


def certificate(scene: Scene, plan: Plan, state: LoopState, piece: Index, ground: Value | Shaking) -> Flag:
    """Return whether all requested outputs are final, whatever the rest of the excitation does.

    - `scene`, `plan`: the prepared scene and its static choices
    - `state`: state after a step
    - `piece`: piece of the excitation that follows
    - `ground`: ground acceleration on it now, ü_g, or ü_g and v̈_g [m/s²]

    The energy can never exceed `energy_after` again. If that is less than the potential at the recorded peak
    (or at the top of the well, if the peak is past it), the rotation stays below the record. In full contact
    only the oscillators hold energy. If their bound and the bound of the remaining ground acceleration
    together stay below Eq. (9), the columns never lift again; several modes then vibrate independently.
    Deformation and shear have bounds of their own. Vertical motion adds its full impulse while the columns
    rock, and reduces weights, (C19), (C20).
    """
    scene, state = jax.lax.stop_gradient((scene, state))
    c = scene.c
    x, v, t, sigma = state.x, state.v, state.t, state.sigma
    impulse = scene.lookahead.impulse(t, piece)
    to_come = scene.lookahead.peak(t, piece, horizontal(ground))
    now = energy(c, sigma, x, v)
    most = energy_after(c, now, impulse)
    one = jnp.ones_like(t)
    # Restrainers move the top of the well; the overturning angle may be smaller.
    well = c.alpha if c.restraint is None else jnp.minimum(c.restraint.well, scene.overturn_angle)
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
    # A rigid podium at rest goes directly to its next uplift, and ends there if none follows.
    if c.vibration is None:
        if plan.shear:
            angular = _angular_at_most(c, well, most, to_come, vertical)
            stays_under &= to_come + c.two_R * angular < present(state.shear) * c.g
        return stays_under & (not plan.impacts)
    # At rest on both edges only the top mass takes energy from the ground: C² = η/2.
    contact = jnp.where(
        sigma == 0, (jnp.sqrt(jnp.maximum(now, 0.0)) + jnp.sqrt(c.eta / 2) * impulse) ** 2, jnp.inf
    )
    each, several = c.vibration, c.several
    # For each mode √(u̇² + ω²u²) grows by ∫|ü_g| dt at most.
    swing = jnp.sqrt(v[1] ** 2 + each.omega2 * x[1] ** 2) + impulse if several is not None else None
    demand = to_come + _demand_of_springs(c, each, jnp.where(sigma == 0, contact, 0.0), swing)
    if not isinstance(vertical, float):
        demand = demand + present(c.tilt) * vertical
    rests = (sigma == 0) & (demand < c.uplift)
    stands = rests | (stays_under & (not plan.impacts))
    most = jnp.where(rests, contact, most)
    if several is not None and swing is not None:
        bounds = _Bounds(several.eta, rests, most, swing)
        return stands & _several_stand(scene, plan, state, several, bounds, well, to_come, vertical)
    if plan.deformation:
        stands &= 0.5 * c.etas * each.omega2 * present(state.deformation) ** 2 > most
    if plan.shear:
        # max of ω²d + 2ζω(u̇_t − u̇_b) at given energy, by Cauchy–Schwarz; at rest u̇_b = 0.
        beam = jnp.where(rests, 0.0, (each.damping * c.two_R) ** 2 / c.spin)
        stands &= present(state.shear) * c.g > jnp.sqrt(
            2 * most * ((each.omega2 + each.damping**2) / _some(c.eta) + beam)
        )
    return stands


def every(flags: Flags) -> Flag:
    """Return whether a flag holds for all modes or stories."""
    return jnp.all(flags, axis=-1) if flags.ndim else flags


def _some(mass: Values) -> Values:
    """Return a positive mass to divide by."""
    return jnp.maximum(mass, jnp.finfo(mass.dtype).tiny)


def _demand_of_springs(c: Coefficients, each: Vibration, contact: Value, swing: Values | None) -> Value:
    """Bound the part of springs in the demand q in full contact: by the energy `contact` of one mode, or by
    the bounds `swing` of several."""
    if swing is not None:
        return weighted(each.demand, jnp.sqrt(each.omega2 + each.damping**2) * swing)
    own = each.demand / jnp.sqrt(_some(c.eta))
    return own * jnp.sqrt(2 * contact * (each.omega2 + each.damping**2))


class _Bounds(NamedTuple):
    """Bounds of several modes: by their common energy while the columns rock, and for each mode alone after
    the columns rest for good."""

    eta: Values
    rests: Flag
    most: Value  # of the energy
    swing: Values  # of √(u̇_i² + ω_i²u_i²) in full contact

    def of_sum(self, weights: Values, beam: Value | float = 0.0) -> Value:
        """Bound Σ w_i y_i for |y_i| ≤ √(u̇_i² + ω_i²d_i²); `beam` adds to Σ w_i²/η_i while the
        columns rock."""
        rocking = jnp.sqrt(2 * self.most * (summed(weights**2 / _some(self.eta)) + beam))
        return jnp.where(self.rests, weighted(jnp.abs(weights), self.swing), rocking)

    def of_each(self, omega2: Values) -> Values:
        """Bound each deformation [m]."""
        rocking = jnp.sqrt(2 * self.most / (_some(self.eta) * omega2))
        return jnp.where(self.rests, self.swing / jnp.sqrt(omega2), rocking)


def _angular_at_most(
    c: Coefficients,
    well: Value,
    most: Value,
    to_come: Value,
    vertical: Value | float,
    springs: Value | None = None,
) -> Value:
    """Bound |θ̈| + θ̇²|sin ψ| inside the well, (C20) [rad/s²].

    - `c`: constants of the podium
    - `well`: |θ| at the top of the well [rad]
    - `most`: bound of the energy per N m_c [m²/s²]
    - `to_come`, `vertical`: bounds of the remaining |ü_g| and |v̈_g| [m/s²]
    - `springs`: bound of Σ η_iF_i [m/s²]; None without springs

    With it |ü_b| ≤ 2R(|θ̈| + θ̇²|sin ψ|), Eq. (14), and |sin ψ| ≤ sin α there. (C20) omits the sine.
    """
    steepest = _steepest(c, well)
    weight = c.gravity if isinstance(vertical, float) else c.gravity * (1 + vertical / c.g)
    angular = (weight * steepest + c.ground * to_come) / c.inertia + steepest * 2 * most / c.spin
    if c.restraint is not None:
        angular += restraint_at_most(c, c.restraint, well, jnp.sqrt(2 * most / c.spin)) / c.inertia
    if springs is not None:
        angular += (0.5 * c.centrifugal * 2 * most / c.spin + 3 * springs / c.two_R) / c.inertia
    return angular


def _several_stand(
    scene: Scene,
    plan: Plan,
    state: LoopState,
    several: Several,
    bounds: _Bounds,
    well: Value,
    to_come: Value,
    vertical: Value | float,
) -> Flag:
    """Return whether all outputs of several modes stay below their records.

    - `scene`, `plan`, `state`: as in `certificate`
    - `several`, `bounds`: constants and bounds of the modes
    - `well`: |θ| at the top of the well [rad]
    - `to_come`, `vertical`: bounds of the remaining |ü_g| and |v̈_g| [m/s²]

    The outputs are deformations, drifts, and forces of springs and of the mass that moves with the beam.
    """
    c, each = scene.c, present(scene.c.vibration)
    stands, stiff = jnp.ones((), bool), jnp.sqrt(each.omega2 + each.damping**2)
    if plan.deformation:
        stands &= every(bounds.of_each(each.omega2) < present(state.deformation))
    if plan.drifts:
        of_story = lambda weights: bounds.of_sum(weights / jnp.sqrt(each.omega2))
        stands &= every(jax.vmap(of_story)(drift_weights(present(several.floors))) < present(state.drifts))

    def of_springs(weights: Values) -> Value:
        """Bound Σ w_i F_i, by Cauchy–Schwarz; at rest u̇_b = 0."""
        beam = weighted(weights, each.damping) ** 2 * c.two_R**2 / c.spin
        return bounds.of_sum(weights * stiff, beam)

    base = 0.0
    if several.residual is not None:
        angular = _angular_at_most(c, well, bounds.most, to_come, vertical, of_springs(several.eta))
        base = to_come + jnp.where(bounds.rests, 0.0, c.two_R * angular)

    def at_most(weights: Values) -> Value:
        """Bound the forces of springs and of the mass that moves with the beam."""
        found = of_springs(weights)
        return found if several.residual is None else found + jnp.abs(1 - summed(weights)) * base

    if plan.shear:
        stands &= at_most(several.shares) < present(state.shear) * c.g
    if plan.floors:
        stands &= every(jax.vmap(at_most)(present(several.floors)) < present(state.floors))
    return stands


def _steepest(c: Coefficients, well: Value) -> Value:
    """Return the largest |sin ψ| up to the top of the well."""
    return c.sin_alpha if c.restraint is None else jnp.maximum(c.sin_alpha, jnp.sin(well - c.alpha))
