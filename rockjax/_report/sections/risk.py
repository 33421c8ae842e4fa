"""Section 7: fragility, annual frequency and probabilities of overturning."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, Any

from rockjax._lognormal import Lognormal
from rockjax._report.blocks import Equation, Equations, Figure, Paragraph, Section
from rockjax._report.cells import slug
from rockjax._report.kinds.risk import AnnualKind, FragilityKind
from rockjax._report.pictures import to_svg
from rockjax._report.tables import Formula, Quantity, plain
from rockjax._report.units import Units, kind_of_unit

from .common import details, in_page_units, in_pairs, stored_figure

if TYPE_CHECKING:
    import xarray

    from rockjax._report.evaluation import Check, Evaluation
    from rockjax._risk.hazard import Hazard


def section(evaluation: Evaluation, units: Units) -> Section:
    """Return section 7 of the page."""
    title = "Probabilities of overturning"
    blocks: list[Any] = [*details(evaluation, 7)]
    if not blocks:
        reasons = [check.reason for check in evaluation.checks if check.kind.section == 7]
        text = reasons[0] if reasons else "No check asks for a fragility, a frequency or a probability."
        return Section(7, title, (Paragraph(text),))
    if any(table.name.startswith("annual") for table in blocks):
        blocks.insert(0, Equations((Equation(Formula("annual_frequency")), Equation(Formula("probability")))))
    return Section(7, title, (*blocks, *in_pairs(_pictures(evaluation, units))))


def _pictures(evaluation: Evaluation, units: Units) -> list[Figure | Paragraph]:
    """Return a picture for each fragility curve, and for each annual frequency."""
    figures: dict[str, Figure | Paragraph] = {}
    unit = units.names, units.g
    for check in evaluation.checks:
        kind = check.kind
        if check.values is None or not isinstance(kind, FragilityKind):
            continue
        curve = kind.curve(check.entry, evaluation.scenes)
        if check.motions and not isinstance(curve, Lognormal):
            name = f"fragility-{slug(check.motions)}-{slug(curve.attrs['measure'])}"
            inputs = _identity(curve), check.motions, unit
            draw = functools.partial(_draw_fragility, curve, name, check.motions, units)
            figures[name] = stored_figure(evaluation, name, inputs, draw)
        if isinstance(kind, AnnualKind):
            name = f"risk-{slug(check.id)}"
            hazard = check.entry.arguments["hazard"]
            inputs = _identity(curve), hazard, check.id, unit
            draw = functools.partial(_draw_risk, curve, hazard, name, check, units)
            figures[name] = stored_figure(evaluation, name, inputs, draw)
    return list(figures.values())


def _identity(curve: Lognormal | xarray.Dataset) -> Any:
    """Return the numbers of a fragility curve, for the fingerprint of its picture."""
    return curve if isinstance(curve, Lognormal) else {str(y): z.values for y, z in curve.items()}


def _draw_fragility(curve: xarray.Dataset, name: str, motions: str, units: Units) -> Figure:
    import matplotlib.pyplot as plt

    from rockjax import plots
    from rockjax.plots._style import in_style

    with in_style():
        figure, axes = plt.subplots(figsize=(4.8, 5.5), layout="constrained")
        plots.fragility(in_page_units(curve, units), axes)
    title = f"Fragility of the set {motions}"
    median = Quantity(float(curve["median_capacity"]), kind_of_unit(curve["at"].attrs["units"]))
    axis = f"{axes.get_ylabel()} as a function of {curve.attrs['measure']}"
    axis = f"{axis[:1].upper()}{axis[1:]}".replace("\n", " ")
    dispersion = f", the dispersion {float(curve['dispersion']):.3g}."
    description = f"{axis}; the median is ", median, dispersion
    svg = to_svg(figure, name, title, plain(description, units))
    return Figure(svg, f"{axis}, set {motions}.", title, description)


def _draw_risk(curve: Any, hazard: Hazard, name: str, check: Check, units: Units) -> Figure:
    from rockjax import plots
    from rockjax._risk.annual import disaggregation

    data = disaggregation(curve, hazard)
    title = f"Annual frequency of check {check.id}"
    caption = (
        "Hazard, fragility, and contributions of the intensities to the annual frequency of check "
        f"{check.id}."
    )
    description = (
        f"{caption} The frequency is {check.value:.4g} a year; {data.attrs['extrapolated']:.0%} of it come "
        "from beyond the hazard curve."
    )
    figure = plots.risk(in_page_units(data, units))
    return Figure(to_svg(figure, name, title, description), caption, title, description)
