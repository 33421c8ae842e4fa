"""`rockjax overturning`."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from ._given import Given, ascending, names, problem_file
from ._options import (
    GRID,
    Example,
    Frequencies,
    Output,
    Panels,
    ProblemFile,
    Pulse,
    PulseName,
    Resume,
    Rtol,
    VerticalRatio,
    pulse_of,
)
from ._outputs import outputs
from ._panels import joined, least
from ._run import Flags, Report, interrupted, option, prepare


@dataclass
class Search(Flags):
    pulse: Pulse = PulseName.ricker
    vertical_ratio: VerticalRatio = None
    frequency_ratio: Frequencies = (1.0, 8.0)
    max_acceleration_ratio: Annotated[
        float, option("--max-acceleration", panel=GRID, help="End of the search, a_p/(g tan α) [–].")
    ] = 12.0
    points: Annotated[int, option("--points", panel=GRID, min=2, help="Frequencies.")] = 141
    sensitivities: Annotated[
        str,
        option(
            "--sensitivities",
            panel=GRID,
            help="Parameters y of d a_ov/d ln y, separated by commas; empty for none.",
        ),
    ] = "alpha,gamma"


@dataclass
class Tolerance(Flags):
    rtol: Rtol = 1e-11


def overturning(
    structure: Panels,
    search: Search,
    accuracy: Tolerance,
    report: Report,
    problem: ProblemFile = None,
    example: Example = None,
    output: Output = "rockjax-overturning",
    resume: Resume = False,
) -> None:
    """Exact overturning boundaries over pulse frequency, with the windows of survival above them.

    With no options: the paper's Fig. 7, from boundaries instead of a grid. Writes OUTPUT.nc,
    OUTPUT-boundaries.png and, with sensitivities, OUTPUT-sensitivity.png. Ctrl-C keeps the podiums that are
    done in OUTPUT.partial.nc; --resume goes on with the others.

    \b
    Examples:
      rockjax overturning --T-s 0,0.5 --eta-over-gamma 5 --points 41
      rockjax overturning --gamma 0 --eta 0 --T-s 0 --pulse one-sine \\
        --sensitivities alpha,R -o block
      rockjax overturning --example spectrum --points 21
      rockjax overturning problem.toml --frequency 2 6
    """
    prepare(report)
    import numpy as np

    import rockjax as rj
    from rockjax._cli import partial
    from rockjax._studies.overturning_spectrum import check_overturning_resumes

    given = Given("overturning", problem_file(problem, example), structure, search, accuracy)
    podiums, ratios, periods, zeta = given.panels(structure)
    search = given.settings(search)
    parameters, end = names(search.sensitivities), search.max_acceleration_ratio
    drawn = ("boundaries", "sensitivity") if parameters else ("boundaries",)
    to = outputs(output, "rockjax-overturning").check(drawn)
    x, pulse = (
        np.linspace(*ascending("--frequency", search.frequency_ratio), search.points),
        pulse_of(search.pulse, search.vertical_ratio),
    )
    if not (end > 0 and math.isfinite(end)):
        raise ValueError(f"--max-acceleration: must be finite and > 0, got {end:g}")
    options = given.options(accuracy)
    found: list = partial.load(partial.path_of(to.prefix), len(podiums)) if resume else [None] * len(podiums)
    report.note(f"{len(podiums)} podiums × {search.points} frequencies")
    with report.progress(len(podiums), "podiums") as bar:
        for k, podium in enumerate(podiums):
            if found[k] is not None:
                check_overturning_resumes(found[k], podium, pulse, x, end, parameters, options)
            else:
                try:
                    found[k] = rj.overturning_spectrum(
                        podium,
                        pulse,
                        x,
                        max_acceleration_ratio=end,
                        sensitivities=parameters,
                        options=options,
                    )
                except KeyboardInterrupt:
                    raise interrupted(
                        to.prefix, found, f"stopped with {k} of {len(podiums)} podiums done"
                    ) from None
                report.note(f"podium {k + 1}: {found[k].attrs['scenes']} scenes")
            bar.update()
    try:
        panels = joined(found, ratios, periods, zeta)
        report.write(to.data(), panels)
    except KeyboardInterrupt:
        raise interrupted(to.prefix, found) from None
    for suffix, draw in zip(drawn, ("overturning_boundaries", "sensitivities"), strict=False):
        report.draw(to.picture(suffix), draw, panels)
    partial.path_of(to.prefix).unlink(missing_ok=True)
    least(report, panels["minimum"].min("frequency_ratio"), ratios, periods, "", ".4f")
    windows = int((panels["boundaries"].count("boundary") > 1).sum())
    scenes = int(sum(data.attrs["scenes"] for data in found))
    report.say(f"{scenes} scenes; windows of survival at {windows} frequencies")
    report.facts |= {"scenes": scenes, "frequencies_with_windows_of_survival": windows}
