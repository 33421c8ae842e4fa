"""The assumptions A1–A9 of the model, and their tests on scenes.

A scene is the structure under one motion.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from rockjax import _results as results
from rockjax._structures.impulses import LARGEST_ECCENTRICITY

if TYPE_CHECKING:
    import xarray

    from .problem import Problem


class Outcome(NamedTuple):
    """Result of testing an assumption on a set of scenes.

    - `violated`: for each scene, whether it violates the assumption, (scenes,)
    - `worst`: number that is inserted in `text`, such as the tested value in the worst scene
    - `text`: description of the result, with `{}` at the place of the number
    - `unfinished`: number of scenes that did not finish, and may violate the assumption later
    - `untested`: number of finished scenes in which the assumption cannot be tested
    """

    violated: np.ndarray
    worst: float
    text: str
    unfinished: int = 0
    untested: int = 0


class Assumption(NamedTuple):
    """An assumption of the model.

    - `id`: number, such as "A1"; `text`: the assumption as a sentence
    - `conservative`: "no" or "depends"; states whether results are on the safe side if the assumption does
      not hold
    - `test`: function (problem, dataset of the peaks of the scenes) ↦ outcome, or a sentence that states why
      there is no outcome
    - `invalidates`: whether a violation turns the result PASS of a check into NOT VALID
    """

    id: str
    text: str
    conservative: str
    test: Callable[[Problem, xarray.Dataset], Outcome | str]
    invalidates: bool = False


def opens_joint(data: xarray.Dataset) -> np.ndarray:
    """Return, for each scene, whether a joint opens, (scenes,).

    A joint opens if its axial force is tensile, or if the vertical impulse on a column at an impact is
    negative. A force or impulse that `data` does not contain is not tested.
    """
    opens = np.zeros(data.sizes["motion"], bool)
    for name in ("least_axial_force", "least_impulse_share"):
        if name in data:
            opens |= data[name].values.min(axis=-1) < 0
    return opens


def _outcome(
    data: xarray.Dataset, violated: np.ndarray, values: np.ndarray, worst: np.ufunc, text: str
) -> Outcome | str:
    """Return the outcome of a test, or a sentence if no scene finished and none violates the assumption.

    - `data`: dataset of the scenes; `violated`, `text`: fields of `Outcome`
    - `values`: tested value of each scene, (scenes,); NaN where unknown
    - `worst`: `np.fmin` if the least value is the worst, `np.fmax` if it is the largest
    """
    unfinished = results.did_not_finish(data["result"].values)
    if unfinished.all() and not violated.any():
        return "Not tested: no scene finished."
    return Outcome(violated, float(worst.reduce(values)), text, int(unfinished.sum()))


def _without_forces(problem: Problem) -> str:
    """Return the reason why joint forces are not tested."""
    key = problem.missing_positions
    return f"Not tested: the file has no {key}." if key else "Not tested: no check asks for joint forces."


# The tests of the assumptions, with the arguments and results of `Assumption.test`.
def _no_sliding(problem: Problem, data: xarray.Dataset) -> Outcome | str:
    mu = problem.joints.friction
    if mu is None:
        return "Not tested: the file has no joints.friction."
    if "peak_friction" not in data:
        return _without_forces(problem)
    demand = _friction_demand(data)
    is_testable = np.isfinite(demand) & ~opens_joint(data)
    if not is_testable.any():
        return "Not tested: under every motion a joint opens or the demand is unknown."
    tested = np.where(is_testable, demand, -np.inf)
    text = "largest demand {} while all joints are closed, against joints.friction"
    outcome = _outcome(data, tested > mu, tested, np.fmax, text)
    if isinstance(outcome, Outcome):
        is_untested = ~is_testable & ~results.did_not_finish(data["result"].values)
        outcome = outcome._replace(untested=int(is_untested.sum()))
    return outcome


def _friction_demand(data: xarray.Dataset) -> np.ndarray:
    """Return the largest friction demand of each scene in motion and, if `data` has it, at impacts,
    (scenes,)."""
    demand = data["peak_friction"].values.max(axis=-1)
    if "peak_impact_friction" in data:  # 0 without impacts
        demand = np.maximum(demand, data["peak_impact_friction"].values.max(axis=-1))
    return demand


def _closed_under_vertical_motion(problem: Problem, data: xarray.Dataset) -> Outcome | str:
    del problem
    codes = data["result"].values
    is_weightless = codes == results.WEIGHTLESS
    unfinished = int((results.did_not_finish(codes) & ~is_weightless).sum())
    text = "{} scenes in which the weight vanishes"
    return Outcome(is_weightless, int(is_weightless.sum()), text, unfinished)


def _beam_rests_on_columns(problem: Problem, data: xarray.Dataset) -> Outcome | str:
    if "least_axial_force" not in data:
        return _without_forces(problem)
    least = data["least_axial_force"].values.min(axis=-1)
    return _outcome(data, opens_joint(data), least, np.fmin, "least axial force {} m_c g of a column")


def _never_tested(reason: str) -> Callable[[Any, Any], str]:
    return lambda problem, data: f"Never tested: {reason}"


def _sharp_edges(problem: Problem, data: xarray.Dataset) -> Outcome | str:
    del problem, data
    return "Tested by checks of the kind contact-pressure only."


def _restitution_laws(problem: Problem, data: xarray.Dataset) -> Outcome | str:
    del data
    note = ""
    if float(problem.podium.impact_eccentricity) > LARGEST_ECCENTRICITY:
        note = (
            " The given factor is too small for rigid faces: at an impact the old edges would need tension."
        )
    if not problem.report.laws:
        return f"Not tested: report.laws has no law.{note}"
    return f"Checks are repeated under the laws {', '.join(problem.report.laws)}; see the table below.{note}"


def _linear_building(problem: Problem, data: xarray.Dataset) -> Outcome | str:
    del problem
    if "peak_drift" not in data:
        return "Never tested: the building must bear the shear of section 6 elastically."
    return "Never tested: the building must bear the shear and the drifts of section 6 elastically."


def _second_order_moments(problem: Problem, data: xarray.Dataset) -> Outcome | str:
    heights = problem.story_heights
    if heights is None or "peak_drift" not in data or "peak_shear" not in data:
        return "Not tested: the structure has no stories with heights."
    drift_ratio = (data["peak_drift"].values / heights).max(axis=-1)
    shear = data["peak_shear"].values
    coefficient = np.divide(drift_ratio, shear, out=np.zeros_like(drift_ratio), where=shear > 0)
    text = "largest drift ratio · W/V {} (usual limit 0.1; W weight, V base shear of the building)"
    return _outcome(data, coefficient > 0.1, coefficient, np.fmax, text)


ASSUMPTIONS = (
    Assumption("A1", "No column slides.", "depends", _no_sliding, True),
    Assumption("A2", "Joints stay closed under vertical motion.", "no", _closed_under_vertical_motion, True),
    Assumption("A3", "Motion is in one plane.", "no", _never_tested("the model has one plane.")),
    Assumption("A4", "Columns turn about sharp edges of full strength.", "no", _sharp_edges),
    Assumption("A5", "The ground is rigid.", "depends", _never_tested("the model has no soil.")),
    Assumption("A6", "Impacts follow the law of restitution.", "depends", _restitution_laws),
    Assumption("A7", "The beam rests on all columns.", "no", _beam_rests_on_columns, True),
    Assumption("A8", "The building stays linear.", "depends", _linear_building),
    Assumption("A9", "Second-order moments in the building are small.", "no", _second_order_moments),
)
INVALIDATING = tuple(assumption for assumption in ASSUMPTIONS if assumption.invalidates)
