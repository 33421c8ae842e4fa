"""Bounds on the remaining motion of a scene (one podium under one excitation), from its energy.

The potential well is the range of rotations from which gravity and restrainers pull the columns back. Columns
in full contact lift when the uplift demand |q| exceeds the threshold q_up, Eq. (9). Equations without a
letter are those of docs/model.md. Equations (C…) are in docs/equations.md, (L2) is in docs/floors.md.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, Self, TypeVar

import jax
import jax.numpy as jnp

from rockjax._excitations.base import Shaking
from rockjax._excitations.ground import PairLookahead
from rockjax._types import Flag, Flags, Index, Value, Values

from .coefficients import Coefficients, Vibration, not_none, summed, weighted
from .energy import energy, energy_after, potential, vertical_impulse_weight
from .model import horizontal, restraint_bound
from .state import LoopState, Scene

T = TypeVar("T")


def all_true(flags: Flags) -> Flag:
    """Return whether all flags along the last axis (modes or stories) are True; a scalar stays as it is."""
    return jnp.all(flags, axis=-1) if flags.ndim else flags


class Bounds:
    """Bounds on the motion after a given state. They are held constant under differentiation. Columns rest
    for good if they are in full contact and never lift again.

    - `c`: constants of the podium
    - `overturn_angle`: α_o [rad]
    - `well`: |θ| at the top of the potential well, at most the overturning angle [rad]
    - `ground`, `vertical`: bounds on the present and later |ü_g| and |v̈_g| [m/s²]; `vertical` is the float
      0.0 if the ground does not move vertically
    - `energy`: bound on the energy per mass N m_c of all columns, (C19) [m²/s²]
    - `min_impact_speed`: an impact ends rocking if |θ̇| before the impact is at most this [rad/s]
    - `stays_inside`: whether the rotation stays inside the well
    - `rests`: whether the columns rest for good; the Python value False unless full contact is integrated
      step by step
    - `demand`: bound on |q| in full contact [m/s²]; only set if full contact is integrated step by step
    - `velocity_amplitudes`: for each mode, bound on √(u̇_i² + ω_i²u_i²) in full contact [m/s]; None without
      modes
    """

    c: Coefficients
    overturn_angle: Value
    well: Value
    ground: Value
    vertical: Value | float
    energy: Value
    min_impact_speed: Value
    stays_inside: Flag
    rests: Flag | bool
    demand: Value
    velocity_amplitudes: Values | None
    _shared_results: dict[Callable[..., Any], Any]

    @classmethod
    def after_step(
        cls, scene: Scene, state: LoopState, piece: Index, ground: Value | Shaking, follows_contact: bool
    ) -> Self:
        """Return the bounds after a step.

        - `scene`: the prepared scene
        - `state`: state after a step
        - `piece`: piece of the excitation that follows
        - `ground`: present ground acceleration on that piece [m/s²], ü_g or, with vertical motion, a
          `Shaking` with ü_g and v̈_g
        - `follows_contact`: whether full contact is integrated step by step. Otherwise a podium in full
          contact goes directly to its next uplift, or its scene ends

        `energy_after` gives the bound on the energy. If the columns are in full contact and the bound on |q|
        is below the threshold, they never lift again, and the modes vibrate independently. Vertical motion
        raises the bounds on the energy, (C19), and on |q|.
        """
        self = cls()
        self._shared_results = {}
        scene, state = jax.lax.stop_gradient((scene, state))
        c = self.c = scene.c
        self.overturn_angle, self.min_impact_speed = scene.overturn_angle, scene.min_impact_speed
        x, v, t, sigma = state.x, state.v, state.t, state.sigma
        impulse = scene.lookahead.impulse(t, piece)
        self.ground = scene.lookahead.peak(t, piece, horizontal(ground))
        energy_now = energy(c, sigma, x, v)
        max_energy = energy_after(c, energy_now, impulse)
        one = jnp.ones_like(t)
        well = c.alpha if c.restraint is None else c.restraint.well
        self.well = jnp.minimum(well, scene.overturn_angle)
        self.vertical = 0.0
        if isinstance(scene.lookahead, PairLookahead):
            self.vertical = scene.lookahead.vertical_peak(t, piece)
            weight = vertical_impulse_weight(c, self.max_sin_psi)
            impulse_sum = impulse + weight * scene.lookahead.vertical_impulse(t, piece)
            max_energy = energy_after(c, energy_now, impulse_sum)
        self.energy = max_energy
        self.stays_inside = (jnp.abs(x[0]) <= self.well) & (max_energy < potential(c, one, self.well))
        self.rests, self.velocity_amplitudes = False, None
        if not follows_contact:
            return self
        demand = self.ground
        if c.vibration is not None:
            # √(u̇² + ω²u²) can grow by at most ∫|ü_g| dt.
            modes = c.vibration
            self.velocity_amplitudes = jnp.sqrt(v[1] ** 2 + modes.omega2 * x[1] ** 2) + impulse
            demand = demand + weighted(
                modes.demand, jnp.sqrt(modes.omega2 + modes.damping**2) * self.velocity_amplitudes
            )
        if not isinstance(self.vertical, float):
            demand = demand + not_none(c.uplift_slope) * self.vertical
        self.demand, self.rests = demand, (sigma == 0) & (demand < c.uplift)
        return self

    def shared(self, make: Callable[[Self], T]) -> T:
        """Return `make(self)`. The result is computed once for each function `make`, and outputs share it."""
        if make not in self._shared_results:
            self._shared_results[make] = make(self)
        return self._shared_results[make]

    def either(self, at_rest: Values, rocking: Values) -> Values:
        """Return `at_rest` if the columns rest for good, else `rocking`."""
        return rocking if isinstance(self.rests, bool) else jnp.where(self.rests, at_rest, rocking)

    def modal_sum(self, weights: Values, beam_weight: Value | float = 0.0) -> Value:
        """Bound |Σ w_i y_i| over the modes i, for any y_i with |y_i| ≤ √(u̇_i² + ω_i²d_i²), where d_i is the
        deformation.

        - `weights`: w_i
        - `beam_weight`: w²/m if the sum has a further term w θ̇, where ½mθ̇² is the kinetic energy of columns
          and beam divided by N m_c; 0 without a further term

        Unless the columns rest for good, the bound is √(2E(Σ w_i²/η_i + `beam_weight`)), where E is the bound
        on the energy. If they rest for good, the bound follows from `velocity_amplitudes`.
        """
        rocking = jnp.sqrt(2 * self.energy * (summed(weights**2 / _nonzero(self.c.etas)) + beam_weight))
        return self.either(weighted(jnp.abs(weights), not_none(self.velocity_amplitudes)), rocking)

    def deformations(self) -> Values:
        """Bound the deformation of each mode [m]."""
        omega2 = not_none(self.c.vibration).omega2
        rocking = jnp.sqrt(2 * self.energy / (_nonzero(self.c.etas) * omega2))
        return self.either(not_none(self.velocity_amplitudes) / jnp.sqrt(omega2), rocking)

    def springs(self, weights: Values) -> Value:
        """Bound |Σ w_i F_i| over the modes i [m/s²]. F_i is the force of spring and damper divided by the
        modal mass, Eq. (7)."""
        modes: Vibration = not_none(self.c.vibration)
        # The dampers also act on the velocity of the beam, |u̇_b| ≤ 2R|θ̇|.
        beam_weight = weighted(weights, modes.damping) ** 2 * self.c.two_R**2 / self.c.spin
        return self.modal_sum(weights * jnp.sqrt(modes.omega2 + modes.damping**2), beam_weight)

    @functools.cached_property
    def beam(self) -> Value:
        """Bound on the beam's absolute acceleration |a_b| [m/s²]."""
        springs = None if self.c.vibration is None else self.springs(self.c.etas)
        rocking = self.c.two_R * self.angular_acceleration_bound(springs)
        return self.ground + self.either(jnp.zeros_like(rocking), rocking)

    def base_shear(self) -> Value:
        """Bound the shear of a superstructure with at most one mode, divided by the mass of the
        superstructure [m/s²]."""
        return self.beam if self.c.vibration is None else self.springs(jnp.ones_like(self.c.eta))

    def floor_acceleration(self, weights: Values) -> Value:
        """Bound the absolute horizontal acceleration of a floor with the weights w_i of the modes, (L2)
        [m/s²]."""
        springs = self.springs(weights)
        if not_none(self.c.modal).residual is None:
            return springs
        return springs + jnp.abs(1 - summed(weights)) * self.beam

    @property
    def max_sin_psi(self) -> Value:
        """Largest |sin ψ| inside the well."""
        c = self.c
        return c.sin_alpha if c.restraint is None else jnp.maximum(c.sin_alpha, jnp.sin(self.well - c.alpha))

    def angular_acceleration_bound(self, springs: Value | None) -> Value:
        """Bound |θ̈| + θ̇²|sin ψ| inside the well, (C20) [rad/s²].

        `springs` is a bound on |Σ η_iF_i| [m/s²] with the forces F_i of the method `springs`, or None if
        nothing vibrates. By Eq. (14), 2R times the result is a bound on |ü_b|.
        """
        c, max_energy, max_sin_psi = self.c, self.energy, self.max_sin_psi
        weight = c.gravity if isinstance(self.vertical, float) else c.gravity * (1 + self.vertical / c.g)
        angular = (weight * max_sin_psi + c.ground * self.ground) / c.inertia
        angular = angular + max_sin_psi * 2 * max_energy / c.spin
        if c.restraint is not None:
            speed = jnp.sqrt(2 * max_energy / c.spin)
            angular += restraint_bound(c, c.restraint, self.well, speed) / c.inertia
        if springs is not None:
            angular += (0.5 * c.centrifugal * 2 * max_energy / c.spin + 3 * springs / c.two_R) / c.inertia
        return angular


def _nonzero(mass: Values) -> Values:
    """Return the mass ratios, with zeros replaced by the smallest positive number, so that they can be
    divisors."""
    return jnp.maximum(mass, jnp.finfo(mass.dtype).tiny)
