"""`rockjax report`."""

from __future__ import annotations

import re
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from rockjax._files import require_writable
from rockjax._problem.models import OUTPUT

from ._context import COMMAND
from ._options import option, structure_options
from ._request import Request
from ._run import FAILED, Console, command


class _Progress:
    """Progress bar of a report. It counts scenes, and shows the name of the running step."""

    def __init__(self, bar: Any):
        self.update, self._bar = bar.update, bar

    def describe(self, text: str) -> None:
        """Show the name of the running step."""
        if hasattr(self._bar, "set_postfix_str"):  # False with --quiet, which has no bar
            self._bar.set_postfix_str(text)


@command(structure_options())
def report(
    request: Request,
    console: Console,
    output: Annotated[
        Path, option("--output", "-o", metavar="FILE.html", panel=OUTPUT, help="The page to write.")
    ] = Path("rockjax-report.html"),
    units: Annotated[
        str | None,
        option("--units", panel=OUTPUT, help="Units of the page, such as kN,m,deg,g,mm."),
    ] = None,
    csv: Annotated[
        Path | None,
        option("--csv", metavar="FOLDER", panel=OUTPUT, help="Folder for a CSV file of each table."),
    ] = None,
    xlsx: Annotated[
        Path | None,
        option("--xlsx", metavar="FILE", panel=OUTPUT, help="Workbook with a sheet for each table."),
    ] = None,
    skip: Annotated[
        str, option("--skip", panel=OUTPUT, help="Parts to leave out: risk, methods, spread.")
    ] = "",
) -> None:
    """Write the design report: every check of a problem file on one page, with its utilisation, its numerical
    error and the influence of the inputs.

    Writes FILE.html, FILE.json (all numbers in SI) and FILE.nc (all scenes; a scene is one structure under
    one ground motion). Scenes in an existing FILE.nc are not solved again. After a change of a text or a
    limit in the problem file, the report therefore takes only seconds. Ctrl-C keeps the solved scenes in
    FILE.partial.nc, and the same command continues from them. The exit status is 0 if every check passes, and
    1 if not.

    \b
    Examples:
      rockjax report --example report -o report.html
      rockjax report problem.toml --units kN,m,deg,g,mm --xlsx report.xlsx
      rockjax report problem.toml --width 0.65 --skip risk,spread
    """
    if request.path is None:
        raise ValueError("rockjax report needs a problem file with [[checks]], or --example report")
    from rockjax._report.reading import problem_of
    from rockjax._report.report import report as make_report

    if xlsx is not None:
        from rockjax._report._formats.xlsx import check_path

        check_path(xlsx)
    skipped = tuple(name.strip() for name in skip.split(",") if name.strip())
    problem = problem_of(request.tables, request.path)
    for path in (csv and csv / "summary.csv", xlsx):
        if path is not None:
            require_writable(path)
    command_line = _command([path for path in (request.path, output, csv, xlsx) if path is not None])
    with console.progress(None, "scenes") as bar:
        try:
            written_report = make_report(
                problem, output, units=units, skip=skipped, progress=_Progress(bar), command=command_line
            )
        except KeyboardInterrupt:
            if (unfinished := output.with_suffix(".partial.nc")).exists():
                console.add_file(unfinished)
            raise
    for path in written_report.written:
        console.add_file(path)
    for path in () if csv is None else written_report.to_csv(csv):
        console.add_file(path)
    if xlsx is not None:
        console.add_file(written_report.to_xlsx(xlsx))
    console.say(repr(written_report))
    console.json_object |= {
        "verdict": written_report.evaluation.verdict,
        "checks": {check.id: check.result for check in written_report.evaluation.checks},
    }
    if not written_report.verified:
        console.status = FAILED


def _command(paths: Sequence[Path]) -> str:
    """Return the command line for the report, with names of files instead of paths.

    - `paths`: paths of the files of the command, some of which need not exist yet
    """
    return shlex.join(_without_folder(word, paths) for word in shlex.split(COMMAND.get()))


def _without_folder(word: str, paths: Sequence[Path] = ()) -> str:
    """Return a word of the command line. If it is a path, or ends with a path, only the name of the file is
    kept.

    - `word`: the word; `paths`: paths of the files of the command
    """
    for path in map(str, paths):
        start = word.removesuffix(path)  # such as "--output=" or "-o"
        if "/" in path and start != word and re.fullmatch(r"|.*=|-\w", start):
            return start + Path(path).name
    option, equals, value = word.rpartition("=")
    is_path = "/" in value and Path(value).parent.is_dir()
    return f"{option}{equals}{Path(value).name}" if is_path else word
