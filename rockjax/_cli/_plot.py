"""`rockjax plot`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from rockjax._files import require_writable
from rockjax._problem.models import OUTPUT

from ._options import argument, option
from ._outputs import Outputs, parse_outputs
from ._run import Console, command


@command()
def plot(
    file: Annotated[Path, argument("A netCDF file that a rockjax command has written.")],
    console: Console,
    output: Annotated[
        str | None,
        option(
            "--output",
            "-o",
            metavar="PATH",
            panel=OUTPUT,
            help="Prefix of the pictures, or a folder for them; by default the file name without suffix.",
        ),
    ] = None,
    kind: Annotated[
        str,
        option(
            "--kind",
            panel=OUTPUT,
            help="Kinds of pictures, separated by commas; by default all, for a response only 'response'.",
        ),
    ] = "",
) -> None:
    """Draw the results in a file, such as spectra, responses, fragilities or design charts.

    Writes OUTPUT-KIND.png. The kinds of a rocking spectrum are rotation, overturning, sensitivity and
    lift-off. The kinds of an overturning spectrum are boundaries and sensitivity. The kinds of a fragility
    are fragility, ida (incremental dynamic analysis) and contents. The kinds of a response are response,
    phase-portrait, moment-rotation, energy, stories, joint-forces, friction-demand and animation (a GIF). The
    kinds of an ensemble are its peaks, such as peak-rotation. All other files have one kind.

    \b
    Examples:
      rockjax plot study.nc
      rockjax plot study.nc --kind phase-portrait,energy -o pictures/study
    """
    from rockjax.plots._from_file import redraw

    files = Outputs(file.with_suffix("")) if output is None else parse_outputs(output, file.stem)
    require_writable(files.picture())
    for path in redraw(
        file, files.prefix, [name.strip() for name in kind.split(",") if name.strip()], files.format
    ):
        console.add_file(path)
