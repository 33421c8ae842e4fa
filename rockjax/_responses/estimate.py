"""Estimated errors: differences from a second solution of the same scene at another tolerance.

The second solution has a tenth of the tolerance, so the difference is the error of the first within about ten
per cent. Close to rounding it has ten times the tolerance, and the difference is an upper estimate.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from rockjax import _results as results
from rockjax._checks import float_type
from rockjax._options import LEAST_ATOL, Options
from rockjax._outputs.registry import VARIABLES, variables_of
from rockjax._outputs.values import by_name
from rockjax._tree import Module

# The true error is below this times the estimate, except for one scene in a hundred (docs/verification.md).
SAFETY = 10.0
FINER = 0.1
# Two solutions of chaotic rocking agree only by chance; a tighter threshold makes this less likely.
PARTED = 0.005  # difference of energetic impacts, 1/16 % of the speed of one from which columns overturn
# Errors above this multiple of the tolerance and this share of the peak: the difference of two solutions is
# then one random draw, and says little about others.
AMPLIFIED, LARGE = 1e5, 1e-3
FALL_APART = 0.01  # difference of overturning times [1/p]: 1 % in the distance to the boundary
SHORTER = 0.7  # factor on steps that the tolerance does not limit


class Errors(Module):
    """Estimated errors of the answers of a scene, and whether its outcome is undecided.

    - `peak_rotation` [–], `peak_deformation` [m], `peak_shear` [–], …: estimated absolute errors of the
      answers of these names, held by `values`; inf for scenes without an answer, NaN for outputs that were
      not requested, None for outputs that the podium does not have
    - `undecided`: an error of ten times the estimate would change whether the columns overturn; or the
      rocking is so sensitive that two solutions differ in impacts from which columns can overturn, in the
      time of overturning, or in the peak rotation by more than 10⁵ `rtol` and a thousandth of it
    """

    values: dict[str, Any]
    undecided: Bool[Array, "*batch"]

    def __getattr__(self, name: str) -> Any:
        return by_name(self, name)


def companion(options: Options) -> Options:
    """Return the options of the second solution."""
    rtol, atol = options.rtol, options.atol
    larger = max if isinstance(atol, int | float) else jnp.maximum
    finer, looser = (FINER * rtol, larger(FINER * atol, LEAST_ATOL)), (rtol / FINER, atol / FINER)
    room = FINER * rtol >= 100 * float(np.finfo(float_type()).eps)
    if isinstance(room, bool):  # plain numbers, so that the program of the first solution is reused
        tolerances = finer if room else looser
    else:
        tolerances = jax.tree.map(lambda a, b: jnp.where(room, a, b), finer, looser)
    return eqx.tree_at(lambda o: (o.rtol, o.atol, o._stride), options, (*tolerances, SHORTER))


def _have_diverged(a: dict[str, Any], b: dict[str, Any], xp) -> Any:
    """Return whether the two solutions have diverged after impacts from which columns can overturn.

    In chaotic rocking both may survive by chance with the same earlier peak. The longer solution may have one
    more impact. If both overturn, their times are compared.
    """
    difference, last = a["energetic"] - b["energetic"], (a["last_energetic"], b["last_energetic"])
    one_more = xp.minimum(abs(difference - last[0]), abs(difference + last[1]))
    # Equal sums, although the last impacts of the two differ.
    by_chance = (abs(last[0] - last[1]) > PARTED) & (xp.minimum(*last) > PARTED)
    as_many = xp.where(by_chance, xp.inf, abs(difference))
    falls = abs(a["fall_time"] - b["fall_time"]) > FALL_APART  # False if one of them is NaN
    return falls | (xp.minimum(as_many, one_more) > PARTED)


def errors(first: tuple[dict[str, Any], dict[str, Any]], second, options: Options, xp) -> Errors:
    """Return the error estimates from two solutions of the same scenes.

    - `first`, `second`: (floats, integers) of each solution, by name
    - `options`: of the first solution
    - `xp`: NumPy for batches on the host, else jax.numpy
    """
    rtol, overturn_ratio = (xp.asarray(y) for y in (options.rtol, options.overturn_ratio))
    if xp is jnp:
        first, second = jax.lax.stop_gradient((first, second))
    (a, flags), (b, others) = first, second
    unknown = (flags["code"] > results.OVERTURNED) | (others["code"] > results.OVERTURNED)

    def difference_of(name):
        same = a[name] == b[name]  # friction may be inf in both
        difference = abs(xp.where(same, 0.0, a[name]) - xp.where(same, 0.0, b[name]))
        unfinished = unknown[(..., *[None] * (difference.ndim - unknown.ndim))]
        return xp.where(unfinished & ~xp.isnan(a[name]), xp.inf, difference)

    rotation = difference_of("peak_rotation")
    falls = flags["overturned"]
    # The excess energy of a column at the overturning angle vanishes on the boundary.
    close = xp.where(
        falls,
        a["fall"] < SAFETY * difference_of("fall"),
        a["peak_rotation"] + SAFETY * rotation >= overturn_ratio,
    )
    sensitive = rotation > xp.maximum(AMPLIFIED * rtol, LARGE) * a["peak_rotation"]
    undecided = unknown | (falls != others["overturned"]) | close | sensitive | _have_diverged(a, b, xp)
    variables = VARIABLES | variables_of(options.outputs)
    values = {
        name: difference_of(name) for name, (each, _) in variables.items() if each.estimated and name in a
    }
    return Errors(values, undecided)
