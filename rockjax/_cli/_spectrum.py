"""`rockjax spectrum`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from ._given import Given, ascending, names, problem_file
from ._options import (
    GRID,
    Accuracy,
    Example,
    Frequencies,
    Output,
    Panels,
    ProblemFile,
    Pulse,
    PulseName,
    Resume,
    VerticalRatio,
    pulse_of,
)
from ._outputs import outputs
from ._panels import joined, least
from ._run import Flags, Report, interrupted, option, prepare


@dataclass
class Grid(Flags):
    pulse: Pulse = PulseName.ricker
    vertical_ratio: VerticalRatio = None
    frequency_ratio: Frequencies = (1.0, 8.0)
    acceleration_ratio: Annotated[
        tuple[float, float], option("--acceleration", panel=GRID, help="Range of a_p/(g tan α) [–].")
    ] = (1.0, 12.0)
    points: Annotated[int, option("--points", panel=GRID, min=2, help="Points along each axis.")] = 100
    sensitivities: Annotated[
        str,
        option(
            "--sensitivities",
            panel=GRID,
            help="Parameters y of ∂(max|θ|/α)/∂ ln y, separated by commas; none where not given.",
        ),
    ] = ""


def spectrum(
    structure: Panels,
    grid: Grid,
    accuracy: Accuracy,
    report: Report,
    problem: ProblemFile = None,
    example: Example = None,
    output: Output = "rockjax-spectrum",
    resume: Resume = False,
) -> None:
    """Rocking spectra: peak rotation over pulse frequency and acceleration, and the boundaries of
    overturning.

    With no options: the 12 panels of the paper's Fig. 6 and its Fig. 7. Boundaries are narrowed down between
    points of the grid; `rockjax overturning` also finds what lies between two points that end alike. Writes
    OUTPUT.nc, OUTPUT-rotation.png, OUTPUT-overturning.png and, with sensitivities, OUTPUT-sensitivity.png.
    Ctrl-C keeps the scenes that are solved in OUTPUT.partial.nc; --resume solves the others.

    \b
    Examples:
      rockjax spectrum
      rockjax spectrum --points 40 --eta-over-gamma 5 --T-s 0,0.5 -o study
      rockjax spectrum --width 0.45 --height 3 --column-mass 1500 \\
        --beam-mass 30e3 --points 40
      rockjax spectrum --example spectrum --points 20
      rockjax spectrum --eta-over-gamma 5 --T-s 0,0.5 --sensitivities alpha,gamma
      rockjax spectrum problem.toml --points 200
    """
    prepare(report)
    import numpy as np

    import rockjax as rj
    from rockjax._cli import partial
    from rockjax._machine.memory import require_memory
    from rockjax._studies.grid_boundaries import with_boundaries

    given = Given("spectrum", problem_file(problem, example), structure, grid, accuracy)
    podiums, ratios, periods, zeta = given.panels(structure)
    grid = given.settings(grid)
    parameters = names(grid.sensitivities)
    drawn = ("rotation", "overturning", *(("sensitivity",) if parameters else ()))
    to = outputs(output, "rockjax-spectrum").check(drawn)
    pulse = pulse_of(grid.pulse, grid.vertical_ratio)
    options = given.options(accuracy, outputs=("peak_rotation",))
    if "peak_rotation" not in options.outputs:
        options = options.replace(outputs=("peak_rotation", *options.outputs))
    x = np.linspace(*ascending("--frequency", grid.frequency_ratio), grid.points)
    y = np.linspace(*ascending("--acceleration", grid.acceleration_ratio, open_below=False), grid.points)
    total = len(podiums) * grid.points**2
    require_memory("--points", total)
    report.note(
        f"{len(podiums)} podiums × {grid.points} frequencies × {grid.points} accelerations: {total} scenes"
    )
    known = partial.load(partial.path_of(to.prefix), len(podiums)) if resume else None
    spectra = []
    try:
        with report.progress(total, "scenes") as bar:
            how = {"options": options, "progress": bar, "resume": known, "sensitivities": parameters}
            spectra = rj.rocking_spectra(podiums, pulse, x, y, **how)
        spectra = with_boundaries(spectra, podiums, pulse, options=options)
        panels = joined(spectra, ratios, periods, zeta)
        report.write(to.data(), panels)
    except rj.Interrupted as stopped:
        raise interrupted(to.prefix, stopped.partial, str(stopped)) from None
    except KeyboardInterrupt:
        raise interrupted(to.prefix, spectra) from None
    report.draw(to.picture("rotation"), "spectra", panels)
    report.draw(to.picture("overturning"), "overturning_curves", panels)
    if parameters:
        report.draw(to.picture("sensitivity"), "sensitivity_spectra", panels)
    partial.path_of(to.prefix).unlink(missing_ok=True)
    failed = int((panels["result"] > 2).sum())
    overturned = float(panels["overturned"].mean())
    from rockjax._responses.peak import UNTIL_OVERTURNING

    until = f" (peaks {UNTIL_OVERTURNING})" if overturned else ""
    report.say(f"{total} scenes: {overturned:.1%} overturned{until}, {failed} without an answer")
    least(report, panels["minimum"].min("frequency_ratio"), ratios, periods, "", ".4f")
    report.facts |= {"scenes": total, "overturned": overturned, "without_answer": failed}
    if failed:
        report.error(f"{failed} of {total} scenes ended without an answer")
