"""The model: equations of motion, uplift demand and impact map, each once, with the paper's numbers.

σ ∈ {−1, 0, +1} is the mode: 0 is full contact, ±1 rocking with the sign of θ. One field serves all of them:
with σ = 0 and θ = θ̇ = 0 the angle ψ = σα − θ vanishes, so do u_b and u̇_b, and Eq. (22) becomes Eq. (4).

States are positions x and velocities v, both tuples over the degrees of freedom: (θ,) where nothing is
elastic, (θ, u) with an elastic superstructure, where u is a number of one mode and a row (u_1, …, u_n) of
several. Which it is and how many is known before tracing; equations of modes are the same for both, and sums
over modes are `summed`.

Restrainers add what each of them says of an elongation and its rate; their equations are numbered (C1) … in
docs/control.md. A podium without any never looks at them.
"""

from __future__ import annotations

from typing import NamedTuple, overload

import jax
import jax.numpy as jnp

from rockjax._engine.once import once
from rockjax._excitations.base import Shaking
from rockjax._sincos import sincos
from rockjax._types import Value, Values, Vector

from .coefficients import Coefficients, Restraint, Several, present, summed, weighted

# Of the time to a stop, and of that since one: steps close to it are no longer.
SLOWING, GATHERING = 0.75, 3.0


def steady_for(c: Coefficients, held: Restraint, theta_dot: Value, theta_ddot: Value) -> Value:
    """How long the rate of rotation stays of the same size, where forces are steep at θ̇ = 0 [s].

    A share of the time that it takes to stop, or that it has taken to come to its rate. Steps that are no
    longer close in on a moment without motion in quarters, so that their error is that of the method although
    the forces have no slope there; not in states alone, whose error tells, but in their derivatives as well,
    whose error does not.
    """
    speed, change = jnp.abs(theta_dot), jnp.abs(theta_ddot)
    rounded = held.slip / (2 * c.sin_alpha)  # over p
    share = jnp.where(theta_dot * theta_ddot < 0, SLOWING, GATHERING)
    still = 0.5 * jnp.sqrt(rounded / c.alpha) / c.p  # from an uplift on, θ̇ ~ t²
    span = share * (speed + rounded * c.p) / jnp.where(change > 0, change, 1.0)
    span = jnp.where(change > 0, span, jnp.inf)
    return jnp.where(speed > 0, span, jnp.minimum(span, still))


class Elongation(NamedTuple):
    """ℓ of (C1) and its derivative by θ, over R; both are zero in full contact."""

    stretch: Value
    lever: Value


def elongation(c: Coefficients, sigma: Value, theta: Value) -> Elongation:
    """How far a column's joints are open."""
    return _elongation(c, sigma, *sincos(0.5 * theta))


def _elongation(c: Coefficients, sigma: Value, s: Value, cos: Value) -> Elongation:
    """The same from sin θ/2 and cos θ/2."""
    return Elongation(4 * c.sin_alpha * sigma * s, 2 * c.sin_alpha * sigma * cos)


def _angles(c: Coefficients, sigma: Value, theta: Value) -> tuple[Value, Value, Elongation]:
    """sin ψ, cos ψ and the elongation by one sine and cosine, of θ/2; cos ψ is not to be asked of full
    contact."""
    s, cos = once(sincos(0.5 * theta))
    sin_theta, cos_theta = 2 * s * cos, 1 - 2 * s * s
    sin_side = sigma * c.sin_alpha
    sin_psi = sin_side * cos_theta - c.cos_alpha * sin_theta
    return sin_psi, c.cos_alpha * cos_theta + sin_side * sin_theta, _elongation(c, sigma, s, cos)


def _restraint(
    c: Coefficients, held: Restraint, open_by: Elongation, theta_dot: Value
) -> tuple[Value, Value | float]:
    """What restrainers take from the right side of Eq. (24), and what they add to its inertia, (C8)."""
    stretch, lever = open_by
    rate = lever * theta_dot / c.p
    against = c.p**2 * lever * sum(each.force(stretch, rate, held.slip) for each in held.restrainers)
    if held.apparent_mass is None:
        return against, 0.0
    push = 0.75 * held.apparent_mass * lever
    return against - 0.25 * push * stretch * theta_dot**2, push * lever


def restraint_at_most(c: Coefficients, held: Restraint, theta: Value, theta_dot: Value) -> Value:
    """A bound of what restrainers take from the right side of Eq. (24), up to |θ| and |θ̇| inside the well,
    (C20)."""
    s, _ = sincos(0.5 * theta)
    lever = 2 * c.sin_alpha
    forces = sum(each.force(2 * lever * s, lever * theta_dot / c.p, held.slip) for each in held.restrainers)
    most = c.p**2 * lever * forces
    if held.apparent_mass is not None:
        most = most + 0.75 * held.apparent_mass * (c.sin_alpha * theta_dot) ** 2
    return most


def horizontal(ground: Value | Shaking) -> Value:
    """ü_g of a ground motion."""
    return ground.horizontal if isinstance(ground, Shaking) else ground


def _weight(c: Coefficients, ground: Value | Shaking) -> Value:
    """What gravity is multiplied with in Eq. (24): g becomes g + v̈_g in all weights."""
    return c.gravity * (1 + ground.vertical / c.g) if isinstance(ground, Shaking) else c.gravity


def _relief(c: Coefficients, ground: Shaking) -> Value:
    """q_up(t) over its static value, (C10): positive as long as g + v̈_g is."""
    return 1 + present(c.tilt) * ground.vertical / c.uplift


def beam(c: Coefficients, sigma: Value, theta: Value, theta_dot: Value) -> tuple[Value, Value]:
    """Horizontal displacement and velocity of the beam (u_b, u̇_b), Eqs. (13), (14)."""
    s, cos = sincos(sigma * c.alpha - theta)
    return c.two_R * (sigma * c.sin_alpha - s), c.two_R * theta_dot * cos


def beam_acceleration(
    c: Coefficients, sigma: Value, theta: Value, theta_dot: Value, theta_ddot: Value
) -> Value:
    """Horizontal acceleration of the beam ü_b, Eq. (14)."""
    s, cos = sincos(sigma * c.alpha - theta)
    return c.two_R * (theta_ddot * cos + theta_dot**2 * s)


def beam_absolute(
    c: Coefficients, sigma: Value, ground: Value | Shaking, x: Vector, v: Vector, a: Vector
) -> Value:
    """Absolute horizontal acceleration of the beam, a_b = ü_g + ü_b."""
    return beam_acceleration(c, sigma, x[0], v[0], a[0]) + horizontal(ground)


def acceleration(c: Coefficients, sigma: Value, ground: Value | Shaking, x: Vector, v: Vector) -> Vector:
    """The equations of motion: θ̈ from Eq. (24), ü_t from Eq. (22), under the ground acceleration `ground` =
    ü_g, or ü_g and v̈_g, (C8).

    In full contact (σ = 0) θ̈ = 0 and Eq. (22) is Eq. (4).
    """
    against, added, gravity, ground = 0.0, 0.0, _weight(c, ground), horizontal(ground)
    if c.restraint is not None:
        s, cos, open_by = _angles(c, sigma, x[0])
        against, added = _restraint(c, c.restraint, open_by, v[0])
        against = once(against)
    else:
        s, cos = sincos(sigma * c.alpha - x[0])
    modes = c.vibration
    if modes is None:
        rocks = -jnp.abs(sigma)
        return (rocks * plus(gravity * s + c.ground * ground * cos, against) / plus(c.inertia, added),)
    s, cos = once((s, cos))
    sway, sway_rate = c.two_R * (sigma * c.sin_alpha - s), c.two_R * v[0] * cos
    springs = modes.omega2 * (x[1] - sway) + modes.damping * (v[1] - sway_rate)  # V_i/m_i, Eq. (7)
    springs = once(springs)
    pull = weighted(modes.coupling, springs)
    moment = s * (c.centrifugal * v[0] ** 2 * cos - gravity) + cos * (pull - c.ground * ground)
    theta_ddot = jnp.abs(sigma) * plus(moment, -against) / plus(c.inertia + c.centrifugal * s**2, added)
    return theta_ddot, -ground - springs


@overload
def plus(value: Value, more: Value | float) -> Value: ...
@overload
def plus(value: float, more: float) -> float: ...
def plus(value: Value | float, more: Value | float) -> Value | float:
    """The sum, where there is something to add: known before tracing."""
    return value if isinstance(more, float) else value + more


def uplift_demand(c: Coefficients, ground: Value | Shaking, x: Vector, v: Vector) -> Value:
    """q of Eq. (9) in full contact; the columns uplift where |q| exceeds `c.uplift`, to the side −sign q.

    Where the ground moves vertically it is what q would be without, at the same share of q_up(t), (C10).
    """
    q = horizontal_demand(c, ground, x, v)
    return q / _relief(c, ground) if isinstance(ground, Shaking) else q


def horizontal_demand(c: Coefficients, ground: Value | Shaking, x: Vector, v: Vector) -> Value:
    """q of Eq. (9)."""
    ground, modes = horizontal(ground), c.vibration
    if modes is None:
        return ground
    return ground - weighted(modes.demand, modes.omega2 * x[1] + modes.damping * v[1])


def demand_jet(c: Coefficients, grounds, states) -> tuple[Value, Value, Value]:
    """The demand with its first two derivatives in time, from those of the ground motion and of the state
    (x, v): everything is linear in full contact but the weight that vertical motion takes off."""
    if not isinstance(grounds[0], Shaking):
        return tuple(uplift_demand(c, ground, *y) for ground, y in zip(grounds, states, strict=True))  # pyright: ignore[reportReturnType]
    q, q1, q2 = (horizontal_demand(c, ground, *y) for ground, y in zip(grounds, states, strict=True))
    r = _relief(c, grounds[0])
    r1, r2 = (present(c.tilt) * ground.vertical / c.uplift for ground in grounds[1:])
    share = q / r
    rate = (q1 - share * r1) / r
    return share, rate, (q2 - 2 * rate * r1 - share * r2) / r


def impact(c: Coefficients, theta_dot: Value) -> Value:
    """θ̇ after an impact: Eq. (27) for θ̇, the same sense of rotation; u_t and u̇_t are continuous, Eq. (26).

    Where e ≤ 0 the result is 0: rocking ends.
    """
    return jnp.maximum(c.restitution, 0.0) * theta_dot


def shear(c: Coefficients, sigma: Value, ground: Value | Shaking, x: Vector, v: Vector, a: Vector) -> Value:
    """Shear of the superstructure over its weight, V_s/(m_t g), Eq. (7): its absolute horizontal acceleration
    over −g, of several modes the mean over their masses and what moves with the beam."""
    ground = horizontal(ground)
    if c.vibration is None:
        return -beam_absolute(c, sigma, ground, x, v, a) / c.g
    several = c.several
    if several is None:
        return -(a[1] + ground) / c.g
    return -_carried(c, several, several.shares, sigma, ground, x, v, a) / c.g


def _carried(
    c: Coefficients,
    several: Several,
    weights: Values,
    sigma: Value,
    ground: Value,
    x: Vector,
    v: Vector,
    a: Vector,
) -> Value:
    """Σ w_i(ü_i + ü_g) over the modes that are kept, and what is left of 1 of the beam's acceleration."""
    found = weighted(weights, a[1] + ground)
    if several.residual is None:
        return found
    return found + (1 - summed(weights)) * beam_absolute(c, sigma, ground, x, v, a)


def drift_weights(floors: Values) -> Values:
    """Γ_i(φ_ji − φ_{j−1,i}) of each story j, for the modes i: the drift of a story is their sum with the
    modal deformations."""
    return jnp.concatenate([floors[:1], floors[1:] - floors[:-1]])


def floor_accelerations(
    c: Coefficients, sigma: Value, ground: Value | Shaking, x: Vector, v: Vector, a: Vector
) -> Values:
    """Absolute horizontal accelerations of the floors, −Σ Γ_iφ_ji F_i + (1 − ΣΓ_iφ_ji) a_b over the modes
    that are kept, F_i = −(ü_i + ü_g)."""
    several, ground = present(c.several), horizontal(ground)
    of_floor = lambda weights: _carried(c, several, weights, sigma, ground, x, v, a)
    return jax.vmap(of_floor)(present(several.floors))
