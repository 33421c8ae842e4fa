"""The page of a report, assembled from the results of all checks: title, verdict, notices and sections."""

from __future__ import annotations

import datetime
import os
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from rockjax._version import __version__

from .assumptions import ASSUMPTIONS, Outcome
from .blocks import Page
from .plausibility import warnings_of
from .sections import SECTIONS
from .sections.common import unused_sets
from .tables import Code, Link, Quantity, Table, Text
from .units import Units

if TYPE_CHECKING:
    from .evaluation import Evaluation

USUAL_UNITS = ("kN", "m", "deg", "g", "mm")


def units_of(evaluation: Evaluation, units: str | Sequence[str] | None = None) -> Units:
    """Return the units of a page: `units` if given, otherwise those of the table `[report]` of the problem
    file. If this table has none, return `USUAL_UNITS`."""
    problem = evaluation.problem
    return Units.parse(units or problem.report.units or USUAL_UNITS, float(problem.podium.g))


def page_of(evaluation: Evaluation, units: Units | None = None, command: str = "") -> Page:
    """Return the page of an evaluation.

    - `evaluation`: the evaluated problem
    - `units`: units of drawings and their captions; by default the result of `units_of`. All other numbers of
      the page stay in SI until a file is written
    - `command`: the command line that makes the report, shown at the head of the page; "" to show none
    """
    units = units or units_of(evaluation)
    problem = evaluation.problem
    project = problem.project
    head = {
        "Project": project.number,
        "Revision": project.revision,
        "Author": project.author,
        "Organisation": project.organisation,
        "Date": date_of(evaluation),
    }
    origin: dict[str, Text] = {
        "Problem file": (Code(problem.path.name), f", SHA-256 {problem.sha256[:12]}…"),
    }
    if command:
        origin["Command"] = (Code(command),)
    title = project.title or problem.path.stem
    revision = f" · rev. {project.revision}" if project.revision else ""
    return Page(
        title=title,
        subject=project.subject or "",
        head={name: text for name, text in head.items() if text},
        origin=origin,
        verdict=evaluation.verdict,
        notices=tuple(_notices(evaluation)),
        sections=tuple(section(evaluation, units) for section in SECTIONS),
        is_verified=evaluation.is_verified,
        footer=f"{title}{revision} · rockjax {__version__}",
    )


def tables_of(evaluation: Evaluation) -> dict[str, Table]:
    """Return all tables of the page: name → table."""
    return {table.name: table for table in page_of(evaluation).tables()}


def date_of(evaluation: Evaluation) -> str:
    """Return the date of the page: the date in the problem file, otherwise the date in the environment
    variable SOURCE_DATE_EPOCH (seconds since 1970), otherwise today."""
    if evaluation.problem.project.date:
        return evaluation.problem.project.date
    epoch = os.environ.get("SOURCE_DATE_EPOCH")
    if epoch and epoch.isdigit():
        return datetime.datetime.fromtimestamp(int(epoch), datetime.UTC).date().isoformat()
    return datetime.date.today().isoformat()


def _notices(evaluation: Evaluation):
    """Yield the notices below the verdict."""
    problem = evaluation.problem
    texts = {assumption.id: assumption.text for assumption in ASSUMPTIONS}
    violated: dict[str, list[str]] = {}
    for check in evaluation.checks:
        for name in check.violated:
            violated.setdefault(name, []).append(check.id)
    for name, found in evaluation.assumptions.items():
        for assumption in ASSUMPTIONS:
            outcome = found.get(assumption.id)
            if isinstance(outcome, Outcome) and not assumption.invalidates and outcome.violated.any():
                yield (
                    *("Assumption ", Link(assumption.id, assumption.id), f" is violated in the set {name}: "),
                    f"“{texts[assumption.id]}”",
                )
    for name, checks in violated.items():
        yield (
            "Assumption ",
            Link(name, name),
            f" is violated in the scenes of {', '.join(checks)}, whose numbers are not verified: ",
            f"“{texts[name]}”",
        )
    undecided = [check.id for check in evaluation.checks if check.result == "UNDECIDED"]
    if undecided:
        yield f"Undecided within the numerical error, or without an answer: {', '.join(undecided)}."
    if problem.missing_positions:
        yield "Not checked, because the structure has no positions of columns: joint forces, A1 and A7."
    sources = problem.sources_of_inputs(used={check.motions for check in evaluation.checks})
    missing = [key for key, source in sources.items() if source is None]
    if missing:
        yield (
            *("Inputs without a source: ", Quantity(len(missing), "count")),
            *(" of ", Quantity(len(sources), "count"), " ("),
            Code(", ".join(missing)),
            ").",
        )
    for check in evaluation.checks:
        if check.values is not None:
            yield from check.kind.notices(check.entry, evaluation.scenes)
    yield from warnings_of(evaluation)
    if unused := unused_sets(evaluation):
        yield ("No check uses the sets of motions ", Code(", ".join(unused)), ".")
    if keys := list(_unused_keys(evaluation)):
        yield ("No check uses ", Code(", ".join(keys)), ".")
    if evaluation.skipped:
        yield f"Left out on request: {', '.join(evaluation.skipped)}."


def _unused_keys(evaluation: Evaluation) -> Iterator[str]:
    """Yield the tables and keys of the file that no check uses: [fragility], [risk] and those of [joints]."""
    problem, kinds = evaluation.problem, {check.kind.name for check in evaluation.checks}
    made_of_joints = any(
        check.kind.is_of_joints and check.kind.name != "contact-pressure" for check in evaluation.checks
    )
    # Assumption A1 uses the friction coefficient if the structure has an elevation.
    if problem.joints.friction is not None and not made_of_joints and problem.podium.elevation is None:
        yield "joints.friction"
    for name in ("contact_width", "contact_depth"):
        if getattr(problem.joints, name) is not None and "contact-pressure" not in kinds:
            yield f"joints.{name}"
    if problem.fragility.model_fields_set and not kinds & {"median-capacity", "annual-frequency"}:
        yield "fragility"
    if problem.risk.model_fields_set and "annual-frequency" not in kinds:
        yield "risk"
