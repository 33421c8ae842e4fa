"""Events: their effect on mode and state, and the derivative of their time."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from rockjax._excitations.base import Shaking
from rockjax._excitations.ground import GroundMotion
from rockjax._types import Flag, Index, Value, Vector

from .coefficients import Coefficients
from .model import acceleration, impact, uplift_demand
from .state import Scene


class Transition(NamedTuple):
    """State and mode after an event, or after a step without one."""

    x: Vector
    v: Vector
    sigma: Value


def transition(
    scene: Scene,
    sigma: Value,
    x: Vector,
    v: Vector,
    ground: Value | Shaking,
    hit: Flag,
    lifted: Flag,
    demand: Value,
    halted: Flag | bool = False,
    to_rest: Flag | bool = False,
) -> Transition:
    """Apply the transition of the automaton at the end of a step.

    - `scene`: the prepared scene
    - `sigma`: mode σ before it
    - `x`, `v`: positions and velocities before it
    - `ground`: ground acceleration that follows, ü_g, or ü_g and v̈_g [m/s²]
    - `hit`: an impact
    - `lifted`: an uplift under the demand `demand` before the event [m/s²]
    - `halted`: a false uplift, back to full contact
    - `to_rest`: an impact that leads to rest

    Without an event the mode stays, but columns at rest lift if the ground acceleration has jumped above the
    threshold.
    """
    c, rocking = scene.c, sigma != 0
    rests = halted | ~rocking
    x = (jnp.where(hit | rests, 0.0, x[0]), *x[1:])
    v = (jnp.where(rests, 0.0, v[0]), *v[1:])
    q = uplift_demand(c, ground, x, v)
    theta_dot_after, mode_after = after_impact(scene, sigma, v[0], q, to_rest)
    v = (jnp.where(hit, theta_dot_after, v[0]), *v[1:])
    stays = jnp.where(rocking, sigma, contact_mode(c, q))
    mode = jnp.where(hit, mode_after, jnp.where(lifted, -jnp.sign(demand), stays))
    return Transition(x, v, jnp.where(halted, 0.0, mode))


def contact_mode(c: Coefficients, q: Value) -> Value:
    """Return the mode of columns at rest under the demand q. They lift where |q| exceeds Eq. (9); equality is
    not uplift."""
    return jnp.where(jnp.abs(q) > c.uplift, -jnp.sign(q), 0.0)


def after_impact(
    scene: Scene, sigma: Value, theta_dot: Value, q: Value, to_rest: Flag | bool = False
) -> tuple[Value, Value]:
    """Return (θ̇⁺, σ⁺) after an impact, Eq. (27).

    - `scene`: the prepared scene
    - `sigma`, `theta_dot`: mode and θ̇ before it [rad/s]
    - `q`: demand in full contact after it [m/s²]
    - `to_rest`: whether the columns come to rest at any speed

    Columns rock on the other side; below the rest velocity, or with `to_rest`, full contact or a new uplift
    follows.
    """
    theta_dot_after = impact(scene.c, theta_dot)
    rocks_on = (jnp.abs(theta_dot_after) > scene.rest_speed) & ~jnp.asarray(to_rest)
    return jnp.where(rocks_on, theta_dot_after, 0.0), jnp.where(rocks_on, -sigma, contact_mode(scene.c, q))


def past_breakpoint(
    scene: Scene, stamp: Value, delta: Value, x: Vector, v: Vector, sigma: Value, pieces: tuple[Index, Index]
) -> tuple[Vector, Vector]:
    """Return the state after a breakpoint between two pieces, moved from its varying time to its fixed stamp.

    - `scene`: the prepared scene
    - `stamp`: fixed time stamp of the breakpoint [s]
    - `delta`: difference of its time, zero in value, with derivatives [s]
    - `x`, `v`, `sigma`: positions, velocities and mode
    - `pieces`: pieces before and after

    If breakpoints of a horizontal and a vertical motion coincide but move differently, the field between them
    applies from one to the other.
    """
    before, after = pieces
    if isinstance(scene.excitation, GroundMotion):
        difference, between = scene.excitation.tie(before)
        difference = jnp.where(after != before, difference, 0.0)
        x, v = restart(scene, stamp, difference, x, v, sigma, between)
        delta = delta - difference
    return restart(scene, stamp, delta, x, v, sigma, after)


@jax.custom_jvp
def restart(
    scene: Scene, t: Value, delta: Value, x: Vector, v: Vector, sigma: Value, piece: Index
) -> tuple[Vector, Vector]:
    """Return the state (x, v) at the time of an event, moved to the fixed time stamp t.

    - `scene`: the prepared scene
    - `t`: fixed time stamp [s]
    - `delta`: time of the event after the stamp, zero in value, with derivatives [s]
    - `x`, `v`, `sigma`: positions, velocities and mode after the event
    - `piece`: piece of the excitation after it

    The event's time moves with the parameters; the stamp does not. The state is taken to the event by the
    field before it, mapped, and brought back by the field after it; the derivative of this sequence is the
    saltation matrix. The way back is zero in value, so only derivatives pay for it.
    """
    del scene, t, delta, sigma, piece
    return x, v


@restart.defjvp
def _restart_jvp(primals, tangents):
    scene, t, _, x, v, sigma, piece = primals
    delta_dot, x_dot, v_dot = tangents[2], tangents[3], tangents[4]
    a = acceleration(scene.c, sigma, scene.excitation.piece(piece)(t), x, v)
    x_dot = tuple(dx - delta_dot * rate for dx, rate in zip(x_dot, v, strict=True))
    v_dot = tuple(dv - delta_dot * rate for dv, rate in zip(v_dot, a, strict=True))
    return (x, v), (x_dot, v_dot)
