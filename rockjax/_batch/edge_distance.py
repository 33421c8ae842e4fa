"""Edge distance of a scene: the estimated change of ln s at which the scene could overturn, where s is the
scale (a factor) of the ground motion.

At the turning points of the rotation, the overturning margin M and the angular deceleration are extrapolated
linearly in ln s. The margin reaches zero at the distance M/|∂M/∂ ln s|, where the scene would overturn. Where
the deceleration reaches zero, the turning point disappears and a different response follows. The edge
distance is the smallest distance at which one of the two quantities reaches zero, over all turning points of
the scene. Turning points with small rotations (large M) are left out, because the derivatives at them grow
without bound while the columns bounce.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
from jax import Array

from rockjax._engine.state import LoopState

MARGIN_USED_BELOW = 0.95  # M is extrapolated at turning points with M below this value
DECELERATION_USED_BELOW = 0.8  # the deceleration is extrapolated at turning points with M below this value
SCALE = "scale"  # name of the differentiated parameter, a factor on the motion


def least_edge_distance(distance: Array, lanes: LoopState, slopes: dict[str, Any]) -> Array:
    """Return the edge distances of scenes, updated by the turning points in the steps just made, shape (n,).

    - `distance`: edge distances before these steps, shape (n,) [ln s]
    - `lanes`: states of the n scenes after the steps
    - `slopes`: derivatives of the states after the steps with respect to ln s, with a first axis of length 1
    """
    margin, deceleration = lanes.accumulators[-1]  # of the output `TurningPoints`
    margin_slope, deceleration_slope = (row[0] for row in slopes["accumulators"][-1])
    distance = jnp.minimum(distance, _zero_distance(margin, margin_slope, margin < MARGIN_USED_BELOW))
    is_used = margin < DECELERATION_USED_BELOW
    return jnp.minimum(distance, _zero_distance(deceleration, deceleration_slope, is_used))


def _zero_distance(value: Array, slope: Array, is_used: Array) -> Array:
    """Return the distance value/|slope| at which a straight line reaches zero; inf where not `is_used`."""
    steepness = jnp.abs(slope)
    has_zero = is_used & (steepness > 0)
    return jnp.where(has_zero, jnp.maximum(value, 0.0) / jnp.where(has_zero, steepness, 1.0), jnp.inf)
