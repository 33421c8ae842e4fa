"""The overturning margin of a scene: positive if it survives, zero on the boundary, negative if it overturns.

The margin is an energy over the depth of the potential well from full contact to the overturning angle α_o =
overturn_ratio·α. A turning point |θ| = θ_m short of α_o has in reserve the work against gravity, and against
other decelerating moments, over the remaining angle:

    M = G + W/(1 + W/w),   G = [cos(α−α_o) − cos(α−θ_m)] / d,   W = f⁺ [sin(α−θ_m) − sin(α−α_o)] / d,
    d = cos(α−α_o) − cos α,

where f is the decelerating moment besides gravity at that time, over gravity's coefficient in Eq. (24), and
f⁺ its positive part. A column that reaches α_o with the speed θ̇ has an excess energy I θ̇²/2. The inertia I
is that of columns, beam and superstructure moving together, as they do near the saddle.

M passes through zero with a finite slope, whether the columns are pushed over or linger at the saddle after
the shaking. The slopes on both sides are equal if gravity alone acts, and nearly equal if the ground still
moves or the superstructure sways. With restrainers the potential V of (C3) replaces that of gravity, (C21):

    G = 1 − V(θ_m)/V(α_o),   f = I (−σθ̈) − V'(θ_m),   W = f⁺ [sin(α−θ_m) − sin(α−α_o)] / V(α_o).

The margin of a scene is the least of its turning points, at most 1 (the columns never lift), or that of its
fall. Turning points appear and vanish with the parameters, and each has its own f. The work term is therefore
limited to w: away from the boundary M follows the largest rotation, which is continuous.
"""

from __future__ import annotations

import jax.numpy as jnp

from rockjax._engine.coefficients import Coefficients
from rockjax._engine.energy import potential, potential_slope, rotational_inertia
from rockjax._sincos import sincos
from rockjax._types import Value

OTHERS = 0.02  # w: limit of the contribution of moments other than gravity


def margin_at_turn(c: Coefficients, overturn_angle: Value, theta: Value, slowing: Value) -> Value:
    """Return the margin M of a turning point.

    - `c`: constants of the podium
    - `overturn_angle`: α_o [rad]
    - `theta`: |θ| at the turning point [rad]
    - `slowing`: angular deceleration −σθ̈ ≥ 0 there [rad/s²]
    """
    one = jnp.ones_like(theta)
    (sin_o, _), (sin, _) = (sincos(c.alpha - angle) for angle in (overturn_angle, theta))
    depth = potential(c, one, overturn_angle)
    push = _moment(c, theta, slowing) - potential_slope(c, theta)
    work = jnp.maximum(push, 0.0) * (sin - sin_o) / depth
    return 1 - potential(c, one, theta) / depth + work / (1 + work / OTHERS)


def margin_at_fall(c: Coefficients, overturn_angle: Value, theta_dot: Value) -> Value:
    """Return the margin M of a column that reaches the overturning angle with the speed θ̇."""
    depth = potential(c, jnp.ones_like(theta_dot), overturn_angle)
    return -0.5 * _moment(c, overturn_angle, theta_dot**2) / depth


def margin_at_rest(c: Coefficients, overturn_angle: Value, theta: Value) -> Value:
    """Return the margin M of a column at rest at |θ| = `theta` ≥ 0 under gravity and restrainers alone;
    beyond the overturning angle, 1 − θ/α_o."""
    one = jnp.ones_like(theta)
    left = 1 - potential(c, one, theta) / potential(c, one, overturn_angle)
    return jnp.where(theta < overturn_angle, left, 1 - theta / overturn_angle)


def _moment(c: Coefficients, theta: Value, rate: Value) -> Value:
    """Return inertia times a rate of the rotation, per N m_c: an angular acceleration, or a squared
    velocity."""
    return c.two_R**2 / 3 * rotational_inertia(c, jnp.ones_like(theta), theta) * rate
