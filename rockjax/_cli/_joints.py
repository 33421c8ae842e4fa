"""Warnings about assumptions of the model that do not hold at the joints.

The model assumes that the joints do not slide, that the beam stays on all columns, and that impacts with the
restitution of the podium are possible between rigid faces.

Each column has two joints, with the ground and with the beam. docs/forces.md describes the forces in them.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np

    import rockjax as rj

# Variables of the checks, and the outputs that contain them.
OPENING = {"least_axial_force": "axial_force", "least_impulse_share": "impact_friction"}
SLIDING = {"peak_friction": "peak_friction", "peak_impact_friction": "impact_friction"}
VARIABLES = (*OPENING, *SLIDING)
OUTPUTS = ("peak_friction", "axial_force", "impact_friction")
LIFT_OFF, FRICTION = "whether the beam stays on all columns", "friction in the joints"


def check_restitution_by_line() -> None:
    """Suppress the Python warning about a small restitution factor, because the command prints the lines of
    `joint_warnings`."""
    warnings.filterwarnings("ignore", "restitution factor too small")


def request_joints(podium: rj.Podium, options: rj.Options) -> rj.Options:
    """Return the options. If the podium has an elevation (positions of columns, heights of masses), the
    outputs `OUTPUTS` are added. Also calls `check_restitution_by_line`."""
    check_restitution_by_line()
    if podium.elevation is None:
        return options
    return options.replace(outputs=tuple(dict.fromkeys((*options.outputs, *OUTPUTS))))


def joint_warnings(podium: rj.Podium, peaks: Any, friction: float | None) -> Iterator[str]:
    """Yield a line for each assumption about the joints that does not hold or cannot be checked.

    - `podium`: the structure
    - `peaks`: the response of a scene, or a dataset of a batch, with `overturned` and, in a batch, codes
      `result`; None if no scene was solved. It may lack some of `VARIABLES`; their checks are then omitted.
      In a batch, scenes that overturn or do not finish are ignored. A single scene is always checked
    - `friction`: friction coefficient μ of the joints [–]; None to omit the checks of friction
    """
    from rockjax._structures.impulses import LARGEST_ECCENTRICITY

    eccentricity = float(podium.impact_eccentricity)
    if eccentricity > LARGEST_ECCENTRICITY:
        yield (
            f"warning: e = {float(podium.restitution_factor):.4g} is too small for rigid faces: at an impact "
            f"the old edges would need tension (impact_eccentricity = {eccentricity:.3g} > 1)"
        )
    reason = "the structure has no elevation" if podium.elevation is None else "there are no motions"
    if podium.elevation is None or peaks is None:
        yield f"not checked, because {reason}: {FRICTION}, and {LIFT_OFF}"
        return
    extremes = _extremes(peaks)
    if any(values.size == 0 for values in extremes.values()):
        yield f"not checked, because no scene survives: {FRICTION}, and {LIFT_OFF}"
        return
    yield from _missing(extremes, friction)
    yield from _openings(extremes)
    if friction is not None:
        yield from _slips(extremes, friction)


def _extremes(peaks: Any) -> dict[str, np.ndarray]:
    """Return the worse value of the two joints of a column for each surviving scene, by name. Variables that
    `peaks` does not have are left out."""
    import numpy as np

    from rockjax._results import did_not_finish

    overturned, survives = np.asarray(peaks.overturned), np.ones((), bool)
    if overturned.ndim:
        survives = ~(overturned | did_not_finish(np.asarray(peaks.result)))
    extremes = {}
    for name in VARIABLES:
        values = getattr(peaks, name, None)
        if values is not None:
            joint_axis = values.dims.index("joint") if hasattr(values, "dims") else -1
            worse = np.min if name in OPENING else np.max
            extremes[name] = worse(np.asarray(values), axis=joint_axis)[survives]
    return extremes


def _missing(extremes: dict[str, np.ndarray], friction: float | None) -> Iterator[str]:
    """Yield a line that names the checks without a variable, and the outputs that they need."""
    checks = {LIFT_OFF: OPENING} | ({} if friction is None else {FRICTION: SLIDING})
    outputs = {name: y for check in checks.values() for name, y in check.items() if name not in extremes}
    subjects = [subject for subject, check in checks.items() if any(name in outputs for name in check)]
    if outputs:
        names = ", ".join(dict.fromkeys(outputs.values()))
        yield f"not checked completely: {', and '.join(subjects)} (request the outputs {names})"


def _openings(extremes: dict[str, np.ndarray]) -> Iterator[str]:
    """Yield a warning if a joint opens in a surviving scene."""
    import numpy as np

    found = {name: extremes[name] for name in OPENING if name in extremes}
    opens = np.any([values < 0 for values in found.values()], axis=0)  # for each scene
    if np.any(opens):
        texts = {
            "least_axial_force": "N = {:.4g} m_c g",
            "least_impulse_share": "share of the mean impulse {:.3g}",
        }
        least = ", ".join(f"least {texts[name].format(values.min())}" for name, values in found.items())
        note = _scenes_note(opens)
        yield f"warning: a joint opens{note} ({least}); from then on the model does not apply"


def _slips(extremes: dict[str, np.ndarray], friction: float) -> Iterator[str]:
    """Yield a warning for motions and for impacts that need more than the friction coefficient `friction`."""
    for cause, name in (("the motion", "peak_friction"), ("an impact", "peak_impact_friction")):
        demand = extremes.get(name)
        if demand is not None and (demand > friction).any():
            yield (
                f"warning: {cause} needs friction {demand.max():.3g} in a joint, more than μ = "
                f"{friction:g}{_scenes_note(demand > friction)}"
            )


def _scenes_note(flags: np.ndarray) -> str:
    """Return a phrase with the number of flagged scenes; an empty string for a single scene."""
    return f" in {int(flags.sum())} of {flags.size} surviving scenes" if flags.size > 1 else ""
