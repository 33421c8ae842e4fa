"""The largest jump of the deck's velocity at the impacts of a scene (one podium under one excitation). (L3)
is in docs/floors.md."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax.numpy as jnp

from rockjax._engine.bounds import Bounds
from rockjax._engine.coefficients import Coefficients
from rockjax._types import Flag, Value

from .base import AbstractEventOutput
from .views import Bounces, Ended, Impact, Start, Step


@dataclasses.dataclass(frozen=True)
class PeakVelocityJump(AbstractEventOutput):
    """The largest jump of the horizontal velocity of the deck (the beam) at an impact, max|Δv_b|, (L3) [m/s].

    `is_final` bounds the jump at the fastest impact that can follow. At an impact θ = 0, so the potential
    energy of gravity and restrainers is zero. The kinetic energy, divided by the mass of all columns, is at
    least ½(`c.spin` + η(2R sin α)²)θ̇² and at most `bounds.energy`. These two bounds limit |θ̇|.
    """

    name = "peak_velocity_jump"
    unit = "m s-1"
    description = "largest jump of the horizontal velocity of the deck at an impact"
    symbol = "|Δv_b|"
    needs_flat = True

    def start(self, start: Start) -> tuple[Value, None]:
        return jnp.zeros((), start.t.dtype), None

    def over_step(self, step: Step, accumulator: Value) -> None:
        del step, accumulator

    def at_impact(self, impact: Impact) -> Value:
        c = impact.c
        return c.two_R * c.cos_alpha * jnp.abs(impact.v_after[0] - impact.v[0])

    def over_bounces(self, bounces: Bounces, accumulator: Value) -> Flag:
        return _jump_bound(bounces.c, bounces.speed, bounces.min_impact_speed) <= accumulator

    def is_final(self, bounds: Bounds, accumulator: Value) -> Flag:
        c = bounds.c
        inertia = c.spin + c.eta * (c.two_R * c.sin_alpha) ** 2
        speed = jnp.sqrt(2 * bounds.energy / inertia)
        return bounds.rests | (_jump_bound(c, speed, bounds.min_impact_speed) <= accumulator)

    def absent(self, ended: Ended) -> dict[str, Any]:
        del ended
        return {}


def _jump_bound(c: Coefficients, speed: Value, min_impact_speed: Value) -> Value:
    """Bound the velocity jumps of the deck at impacts [m/s]. If the columns come to rest at an impact, the
    deck loses its whole velocity.

    - `c`: constants of the podium
    - `speed`: upper bound on |θ̇| before the impacts [rad/s]
    - `min_impact_speed`: the columns come to rest if |θ̇| before the impact is at most this speed [rad/s]
    """
    change = jnp.maximum(jnp.minimum(1 - c.restitution, 1.0) * speed, jnp.minimum(speed, min_impact_speed))
    return c.two_R * c.cos_alpha * change
