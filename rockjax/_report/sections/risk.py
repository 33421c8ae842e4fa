"""Section 7: fragility, annual frequency and probabilities of overturning."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, Any

from rockjax._lognormal import Lognormal
from rockjax._report.blocks import Equation, Equations, Figure, Paragraph, Section
from rockjax._report.cells import slug
from rockjax._report.kinds.risk import AnnualKind, FragilityKind
from rockjax._report.pictures import to_svg
from rockjax._report.tables import Formula
from rockjax._report.units import Units
from rockjax._units import displayed_or_empty

from .common import details, stored_figure

if TYPE_CHECKING:
    import xarray

    from rockjax._report.evaluation import Check, Evaluation
    from rockjax._risk.hazard import Hazard


def section(evaluation: Evaluation, units: Units) -> Section:
    """Return section 7 of the page."""
    del units
    title = "Probabilities of overturning"
    blocks: list[Any] = [*details(evaluation, 7)]
    if not blocks:
        reasons = [check.reason for check in evaluation.checks if check.kind.section == 7]
        text = reasons[0] if reasons else "No check asks for a fragility, a frequency or a probability."
        return Section(7, title, (Paragraph(text),))
    if any(table.name.startswith("annual") for table in blocks):
        blocks.insert(0, Equations((Equation(Formula("annual_frequency")), Equation(Formula("probability")))))
    return Section(7, title, (*blocks, *_pictures(evaluation)))


def _pictures(evaluation: Evaluation) -> list[Figure]:
    """Return a picture for each fragility curve, and for each annual frequency."""
    figures = {}
    for check in evaluation.checks:
        kind = check.kind
        if check.values is None or not isinstance(kind, FragilityKind):
            continue
        curve = kind.curve(check.entry, evaluation.scenes)
        if check.motions and not isinstance(curve, Lognormal):
            name = f"fragility-{slug(check.motions)}-{slug(curve.attrs['measure'])}"
            inputs = _identity(curve), check.motions
            draw = functools.partial(_draw_fragility, curve, name, check.motions)
            figures[name] = stored_figure(evaluation, name, inputs, draw)
        if isinstance(kind, AnnualKind):
            name = f"risk-{slug(check.id)}"
            hazard = check.entry.arguments["hazard"]
            inputs = _identity(curve), hazard, check.id
            draw = functools.partial(_draw_risk, curve, hazard, name, check)
            figures[name] = stored_figure(evaluation, name, inputs, draw)
    return list(figures.values())


def _identity(curve: Lognormal | xarray.Dataset) -> Any:
    """Return the numbers of a fragility curve, for the fingerprint of its picture."""
    return curve if isinstance(curve, Lognormal) else {str(y): z.values for y, z in curve.items()}


def _draw_fragility(curve: xarray.Dataset, name: str, motions: str) -> Figure:
    import matplotlib.pyplot as plt

    from rockjax import plots
    from rockjax.plots._style import in_style

    with in_style():
        figure, axes = plt.subplots(figsize=(6.4, 3.6), layout="constrained")
        plots.fragility(curve, axes)
    title = f"Fragility of the set {motions}"
    median, unit = float(curve["median_capacity"]), curve["at"].attrs["units"]
    description = (
        f"Probability of overturning as a function of {curve.attrs['measure']}; the median is {median:.4g} "
        f"{displayed_or_empty(unit)}".rstrip()
        + "."
    )
    caption = f"Probability of overturning as a function of {curve.attrs['measure']}, set {motions}."
    return Figure(to_svg(figure, name, title, description), caption, title, description)


def _draw_risk(curve: Any, hazard: Hazard, name: str, check: Check) -> Figure:
    from rockjax import plots
    from rockjax._risk.annual import disaggregation

    data = disaggregation(curve, hazard)
    title = f"Annual frequency of check {check.id}"
    description = (
        "Hazard, fragility, and contributions of the intensities to the annual frequency of check "
        f"{check.id}, which is {check.value:.4g} a year."
    )
    caption = (
        "Hazard, fragility, and contributions of the intensities to the annual frequency of check "
        f"{check.id}."
    )
    return Figure(to_svg(plots.risk(data), name, title, description), caption, title, description)
