"""The overturning margin of a scene: positive where it survives, zero on the boundary, negative where it overturns.

Energy, over the depth of the potential well from full contact to the overturning angle α_o = overturn_ratio·α. A turning
point |θ| = θ_m short of α_o had to spare the work against gravity, and against what else turns it back, on what is left
of the way:

    M = G + W/(1 + W/w),   G = [cos(α−α_o) − cos(α−θ_m)] / d,   W = f⁺ [sin(α−θ_m) − sin(α−α_o)] / d,
    d = cos(α−α_o) − cos α,

where f is what besides gravity turns the column back at that moment, over gravity's own coefficient in Eq. (24), and f⁺
its positive part. A column that reaches α_o with the speed θ̇ had I θ̇²/2 too much. The inertia I is that of columns, beam
and superstructure moving as one: so they do where they linger at the saddle.

So M passes through zero with a slope, whether the columns are pushed over or linger at the saddle after the shaking; one
slope exactly where gravity alone decides, nearly where the ground still moves or the superstructure sways. The margin of
a scene is the least of its turning points, at most 1 (the columns never lift), or that of its fall. Turning points come
and go with the parameters, and each has its own f: W is kept below w, so that away from the boundary M follows the largest
rotation, which is continuous.
"""

from __future__ import annotations

import jax.numpy as jnp

from rockjax._types import Value

from .model import Coefficients
from .sincos import sincos

OTHERS = 0.02  # w: as much as others than gravity may add


def at_turn(c: Coefficients, overturn_angle: Value, theta: Value, slowing: Value) -> Value:
    """M of a turning point at |θ| = `theta` with the angular deceleration `slowing` = −σθ̈ ≥ 0."""
    sin_o, cos_o = sincos(c.alpha - overturn_angle)
    sin, cos = sincos(c.alpha - theta)
    push = jnp.maximum((c.inertia + c.centrifugal) * slowing / c.gravity - sin, 0.0)
    depth = cos_o - c.cos_alpha
    work = push * (sin - sin_o) / depth
    return (cos_o - cos) / depth + work / (1 + work / OTHERS)


def at_fall(c: Coefficients, overturn_angle: Value, theta_dot: Value) -> Value:
    """M of a column that reaches the overturning angle with the speed θ̇."""
    _, cos_o = sincos(c.alpha - overturn_angle)
    return -0.5 * (c.inertia + c.centrifugal) * theta_dot**2 / (c.gravity * (cos_o - c.cos_alpha))


def at_rest(c: Coefficients, overturn_angle: Value, theta: Value) -> Value:
    """M of a column held at |θ| = `theta` ≥ 0 by nothing; beyond the overturning angle how far, over that angle."""
    _, cos_o = sincos(c.alpha - overturn_angle)
    _, cos = sincos(c.alpha - theta)
    return jnp.where(theta < overturn_angle, (cos_o - cos) / (cos_o - c.cos_alpha), 1 - theta / overturn_angle)
