"""Changes of contact mode and state at events, and the effect of event times on derivatives.

The time of an event (uplift, impact, overturning) or of a breakpoint (a jump or kink of the ground motion)
depends on the parameters. The value of this time, held constant under differentiation, is called the stamp.
Columns in full contact lift when the uplift demand |q| exceeds its threshold, Eq. (9). A ground acceleration
is ü_g (horizontal) or, if the ground also moves vertically, a `Shaking` with ü_g and v̈_g. Equations without
a letter are those of docs/model.md; (L…) are in docs/floors.md.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from rockjax._excitations.base import Shaking
from rockjax._excitations.ground import GroundMotion
from rockjax._types import Flag, Index, Value, Vector

from .coefficients import Coefficients
from .model import acceleration, horizontal, impact, uplift_demand
from .state import Scene


class Transition(NamedTuple):
    """State and contact mode after an event, or after a step without one."""

    x: Vector  # positions
    v: Vector  # velocities
    sigma: Value  # contact mode


def transition(
    scene: Scene,
    sigma: Value,
    x: Vector,
    v: Vector,
    ground: Value | Shaking,
    hit: Flag,
    lifted: Flag,
    demand: Value,
    false_uplift: Flag | bool = False,
    to_rest: Flag | bool = False,
) -> Transition:
    """Apply the transition between contact modes at the end of a step.

    - `scene`: the prepared scene
    - `sigma`: contact mode σ before the transition
    - `x`, `v`: positions and velocities before the transition
    - `ground`: ground acceleration after the transition [m/s²]
    - `hit`: True for an impact
    - `lifted`: True for an uplift
    - `demand`: demand q before the uplift [m/s²]; the columns lift to the side −sign q
    - `false_uplift`: True if the columns return to θ = 0 in a very short first step after an uplift. Then the
      uplift does not count, and the columns are in full contact
    - `to_rest`: True if an impact brings the columns to rest at any speed

    Without an event the contact mode stays the same, except that columns in full contact lift if a jump of
    the ground acceleration has brought the demand above the threshold.
    """
    c, rocking = scene.c, sigma != 0
    in_contact = false_uplift | ~rocking
    x = (jnp.where(hit | in_contact, 0.0, x[0]), *x[1:])
    v = (jnp.where(in_contact, 0.0, v[0]), *v[1:])
    q = uplift_demand(c, ground, x, v)
    theta_dot_after, mode_after = after_impact(scene, sigma, v[0], q, to_rest)
    v = (jnp.where(hit, theta_dot_after, v[0]), *v[1:])
    stays = jnp.where(rocking, sigma, contact_mode(c, q))
    mode = jnp.where(hit, mode_after, jnp.where(lifted, -jnp.sign(demand), stays))
    return Transition(x, v, jnp.where(false_uplift, 0.0, mode))


def contact_mode(c: Coefficients, q: Value) -> Value:
    """Return the contact mode of columns at rest under the demand q [m/s²]: they lift to the side −sign q if
    |q| exceeds the threshold of Eq. (9). Otherwise, also if |q| equals the threshold, they stay in full
    contact."""
    return jnp.where(jnp.abs(q) > c.uplift, -jnp.sign(q), 0.0)


def after_impact(
    scene: Scene, sigma: Value, theta_dot: Value, q: Value, to_rest: Flag | bool = False
) -> tuple[Value, Value]:
    """Return the rate θ̇⁺ [rad/s] and the contact mode σ⁺ after an impact, Eq. (27).

    - `scene`: the prepared scene
    - `sigma`, `theta_dot`: contact mode and θ̇ [rad/s] before the impact
    - `q`: demand in full contact after the impact [m/s²]
    - `to_rest`: True if the columns come to rest at any speed

    The columns rock on to the other side unless |θ̇⁺| is at most the rest velocity, or `to_rest` is True.
    Then full contact follows, or a new uplift if |q| exceeds the threshold.
    """
    theta_dot_after = impact(scene.c, theta_dot)
    rocks_on = (jnp.abs(theta_dot_after) > scene.rest_speed) & ~jnp.asarray(to_rest)
    return jnp.where(rocks_on, theta_dot_after, 0.0), jnp.where(rocks_on, -sigma, contact_mode(scene.c, q))


class Jolt(NamedTuple):
    """A jump of the ground's velocity, and the state after it."""

    jump: Value | Shaking  # velocity jump of the ground [m/s]; zero without a jump
    # Contact mode in which the velocities change: the mode before the jump or, for columns at rest, the side
    # to which the jump can lift them.
    side: Value
    change: Vector  # changes of the velocities due to the jump, before the impact that may follow
    lifts: Flag  # whether columns at rest lift
    # Whether the jump drives moving columns with θ = 0 (just after an impact or uplift) into the ground. This
    # counts as a further impact.
    strikes: Flag
    v: Vector  # velocities after the jump
    sigma: Value  # contact mode after the jump


def jolt(
    scene: Scene, sigma: Value, x: Vector, v: Vector, ground: Value | Shaking, jump: Value | Shaking
) -> Jolt:
    """Return the effect of a jump of the ground's velocity. docs/floors.md has the equations for a single
    block, (L13), (L14).

    - `scene`: the prepared scene
    - `sigma`, `x`, `v`: contact mode, positions and velocities before the jump
    - `ground`: ground acceleration after the jump [m/s²]
    - `jump`: velocity jump of the ground [m/s], a scalar or a `Shaking`, like `ground`

    The equation of motion is linear in the accelerations of the structure and of the ground. Therefore the
    same coefficients relate the velocity jumps of the structure to those of the ground. Columns at rest lift
    to the side opposite to the horizontal velocity jump if their speed after the jump exceeds the rest
    velocity.
    """
    c, at_rest = scene.c, (x[0] == 0) & (v[0] == 0)
    side = jnp.where(at_rest, -jnp.sign(horizontal(jump)), sigma)
    response = lambda ground: acceleration(c, side, ground, x, v)
    change = jax.tree.map(jnp.subtract, response(jump), response(jax.tree.map(jnp.zeros_like, jump)))
    v = tuple(map(jnp.add, v, change))
    lifts = at_rest & (side * v[0] > scene.rest_speed)
    strikes = ~at_rest & (x[0] == 0) & (side * v[0] < 0)
    theta_dot_after, mode_after = after_impact(scene, side, v[0], uplift_demand(c, ground, x, v))
    theta_dot = jnp.where(strikes, theta_dot_after, jnp.where(at_rest & ~lifts, 0.0, v[0]))
    mode = jnp.where(strikes, mode_after, jnp.where(at_rest & ~lifts, sigma, side))
    return Jolt(jump, side, change, lifts, strikes, (theta_dot, *v[1:]), mode)


def past_breakpoint(
    scene: Scene, stamp: Value, delta: Value, x: Vector, v: Vector, sigma: Value, pieces: tuple[Index, Index]
) -> tuple[Vector, Vector]:
    """Return the state after a breakpoint, moved from the time of the breakpoint to the stamp.

    - `scene`: the prepared scene
    - `stamp`: stamp of the breakpoint [s]
    - `delta`: time of the breakpoint minus its stamp [s], which is zero, but has the derivatives of this time
    - `x`, `v`, `sigma`: positions, velocities and contact mode
    - `pieces`: pieces of the excitation before and after the breakpoint

    A breakpoint of the horizontal and a breakpoint of the vertical motion may coincide although the
    derivatives of their times with respect to the parameters differ. The time between them is then zero, but
    its derivative is not, so the state is first moved over this time.
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
    """Return the state (x, v), moved from the time of an event to the stamp t of this event.

    - `scene`: the prepared scene
    - `t`: stamp of the event [s]
    - `delta`: time of the event minus its stamp [s], which is zero, but has the derivatives of this time
    - `x`, `v`, `sigma`: positions, velocities and contact mode after the event
    - `piece`: piece of the excitation after the event

    The time of the event depends on the parameters; the end of the step and the stamp do not. Before this
    call, the caller moves the state from the end of the step to the event, with the equation of motion that
    holds before the event, and applies the transition. This function moves the state to the stamp with the
    equation of motion that holds after the event, which changes derivatives, but not values. The derivative
    of the whole sequence is the saltation matrix.
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
