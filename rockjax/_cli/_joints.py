"""Warnings about assumptions of the model that do not hold at the joints.

The model assumes that the joints do not slide, that the beam stays on all columns, and that impacts with the
restitution of the podium are possible between rigid faces.

Each column has two joints, with the ground and with the beam. docs/forces.md describes the forces in them.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np

    import rockjax as rj

VARIABLES = ("least_axial_force", "least_impulse_share", "peak_friction", "peak_impact_friction")
OUTPUTS = ("peak_friction", "axial_force", "impact_friction")  # outputs that contain `VARIABLES`
ROUNDING = 1e-9  # allowed rounding error of `Podium.impact_eccentricity` [–]


def request_joints(podium: rj.Podium, options: rj.Options) -> rj.Options:
    """Return the options. If the podium has an elevation (positions of columns, heights of masses), the
    outputs `OUTPUTS` are added."""
    if podium.elevation is None:
        return options
    return options.replace(outputs=tuple(dict.fromkeys((*options.outputs, *OUTPUTS))))


def joint_warnings(podium: rj.Podium, peaks: Any, friction: float | None) -> Iterator[str]:
    """Yield a line for each assumption about the joints that does not hold or cannot be checked.

    - `podium`: the structure
    - `peaks`: the response of a scene, or a dataset of a batch, with `VARIABLES`, `overturned` and, in a
      batch, codes `result`; None to check only the restitution. In a batch, scenes that overturn or do not
      finish are ignored. A single scene is always checked
    - `friction`: friction coefficient μ of the joints [–]; None to omit the checks of friction
    """
    import numpy as np

    from rockjax._results import did_not_finish

    eccentricity = float(podium.impact_eccentricity)
    if eccentricity > 1 + ROUNDING:
        yield (
            f"warning: e = {float(podium.restitution_factor):.4g} is too small for rigid faces: at an impact "
            f"the old edges would need tension (impact_eccentricity = {eccentricity:.3g} > 1)"
        )
    if podium.elevation is None:
        yield (
            "not checked, because the structure has no elevation: friction in the joints, and whether the "
            "beam stays on all columns"
        )
        return
    if peaks is None:
        return
    overturned = np.asarray(peaks.overturned)
    survives = np.ones((), bool)
    if overturned.ndim:
        survives = ~(overturned | did_not_finish(np.asarray(peaks.result)))

    def extreme(name: str, sign: int) -> np.ndarray:
        """Return the larger (`sign` 1) or smaller (`sign` −1) value of the two joints of a column, for each
        surviving scene."""
        values = getattr(peaks, name)
        joint_axis = values.dims.index("joint") if hasattr(values, "dims") else -1
        return sign * np.max(sign * np.asarray(values), axis=joint_axis)[survives]

    axial_force, impulse_share = extreme("least_axial_force", -1), extreme("least_impulse_share", -1)
    if axial_force.size == 0:
        return
    opens = (axial_force < 0) | (impulse_share < 0)
    if opens.any():
        yield (
            f"warning: a joint opens{_scenes_note(opens)} (least N = {axial_force.min():.4g} m_c g, least "
            f"share of the mean impulse {impulse_share.min():.3g}); from then on the model does not apply"
        )
    if friction is None:
        return
    for cause, name in (("the motion", "peak_friction"), ("an impact", "peak_impact_friction")):
        demand = extreme(name, 1)
        slides = demand > friction
        if slides.any():
            yield (
                f"warning: {cause} needs friction {demand.max():.3g} in a joint, more than μ = "
                f"{friction:g}{_scenes_note(slides)}"
            )


def _scenes_note(flags: np.ndarray) -> str:
    """Return a phrase with the number of flagged scenes; an empty string for a single scene."""
    return f" in {int(flags.sum())} of {flags.size} surviving scenes" if flags.size > 1 else ""
