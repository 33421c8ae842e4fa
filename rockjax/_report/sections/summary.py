"""Section 1: the summary of checks. U is the utilisation of a check, value/limit or limit/value."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from rockjax._report.blocks import Limit, Section, Summary, SummaryRow
from rockjax._report.tables import Quantity, Text, TextCell, joined
from rockjax._report.units import Units, si_unit

from .instants import Instant, column_text, instant_of_check

if TYPE_CHECKING:
    from rockjax._report.evaluation import Check, Evaluation
    from rockjax._report.problem import Problem

SHOWN_SLOPES = 4  # largest number of derivatives that a row of the summary shows
LEAST_SLOPE = 1e-9  # derivatives d ln U/d ln y with absolute values up to this number are rounding errors [–]
_NOTE = (
    "U is value/limit, or limit/value where the limit is a minimum. Errors are estimates of the numerical "
    "error; for sampled probabilities, they are standard errors. If columns or contents overturn under "
    "one motion of the set, or a joint opens in a check of friction, U exceeds 1 for every statistic. "
    "“Changes with” lists the inputs y with the largest |d ln U/d ln y|, for the motions that determine the "
    "value. “U with spread” is the range of U, evaluated with all motions, if one input at a time is changed "
    "by "
)


def section(evaluation: Evaluation, units: Units) -> Section:
    """Return section 1 of the page."""
    del units
    rows = tuple(_row(check, evaluation) for check in evaluation.checks)
    spread = Quantity(evaluation.problem.report.spread, "ratio", is_input=True)
    return Section(1, "Summary of checks", (Summary(rows, (_NOTE, "± ", spread, ".")),))


def _row(check: Check, evaluation: Evaluation) -> SummaryRow:
    scope = check.kind.scope(check.entry, evaluation.problem)
    limit: Limit | TextCell = TextCell("none given", "none")
    if check.kind.has_limit and math.isfinite(check.limit):
        comparison = "≥" if check.kind.is_minimum else "≤"
        quantity = Quantity(check.limit, check.entry.quantity, is_input=True)
        limit = Limit(comparison, quantity, check.entry.keys.unit or si_unit(check.entry.quantity))
    if check.values is None:
        state = {"BY OTHERS": "by others", "UNDECIDED": "unanswered"}.get(check.result, "not made")
        return SummaryRow(
            check.id,
            check.name,
            scope,
            TextCell(state, state),
            limit,
            TextCell("no value", "none"),
            check.result,
            reason=check.reason,
            section=check.kind.section,
            clause=check.clause,
            is_target=check.is_target,
        )
    if math.isfinite(check.utilisation):
        utilisation: Quantity | TextCell = Quantity(check.utilisation, "utilisation")
    elif math.isnan(check.utilisation):
        utilisation = TextCell("no value", "none")
    else:
        utilisation = TextCell("> 1", "fail")
    instant = instant_of_check(check, evaluation)
    return SummaryRow(
        check.id,
        check.name,
        scope,
        _value(check, evaluation.problem, instant),
        limit,
        utilisation,
        check.result,
        governs=joined((_governs(check), _instant_parts(check, evaluation.problem, instant)), ""),
        sensitivities=_slopes(check),
        spread=_spread(check),
        section=check.kind.section,
        assumptions=check.violated,
        clause=check.clause,
        is_target=check.is_target,
    )


def _value(check: Check, problem: Problem, instant: Instant | None) -> Quantity | TextCell:
    """Return the value of a check with its error, or with its interval if the error is unknown. A ratio θ/α
    has the rotation θ as a note.

    `instant`: instant of the governing value, or of the first opening of a joint; None if it is unknown
    """
    if not math.isfinite(check.value):
        if check.state == "joint opens" and instant is not None:
            return TextCell((f"{check.text} at ", Quantity(instant.time, "time")), check.state)
        return TextCell(check.parts.get("text") or check.text, check.state)
    kind, note = check.entry.quantity, ()
    if check.kind.name == "peak-rotation":
        angle = check.value * float(problem.podium.alpha) * problem.column_enlargement
        note = ("θ = ", Quantity(angle, "angle"))
    if check.values is not None and check.values.interval:
        lower, upper, confidence = check.values.interval
        share = Quantity(confidence, "ratio", is_input=True)
        note = share, " interval ", Quantity(lower, kind), " to ", Quantity(upper, kind)
    return Quantity(check.value, kind, check.error if check.error > 0 else None, note=note)


def _governs(check: Check) -> Text:
    """Return the governing motion or pulse of a check, the location of the value, and `check.reason`. For a
    quantile between two values, return both motions."""
    names = check.values.names if check.values else ()
    if not names:
        name = "whole set"
    elif check.statistic == "mean":
        name = "all (mean)"
    else:
        name = " and ".join(name for name, weight in zip(names, check.weights, strict=True) if weight)
    where, reason = (check.parts.get(y) or getattr(check, y) for y in ("location", "reason"))
    return joined(text for text in (name, where, reason) if text)


def _instant_parts(check: Check, problem: Problem, instant: Instant | None) -> tuple[Any, ...]:
    """Return the column and the time of the governing value of a check, as the end of a text; () if they are
    unknown."""
    if instant is None or check.statistic != "max":
        return ()
    column = column_text(problem, instant) if check.kind.is_of_joints else ()
    column = (column,) if isinstance(column, str) else column
    return *((", ", *column) if column else ()), ", ", Quantity(instant.time, "time")


def _slopes(check: Check) -> Text:
    """Return the derivatives of a check with the largest absolute values, or the reason why there are none.
    Rounding errors of derivatives that are 0 are left out."""
    known = {name: value for name, value in check.sensitivities.items() if math.isfinite(value)}
    if not known:
        is_finite = math.isfinite(check.value) and math.isfinite(check.utilisation)
        return check.no_slopes if is_finite else "no finite value"
    nonzero = [item for item in known.items() if abs(item[1]) > LEAST_SLOPE]
    largest = sorted(nonzero, key=lambda item: -abs(item[1]))[:SHOWN_SLOPES]
    if not largest:
        return "all derivatives are 0"
    return joined((f"{name} ", Quantity(value, "derivative")) for name, value in largest)


def _spread(check: Check) -> Text:
    """Return the range of U with changed inputs, and the change that gives the largest U.

    If changes make U infinite, return the least U and up to three of these changes. If U is infinite even
    with unchanged inputs, return only the least U. Add up to three changes for which U has no value.
    """
    if not check.spread:
        return "not computed"
    utilisations = {
        f"{name} {sign}": u for name, pair in check.spread.items() for u, sign in zip(pair, "−+", strict=True)
    }
    changes = [(u, name) for name, u in utilisations.items() if not math.isnan(u)]
    if not changes:
        return "no value"
    lowest, highest = min(u for u, _ in changes), max(changes)
    least = Quantity(lowest, "utilisation") if math.isfinite(lowest) else ""
    events = {f"{name} {'−+'[k]}": text for (name, k), text in check.spread_events.items()}
    infinite: dict[str, list[str]] = {}  # event → changes that cause it
    for u, name in changes:
        if not math.isfinite(u):
            infinite.setdefault(events.get(name, "no finite value"), []).append(name)
    causes = [f"{event} with {_first_three(names)}" for event, names in infinite.items()]
    missing = [name for name, u in utilisations.items() if math.isnan(u)]
    if infinite and math.isfinite(check.utilisation):
        beginning = ("from ", least, "; ") if least else ()
        text: tuple[Any, ...] = (*beginning, _first_three(causes, "; "))
    elif infinite:
        text = ("from ", least) if least else ("no finite value",)
    else:
        text = (least, " … ", Quantity(highest[0], "utilisation"), f" ({highest[1]})")
    return (*text, f"; no value with {_first_three(missing)}") if missing else text


def _first_three(names: list[str], separator: str = ", ") -> str:
    return separator.join(names[:3]) + (" …" if len(names) > 3 else "")
