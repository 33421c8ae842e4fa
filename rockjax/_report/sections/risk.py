"""Section 7: fragility and annual frequency."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rockjax._report.blocks import Equation, Equations, Paragraph, Section
from rockjax._report.kinds import QUANTITY_OF_UNIT, RiskKind
from rockjax._report.tables import Column, Formula, Quantity, Table, Word
from rockjax._report.units import Units

from .common import number, slug

if TYPE_CHECKING:
    from rockjax._report.evaluation import Check, Evaluation


def section(evaluation: Evaluation, units: Units) -> Section:
    """Return the section."""
    del units
    title = "Annual frequency of overturning"
    checks = [check for check in evaluation.checks if isinstance(check.kind, RiskKind)]
    made = [check for check in checks if check.values is not None]
    if not made:
        reason = checks[0].reason if checks else "No check asks for a fragility or an annual frequency."
        return Section(7, title, (Paragraph(reason),))
    blocks: list[Any] = []
    if any(check.kind.name == "annual-frequency" for check in made):
        rows = Equation(Formula("annual_frequency")), Equation(Formula("probability"))
        blocks.append(Equations(rows))
    done: set[str] = set()
    for check in made:
        table = _table(check, evaluation)
        if table.name not in done:
            done.add(table.name)
            blocks.append(table)
    return Section(7, title, tuple(blocks))


def _table(check: Check, evaluation: Evaluation) -> Table:
    problem = evaluation.problem
    with_hazard = check.kind.name == "annual-frequency"
    data = evaluation.scenes.risk(str(check.motions), with_hazard)
    kind = QUANTITY_OF_UNIT.get(data.attrs["units"], "number")
    confidence = f"{problem.fragility.confidence:.0%} interval"
    median, dispersion = (
        tuple(float(y) for y in data[f"{name}_interval"]) for name in ("median", "dispersion")
    )
    rows: list[tuple[Any, ...]] = [
        (f"Median overturning {data.attrs['measure']}", Quantity(float(data["median"]), kind)),
        (f"Median, {confidence}, lower", number(median[0], kind)),
        (f"Median, {confidence}, upper", number(median[1], kind)),
        ("Dispersion", Quantity(float(data["dispersion"]), "number")),
        (f"Dispersion, {confidence}, lower", number(dispersion[0], "number")),
        (f"Dispersion, {confidence}, upper", number(dispersion[1], "number")),
    ]
    if with_hazard:
        rows += [
            ("Annual frequency λ_f", Quantity(float(data["frequency"]), "rate")),
            ("Return period", number(data["return_period"], "return period")),
            (f"Probability in {problem.risk.years:g} years", Quantity(float(data["probability"]), "ratio")),
            ("Share from beyond the hazard curve", Quantity(float(data["extrapolated"]), "ratio")),
        ]
        for name, value in zip(data["parameter"].values, data["sensitivity"].values, strict=True):
            symbol = "d ln λ_f/dβ" if name == "dispersion" else f"d ln λ_f/d ln {name}"
            rows.append((symbol, Quantity(float(value), "number")))
    cells = tuple((Word(str(name)), value) for name, value in rows)
    name = f"risk-{slug(str(check.motions))}-{'annual' if with_hazard else 'median'}"
    caption = f"Fragility of the set {check.motions}" + (" and annual frequency" if with_hazard else "")
    return Table(name, caption, (Column("Quantity"), Column("Value")), cells)
