"""The model: equations of motion, uplift demand and impact map, with the paper's equation numbers.

σ ∈ {−1, 0, +1} is the mode: 0 is full contact, ±1 rocking with the sign of θ. One vector field serves all of
them: with σ = 0 and θ = θ̇ = 0 the angle ψ = σα − θ, u_b and u̇_b vanish, and Eq. (22) becomes Eq. (4).

States are positions x and velocities v, both tuples over the degrees of freedom: (θ,) for rigid podiums, (θ,
u) with an elastic superstructure, where u is a number for one mode and a row (u_1, …, u_n) for several. The
number of modes is known before tracing. The equations of modes are the same for both, and `summed` sums over
modes.

Restrainers add forces that depend on an elongation and its rate; their equations are numbered (C1) … in
docs/control.md. A podium without restrainers skips them.
"""

from __future__ import annotations

from typing import NamedTuple, overload

import jax
import jax.numpy as jnp

from rockjax._excitations.base import Shaking
from rockjax._programs.barrier import barrier
from rockjax._sincos import sincos
from rockjax._types import Value, Values, Vector

from .coefficients import Coefficients, ModalConstants, Restraint, present, summed, weighted

# Longest steps near a moment without motion: fractions of the time until it, and of the time since it.
SLOWING, GATHERING = 0.75, 3.0


def steady_for(c: Coefficients, restraint: Restraint, theta_dot: Value, theta_ddot: Value) -> Value:
    """Return the longest step [s] over which the rate of rotation keeps its order of magnitude, for forces
    with an infinite slope at θ̇ = 0.

    - `c`, `restraint`: constants of the podium and of its restrainers
    - `theta_dot`, `theta_ddot`: θ̇ [rad/s] and θ̈ [rad/s²] at the start of the step

    The step is a fraction of the time until the columns stop, or since they started from rest. Steps then
    approach a moment without motion geometrically, and keep the order of the method although the slope of
    forces is infinite there. Derivatives stay accurate too, whose error the step-size control does not see.
    """
    speed, change = jnp.abs(theta_dot), jnp.abs(theta_ddot)
    rounded = restraint.slip / (2 * c.sin_alpha)  # over p
    share = jnp.where(theta_dot * theta_ddot < 0, SLOWING, GATHERING)
    still = 0.5 * jnp.sqrt(rounded / c.alpha) / c.p  # from an uplift on, θ̇ ~ t²
    span = share * (speed + rounded * c.p) / jnp.where(change > 0, change, 1.0)
    span = jnp.where(change > 0, span, jnp.inf)
    return jnp.where(speed > 0, span, jnp.minimum(span, still))


class Elongation(NamedTuple):
    """Elongation ℓ of (C1) and its derivative with respect to θ, over R; both are zero in full contact."""

    stretch: Value
    lever: Value


def elongation(c: Coefficients, sigma: Value, theta: Value) -> Elongation:
    """Return the elongation of a device over both joints of a column."""
    return _elongation(c, sigma, *sincos(0.5 * theta))


def _elongation(c: Coefficients, sigma: Value, s: Value, cos: Value) -> Elongation:
    """Return the elongation from sin θ/2 and cos θ/2."""
    return Elongation(4 * c.sin_alpha * sigma * s, 2 * c.sin_alpha * sigma * cos)


def _angles(c: Coefficients, sigma: Value, theta: Value) -> tuple[Value, Value, Elongation]:
    """Return sin ψ, cos ψ and the elongation from one sine and cosine, of θ/2. cos ψ is not valid in full
    contact."""
    s, cos = barrier(sincos(0.5 * theta))
    sin_theta, cos_theta = 2 * s * cos, 1 - 2 * s * s
    sin_side = sigma * c.sin_alpha
    sin_psi = sin_side * cos_theta - c.cos_alpha * sin_theta
    return sin_psi, c.cos_alpha * cos_theta + sin_side * sin_theta, _elongation(c, sigma, s, cos)


def _restraint(
    c: Coefficients, restraint: Restraint, open_by: Elongation, theta_dot: Value
) -> tuple[Value, Value | float]:
    """Return the moment of restrainers, which the right side of Eq. (24) loses, and their addition to its
    inertia, (C8)."""
    stretch, lever = open_by
    rate = lever * theta_dot / c.p
    against = (
        c.p**2 * lever * sum(each.force(stretch, rate, restraint.slip) for each in restraint.restrainers)
    )
    if restraint.apparent_mass is None:
        return against, 0.0
    push = 0.75 * restraint.apparent_mass * lever
    return against - 0.25 * push * stretch * theta_dot**2, push * lever


def restraint_at_most(c: Coefficients, restraint: Restraint, theta: Value, theta_dot: Value) -> Value:
    """Bound the moment of restrainers in Eq. (24), (C20).

    - `c`, `restraint`: constants of the podium and of its restrainers
    - `theta`, `theta_dot`: largest |θ| [rad], inside the well, and largest |θ̇| [rad/s]
    """
    s, _ = sincos(0.5 * theta)
    lever = 2 * c.sin_alpha
    forces = sum(
        each.force(2 * lever * s, lever * theta_dot / c.p, restraint.slip) for each in restraint.restrainers
    )
    most = c.p**2 * lever * forces
    if restraint.apparent_mass is not None:
        most = most + 0.75 * restraint.apparent_mass * (c.sin_alpha * theta_dot) ** 2
    return most


def horizontal(ground: Value | Shaking) -> Value:
    """Return ü_g of a ground motion."""
    return ground.horizontal if isinstance(ground, Shaking) else ground


def _weight(c: Coefficients, ground: Value | Shaking) -> Value:
    """Return the coefficient of gravity in Eq. (24), in which vertical motion replaces g by g + v̈_g."""
    return c.gravity * (1 + ground.vertical / c.g) if isinstance(ground, Shaking) else c.gravity


def _relief(c: Coefficients, ground: Shaking) -> Value:
    """Return q_up(t) over its static value, (C10): positive as long as g + v̈_g is."""
    return 1 + present(c.tilt) * ground.vertical / c.uplift


def beam(c: Coefficients, sigma: Value, theta: Value, theta_dot: Value) -> tuple[Value, Value]:
    """Return the horizontal displacement [m] and velocity [m/s] of the beam (u_b, u̇_b), Eqs. (13), (14).

    - `c`: constants of the podium
    - `sigma`: mode σ ∈ {−1, 0, 1}
    - `theta`, `theta_dot`: θ [rad] and θ̇ [rad/s]
    """
    s, cos = sincos(sigma * c.alpha - theta)
    return c.two_R * (sigma * c.sin_alpha - s), c.two_R * theta_dot * cos


def beam_acceleration(
    c: Coefficients, sigma: Value, theta: Value, theta_dot: Value, theta_ddot: Value
) -> Value:
    """Return the horizontal acceleration of the beam relative to the ground ü_b [m/s²], Eq. (14).

    - `c`: constants of the podium
    - `sigma`: mode σ ∈ {−1, 0, 1}
    - `theta`, `theta_dot`, `theta_ddot`: θ [rad], θ̇ [rad/s] and θ̈ [rad/s²]
    """
    s, cos = sincos(sigma * c.alpha - theta)
    return c.two_R * (theta_ddot * cos + theta_dot**2 * s)


def beam_rise(c: Coefficients, sigma: Value, theta: Value, theta_dot: Value, theta_ddot: Value) -> Value:
    """Return the vertical acceleration of the beam relative to the ground v̈_b [m/s²], Eq. (15), upwards.

    - `c`: constants of the podium
    - `sigma`: mode σ ∈ {−1, 0, 1}
    - `theta`, `theta_dot`, `theta_ddot`: θ [rad], θ̇ [rad/s] and θ̈ [rad/s²]
    """
    s, cos = sincos(sigma * c.alpha - theta)
    return c.two_R * (theta_ddot * s - theta_dot**2 * cos)


def beam_absolute(
    c: Coefficients, sigma: Value, ground: Value | Shaking, x: Vector, v: Vector, a: Vector
) -> Value:
    """Return the absolute horizontal acceleration of the beam a_b = ü_g + ü_b [m/s²].

    - `c`: constants of the podium
    - `sigma`: mode σ ∈ {−1, 0, 1}
    - `ground`: ü_g, or ü_g and v̈_g [m/s²]
    - `x`, `v`, `a`: positions, velocities and accelerations
    """
    return beam_acceleration(c, sigma, x[0], v[0], a[0]) + horizontal(ground)


def acceleration(c: Coefficients, sigma: Value, ground: Value | Shaking, x: Vector, v: Vector) -> Vector:
    """Return the accelerations of the equations of motion: θ̈ from Eq. (24), ü_t from Eq. (22).

    - `c`: constants of the podium
    - `sigma`: mode σ ∈ {−1, 0, 1}
    - `ground`: ground acceleration ü_g, or ü_g and v̈_g, (C8) [m/s²]
    - `x`, `v`: positions (θ [rad], u_t [m]) and velocities

    In full contact (σ = 0) θ̈ = 0 and Eq. (22) is Eq. (4).
    """
    against, added, gravity, ground = 0.0, 0.0, _weight(c, ground), horizontal(ground)
    if c.restraint is not None:
        s, cos, open_by = _angles(c, sigma, x[0])
        against, added = _restraint(c, c.restraint, open_by, v[0])
        against = barrier(against)
    else:
        s, cos = sincos(sigma * c.alpha - x[0])
    modes = c.vibration
    if modes is None:
        rocks = -jnp.abs(sigma)
        return (rocks * plus(gravity * s + c.ground * ground * cos, against) / plus(c.inertia, added),)
    s, cos = barrier((s, cos))
    sway, sway_rate = c.two_R * (sigma * c.sin_alpha - s), c.two_R * v[0] * cos
    springs = modes.omega2 * (x[1] - sway) + modes.damping * (v[1] - sway_rate)  # V_i/m_i, Eq. (7)
    springs = barrier(springs)
    pull = weighted(modes.coupling, springs)
    moment = s * (c.centrifugal * v[0] ** 2 * cos - gravity) + cos * (pull - c.ground * ground)
    theta_ddot = jnp.abs(sigma) * plus(moment, -against) / plus(c.inertia + c.centrifugal * s**2, added)
    return theta_ddot, -ground - springs


@overload
def plus(value: Value, addend: Value | float) -> Value: ...
@overload
def plus(value: float, addend: float) -> float: ...
def plus(value: Value | float, addend: Value | float) -> Value | float:
    """Return the sum, or the value alone if nothing is to be added, which is known before tracing."""
    return value if isinstance(addend, float) else value + addend


def uplift_demand(c: Coefficients, ground: Value | Shaking, x: Vector, v: Vector) -> Value:
    """Return the demand q of Eq. (9) in full contact [m/s²].

    - `c`: constants of the podium
    - `ground`: ü_g, or ü_g and v̈_g [m/s²]
    - `x`, `v`: positions and velocities

    The columns uplift where |q| exceeds `c.uplift`, to the side −sign q. Under vertical motion q is divided
    by q_up(t) over its static value, (C10), so that the threshold stays the same.
    """
    q = horizontal_demand(c, ground, x, v)
    return q / _relief(c, ground) if isinstance(ground, Shaking) else q


def horizontal_demand(c: Coefficients, ground: Value | Shaking, x: Vector, v: Vector) -> Value:
    """Return q of Eq. (9), without the effect of vertical motion [m/s²].

    - `c`: constants of the podium
    - `ground`: ü_g, or ü_g and v̈_g [m/s²]
    - `x`, `v`: positions and velocities
    """
    ground, modes = horizontal(ground), c.vibration
    if modes is None:
        return ground
    return ground - weighted(modes.demand, modes.omega2 * x[1] + modes.damping * v[1])


def demand_jet(c: Coefficients, grounds, states) -> tuple[Value, Value, Value]:
    """Return the demand and its first two derivatives in time, from those of the ground motion and of the
    state (x, v). In full contact everything is linear except the weight, which vertical motion changes."""
    if not isinstance(grounds[0], Shaking):
        return tuple(uplift_demand(c, ground, *y) for ground, y in zip(grounds, states, strict=True))  # pyright: ignore[reportReturnType]
    q, q1, q2 = (horizontal_demand(c, ground, *y) for ground, y in zip(grounds, states, strict=True))
    r = _relief(c, grounds[0])
    r1, r2 = (present(c.tilt) * ground.vertical / c.uplift for ground in grounds[1:])
    share = q / r
    rate = (q1 - share * r1) / r
    return share, rate, (q2 - 2 * rate * r1 - share * r2) / r


def impact(c: Coefficients, theta_dot: Value) -> Value:
    """Return θ̇ after an impact, Eq. (27): the sense of rotation stays; u_t and u̇_t are continuous, Eq.
    (26).

    If e ≤ 0 the result is 0: rocking ends.
    """
    return jnp.maximum(c.restitution, 0.0) * theta_dot


def shear(c: Coefficients, sigma: Value, ground: Value | Shaking, x: Vector, v: Vector, a: Vector) -> Value:
    """Return the shear of the superstructure over its weight V_s/(m_t g) [–], Eq. (7).

    - `c`: constants of the podium
    - `sigma`: mode σ ∈ {−1, 0, 1}
    - `ground`: ü_g, or ü_g and v̈_g [m/s²]
    - `x`, `v`, `a`: positions, velocities and accelerations

    It is the absolute horizontal acceleration of the superstructure over −g; with several modes, the mean
    over the modal masses and the residual mass.
    """
    ground = horizontal(ground)
    if c.vibration is None:
        return -beam_absolute(c, sigma, ground, x, v, a) / c.g
    modal = c.modal
    if modal is None:
        return -(a[1] + ground) / c.g
    return -_carried(c, modal, modal.shares, sigma, ground, x, v, a) / c.g


def _carried(
    c: Coefficients,
    modal: ModalConstants,
    weights: Values,
    sigma: Value,
    ground: Value,
    x: Vector,
    v: Vector,
    a: Vector,
) -> Value:
    """Return Σ w_i(ü_i + ü_g) over the retained modes, plus 1 − Σ w_i times the beam's absolute
    acceleration."""
    found = weighted(weights, a[1] + ground)
    if modal.residual is None:
        return found
    return found + (1 - summed(weights)) * beam_absolute(c, sigma, ground, x, v, a)


def drift_weights(floors: Values) -> Values:
    """Return Γ_i(φ_ji − φ_{j−1,i}) of each story j and mode i; the drift of a story is their sum weighted by
    the modal deformations."""
    return jnp.concatenate([floors[:1], floors[1:] - floors[:-1]])


def floor_accelerations(
    c: Coefficients, sigma: Value, ground: Value | Shaking, x: Vector, v: Vector, a: Vector
) -> Values:
    """Return the absolute horizontal accelerations of the floors [m/s²].

    - `c`: constants of the podium
    - `sigma`: mode σ ∈ {−1, 0, 1}
    - `ground`: ü_g, or ü_g and v̈_g [m/s²]
    - `x`, `v`, `a`: positions, velocities and accelerations

    They are −Σ Γ_iφ_ji F_i + (1 − ΣΓ_iφ_ji) a_b over the retained modes, with F_i = −(ü_i + ü_g).
    """
    modal, ground = present(c.modal), horizontal(ground)
    of_floor = lambda weights: _carried(c, modal, weights, sigma, ground, x, v, a)
    return jax.vmap(of_floor)(present(modal.floors))
