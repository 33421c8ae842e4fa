"""Warnings about the joints: whether the model's own assumptions hold."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import rockjax as rj

OUTPUTS = ("peak_friction", "axial_force", "impact_friction")
ROUNDING = 1e-9  # of ξ_J above 1


def with_joints(podium: rj.Podium, options: rj.Options) -> rj.Options:
    """Return the options with outputs of the joints if the podium has an elevation."""
    if podium.elevation is None:
        return options
    return options.replace(outputs=tuple(dict.fromkeys((*options.outputs, *OUTPUTS))))


def joint_warnings(podium: rj.Podium, peak: rj.Peak | rj.Response, friction: float | None) -> Iterator[str]:
    """Yield lines on joints that open, need more friction than there is, or were not checked.

    - `podium`: the structure; `peak`: peaks of one scene
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
    if not bool(peak.joints_closed):
        least = float(np.min(np.asarray(peak.least_axial_force)))
        share = float(np.min(np.asarray(peak.least_impulse_share)))
        yield (
            f"warning: a joint opens (least N = {least:.4g} m_c g, least share of an impulse {share:.3g}); "
            "the scene is outside the model from then on"
        )
    if friction is None:
        return
    for what, values in (("the motion", peak.peak_friction), ("an impact", peak.peak_impact_friction)):
        demand = float(np.max(np.asarray(values)))
        if demand > friction:
            yield f"warning: {what} needs friction {demand:.3g} in a joint, more than μ = {friction:g}"
