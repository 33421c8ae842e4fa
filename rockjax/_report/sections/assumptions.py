"""Section 10: assumptions of the model, and checks that were not made."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from rockjax._report.assumptions import ASSUMPTIONS, Assumption, Outcome
from rockjax._report.blocks import Paragraph, Section
from rockjax._report.cells import number_cell
from rockjax._report.kinds import KINDS
from rockjax._report.tables import Code, Column, Part, Quantity, Table, Text, TextCell, joined
from rockjax._report.units import Units

from .common import drifts_of, surviving_scenes
from .structure import column_count

if TYPE_CHECKING:
    from rockjax._report.evaluation import Check, Evaluation

# Assumption → effect that results neglect if it does not hold. The page shows it below "conservative?".
EVIDENCE = {
    "A1": "sliding limits the force, but moves the columns",
    "A2": "a joint that opens transmits no force",
    "A3": "two components act together",
    "A4": "crushed edges narrow the base",
    "A5": "soft ground lowers the frequencies and adds damping",
    "A6": "each law of impact is the worse one under some motions",
    "A7": "a column without the beam rocks alone",
    "A8": "yielding lengthens the period and limits the shear",
    "A9": "gravity adds to the drifts",
}


def section(evaluation: Evaluation, units: Units) -> Section:
    """Return section 10 of the page."""
    del units
    rows = [_row(assumption, evaluation) for assumption in ASSUMPTIONS]
    columns = (
        Column("No."),
        Column("Assumption"),
        Column("Conservative"),
        Column("Result"),
        Column("Tested here"),
    )
    table = Table(
        "assumptions", "Assumptions of the model", columns, tuple(rows), ids=tuple(y.id for y in ASSUMPTIONS)
    )
    blocks: list[Any] = [table]
    laws = _laws(evaluation)
    if laws is not None:
        blocks.append(laws)
    missing = [check for check in evaluation.checks if check.result in ("NOT MADE", "BY OTHERS")]
    if missing:
        headings = Column("Check"), Column("Name"), Column("Result"), Column("Reason")
        cells = tuple(
            (
                TextCell(check.id),
                TextCell(check.name),
                TextCell(check.result, check.result.lower()),
                TextCell(check.reason),
            )
            for check in missing
        )
        blocks.append(Table("left-out", "Checks that were not made here", headings, cells))
    requested = {check.kind.name for check in evaluation.checks}
    unrequested = [name for name in KINDS if name not in requested and name != "by-others"]
    blocks.append(Paragraph(("Checks that the file does not ask for: ", Code(", ".join(unrequested)), ".")))
    return Section(10, "Assumptions and what is left out", tuple(blocks))


def _row(assumption: Assumption, evaluation: Evaluation) -> tuple[TextCell, ...]:
    """Return the row of an assumption. The assumption counts as violated if it is violated for any set of
    motions."""
    found = {name: outcomes[assumption.id] for name, outcomes in evaluation.assumptions.items()}
    outcomes = {name: outcome for name, outcome in found.items() if isinstance(outcome, Outcome)}
    without: dict[str, list[str]] = {}  # reason for not testing → sets of motions
    for name, reason in found.items():
        if isinstance(reason, str):
            without.setdefault(reason, []).append(name)
    shown: Text = ()
    texts: list[Text]
    if assumption.id == "A6":  # the law of impact; the test compares the results of checks under other laws
        result, text = _changes(evaluation)
        texts = [*without, text]
    elif assumption.id == "A4":
        result, shown = _contact_pressure(evaluation)
        texts = []
    else:
        result = _result(tuple(outcomes.values()), has_untested_set=bool(without))
        texts = [_sentence(name, outcome) for name, outcome in outcomes.items()]
        # The sets are named unless the reason applies to all of them.
        is_common = len(without) == 1 and not outcomes
        texts += [reason if is_common else f"{', '.join(sets)}: {reason}" for reason, sets in without.items()]
    shown = shown or joined(texts, " ") or "No scene was solved."
    if assumption.id == "A8":
        shown = (*((shown,) if isinstance(shown, str) else shown), *_demands(evaluation))
    return (
        TextCell(assumption.id),
        TextCell(assumption.text),
        TextCell(assumption.conservative, note=EVIDENCE[assumption.id]),
        result,
        TextCell(shown),
    )


def _result(outcomes: tuple[Outcome, ...], has_untested_set: bool) -> TextCell:
    """Return the cell with the result of the tests of an assumption.

    - `outcomes`: outcomes for the sets in which the assumption was tested
    - `has_untested_set`: whether there are sets in which it was not tested
    """
    if not outcomes:
        return TextCell("not tested", "not tested")
    if any(outcome.violated.any() for outcome in outcomes):
        return TextCell("violated", "violated")
    if any(outcome.unfinished for outcome in outcomes):
        return TextCell("undecided", "undecided")
    if has_untested_set:
        return TextCell("not tested in every set", "not tested")
    if any(outcome.untested for outcome in outcomes):
        return TextCell("not tested in every scene", "not tested")
    return TextCell("holds", "holds")


def _changes(evaluation: Evaluation) -> tuple[TextCell, str]:
    """Return a cell that states whether other laws of impact change results of checks, and a text with the
    ids of the checks whose results change and of the checks that were not repeated."""
    made = [check for check in evaluation.checks if check.values is not None]
    repeated = [check for check in made if check.laws]
    if not repeated:
        return TextCell("not tested", "not tested"), "No check was repeated."
    changed = [
        check.id
        for check in repeated
        if any(result != _result_if_valid(check) for _, result in check.laws.values())
    ]
    others: dict[str, list[str]] = {}  # reason for not repeating checks → ids of the checks
    for check in made:
        if not check.laws:
            others.setdefault(check.kind.no_laws, []).append(check.id)
    text = f"Results that change: {', '.join(changed) or 'none'}."
    text += "".join(
        f" Not repeated, because {reason}: {', '.join(names)}." for reason, names in others.items()
    )
    if changed:
        return TextCell("matters", "violated"), text
    if others:
        return TextCell("no difference in the repeated checks", "not tested"), text
    return TextCell("makes no difference", "holds"), text


def _contact_pressure(evaluation: Evaluation) -> tuple[TextCell, Text]:
    """Return the cell with the result for A4, from the checks of the contact pressure, and a text with these
    checks."""
    checks = [
        check
        for check in evaluation.checks
        if check.kind.name == "contact-pressure" and check.values is not None
    ]
    if not checks:
        return TextCell("not tested", "not tested"), "Tested by checks of the kind contact-pressure only."
    parts: list[Part] = []
    for check in checks:
        u = check.utilisation
        parts += [f"{check.id}: ", *(("U = ", Quantity(u, "utilisation"), ", ") if math.isfinite(u) else ())]
        parts.append(f"{check.result}. ")
    text = (*parts, "The width of the contact strip under full load needs separate confirmation.")
    words = {check.result for check in checks}
    if "FAIL" in words:
        return TextCell("violated", "violated"), text
    if words <= {"PASS"}:
        return TextCell("strength holds", "holds"), text
    return TextCell("undecided", "undecided"), text


def _demands(evaluation: Evaluation) -> Iterator[Part]:
    """Yield the parts of a text with the largest base shear and storey drifts of each set of motions. The
    building must remain elastic under them."""
    problem = evaluation.problem
    mass, count = problem.column_mass, column_count(problem)
    for name in evaluation.assumptions:
        data = evaluation.scenes.peaks(name)
        survives = surviving_scenes(data)
        if not survives.any() or "peak_shear" not in data:
            continue
        shear = float(data["peak_shear"].values[survives].max())
        yield from (f" {name}: base shear ", Quantity(shear, "number"), " of the weight of the building")
        if mass is not None and count is not None:
            weight = float(problem.podium.eta) * count * mass * float(problem.podium.g)
            yield from (" (", Quantity(shear * weight, "force"), ")")
        drifts = drifts_of(data)
        if drifts is not None:
            yield from (", storey drift ", Quantity(float(drifts[survives].max()), "displacement"))
            if problem.story_heights is not None:
                ratio = float((drifts[survives] / problem.story_heights).max())
                yield from (", storey drift ratio ", Quantity(ratio, "ratio"))
        yield "."


def _result_if_valid(check: Check) -> str:
    """Return the result that a check would have if no assumption were violated: PASS in place of NOT
    VALID."""
    return "PASS" if check.result == "NOT VALID" else check.result


def _sentence(name: str, outcome: Outcome) -> Text:
    """Return the outcome of a test for the set of motions `name`, as a sentence."""
    before, _, after = outcome.text.partition("{}")
    kind = "count" if isinstance(outcome.worst, int) else "number"
    worst = Quantity(outcome.worst, kind) if math.isfinite(outcome.worst) else "without bound"
    parts: list[Part] = [f"{name}: {before}", worst, after]
    scenes = " of ", Quantity(len(outcome.violated), "count"), " scenes"
    if outcome.violated.any():
        parts += ["; violated in ", Quantity(int(np.sum(outcome.violated)), "count"), *scenes]
    if outcome.untested:
        parts += ["; not tested in ", Quantity(outcome.untested, "count"), *scenes]
    if outcome.unfinished:
        parts += ["; ", Quantity(outcome.unfinished, "count"), *scenes, " did not finish"]
    return (*parts, ".")


def _laws(evaluation: Evaluation) -> Table | None:
    """Return the table of the checks under each law of impact, for assumption A6. Return None if no check was
    evaluated under other laws."""
    checks = [check for check in evaluation.checks if check.laws]
    if not checks:
        return None
    laws = list(evaluation.problem.report.laws)
    columns = (
        Column("Check"),
        Column("U", "utilisation"),
        *(
            column
            for law in laws
            for column in (Column(f"U, {law}", "utilisation"), Column(f"Result, {law}"))
        ),
    )
    rows = []
    for check in checks:
        cells: list[Any] = [
            TextCell(check.id),
            number_cell(check.utilisation, "utilisation", text="no finite value"),
        ]
        for law in laws:
            u, word = check.laws[law]
            cells += [number_cell(u, "utilisation", text="no finite value"), TextCell(word, word.lower())]
        rows.append(tuple(cells))
    caption = "Checks under other laws of impact; violated assumptions are not considered"
    return Table("laws", caption, columns, tuple(rows))
