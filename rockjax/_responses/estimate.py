"""Estimated errors: differences from a second solution of the same scene at another tolerance.

The second solution has a tenth of the tolerance, so that the difference is the error of the first to a tenth.
Close to rounding it has ten times the tolerance, and the difference errs on the safe side.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from rockjax import _results as results
from rockjax._checks import float_type
from rockjax._options import LEAST_ATOL, OF_STORIES, Options
from rockjax._results import Errors

# The true error is below this times the estimate, but for one scene in a hundred (docs/verification.md).
SAFETY = 10.0
FINER = 0.1
# Where two solutions of chaotic rocking agree, it is by chance: the closer they have to, the rarer it is.
PARTED = 0.005  # energetic impacts: a sixteenth of a percent of the speed of one from which columns overturn
# Errors that grow so much and become so large a part of the peak: the difference of two solutions is one
# draw of many then, and says little about the next.
AMPLIFIED, LARGE = 1e5, 1e-3
FALL_APART = 0.01  # 1/p: the distance to the boundary is another one by a hundredth
SHORTER = 0.7  # steps, where it is not the tolerance that sets them


def companion(options: Options) -> Options:
    """The options of the second solution."""
    rtol, atol = options.rtol, options.atol
    larger = max if isinstance(atol, int | float) else jnp.maximum
    finer, looser = (FINER * rtol, larger(FINER * atol, LEAST_ATOL)), (rtol / FINER, atol / FINER)
    room = FINER * rtol >= 100 * float(np.finfo(float_type()).eps)
    if isinstance(room, bool):  # as plain numbers, which the program of the first solution takes as well
        tolerances = finer if room else looser
    else:
        tolerances = jax.tree.map(lambda a, b: jnp.where(room, a, b), finer, looser)
    return eqx.tree_at(lambda o: (o.rtol, o.atol, o._stride), options, (*tolerances, SHORTER))


def _parted(a: dict[str, Any], b: dict[str, Any], xp) -> Any:
    """Return whether the two solutions have parted after impacts from which columns can overturn.

    In chaotic rocking both may survive by chance with the same earlier peak. The longer solution may have one
    more impact. Where both overturn, their times are compared.
    """
    apart, last = a["energetic"] - b["energetic"], (a["last_energetic"], b["last_energetic"])
    one_more = xp.minimum(abs(apart - last[0]), abs(apart + last[1]))
    # Equal sums, and the last impact of each another one than of the other.
    by_chance = (abs(last[0] - last[1]) > PARTED) & (xp.minimum(*last) > PARTED)
    as_many = xp.where(by_chance, xp.inf, abs(apart))
    falls = abs(a["fall_time"] - b["fall_time"]) > FALL_APART  # not so where one of them is NaN
    return falls | (xp.minimum(as_many, one_more) > PARTED)


def errors(first: tuple[dict[str, Any], dict[str, Any]], second, options: Options, xp) -> Errors:
    """Return the error estimates from floats and integers of both solutions.

    `options` are those of the first one; `xp` is NumPy for batches on the host, else jax.numpy.
    """
    rtol, overturn_ratio = (xp.asarray(y) for y in (options.rtol, options.overturn_ratio))
    if xp is jnp:
        first, second = jax.lax.stop_gradient((first, second))
    (a, flags), (b, others) = first, second
    unknown = (flags["code"] > results.OVERTURNED) | (others["code"] > results.OVERTURNED)

    def apart(name):
        difference = abs(a[name] - b[name])
        lost = unknown[(..., *[None] * (difference.ndim - unknown.ndim))]
        return xp.where(lost & ~xp.isnan(a[name]), xp.inf, difference)

    rotation = apart("peak_rotation")
    falls = flags["overturned"]
    # What a column has too much when it reaches the overturning angle vanishes on the boundary.
    close = xp.where(
        falls, a["fall"] < SAFETY * apart("fall"), a["peak_rotation"] + SAFETY * rotation >= overturn_ratio
    )
    sensitive = rotation > xp.maximum(AMPLIFIED * rtol, LARGE) * a["peak_rotation"]
    undecided = unknown | (falls != others["overturned"]) | close | sensitive | _parted(a, b, xp)
    peaks = apart("peak_deformation"), apart("peak_shear")
    of_stories = {name: apart(name) for name in OF_STORIES if name in a}
    return Errors(rotation, *peaks, undecided, **of_stories)
