"""Warnings about the joints: whether the model's own assumptions hold."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np

    import rockjax as rj

# What is read, besides whether scenes overturn.
ANSWERS = "least_axial_force", "least_impulse_share", "peak_friction", "peak_impact_friction"
OUTPUTS = ("peak_friction", "axial_force", "impact_friction")
ROUNDING = 1e-9  # of ξ_J above 1


def request_joints(podium: rj.Podium, options: rj.Options) -> rj.Options:
    """Return the options with outputs of the joints if the podium has an elevation."""
    if podium.elevation is None:
        return options
    return options.replace(outputs=tuple(dict.fromkeys((*options.outputs, *OUTPUTS))))


def joint_warnings(podium: rj.Podium, peaks: Any, friction: float | None) -> Iterator[str]:
    """Yield lines on joints that open, need more friction than there is, or were not checked.

    - `podium`: the structure
    - `peaks`: anything with `ANSWERS` as attributes, of one scene or of many; scenes that overturn do not
      count among many. None without scenes
    - `friction`: friction coefficient μ of the joints; None if unknown
    """
    import numpy as np

    place = float(podium.impact_eccentricity)
    if place > 1 + ROUNDING:
        yield (
            f"warning: e = {float(podium.restitution_factor):.4g} is less than rigid faces leave at an "
            f"impact: the old edges would have to pull (impact_eccentricity = {place:.3g} > 1)"
        )
    if podium.elevation is None:
        yield "not checked: friction in the joints, and whether the beam stays on all columns (no elevation)"
        return
    if peaks is None:
        return
    overturned = np.asarray(peaks.overturned)
    stands = ~overturned if overturned.ndim else np.ones((), bool)

    def worst(name: str, side: int) -> np.ndarray:
        """Return the largest (`side` 1) or least (−1) value of both joints in each scene that counts."""
        values = getattr(peaks, name)
        joint = values.dims.index("joint") if hasattr(values, "dims") else -1
        return side * np.max(side * np.asarray(values), axis=joint)[stands]

    least, share = worst("least_axial_force", -1), worst("least_impulse_share", -1)
    if least.size == 0:
        return
    opens = (least < 0) | (share < 0)
    if opens.any():
        yield (
            f"warning: a joint opens{_among(opens)} (least N = {least.min():.4g} m_c g, least share of an "
            f"impulse {share.min():.3g}); such a scene is outside the model from then on"
        )
    if friction is None:
        return
    for what, name in (("the motion", "peak_friction"), ("an impact", "peak_impact_friction")):
        demand = worst(name, 1)
        slides = demand > friction
        if slides.any():
            yield (
                f"warning: {what} needs friction {demand.max():.3g} in a joint, more than μ = "
                f"{friction:g}{_among(slides)}"
            )


def _among(flags: np.ndarray) -> str:
    """Return how many scenes of several are meant."""
    return f" in {int(flags.sum())} of {flags.size} scenes that survive" if flags.size > 1 else ""
