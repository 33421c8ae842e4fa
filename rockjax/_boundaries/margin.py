"""Signed margin of a scene (one podium under one motion): positive if the scene survives, zero on the
boundary, negative if it overturns."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np

from rockjax._checks import concrete
from rockjax._options import Options
from rockjax._structures import Podium

# By default, a scan is designed to find every overturning interval wider than this fraction of the scanned
# range.
DEFAULT_WIDTH = 1e-4
# If the `certain_width` of a search exceeds the requested width by more than this factor, the cause is not
# rounding, but scenes that did not finish.
ROUNDING_ALLOWANCE = 1.01
# Relative tolerance of the scenes of a scan. The position of a change between survival and overturning has
# about the same relative error if it is found from these scenes.
SCAN_TOLERANCE = 1e-6
_LEAST_SURVIVING_MARGIN = float(np.finfo(np.float32).tiny)  # least margin of a scene that survives


def has_margin(options: Options, podium: Podium) -> bool:
    """Return whether scenes have an overturning margin (see docs/overturning.md).

    Scenes have a margin if the overturning angle `overturn_ratio`·α is at most the stability angle θ_s. The
    stability angle is α without tendons and larger with tendons. The result is False if the angles cannot be
    compared because JAX traces `overturn_ratio` or, for ratios above 1, θ_s/α.
    """
    ratio = concrete(options.overturn_ratio)
    if ratio is None or bool(np.all(ratio <= 1)):
        return ratio is not None
    limit = concrete(podium.stability_angle / podium.alpha)
    return limit is not None and bool(np.all(ratio <= limit))


def signed_margin(floats: dict[str, Any], overturned, overturn_ratio, uses_margin: bool, xp: Any = jnp):
    """Return the signed margin of a scene: > 0 if it survives, ≤ 0 if it overturns, exactly 1 if the
    columns never lift.

    - `floats`: outputs of the scene by name: `margin` if `uses_margin`, otherwise `peak_rotation`
    - `overturned`: whether the scene overturned
    - `overturn_ratio`: |θ|/α at which a scene counts as overturned
    - `uses_margin`: whether the overturning margin applies, see `has_margin`
    - `xp`: `numpy` or `jax.numpy`

    The result is the overturning margin if `uses_margin`. Otherwise it is 1 − max|θ|/(α·`overturn_ratio`) for
    scenes that survive, and −1 for scenes that overturn.
    """
    if uses_margin:
        value = floats["margin"]
        # Rounding may give the margin the wrong sign.
        return xp.where(overturned, xp.minimum(value, 0.0), xp.maximum(value, _LEAST_SURVIVING_MARGIN))
    return xp.where(
        overturned, -1.0, xp.maximum(1 - floats["peak_rotation"] / overturn_ratio, _LEAST_SURVIVING_MARGIN)
    )


def boundary_residual(floats: dict[str, Any], uses_margin: bool):
    """Return the output from which the derivatives of the boundary follow: the margin, or the time of
    overturning if scenes have no margin. The output must be differentiated just on the overturning side of
    the boundary.

    The time of overturning and its derivatives grow without bound towards the boundary. But the ratio of two
    of these derivatives tends to a finite limit, from which the derivative of the boundary follows.
    """
    return floats["margin" if uses_margin else "overturn_time"]


def margin_options(options: Options, uses_margin: bool) -> Options:
    """Return `options` with the output that the search for a boundary needs as the only requested output."""
    return options.replace(outputs=("margin" if uses_margin else "peak_rotation",), throw=False)


def scan_options(options: Options, width, xp: Any = jnp) -> Options:
    """Return less accurate options for a scan. They are accurate enough to show overturning intervals wider
    than the fraction `width` of the range. Neighbouring scenes of the scan with different outcomes are later
    solved again with `options`."""
    loose = SCAN_TOLERANCE * xp.minimum(1.0, width / DEFAULT_WIDTH)
    return options.replace(rtol=xp.maximum(options.rtol, loose), atol=xp.maximum(options.atol, 1e-2 * loose))
