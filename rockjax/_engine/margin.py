"""The overturning margin of a scene: positive where it survives, zero on the boundary, negative where it
overturns.

Energy, over the depth of the potential well from full contact to the overturning angle α_o =
overturn_ratio·α. A turning point |θ| = θ_m short of α_o had to spare the work against gravity, and against
what else turns it back, on what is left of the way:

    M = G + W/(1 + W/w),   G = [cos(α−α_o) − cos(α−θ_m)] / d,   W = f⁺ [sin(α−θ_m) − sin(α−α_o)] / d,
    d = cos(α−α_o) − cos α,

where f is what besides gravity turns the column back at that moment, over gravity's own coefficient in Eq.
(24), and f⁺ its positive part. A column that reaches α_o with the speed θ̇ had I θ̇²/2 too much. The inertia
I is that of columns, beam and superstructure moving as one: so they do where they linger at the saddle.

So M passes through zero with a slope, whether the columns are pushed over or linger at the saddle after the
shaking; one slope exactly where gravity alone decides, nearly where the ground still moves or the
superstructure sways. Where restrainers hold the columns as well, the potential V of (C3) stands for that of
gravity, (C21):

    G = 1 − V(θ_m)/V(α_o),   f = I (−σθ̈) − V'(θ_m),   W = f⁺ [sin(α−θ_m) − sin(α−α_o)] / V(α_o).

The margin of a scene is the least of its turning points, at most 1 (the columns never lift), or that of its
fall. Turning points come and go with the parameters, and each has its own f: W is kept below w, so that away
from the boundary M follows the largest rotation, which is continuous.
"""

from __future__ import annotations

import jax.numpy as jnp

from rockjax._sincos import sincos
from rockjax._types import Value

from .coefficients import Coefficients
from .energy import potential, potential_slope, rotational_inertia

OTHERS = 0.02  # w: as much as others than gravity may add


def at_turn(c: Coefficients, overturn_angle: Value, theta: Value, slowing: Value) -> Value:
    """M of a turning point at |θ| = `theta` with the angular deceleration `slowing` = −σθ̈ ≥ 0."""
    one = jnp.ones_like(theta)
    (sin_o, _), (sin, _) = (sincos(c.alpha - angle) for angle in (overturn_angle, theta))
    depth = potential(c, one, overturn_angle)
    push = _moment(c, theta, slowing) - potential_slope(c, theta)
    work = jnp.maximum(push, 0.0) * (sin - sin_o) / depth
    return 1 - potential(c, one, theta) / depth + work / (1 + work / OTHERS)


def at_fall(c: Coefficients, overturn_angle: Value, theta_dot: Value) -> Value:
    """M of a column that reaches the overturning angle with the speed θ̇."""
    depth = potential(c, jnp.ones_like(theta_dot), overturn_angle)
    return -0.5 * _moment(c, overturn_angle, theta_dot**2) / depth


def at_rest(c: Coefficients, overturn_angle: Value, theta: Value) -> Value:
    """M of a column held at |θ| = `theta` ≥ 0 by nothing; beyond the overturning angle how far, over that
    angle."""
    one = jnp.ones_like(theta)
    left = 1 - potential(c, one, theta) / potential(c, one, overturn_angle)
    return jnp.where(theta < overturn_angle, left, 1 - theta / overturn_angle)


def _moment(c: Coefficients, theta: Value, rate: Value) -> Value:
    """Inertia times a rate of the rotation, per N m_c: an angular acceleration, or the square of a
    velocity."""
    return c.two_R**2 / 3 * rotational_inertia(c, jnp.ones_like(theta), theta) * rate
