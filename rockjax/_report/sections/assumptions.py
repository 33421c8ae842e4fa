"""Section 10: assumptions of the model, and checks that were not made."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from rockjax._report.assumptions import ASSUMPTIONS, Assumption, Outcome
from rockjax._report.blocks import Paragraph, Section
from rockjax._report.cells import number_cell
from rockjax._report.kinds import KINDS
from rockjax._report.tables import Code, Column, Table, TextCell
from rockjax._report.units import Units

if TYPE_CHECKING:
    from rockjax._report.evaluation import Check, Evaluation


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
    texts, violated, tested, unfinished = [], False, False, 0
    for name, outcomes in evaluation.assumptions.items():  # sets of motions
        outcome = outcomes[assumption.id]
        if isinstance(outcome, str):
            if outcome not in texts:
                texts.append(outcome)
            continue
        tested = True
        violated |= bool(outcome.violated.any())
        unfinished += outcome.unfinished
        texts.append(_sentence(name, outcome))
    if assumption.id == "A6":  # the law of impact; the test compares the results of checks under other laws
        changed = [
            check.id
            for check in evaluation.checks
            if any(result != _result_if_valid(check) for _, result in check.laws.values())
        ]
        tested = any(check.laws for check in evaluation.checks)
        violated = bool(changed)
        texts.append(f"Results that change: {', '.join(changed) or 'none'}.")
    words = {"A6": ("matters", "makes no difference")}.get(assumption.id, ("violated", "holds"))
    result = TextCell(words[0], "violated") if violated else TextCell(words[1], "holds")
    if unfinished and not violated:
        result = TextCell("undecided", "undecided")
    return (
        TextCell(assumption.id),
        TextCell(assumption.text),
        TextCell(assumption.conservative),
        result if tested else TextCell("not tested", "not tested"),
        TextCell(" ".join(texts) or "No scene was solved."),
    )


def _result_if_valid(check: Check) -> str:
    """Return the result that a check would have if no assumption were violated: PASS in place of NOT
    VALID."""
    return "PASS" if check.result == "NOT VALID" else check.result


def _sentence(name: str, outcome: Outcome) -> str:
    """Return the outcome of a test for the set of motions `name`, as a sentence."""
    worst = f"{outcome.worst:.3g}" if math.isfinite(outcome.worst) else "without bound"
    count, scenes = int(np.sum(outcome.violated)), len(outcome.violated)
    share = f"; violated in {count} of {scenes} scenes" if count else ""
    unfinished = f"; {outcome.unfinished} of {scenes} scenes did not finish" if outcome.unfinished else ""
    return f"{name}: {outcome.text.format(worst)}{share}{unfinished}."


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
    caption = "Checks of peaks under other laws of impact; violated assumptions are not considered"
    return Table("laws", caption, columns, tuple(rows))
