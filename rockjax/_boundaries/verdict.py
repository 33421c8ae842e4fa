"""Whether a scene survives, as a number that has a zero on the boundary of overturning."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np

from rockjax._checks import concrete
from rockjax._options import Options
from rockjax._structures import Podium

NARROWEST = 1e-4  # of the range: below a boundary no wider window of overturning is missed
LOOSE = 1e-6  # tolerance of scenes that only look: it moves a boundary by about as much, as a share of itself
_TINY = float(np.finfo(np.float32).tiny)


def has_margin(options: Options, podium: Podium) -> bool:
    """Whether the convention of overturning has a margin: known to be |θ| = θ_s at most, α without
    tendons."""
    ratio = concrete(options.overturn_ratio)
    if ratio is None or bool(np.all(ratio <= 1)):
        return ratio is not None
    limit = concrete(podium.stability_angle / podium.alpha)
    return limit is not None and bool(np.all(ratio <= limit))


def signed_margin(floats: dict[str, Any], overturned, overturn_ratio, margin: bool, xp: Any = jnp):
    """A number > 0 where a scene survives and ≤ 0 where it overturned; the overturning margin where there is
    one.

    It is 1 exactly where the columns never lift.
    """
    if margin:
        value = floats["margin"]
        # The sign is that of the verdict, rounding or not.
        return xp.where(overturned, xp.minimum(value, 0.0), xp.maximum(value, _TINY))
    return xp.where(overturned, -1.0, xp.maximum(1 - floats["peak_rotation"] / overturn_ratio, _TINY))


def boundary_residual(floats: dict[str, Any], margin: bool):
    """What is differentiated just past the boundary: the margin; without one, the time of overturning.

    That time grows without bound towards the boundary, and its derivatives in the ratio that keeps a scene on
    it.
    """
    return floats["margin" if margin else "overturn_time"]


def margin_options(options: Options, margin: bool) -> Options:
    """The same accuracy, with no outputs but what the boundary needs."""
    return options.replace(outputs=("margin" if margin else "peak_rotation",), throw=False)


def looking(options: Options, width, xp: Any = jnp) -> Options:
    """Accurate enough not to miss a window of so much of the range; what is found is confirmed with
    `options`."""
    loose = LOOSE * xp.minimum(1.0, width / NARROWEST)
    return options.replace(rtol=xp.maximum(options.rtol, loose), atol=xp.maximum(options.atol, 1e-2 * loose))
