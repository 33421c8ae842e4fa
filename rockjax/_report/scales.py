"""Least factors on motions that lift or overturn the columns.

A scene is the structure under one motion multiplied by a factor. A boundary is a factor at which the outcome
changes between survival and overturning. A window is an interval of factors between two boundaries, with the
same outcome for all factors inside.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from rockjax import _results as results
from rockjax._batch.batch import LANES
from rockjax._boundaries.boundary import BOUNDARY, boundary_slopes
from rockjax._boundaries.crossings import Plane, margins, scan
from rockjax._boundaries.first import BRACKET_TOLERANCE, ROW_SIZE
from rockjax._excitations.base import AbstractExcitation
from rockjax._motions.convert import as_batch
from rockjax._options import Options
from rockjax._responses.variants import pick_motions
from rockjax._roots import Brackets, narrow_brackets
from rockjax._structures import Podium

from .derivatives import SlopesFunction, leaf_directions, prepare_solved_answers, solved_answers
from .problem import MotionSet, Problem
from .scenes import Scenes, with_given_restitution
from .store import Stored, fingerprint
from .uplift import UpliftRatio

if TYPE_CHECKING:
    import xarray

MAX_SCALE = 10.0  # largest factor in the search for overturning
JUST_BELOW = 1 - 1e-6  # a boundary times this factor gives a scene just below the boundary
# The search for the end of a window of overturning starts with scenes at these multiples of the least
# overturning factor.
WINDOW_FACTORS = 1 + np.geomspace(1e-6, 1.0, 32)
BOUNDARY_ERROR = 1e-9  # relative error of overturning factors that are searched with `boundary_options` [–]


def least_factors(scenes: Scenes, name: str, event: str, law: str | None = None) -> xarray.Dataset:
    """Return for each motion of a set the least factor that lifts or overturns the columns, along `motion`.

    - `scenes`: the scenes of the problem
    - `name`: name of the set; `event`: "uplift" or "overturning"
    - `law`: law of impact that replaces the law of the structure; None for no change. It does not change
      factors that lift the columns, because no impact precedes uplift

    The variables of the dataset are `factor`, its estimated `error`, and `end`, the factor up to which all
    scenes of the search finished. The variable `is_open` is True if `end` is less than `factor` because
    scenes at lower factors did not finish; a lower factor may then overturn the columns. For a motion that
    does not overturn the columns in the finished scenes, `factor` is inf and `error` is NaN. For uplift,
    `end` is inf.

    For overturning there are three more variables, `survives_from`, `overturns_again_from` and `window_end`.
    The columns overturn at factors from `factor` to `survives_from`, and survive from there to
    `overturns_again_from`. Both variables are searched up to `window_end`: twice `factor`, or the last factor
    before a scene that did not finish. A variable that is not found is NaN. Narrow windows may be missed.

    Raises `ValueError` for a motion without horizontal acceleration, `RuntimeError` if the least uplift
    factor is too small to be found, and `UnfinishedScenesError` if a scene without uplift does not finish.
    These errors occur for "uplift" only.
    """
    return scenes.store.get(*_stored_search(scenes, name, event, law))


def start_search(scenes: Scenes, name: str, event: str) -> bool:
    """Start the searches of `least_factors` under all laws of impact in other threads, unless their results
    are stored. Return False if all results are stored, otherwise True."""
    laws = (None, *scenes.laws) if event == "overturning" else (None,)
    started = [scenes.store.start(*_stored_search(scenes, name, event, law)) for law in laws]
    is_started = any(started)
    if is_started and event == "uplift":  # `least_factor_slopes` will need this program
        prepare_solved_answers(scenes, name, _ratio_options(scenes.problem))
    return is_started


def _stored_search(scenes: Scenes, name: str, event: str, law: str | None) -> Stored:
    """Return the arguments of `Store.get` for the search of `least_factors`."""
    law = law if law in scenes.laws and event == "overturning" else None
    motions, podium, options = scenes.motion_set(name), scenes.podium(law), scenes.problem.options
    inputs_hash = fingerprint(podium, motions.identities, options, event, MAX_SCALE, WINDOW_FACTORS)

    def solve() -> xarray.Dataset:
        return _uplift(scenes, motions) if event == "uplift" else _overturning(scenes, motions, law)

    return f"scales.{name}.{event}" + (f".{law}" if law else ""), inputs_hash, solve


def just_below(factors: np.ndarray, end: float | np.ndarray = MAX_SCALE) -> np.ndarray:
    """Return factors just below the boundaries `factors`. A factor that is not finite means that the search
    found no boundary. In its place, return `end`, the end of the search."""
    return np.where(np.isfinite(factors), JUST_BELOW * factors, end)


def _uplift(scenes: Scenes, motions: MotionSet) -> xarray.Dataset:
    import xarray

    scenes.describe(f"uplift factors of {motions.name}")
    factor = _estimate_uplift_factors(scenes, motions)
    # At 0.9 times the estimate the columns do not lift. A second solution there gives the factor and its
    # error.
    excitations = [y.scaled(0.9 * f) for y, f in zip(motions.excitations, factor, strict=True)]
    data = scenes.solve(scenes.problem.podium, excitations, _uplift_options(scenes.problem), ("motion",))
    _check_finished(motions, data["result"].values)
    factor = 0.9 * factor / data["uplift_ratio"].values
    error = factor * data["uplift_ratio_error"].values / data["uplift_ratio"].values
    variables = {"factor": factor, "error": error}
    variables |= {"end": np.full(factor.shape, np.inf), "is_open": np.zeros(factor.shape, bool)}
    return xarray.Dataset({name: ("motion", y) for name, y in variables.items()})


def _uplift_options(problem: Problem) -> Options:
    return problem.options.replace(outputs=(UpliftRatio(), "peak_rotation", "errors"), throw=False)


def _ratio_options(problem: Problem) -> Options:
    """Return the options of scenes whose only answer is the uplift ratio."""
    return _uplift_options(problem).replace(outputs=(UpliftRatio(),))


def _estimate_uplift_factors(scenes: Scenes, motions: MotionSet) -> np.ndarray:
    """Return estimates of the least factors that lift the columns, (motions,), from scenes without uplift."""
    from rockjax._batch.batch import peak_responses

    podium, options = scenes.problem.podium, _uplift_options(scenes.problem)
    # The first factors are 0.3 times those that lift a rigid structure. If the columns lift nevertheless,
    # because of vibrations or vertical motion, the factors are reduced.
    largest = np.array([_largest_acceleration(y) for y in motions.excitations])
    if not largest.all():
        name = motions.names[int(np.argmin(largest))]
        raise ValueError(f"{name} has no horizontal acceleration, so no factor on it lifts the columns")
    factors = 0.3 * float(podium.uplift_ground_acceleration) / largest
    for _ in range(20):
        excitations = [y.scaled(f) for y, f in zip(motions.excitations, factors, strict=True)]
        peaks = peak_responses(podium, excitations, options=options)
        codes = np.asarray(results.code_of(peaks.result))
        # Vertical motion lifts the columns before their weight vanishes.
        uplifted = np.asarray(peaks.uplifted) | (codes == results.WEIGHTLESS)
        _check_finished(motions, codes[~uplifted])
        if not np.any(uplifted):
            return factors / np.asarray(peaks.uplift_ratio)
        factors = np.where(uplifted, factors / 3, factors)
    raise RuntimeError(
        f"report: a motion of {motions.name} lifts the columns even if multiplied by "
        f"{3 * factors.min():.2g}; check the unit of the motions"
    )


class UnfinishedScenesError(RuntimeError):
    """Raised if a value is unknown because scenes did not finish."""


def _check_finished(motions: MotionSet, codes: np.ndarray) -> None:
    """Raise `UnfinishedScenesError` if a scene without uplift did not finish. `codes`: results of the
    scenes."""
    failures = results.explain_failures(codes)
    if failures:
        raise UnfinishedScenesError(f"the uplift factors of {motions.name} are unknown: {failures}")


def _overturning(scenes: Scenes, motions: MotionSet, law: str | None) -> xarray.Dataset:
    """Return the result of `least_factors` for overturning. With a `law`, windows are not searched."""
    import xarray

    scenes.describe(f"overturning factors of {motions.name}" + (f" with the law {law}" if law else ""))
    options = boundary_options(scenes.problem)
    scaled = _scaled_motions(with_given_restitution(scenes.podium(law)), motions)

    def plane(motion: np.ndarray, factor: np.ndarray) -> tuple[Podium, Any]:
        scenes.store.raise_if_stopped()
        return scaled(motion, factor)

    # As in `overturning_boundary`, the search is over fractions of the largest factor, so that the factors
    # are those of `overturning_scale` bit for bit.
    search = lambda motion, fraction: plane(motion, fraction * MAX_SCALE)
    found = scan(search, np.arange(len(motions)), (0.0, 1.0), ROW_SIZE, options, first_only=True)
    factors, _ = found.crossings.first(len(motions))
    factors, finished_to = factors * MAX_SCALE, found.finished_to * MAX_SCALE
    # Boundaries are narrowed to rounding, so the errors of the scenes alone determine the error of a factor.
    error = np.where(np.isfinite(factors), factors * BOUNDARY_ERROR, np.nan)
    variables = {
        "factor": factors,
        "error": error,
        "end": np.minimum(MAX_SCALE, finished_to),
        "is_open": np.isfinite(factors) & (finished_to < JUST_BELOW * factors),
    }
    if law is None:
        names = "survives_from", "overturns_again_from", "window_end"
        variables |= zip(names, _window_ends(plane, factors, options), strict=True)
    return xarray.Dataset({name: ("motion", y) for name, y in variables.items()})


def _scaled_motions(podium: Podium, motions: MotionSet) -> Plane:
    """Return the function (indices of motions, factors) ↦ (podium, motions multiplied by the factors)."""
    batch = as_batch("report", motions.excitations)
    # The elevation, and restrainers without strength, do not affect the motion of the columns.
    structure = podium.split_rows().without_idle_restrainers().without_elevation()
    return lambda motion, factor: (structure, pick_motions(batch, motion).scaled(factor))


def _window_ends(plane: Plane, factors: np.ndarray, options: Options) -> np.ndarray:
    """Return three rows of factors, (3, motions): the factors at which the first window of overturning ends,
    the factors at which the next window of overturning begins, and the largest searched factors. A factor
    that was not found is NaN. The search for a motion ends before the first scene that does not finish.

    - `plane`: result of `_scaled_motions`
    - `factors`: the least overturning factors, (motions,); inf where none was found
    - `options`: options of the scenes
    """
    overturning = np.flatnonzero(np.isfinite(factors))  # indices of the motions

    def evaluate(motion: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        margin, impacts, _ = margins(plane, np.repeat(motion, y.shape[1]), y.ravel(), options)
        return margin.reshape(y.shape), impacts.reshape(y.shape)

    ends = np.full((3, factors.size), np.nan)
    if overturning.size == 0:
        return ends
    y = factors[overturning, None] * WINDOW_FACTORS
    margin, impacts = evaluate(overturning, y)
    finished, points = np.logical_and.accumulate(~np.isnan(margin), axis=1), np.arange(WINDOW_FACTORS.size)
    survives, overturns = finished & (margin > 0), finished & (margin <= 0)
    first = np.argmax(survives, axis=1)  # 0 if no point survives
    again = np.argmax(overturns & (points > first[:, None]), axis=1)  # 0 if all later points survive
    # If the first point did not finish, nothing is known above the least overturning factor.
    last = np.max(np.where(finished, y, factors[overturning, None]), axis=1)
    ends[2, overturning] = last
    # The first change of the outcome is between the points first − 1, which overturns, and first, which
    # survives. The second is between again − 1, which survives, and again, which overturns.
    for change, (survivor, other) in enumerate(((first, first - 1), (again - 1, again))):
        found = np.flatnonzero((first > 0) & ((again > 0) | (change == 0)))
        if found.size:
            at = lambda table, k, found=found: table[found, k[found]]
            brackets = Brackets(
                at(y, survivor), at(y, other), at(margin, survivor), at(margin, other), at(impacts, other)
            )
            solve = lambda rows, y, found=found: evaluate(overturning[found][rows], y)
            final = narrow_brackets(brackets, solve, BRACKET_TOLERANCE, LANES)
            ends[change, overturning[found]] = 0.5 * (final.a + final.b)
    return ends


def boundary_options(problem: Problem) -> Options:
    """Return the options of searches for boundaries of overturning."""
    return BOUNDARY.replace(overturn_ratio=problem.options.overturn_ratio)


def least_factor_slopes(scenes: Scenes, event: str, name: str, motion: int) -> SlopesFunction:
    """Return a function that computes the least factor on a motion, and the derivatives of this factor with
    respect to the n + 1 logarithms that `derivatives.py` defines.

    - `scenes`: the scenes of the problem
    - `event`: "uplift" or "overturning"
    - `name`: name of the set of motions; `motion`: index of the motion in the set
    """
    problem, excitation = scenes.problem, scenes.motion_set(name).excitations[motion]
    factor = float(least_factors(scenes, name, event)["factor"][motion])
    if event == "overturning":
        return lambda: (factor, overturning_slopes(problem, excitation, factor))
    scale = 0.9 * factor

    def least_factor() -> tuple[np.ndarray, np.ndarray]:
        answers = solved_answers(problem, excitation.scaled(scale), _ratio_options(problem))
        ratio, slopes = answers["uplift_ratio"]
        return scale / ratio, -scale / ratio**2 * slopes

    return least_factor


def overturning_slopes(
    problem: Problem, excitation: AbstractExcitation, factor: float, options: Options | None = None
) -> np.ndarray:
    """Return the derivatives of the least overturning factor on a motion with respect to the n + 1 logarithms
    that `derivatives.py` defines.

    - `problem`: the problem; `excitation`: the motion; `factor`: least factor on the motion that overturns
    - `options`: options of the scenes; by default those of `boundary_options`
    """
    podium = problem.differentiable_podium.split_rows().without_elevation()
    options = boundary_options(problem) if options is None else options
    slopes, positions = boundary_slopes(podium, excitation, factor, MAX_SCALE, options)
    directions = leaf_directions(problem, excitation, with_elevation=False)
    return slopes @ np.array([directions[i] for i in positions])


def _largest_acceleration(excitation: Any) -> float:
    """Return the largest absolute horizontal acceleration of an excitation [m/s²]. If the excitation has no
    samples, it is evaluated at 1001 times."""
    horizontal = getattr(excitation, "horizontal", excitation)
    samples = getattr(horizontal, "acceleration", None)
    if samples is not None:
        return float(np.abs(np.asarray(samples)).max()) * float(abs(horizontal.scale))
    start, end = (float(y) for y in horizontal.support)
    return float(np.abs(np.asarray(jax.vmap(horizontal)(jnp.linspace(start, end, 1001)))).max())
