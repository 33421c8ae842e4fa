"""How far the scale of a ground motion may change before a scene could overturn: an estimate, from
derivatives.

Every turning point of a scene moves with the scale s of its motion. Prolonged along its derivative, its
margin M is used up at a distance M/|∂M/∂ ln s|; and where its angular deceleration is used up it is a
turning point no longer, so that what follows is another motion. The least of these over all turning points
is the reach. Rocking so small that it is far from overturning is left out, for its derivatives are those of
bouncing: they grow without bound and say nothing.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
from jax import Array

from rockjax._engine.coefficients import present
from rockjax._engine.state import LoopState

SMALL = 0.95  # turning points of such a margin or more are left out …
NOT_LARGE = 0.8  # … and their decelerations from this on
SCALE = "scale"  # the parameter that lanes follow, a factor on the motion


def least_reach(reach: Array, lane: LoopState, slopes: dict[str, Any]) -> Array:
    """The reach so far, in ln s, with the turning points of the last trials of lanes; `slopes` are rows
    beside them."""
    margin, slowing = present(lane.turn)
    of_margin, of_slowing = (row[0] for row in slopes["turn"])
    reach = jnp.minimum(reach, _distance(margin, of_margin, margin < SMALL))
    return jnp.minimum(reach, _distance(slowing, of_slowing, margin < NOT_LARGE))


def _distance(value: Array, slope: Array, counts: Array) -> Array:
    """Where a straight line comes to zero; inf where it does not count."""
    steep = jnp.abs(slope)
    moves = counts & (steep > 0)
    return jnp.where(moves, jnp.maximum(value, 0.0) / jnp.where(moves, steep, 1.0), jnp.inf)
