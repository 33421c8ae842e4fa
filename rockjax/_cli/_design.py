"""`rockjax design`."""

from __future__ import annotations

from rockjax._problem import models

from ._joints import check_restitution_by_line, joint_warnings
from ._options import Output, accuracy_options, options_of, structure_options
from ._outputs import parse_outputs
from ._request import Request
from ._run import INTERRUPTED, Console, command


@command(
    structure_options(), options_of(models.Problem, "starts", "seed", "friction"), accuracy_options(rtol=None)
)
def design(request: Request, console: Console, output: Output = "rockjax-design") -> None:
    """Design a podium: minimise an objective over bounded variables, subject to targets.

    Prints the variables, and the targets with their margins and shadow prices. A shadow price is the decrease
    of the objective per relative relaxation of a limit. Writes OUTPUT.json, OUTPUT-convergence.png and
    OUTPUT-response.png (the responses before and after the design). Options of the structure override the
    problem file. The exit status is 1 if no design satisfies the targets. Ctrl-C keeps the best design so
    far.

    \b
    Examples:
      rockjax design --example column
      rockjax design problem.toml --top-mass 400e3 --starts 8 -o heavier
    """
    from rockjax._extensions import extension

    optimise = extension("design")

    if request.path is None:
        raise ValueError("rockjax design needs a problem file (TOML), or --example column")
    files = parse_outputs(output, "rockjax-design").check(("convergence", "response"), ".json")
    check_restitution_by_line()
    problem = optimise.problem_of(request.tables, request.path, request.reader.set_by_options)
    best, written, interrupt = optimise.design_command(problem, files.prefix, console.quiet, files.format)
    console.say(str(best))
    peaks = optimise.joint_peaks(problem, best)
    console.say_warnings(joint_warnings(best.podium, peaks, request.problem.friction))
    for path in written:
        console.add_file(path)
    console.json_object |= {
        name: value for name, value in optimise.design_record(best).items() if name != "history"
    }
    if interrupt is not None:
        console.error(f"{interrupt}; the best design so far is saved", INTERRUPTED)
    elif not best.satisfied:
        console.error(f"the targets are not satisfied. {optimise.RESULTS[best.result]}")
