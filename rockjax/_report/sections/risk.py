"""Section 7: fragility, annual frequency and probabilities of overturning."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rockjax._report.blocks import Equation, Equations, Paragraph, Section
from rockjax._report.tables import Formula
from rockjax._report.units import Units

from .common import details

if TYPE_CHECKING:
    from rockjax._report.evaluation import Evaluation


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
    return Section(7, title, tuple(blocks))
