"""Estimated errors: differences between two solutions of the same scene with different tolerances.

The second tolerance is a tenth of the first. The difference then equals the error of the first solution
within about 10 %. If a tenth of the first tolerance is too close to rounding, the second tolerance is ten
times the first, and the difference overestimates the error.
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

# The true error of the rotation is below SAFETY times its estimate in 99.86 % of two million random scenes
# (docs/verification.md). A scene is undecided if an error of SAFETY times the estimate could change whether
# the columns overturn.
SAFETY = 10.0
TOLERANCE_RATIO = 0.1  # second tolerance divided by the first, unless rounding prevents this
# Two solutions have diverged if their weighted sums over impacts (`EnergeticImpacts` in _outputs/impacts.py)
# differ by more than this. For example, the sum changes by this amount if the speed of one impact with
# |θ̇⁻| = pα changes by 1/16 %. A lower threshold makes it less likely that chaotic solutions agree by chance.
SUM_DIFFERENCE = 0.005
# Rocking is chaotic if the difference between the peak rotations of the two solutions, divided by the peak
# rotation, exceeds both CHAOTIC_RTOLS times `rtol` and CHAOTIC_CHANGE. Such a difference is random and does
# not estimate the error.
CHAOTIC_RTOLS, CHAOTIC_CHANGE = 1e5, 1e-3
# Two solutions have diverged if their overturning times, multiplied by p, differ by more than this [–]. Close
# to the overturning boundary, a change of the distance to the boundary by 1 % has this effect.
FALL_DIFFERENCE = 0.01
STRIDE_FACTOR = 0.7  # factor on the largest step length in the second solution


class Errors(Module):
    """Estimated errors of the answers of a scene, and whether its outcome is undecided.

    The errors are differences between two solutions of the scene.

    - `peak_rotation` [–], `peak_deformation` [m], `peak_shear` [–], …: estimated absolute errors of the
      answers with these names. An error is inf if one of the two solutions did not finish. It is NaN or None
      if the answer is NaN or None, and None for answers without an estimate, such as times
    - `undecided`: True in four cases: the columns overturn in only one of the two solutions; an error of ten
      times the estimate could change whether they overturn; one of the solutions did not finish; or rocking
      is chaotic, see below
    - `values`: the estimated errors by name

    Rocking counts as chaotic in three cases: the impacts of the two solutions differ (slow impacts count
    little); the times of overturning differ by more than 0.01/p; or the peak rotations differ by more than
    both 10⁵ `rtol` and 10⁻³ times the peak rotation.
    """

    values: dict[str, Any]
    undecided: Bool[Array, "*batch"]

    def __getattr__(self, name: str) -> Any:
        return by_name(self, name)


def second_options(options: Options) -> Options:
    """Return the options of the second solution. `options` are those of the first."""
    rtol, atol = options.rtol, options.atol
    larger = max if isinstance(atol, int | float) else jnp.maximum
    finer, looser = (
        (TOLERANCE_RATIO * rtol, larger(TOLERANCE_RATIO * atol, LEAST_ATOL)),
        (rtol / TOLERANCE_RATIO, atol / TOLERANCE_RATIO),
    )
    can_be_finer = TOLERANCE_RATIO * rtol >= 100 * float(np.finfo(float_type()).eps)
    # Python numbers stay Python numbers, so that both solutions use the same compiled program.
    if isinstance(can_be_finer, bool):
        tolerances = finer if can_be_finer else looser
    else:
        tolerances = jax.tree.map(lambda a, b: jnp.where(can_be_finer, a, b), finer, looser)
    return eqx.tree_at(lambda o: (o.rtol, o.atol, o._stride), options, (*tolerances, STRIDE_FACTOR))


def _have_diverged(a: dict[str, Any], b: dict[str, Any], xp) -> Any:
    """Return True if two solutions differ in their impacts or in their times of overturning.

    - `a`, `b`: floats of the two solutions by name: `energetic`, the weighted sum over impacts of
      `EnergeticImpacts`, in which slow impacts count little; `last_energetic`, the contribution of the last
      impact to this sum; and `fall_time`, the time of overturning multiplied by p
    - `xp`: NumPy or jax.numpy

    The peaks alone do not show that solutions have diverged: solutions may diverge after their peaks, and
    both may survive by chance. Two solutions that differ only by one more impact at the end of one of them
    have not diverged. Times of overturning are compared if both solutions overturn.
    """
    difference, last = a["energetic"] - b["energetic"], (a["last_energetic"], b["last_energetic"])
    if_one_more = xp.minimum(abs(difference - last[0]), abs(difference + last[1]))
    # The sums may be equal by chance; the last impacts then differ.
    equal_by_chance = (abs(last[0] - last[1]) > SUM_DIFFERENCE) & (xp.minimum(*last) > SUM_DIFFERENCE)
    if_same_count = xp.where(equal_by_chance, xp.inf, abs(difference))
    falls_differ = abs(a["fall_time"] - b["fall_time"]) > FALL_DIFFERENCE  # False if one time is NaN
    return falls_differ | (xp.minimum(if_same_count, if_one_more) > SUM_DIFFERENCE)


def errors(first: tuple[dict[str, Any], dict[str, Any]], second, options: Options, xp) -> Errors:
    """Return the error estimates from two solutions of the same scenes.

    - `first`, `second`: for each solution, (floats, integers), two dicts by name
    - `options`: options of the first solution
    - `xp`: NumPy for batches on the host, else jax.numpy
    """
    rtol, overturn_ratio = (xp.asarray(y) for y in (options.rtol, options.overturn_ratio))
    if xp is jnp:
        first, second = jax.lax.stop_gradient((first, second))
    (a, integers), (b, second_integers) = first, second
    codes = integers["code"], second_integers["code"]
    unfinished = results.did_not_finish(codes[0]) | results.did_not_finish(codes[1])

    def difference_of(name):
        equal = a[name] == b[name]  # both may be inf
        difference = abs(xp.where(equal, 0.0, a[name]) - xp.where(equal, 0.0, b[name]))
        is_unknown = unfinished[(..., *[None] * (difference.ndim - unfinished.ndim))]
        return xp.where(is_unknown & ~xp.isnan(a[name]), xp.inf, difference)

    rotation = difference_of("peak_rotation")
    overturned = integers["overturned"]
    # `fall` is proportional to the kinetic energy at the overturning angle. A scene on the boundary between
    # survival and overturning has the kinetic energy 0 there.
    is_close = xp.where(
        overturned,
        a["fall"] < SAFETY * difference_of("fall"),
        a["peak_rotation"] + SAFETY * rotation >= overturn_ratio,
    )
    is_chaotic = rotation > xp.maximum(CHAOTIC_RTOLS * rtol, CHAOTIC_CHANGE) * a["peak_rotation"]
    undecided = unfinished | (overturned != second_integers["overturned"]) | is_close | is_chaotic
    undecided = undecided | _have_diverged(a, b, xp)
    variables = VARIABLES | variables_of(options.outputs)
    values = {
        name: difference_of(name)
        for name, (variable, _) in variables.items()
        if variable.estimated and name in a
    }
    return Errors(values, undecided)
