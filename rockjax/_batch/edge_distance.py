"""Edge distance of a scene: the estimated change of ln s at which the scene could overturn, where s is the
scale of the ground motion.

At every turning point of the rotation, the overturning margin M and the angular deceleration depend on s.
Extrapolated linearly, M vanishes at the distance M/|∂M/∂ ln s|, and the scene would overturn. Where the
deceleration vanishes, the turning point disappears, and a different motion follows. The edge distance is the
least of these distances in the scene. Turning points with small rotations do not count, because their
derivatives grow without bound while the columns bounce.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
from jax import Array

from rockjax._engine.state import LoopState

MAX_MARGIN = 0.95  # margins of turning points count if they are below this value
MAX_DECELERATION_MARGIN = 0.8  # decelerations count at turning points with a margin below this value
SCALE = "scale"  # name of the differentiated parameter, a factor on the motion


def least_edge_distance(distance: Array, lane: LoopState, slopes: dict[str, Any]) -> Array:
    """Return the edge distance of each lane, including the turning points of the last trials.

    - `distance`: edge distance before these trials [ln s]
    - `lane`: states of the lanes after the trials
    - `slopes`: derivatives of the states with respect to ln s, one row
    """
    margin, deceleration = lane.records[-1]  # record of the output `TurningPoints`
    slope, rate = (row[0] for row in slopes["records"][-1])  # derivatives of margin and deceleration
    distance = jnp.minimum(distance, _distance(margin, slope, margin < MAX_MARGIN))
    return jnp.minimum(distance, _distance(deceleration, rate, margin < MAX_DECELERATION_MARGIN))


def _distance(value: Array, slope: Array, is_counted: Array) -> Array:
    """Return the distance at which a straight line reaches zero, or inf unless `is_counted`."""
    steepness = jnp.abs(slope)
    has_zero = is_counted & (steepness > 0)
    return jnp.where(has_zero, jnp.maximum(value, 0.0) / jnp.where(has_zero, steepness, 1.0), jnp.inf)
