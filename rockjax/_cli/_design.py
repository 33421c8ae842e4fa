"""`rockjax design`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from ._given import Given, problem_file
from ._options import ACCURACY, Changes, Example, Output, ProblemFile
from ._outputs import outputs
from ._run import INTERRUPTED, Flags, Report, option, prepare


@dataclass
class Search(Flags):
    starts: Annotated[
        int | None,
        option("--starts", panel=ACCURACY, min=1, help="Starting points; replaces those of the file."),
    ] = None
    seed: Annotated[
        int | None,
        option("--seed", panel=ACCURACY, help="Seed of the starting points; replaces that of the file."),
    ] = None
    rtol: Annotated[
        float | None,
        option("--rtol", panel=ACCURACY, help="Relative tolerance of the step-size control [–]."),
    ] = None


def design(
    structure: Changes,
    search: Search,
    report: Report,
    problem: ProblemFile = None,
    example: Example = None,
    output: Output = "rockjax-design",
) -> None:
    """Size a podium: variables within bounds, targets on overturning, rotation, shear, an objective to
    minimise.

    Prints variables, targets with their margins and shadow prices; writes OUTPUT.json, OUTPUT-convergence.png
    and, before and after, OUTPUT-response.png. Options of the structure override the file. Ends with 1 where
    no design satisfies the targets. Ctrl-C keeps the best design so far.

    \b
    Examples:
      rockjax design --example column
      rockjax design problem.toml --top-mass 400e3 --starts 8 -o heavier
    """
    prepare(report)
    from rockjax._extensions import extension

    optimise = extension("design")

    chosen = problem_file(problem, example)
    if chosen is None:
        raise ValueError("design: needs a problem file (TOML), or --example column")
    to = outputs(output, "rockjax-design").check(("convergence", "response"), ".json")
    given = Given("design", chosen, structure, search)
    table = given.table
    if structure.given and "structure" in table:
        table = table | {"structure": given.structure_table(structure)}
    if search.rtol is not None:
        table = table | {
            "options": table.get("options", {}) | {"rtol": search.rtol, "atol": 0.01 * search.rtol}
        }
    asked = optimise.problem_of(table, chosen, given.where)
    found, written, stopped = optimise.design_command(
        asked, to.prefix, search.starts, search.seed, report.quiet, to.format
    )
    report.say(str(found))
    for path in written:
        report.wrote(path)
    report.facts |= {name: value for name, value in optimise.account(found).items() if name != "history"}
    if stopped is not None:
        report.error(f"{stopped}; the best design so far is kept", INTERRUPTED)
    elif not found.satisfied:
        report.error("no design that satisfies the targets was found")
