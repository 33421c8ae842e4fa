"""Signed margin of a scene: a number that is zero on the boundary of overturning."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np

from rockjax._checks import concrete
from rockjax._options import Options
from rockjax._structures import Podium

DEFAULT_WIDTH = 1e-4  # least width of a window that is not missed, as a share of the range
SCAN_TOLERANCE = (
    1e-6  # tolerance of scenes that only scan; the relative error of a boundary is about the same
)
_TINY = float(np.finfo(np.float32).tiny)


def has_margin(options: Options, podium: Podium) -> bool:
    """Return whether the convention of overturning has a margin: its limit is known to be |θ| = θ_s at most,
    or α without tendons."""
    ratio = concrete(options.overturn_ratio)
    if ratio is None or bool(np.all(ratio <= 1)):
        return ratio is not None
    limit = concrete(podium.stability_angle / podium.alpha)
    return limit is not None and bool(np.all(ratio <= limit))


def signed_margin(floats: dict[str, Any], overturned, overturn_ratio, margin: bool, xp: Any = jnp):
    """Return a number > 0 for a scene that survives and ≤ 0 for one that overturned: the overturning margin,
    if there is one.

    - `floats`: outputs of the scene, `margin` or `peak_rotation`
    - `overturned`: whether it overturned
    - `overturn_ratio`: |θ|/α that counts as overturning
    - `margin`: whether the convention of overturning has a margin
    - `xp`: `numpy` or `jax.numpy`

    It is exactly 1 if the columns never lift.
    """
    if margin:
        value = floats["margin"]
        # The sign must agree with `overturned` despite rounding.
        return xp.where(overturned, xp.minimum(value, 0.0), xp.maximum(value, _TINY))
    return xp.where(overturned, -1.0, xp.maximum(1 - floats["peak_rotation"] / overturn_ratio, _TINY))


def boundary_residual(floats: dict[str, Any], margin: bool):
    """Return the quantity to differentiate just past the boundary: the margin or, without one, the time of
    overturning.

    That time grows without bound towards the boundary, and so do its derivatives, but their ratio stays that
    of the boundary.
    """
    return floats["margin" if margin else "overturn_time"]


def margin_options(options: Options, margin: bool) -> Options:
    """Return options of the same accuracy whose only outputs are those that the boundary needs."""
    return options.replace(outputs=("margin" if margin else "peak_rotation",), throw=False)


def scan_options(options: Options, width, xp: Any = jnp) -> Options:
    """Return options accurate enough not to miss a window of this share of the range; findings are confirmed
    with `options`."""
    loose = SCAN_TOLERANCE * xp.minimum(1.0, width / DEFAULT_WIDTH)
    return options.replace(rtol=xp.maximum(options.rtol, loose), atol=xp.maximum(options.atol, 1e-2 * loose))
