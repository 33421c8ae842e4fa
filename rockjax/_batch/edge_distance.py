"""Edge distance of a scene: the estimated change of ln s at which the scene could overturn, where s is the
scale of the ground motion (a factor on it).

At each turning point of the rotation, two quantities are extrapolated linearly in ln s. The first is the
overturning margin M (see docs/overturning.md): at the distance M/|∂M/∂ ln s| it is zero, and the scene would
overturn. The second is the angular deceleration: where it is zero, the turning point disappears, and a
different response follows. The edge distance is the smallest of these distances, over both quantities and all
turning points of the scene. Turning points with small rotations (large M) are left out, because their
derivatives grow without bound while the columns bounce.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
from jax import Array

from rockjax._engine.state import LoopState

MARGIN_USED_BELOW = 0.95  # M is extrapolated at turning points with M below this value
DECELERATION_USED_BELOW = 0.8  # the deceleration is extrapolated at turning points with M below this value
SCALE = "scale"  # name of the parameter s


def least_edge_distance(distance: Array, lanes: LoopState, slopes: dict[str, Any]) -> Array:
    """Return the edge distances of n scenes after a step of each scene, shape (n,).

    - `distance`: edge distances before the steps, as changes of ln s [–], shape (n,)
    - `lanes`: states of the scenes after the steps, with the turning points in the steps
    - `slopes`: derivatives of these states with respect to ln s, with a first axis of length 1
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
