"""Edge distance of a scene: the estimated change of the scale, from derivatives, before it could overturn.

Every turning point of a scene moves with the scale s of its motion. Extrapolated along its derivative, its
margin M vanishes at a distance M/|∂M/∂ ln s|. Where its angular deceleration vanishes it is no longer a
turning point, and a different motion follows. The edge distance is the least of these distances over all
turning points. Small rocking far from overturning is left out, because its derivatives are those of bouncing,
which grow without bound and are not informative.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
from jax import Array

from rockjax._engine.state import LoopState

SMALL = 0.95  # turning points with this margin or more are left out …
NOT_LARGE = 0.8  # … and decelerations of those with this margin or more
SCALE = "scale"  # the differentiated parameter, a factor on the motion


def least_edge_distance(distance: Array, lane: LoopState, slopes: dict[str, Any]) -> Array:
    """Return the edge distance so far, in ln s, including the turning points of the last trials of lanes;
    `slopes` are the rows of derivatives beside them."""
    margin, slowing = lane.records[-1]  # of `TurningPoints`
    of_margin, of_slowing = (row[0] for row in slopes["records"][-1])
    distance = jnp.minimum(distance, _distance(margin, of_margin, margin < SMALL))
    return jnp.minimum(distance, _distance(slowing, of_slowing, margin < NOT_LARGE))


def _distance(value: Array, slope: Array, counts: Array) -> Array:
    """Return the distance to the zero of a straight line; inf for values that do not count."""
    steep = jnp.abs(slope)
    has_slope = counts & (steep > 0)
    return jnp.where(has_slope, jnp.maximum(value, 0.0) / jnp.where(has_slope, steep, 1.0), jnp.inf)
