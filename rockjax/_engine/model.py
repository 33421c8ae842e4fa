"""The model: equations of motion, uplift demand and impact map, numbered as in docs/model.md.

σ ∈ {−1, 0, +1} is the contact mode: 0 is full contact, ±1 rocking with the sign of θ. One vector field serves
all contact modes: in full contact σ = θ = θ̇ = 0, so the angle ψ = σα − θ and the displacement u_b and
velocity u̇_b of the beam are zero, and Eq. (22) becomes Eq. (4).

A state consists of positions x and velocities v. The positions are (θ, u_t) if the superstructure vibrates,
and (θ,) otherwise. θ is the rotation of the columns [rad], and u_t the horizontal displacement of the
superstructure relative to the ground [m]: a scalar for one vibration mode, an array (u_1, …, u_n) for
several. The equations are the same for any number of modes, which is fixed at compilation; `summed` sums over
the modes.

A ground acceleration is the scalar ü_g (horizontal) or, if the ground also moves vertically, a `Shaking` with
ü_g and v̈_g [m/s²].

The columns lift when the uplift demand |q| exceeds the threshold q_up, Eq. (9).

Restrainers (tendons, dampers, inerters) add forces that depend on their elongation and its derivatives in
time. A podium without restrainers skips these forces. Equations (C…) are in docs/control.md, (L2) is in
docs/floors.md.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from rockjax._excitations.base import Shaking
from rockjax._programs.barrier import barrier
from rockjax._sincos import sincos
from rockjax._types import Value, Values, Vector

from .coefficients import Coefficients, ModalConstants, Restraint, not_none, summed, weighted

# `steady_step` limits a step to these multiples of |θ̇/θ̈|: the first while the columns slow down, the second
# while they speed up.
MAX_SLOWING_STEP, MAX_SPEEDING_STEP = 0.75, 3.0


def steady_step(c: Coefficients, restraint: Restraint, theta_dot: Value, theta_ddot: Value) -> Value:
    """Return the longest step over which θ̇ keeps its order of magnitude [s].

    - `c`, `restraint`: constants of the podium and of its restrainers
    - `theta_dot`, `theta_ddot`: θ̇ [rad/s] and θ̈ [rad/s²] at the start of the step

    Some dampers need this limit, because the slope of their force is infinite at θ̇ = 0. The limit is
    proportional to |θ̇/θ̈|, which is about the time until the columns stop, or the time since they were at
    rest. Steps thus become geometrically shorter towards an instant with θ̇ = 0, and the method keeps its
    order there. Derivatives with respect to parameters also stay accurate, although the step-size control
    does not estimate their error.
    """
    speed, speed_rate = jnp.abs(theta_dot), jnp.abs(theta_ddot)
    slip_speed = restraint.slip / (2 * c.sin_alpha)  # |θ̇|/p below which the force is smoothed
    fraction = jnp.where(theta_dot * theta_ddot < 0, MAX_SLOWING_STEP, MAX_SPEEDING_STEP)
    from_rest = 0.5 * jnp.sqrt(slip_speed / c.alpha) / c.p  # first step after an uplift, where θ̇ ∝ t²
    span = fraction * (speed + slip_speed * c.p) / jnp.where(speed_rate > 0, speed_rate, 1.0)
    span = jnp.where(speed_rate > 0, span, jnp.inf)
    return jnp.where(speed > 0, span, jnp.minimum(span, from_rest))


class Elongation(NamedTuple):
    """Elongation ℓ of a restrainer from the ground to the beam, and dℓ/dθ; both are zero in full contact."""

    stretch: Value  # ℓ/R, (C1)
    lever: Value  # (dℓ/dθ)/R


def elongation(c: Coefficients, sigma: Value, theta: Value) -> Elongation:
    """Return the `Elongation` of a restrainer from the ground to the beam, (C1)."""
    return _elongation(c, sigma, *sincos(0.5 * theta))


def _elongation(c: Coefficients, sigma: Value, s: Value, cos: Value) -> Elongation:
    """Return the elongation from s = sin(θ/2) and cos = cos(θ/2)."""
    return Elongation(4 * c.sin_alpha * sigma * s, 2 * c.sin_alpha * sigma * cos)


def _angles(c: Coefficients, sigma: Value, theta: Value) -> tuple[Value, Value, Elongation]:
    """Return sin ψ, cos ψ and the elongation, all from sin(θ/2) and cos(θ/2). In full contact cos ψ is not
    valid."""
    s, cos = barrier(sincos(0.5 * theta))
    sin_theta, cos_theta = 2 * s * cos, 1 - 2 * s * s
    sin_side = sigma * c.sin_alpha
    sin_psi = sin_side * cos_theta - c.cos_alpha * sin_theta
    return sin_psi, c.cos_alpha * cos_theta + sin_side * sin_theta, _elongation(c, sigma, s, cos)


def _restraint(
    c: Coefficients, restraint: Restraint, extension: Elongation, theta_dot: Value
) -> tuple[Value, Value | float]:
    """Return the moment that the restrainers subtract from the right side of Eq. (24) [1/s²], and the inertia
    that they add to the factor of θ̈ [–], (C8)."""
    stretch, lever = extension
    rate = lever * theta_dot / c.p
    resisting = (
        c.p**2 * lever * sum(each.force(stretch, rate, restraint.slip) for each in restraint.restrainers)
    )
    if restraint.apparent_mass is None:
        return resisting, 0.0
    push = 0.75 * restraint.apparent_mass * lever
    return resisting - 0.25 * push * stretch * theta_dot**2, push * lever


def restraint_bound(c: Coefficients, restraint: Restraint, theta: Value, theta_dot: Value) -> Value:
    """Return an upper bound on the moment of the restrainers in Eq. (24) [1/s²], from their forces at the
    largest elongation and rate.

    - `c`, `restraint`: constants of the podium and of its restrainers
    - `theta`: largest |θ|, at most `restraint.well` [rad]
    - `theta_dot`: largest |θ̇| [rad/s]
    """
    s, _ = sincos(0.5 * theta)
    lever = 2 * c.sin_alpha
    forces = sum(
        each.force(2 * lever * s, lever * theta_dot / c.p, restraint.slip) for each in restraint.restrainers
    )
    moment = c.p**2 * lever * forces
    if restraint.apparent_mass is not None:
        moment = moment + 0.75 * restraint.apparent_mass * (c.sin_alpha * theta_dot) ** 2
    return moment


def horizontal(ground: Value | Shaking) -> Value:
    """Return ü_g of a ground acceleration."""
    return ground.horizontal if isinstance(ground, Shaking) else ground


def _weight(c: Coefficients, ground: Value | Shaking) -> Value:
    """Return the factor of −sin ψ in Eq. (24) [1/s²]; under vertical motion, g + v̈_g replaces g."""
    return c.gravity * (1 + ground.vertical / c.g) if isinstance(ground, Shaking) else c.gravity


def _threshold_ratio(c: Coefficients, ground: Shaking) -> Value:
    """Return the uplift threshold under vertical motion, (C10), divided by `c.uplift`, its value without
    vertical motion. The ratio is positive as long as g + v̈_g is positive."""
    return 1 + not_none(c.uplift_slope) * ground.vertical / c.uplift


def beam(c: Coefficients, sigma: Value, theta: Value, theta_dot: Value) -> tuple[Value, Value]:
    """Return the horizontal displacement u_b [m] and velocity u̇_b [m/s] of the beam, Eqs. (13), (14).

    - `c`: constants of the podium
    - `sigma`: contact mode σ ∈ {−1, 0, 1}
    - `theta`, `theta_dot`: θ [rad] and θ̇ [rad/s]
    """
    s, cos = sincos(sigma * c.alpha - theta)
    return c.two_R * (sigma * c.sin_alpha - s), c.two_R * theta_dot * cos


def beam_vertical_velocity(c: Coefficients, sigma: Value, theta: Value, theta_dot: Value) -> Value:
    """Return the vertical velocity v̇_b of the beam relative to the ground, positive upwards [m/s], Eq. (15).

    - `c`: constants of the podium
    - `sigma`: contact mode σ ∈ {−1, 0, 1}
    - `theta`, `theta_dot`: θ [rad] and θ̇ [rad/s]
    """
    return c.two_R * theta_dot * sincos(sigma * c.alpha - theta)[0]


class BeamMotion(NamedTuple):
    """Motion of the beam relative to the ground, Eqs. (13) to (15).

    - `sway`, `velocity`: horizontal displacement u_b [m] and velocity u̇_b [m/s]
    - `acceleration`, `rise`: horizontal acceleration ü_b, and vertical acceleration v̈_b, positive upwards
      [m/s²]
    - `sin_psi`, `cos_psi`: sin ψ and cos ψ, ψ = σα − θ
    """

    sway: Value
    velocity: Value
    acceleration: Value
    rise: Value
    sin_psi: Value
    cos_psi: Value


def beam_motion(
    c: Coefficients, sigma: Value, theta: Value, theta_dot: Value, theta_ddot: Value
) -> BeamMotion:
    """Return the motion of the beam relative to the ground, Eqs. (13) to (15).

    - `c`: constants of the podium
    - `sigma`: contact mode σ ∈ {−1, 0, 1}
    - `theta`, `theta_dot`, `theta_ddot`: θ [rad], θ̇ [rad/s] and θ̈ [rad/s²]
    """
    s, cos = barrier(sincos(sigma * c.alpha - theta))
    return BeamMotion(
        c.two_R * (sigma * c.sin_alpha - s),
        c.two_R * theta_dot * cos,
        c.two_R * (theta_ddot * cos + theta_dot**2 * s),
        c.two_R * (theta_ddot * s - theta_dot**2 * cos),
        s,
        cos,
    )


def beam_acceleration(
    c: Coefficients, sigma: Value, theta: Value, theta_dot: Value, theta_ddot: Value
) -> Value:
    """Return the horizontal acceleration ü_b of the beam relative to the ground [m/s²], Eq. (14); arguments
    as for `beam_motion`."""
    return beam_motion(c, sigma, theta, theta_dot, theta_ddot).acceleration


def beam_vertical_acceleration(
    c: Coefficients, sigma: Value, theta: Value, theta_dot: Value, theta_ddot: Value
) -> Value:
    """Return the vertical acceleration v̈_b of the beam relative to the ground, positive upwards [m/s²], Eq.
    (15); arguments as for `beam_motion`."""
    return beam_motion(c, sigma, theta, theta_dot, theta_ddot).rise


def beam_absolute_acceleration(
    c: Coefficients, sigma: Value, ground: Value | Shaking, x: Vector, v: Vector, a: Vector
) -> Value:
    """Return the absolute horizontal acceleration a_b = ü_g + ü_b of the beam [m/s²].

    - `c`: constants of the podium
    - `sigma`: contact mode σ ∈ {−1, 0, 1}
    - `ground`: ground acceleration [m/s²]
    - `x`, `v`, `a`: positions, velocities and accelerations
    """
    return beam_acceleration(c, sigma, x[0], v[0], a[0]) + horizontal(ground)


def acceleration(c: Coefficients, sigma: Value, ground: Value | Shaking, x: Vector, v: Vector) -> Vector:
    """Return the accelerations of the equations of motion: θ̈ from Eq. (24), ü_t from Eq. (22).

    - `c`: constants of the podium
    - `sigma`: contact mode σ ∈ {−1, 0, 1}
    - `ground`: ground acceleration [m/s²]
    - `x`, `v`: positions (θ [rad], u_t [m]) and velocities

    Restrainers add their terms of (C8) to Eq. (24). Under vertical ground motion, g + v̈_g replaces g in the
    term of gravity. In full contact (σ = 0), θ̈ is 0 and Eq. (22) becomes Eq. (4).
    """
    resisting, added, gravity, ground = 0.0, 0.0, _weight(c, ground), horizontal(ground)
    if c.restraint is not None:
        s, cos, extension = _angles(c, sigma, x[0])
        resisting, added = _restraint(c, c.restraint, extension, v[0])
        resisting = barrier(resisting)
    else:
        s, cos = sincos(sigma * c.alpha - x[0])
    modes = c.vibration
    if modes is None:
        moment = -jnp.abs(sigma) * plus(gravity * s + c.ground * ground * cos, resisting)
        return (moment / plus(c.inertia, added),)
    s, cos = barrier((s, cos))
    u_b, u_b_dot = c.two_R * (sigma * c.sin_alpha - s), c.two_R * v[0] * cos
    springs = modes.omega2 * (x[1] - u_b) + modes.damping * (v[1] - u_b_dot)  # F_i = V_i/m_i, Eq. (7)
    springs = barrier(springs)
    pull = weighted(modes.coupling, springs)
    moment = s * (c.centrifugal * v[0] ** 2 * cos - gravity) + cos * (pull - c.ground * ground)
    theta_ddot = jnp.abs(sigma) * plus(moment, -resisting) / plus(c.inertia + c.centrifugal * s**2, added)
    return theta_ddot, -ground - springs


def plus(value: Any, addend: Value | float) -> Any:
    """Return value + addend, or the value alone if the addend is a Python float, which is always 0.0."""
    return value if isinstance(addend, float) else value + addend


def uplift_demand(c: Coefficients, ground: Value | Shaking, x: Vector, v: Vector) -> Value:
    """Return the uplift demand q in full contact, Eq. (9) [m/s²].

    - `c`: constants of the podium
    - `ground`: ground acceleration [m/s²]
    - `x`, `v`: positions and velocities

    The columns lift to the side −sign q if |q| exceeds `c.uplift`. Under vertical motion, the threshold
    varies with time. The result is then q divided by the ratio of this threshold to `c.uplift`, its value
    without vertical motion, and can still be compared with `c.uplift`.
    """
    q = horizontal_demand(c, ground, x, v)
    return q / _threshold_ratio(c, ground) if isinstance(ground, Shaking) else q


def horizontal_demand(c: Coefficients, ground: Value | Shaking, x: Vector, v: Vector) -> Value:
    """Return q of Eq. (9), without the effect of vertical motion [m/s²].

    - `c`: constants of the podium
    - `ground`: ground acceleration [m/s²]
    - `x`, `v`: positions and velocities
    """
    ground, modes = horizontal(ground), c.vibration
    if modes is None:
        return ground
    return ground - weighted(modes.demand, modes.omega2 * x[1] + modes.damping * v[1])


def demand_jet(c: Coefficients, grounds, states) -> tuple[Value, Value, Value]:
    """Return the uplift demand q in full contact and its first two derivatives in time.

    - `c`: constants of the podium
    - `grounds`: ground acceleration and its first two derivatives in time
    - `states`: the pair (x, v) of positions and velocities, and its first two derivatives in time

    Eq. (9) is linear, so it also holds for derivatives. Under vertical motion the quotient rule is applied.
    """
    if not isinstance(grounds[0], Shaking):
        return tuple(uplift_demand(c, ground, *y) for ground, y in zip(grounds, states, strict=True))  # pyright: ignore[reportReturnType]
    q, q1, q2 = (horizontal_demand(c, ground, *y) for ground, y in zip(grounds, states, strict=True))
    r = _threshold_ratio(c, grounds[0])
    r1, r2 = (not_none(c.uplift_slope) * ground.vertical / c.uplift for ground in grounds[1:])
    demand = q / r
    rate = (q1 - demand * r1) / r
    return demand, rate, (q2 - 2 * rate * r1 - demand * r2) / r


def impact(c: Coefficients, theta_dot: Value) -> Value:
    """Return θ̇ after an impact [rad/s], the restitution factor e times θ̇ before the impact, Eq. (27).

    θ̇ keeps its sign, and the displacement u_t and velocity u̇_t of the superstructure are continuous, Eq.
    (26). If e ≤ 0 the result is 0, and rocking ends.
    """
    return jnp.maximum(c.restitution, 0.0) * theta_dot


def shear(c: Coefficients, sigma: Value, ground: Value | Shaking, x: Vector, v: Vector, a: Vector) -> Value:
    """Return the shear of the superstructure divided by its weight, V_s/(m_t g) [–], Eq. (7).

    - `c`: constants of the podium
    - `sigma`: contact mode σ ∈ {−1, 0, 1}
    - `ground`: ground acceleration [m/s²]
    - `x`, `v`, `a`: positions, velocities and accelerations

    The result is the absolute horizontal acceleration of the superstructure divided by −g. With several
    vibration modes, this is the mean acceleration of the modal masses and the residual mass (the mass that
    belongs to no mode and moves with the beam).
    """
    ground = horizontal(ground)
    if c.vibration is None:
        return -beam_absolute_acceleration(c, sigma, ground, x, v, a) / c.g
    modal = c.modal
    if modal is None:
        return -(a[1] + ground) / c.g
    return -_floor_acceleration(c, modal, modal.shares, sigma, ground, x, v, a) / c.g


def _floor_acceleration(
    c: Coefficients,
    modal: ModalConstants,
    weights: Values,
    sigma: Value,
    ground: Value,
    x: Vector,
    v: Vector,
    a: Vector,
) -> Value:
    """Return the absolute horizontal acceleration of a floor with the weights w_i of the modes i, (L2)
    [m/s²]: Σ w_i(ü_i + ü_g) + (1 − Σ w_i) a_b. ü_i is the acceleration of mode i relative to the ground, a_b
    the absolute acceleration of the beam. Without a residual mass, the second term is zero and is left
    out."""
    of_modes = weighted(weights, a[1] + ground)
    if modal.residual is None:
        return of_modes
    return of_modes + (1 - summed(weights)) * beam_absolute_acceleration(c, sigma, ground, x, v, a)


def floor_accelerations(
    c: Coefficients, sigma: Value, ground: Value | Shaking, x: Vector, v: Vector, a: Vector
) -> Values:
    """Return the absolute horizontal accelerations of the floors [m/s²].

    - `c`: constants of the podium
    - `sigma`: contact mode σ ∈ {−1, 0, 1}
    - `ground`: ground acceleration [m/s²]
    - `x`, `v`, `a`: positions, velocities and accelerations

    In (L2), the weight of mode i in floor j is Γ_iφ_ji, the participation factor times the mode shape.
    """
    modal, ground = not_none(c.modal), horizontal(ground)
    of_floor = lambda weights: _floor_acceleration(c, modal, weights, sigma, ground, x, v, a)
    return jax.vmap(of_floor)(not_none(modal.floors))
