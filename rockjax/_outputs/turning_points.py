"""The overturning margin M of a scene (one podium under one excitation): positive if the columns survive,
zero on the boundary of overturning, negative if they overturn.

The overturning angle is α_o = overturn_ratio·α. The depth of the potential well is the increase of the
potential energy from full contact to α_o. The margin is an energy divided by this depth.

At a turning point |θ| = θ_m < α_o, the energy is the work that a further rotation from θ_m to α_o would need.
Divided by the depth, the work against gravity is G, and the work against all other decelerating moments is W.
The contribution of W is limited to w = 0.02:

    M = G + W/(1 + W/w),   G = [cos(α−α_o) − cos(α−θ_m)] / d,   W = f⁺ [sin(α−θ_m) − sin(α−α_o)] / d,
    d = cos(α−α_o) − cos α.

f is the sum of the other decelerating moments at the turning point, divided by the coefficient of gravity in
Eq. (24) of docs/model.md, and f⁺ is the positive part of f.

A column that reaches α_o with the speed θ̇ has the excess energy I θ̇²/2 there. The margin is then −I θ̇²/2
divided by the depth. I is the moment of inertia of a motion in which the superstructure moves with columns
and beam, as it does near the unstable equilibrium.

As a function of a parameter, M passes through zero with a finite slope, both during the shaking and after it.
The slopes on both sides of zero are equal if only gravity acts, and nearly equal if the ground still moves or
the superstructure vibrates. With restrainers, the potential energy V of gravity and restrainers, (C3),
replaces that of gravity; the margin is (C21). Both equations are in docs/equations.md:

    G = 1 − V(θ_m)/V(α_o),   f = I (−σθ̈) − V'(θ_m),   W = f⁺ [sin(α−θ_m) − sin(α−α_o)] / V(α_o),

where σ is the sign of θ, and V and I are divided by the mass of all columns.

The margin of a scene is the least margin of all turning points, including an initial rotation, and a rotation
that still increases at the end of the scene. The margin is 1 if the columns never lift, and the margin at α_o
if they overturn. If a parameter changes, a turning point with its own f can appear or vanish, and M jumps.
Such a jump is small, because the contribution of W is at most w. Away from the boundary, M depends mainly on
the largest rotation, which is continuous.
"""

from __future__ import annotations

import jax.numpy as jnp

from rockjax._engine.coefficients import Coefficients
from rockjax._engine.energy import potential, potential_slope, rotational_inertia
from rockjax._sincos import sincos
from rockjax._types import Value

MAX_WORK = 0.02  # w: limit of the contribution of W [–]


def margin_at_turn(c: Coefficients, overturn_angle: Value, theta: Value, slowing: Value) -> Value:
    """Return the margin M of a turning point.

    - `c`: constants of the podium
    - `overturn_angle`: α_o [rad]
    - `theta`: |θ| at the turning point [rad]
    - `slowing`: angular deceleration −σθ̈ ≥ 0 at the turning point [rad/s²]
    """
    one = jnp.ones_like(theta)
    (sin_o, _), (sin, _) = (sincos(c.alpha - angle) for angle in (overturn_angle, theta))
    depth = potential(c, one, overturn_angle)
    other_moment = _moment(c, theta, slowing) - potential_slope(c, theta)
    work = jnp.maximum(other_moment, 0.0) * (sin - sin_o) / depth
    return 1 - potential(c, one, theta) / depth + work / (1 + work / MAX_WORK)


def margin_at_fall(c: Coefficients, overturn_angle: Value, theta_dot: Value) -> Value:
    """Return the margin M of columns that reach the overturning angle `overturn_angle` [rad] with the rate
    `theta_dot` [rad/s]."""
    depth = potential(c, jnp.ones_like(theta_dot), overturn_angle)
    return -0.5 * _moment(c, overturn_angle, theta_dot**2) / depth


def margin_at_rest(c: Coefficients, overturn_angle: Value, theta: Value) -> Value:
    """Return the margin M of columns that are released at rest from |θ| = `theta` [rad] and have no other
    decelerating moments than those of gravity and restrainers: G for |θ| < α_o, else 1 − |θ|/α_o."""
    one = jnp.ones_like(theta)
    margin = 1 - potential(c, one, theta) / potential(c, one, overturn_angle)
    return jnp.where(theta < overturn_angle, margin, 1 - theta / overturn_angle)


def _moment(c: Coefficients, theta: Value, rate: Value) -> Value:
    """Return I times `rate`, divided by N m_c [m²/s²]; `rate` is an angular acceleration [rad/s²] or a
    squared angular speed [rad²/s²]."""
    return c.two_R**2 / 3 * rotational_inertia(c, jnp.ones_like(theta), theta) * rate
