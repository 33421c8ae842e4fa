"""All kinds of checks, and their keys in problem files. Entries of `[[targets]]` have the same kinds and keys
as `[[checks]]`."""

from __future__ import annotations

import functools
from typing import Annotated, Any, Literal

from pydantic import Field, create_model

from rockjax._problem import models
from rockjax._problem.models import Positive, key
from rockjax._report.entry import CheckKeys
from rockjax._report.units import KINDS as QUANTITIES

from .base import Kind
from .floors import FloorKind
from .outside import ByOthers, OutsideModel
from .peaks import NoOverturning, peak_kinds
from .risk import AnnualKind, FailureKind, FragilityKind, ShareKind
from .searches import PulseKind, ScaleKind

# Keys that only some kinds have: name → (type, description).
_DESIGN_ONLY = " Only `rockjax design` uses it."
_WIDTH_MEANING = (
    "A range of overturning amplitudes that is narrower than this fraction of the largest searched amplitude "
    "may be missed [–]."
)
_WIDTH = {"width": (Positive, _WIDTH_MEANING)}
_DESIGN_WIDTH = {"width": (Positive, _WIDTH_MEANING + _DESIGN_ONLY)}
_SCALE = {
    "max_scale": (Positive, "Largest searched factor on the motions [–]." + _DESIGN_ONLY)
} | _DESIGN_WIDTH
_PULSE = {
    "pulse": (models.PulseName, "Kind of the pulse."),
    "T_p": (models.Periods, "Periods of the pulse [s]."),
    "frequency_ratio": (models.Periods, "Frequencies ω_p/p of the pulse [–], instead of its periods."),
    "ratio": (bool, "Whether the limit is given as a_p/(g tan α)."),
    "max_acceleration_ratio": (Positive, "Largest searched amplitude, as a_p/(g tan α) [–]."),
}
_ANNUAL = {
    "hazard": (str, "File of a hazard curve, relative to the folder of this file; by default risk.hazard."),
    "max_intensity": (
        Positive,
        "Largest searched intensity, in the SI unit of the hazard; by default the last point of the hazard."
        + _DESIGN_ONLY,
    ),
}
_SHARE = {
    "intensity": (Positive, "Factor on the motions [–]; by default 1."),
    "smoothing": (Positive, "Bandwidth h of the smoothed share [–]." + _DESIGN_ONLY),
}
_FAILURE = {
    "motion": (models.GaussianKeys, "The random motion."),
    "cov": (Positive, "Coefficient of variation of the estimate at which sampling stops [–]."),
    "rays": (
        Annotated[int, Field(ge=8)],
        "Number of rays, half-lines through failing samples." + _DESIGN_ONLY,
    ),
    "seed": (models.Index, "Seed of the samples."),
}
_OTHERS = {"text": (models.Text, "What is checked."), "reference": (models.Text, "Where it is checked.")}
_KINDS: tuple[Kind, ...] = (
    *peak_kinds(),
    NoOverturning("no-overturning", "No motion overturns the columns", "number", has_limit=False),
    ScaleKind("overturning-scale", "Least factor on the motions that overturns", "number", True, keys=_SCALE),
    ScaleKind(
        "uplift-scale", "Least factor on the motions that lifts the columns", "number", True, event="uplift"
    ),
    PulseKind(
        "overturning-acceleration",
        "Least amplitude of pulses that overturns",
        "acceleration",
        True,
        keys=_PULSE | _WIDTH,
        needs_motions=False,
    ),
    FragilityKind(
        "median-capacity",
        "Median overturning intensity of the set",
        "number",
        True,
        section=7,
        keys=_SCALE,
        has_one_value=True,
        skip_name="risk",
    ),
    AnnualKind(
        "annual-frequency",
        "Annual frequency of overturning",
        "rate",
        section=7,
        keys=_ANNUAL | _DESIGN_WIDTH,
        has_one_value=True,
        skip_name="risk",
    ),
    ShareKind(
        "overturning-probability",
        "Share of the motions that overturn",
        "ratio",
        section=7,
        keys=_SHARE,
        has_one_value=True,
    ),
    FailureKind(
        "failure-probability",
        "Probability of overturning under a random motion",
        "ratio",
        section=7,
        keys=_FAILURE,
        needs_motions=False,
        has_one_value=True,
        skip_name="risk",
    ),
    FloorKind(
        "contents-rotation",
        "Rotation of contents max|φ|/α_c",
        "number",
        section=6,
        keys={"contents": (list[str], "Names of [[contents]]; by default all.")},
        table="contents",
        dim="contents",
        peak="peak_rotation",
        symbol="max|φ|/α_c",
    ),
    FloorKind(
        "floor-spectrum",
        "Pseudo-acceleration of oscillators on floors",
        "acceleration",
        section=6,
        keys={"oscillators": (list[str], "Names of [[oscillators]]; by default all.")},
        table="oscillators",
        dim="oscillator",
        peak="pseudo_acceleration",
        symbol="PSA",
    ),
    OutsideModel(
        "sliding-displacement",
        "Sliding displacement",
        "displacement",
        section=10,
        reason="Columns do not slide in the model (A1); the check peak-friction gives the friction demand.",
    ),
    OutsideModel(
        "soil-rotation",
        "Rotation of the soil",
        "angle",
        section=10,
        reason="The ground is rigid in the model (A5); a model with soil springs would be needed.",
    ),
    OutsideModel(
        "two-directions",
        "Motion in two directions",
        "number",
        section=10,
        reason="Motion is in a plane in the model (A3); a spatial model would be needed.",
    ),
    ByOthers(
        "by-others", "By others", "number", section=10, keys=_OTHERS, needs_motions=False, has_limit=False
    ),
)
KINDS = {kind.name: kind for kind in _KINDS}
assert {kind.quantity for kind in _KINDS} <= set(QUANTITIES)


@functools.cache
def check_model(kind: str) -> type[CheckKeys]:
    """Return the pydantic model of the tables `[[checks]]` and `[[targets]]` with this `kind`."""
    fields: Any = {
        name: (type_ | None, key(None, meaning)) for name, (type_, meaning) in KINDS[kind].keys.items()
    }
    fields["kind"] = Literal[kind], key(..., "Kind of the check.")
    return create_model(kind, __base__=CheckKeys, **fields)
