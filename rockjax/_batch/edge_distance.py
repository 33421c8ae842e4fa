"""Edge distance of a scene: the estimated change of ln s at which the scene could overturn, where s is the
scale of the ground motion.

At every turning point of the rotation, the overturning margin M and the angular deceleration are extrapolated
linearly in ln s. M reaches zero at the distance M/|∂M/∂ ln s|, where the scene would overturn. Where the
deceleration reaches zero, the turning point disappears, and a different motion follows. The edge distance is
the least of all these distances in the scene. Turning points with small rotations are left out, because their
derivatives grow without bound while the columns bounce.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
from jax import Array

from rockjax._engine.state import LoopState

MAX_MARGIN = 0.95  # the margin is extrapolated at turning points with a margin below this value
MAX_DECELERATION_MARGIN = 0.8  # the deceleration is extrapolated at turning points below this margin
SCALE = "scale"  # name of the differentiated parameter, a factor on the motion


def least_edge_distance(distance: Array, lane: LoopState, slopes: dict[str, Any]) -> Array:
    """Return the edge distances of scenes, updated by the turning points in the steps just made, shape (n,).

    - `distance`: edge distances before these steps, shape (n,) [ln s]
    - `lane`: states of the n scenes after the steps
    - `slopes`: derivatives of these states with respect to ln s, with a first axis of length 1
    """
    margin, deceleration = lane.accumulators[-1]  # of the output `TurningPoints`
    slope, rate = (row[0] for row in slopes["accumulators"][-1])  # derivatives of margin and deceleration
    distance = jnp.minimum(distance, _distance(margin, slope, margin < MAX_MARGIN))
    return jnp.minimum(distance, _distance(deceleration, rate, margin < MAX_DECELERATION_MARGIN))


def _distance(value: Array, slope: Array, is_counted: Array) -> Array:
    """Return the distance at which a straight line reaches zero, or inf unless `is_counted`."""
    steepness = jnp.abs(slope)
    has_zero = is_counted & (steepness > 0)
    return jnp.where(has_zero, jnp.maximum(value, 0.0) / jnp.where(has_zero, steepness, 1.0), jnp.inf)
