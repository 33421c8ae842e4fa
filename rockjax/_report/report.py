"""Design reports: the results of an evaluation as a page, which can be written to files."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rockjax._files import interruption_delayed, require_writable, write_atomically
from rockjax._machine.threads import TABLE_MODULES, import_in_background

from .assemble import page_of, units_of
from .evaluate import check_skip, evaluate_with_store, made_entries
from .evaluation import Evaluation
from .problem import Problem
from .sections import methods, rocking
from .store import Store

if TYPE_CHECKING:
    from .blocks import Page
    from .tables import Table
    from .units import Units


@dataclasses.dataclass(frozen=True)
class Report:
    """A report, from [`rockjax.report`][].

    - `evaluation`: the checks and their scenes
    - `page`: content of the page, with numbers in SI; `units`: units in which the page shows the numbers
    - `written`: paths of the files that were written
    """

    evaluation: Evaluation
    page: Page
    units: Units
    written: tuple[Path, ...] = ()

    @property
    def html(self) -> str:
        """The page as the text of a self-contained HTML file."""
        return self._encoded("html")["report.html"].decode()

    @property
    def json(self) -> str:
        """The contents of the page as JSON, with all numbers in SI."""
        return next(iter(self._encoded("json").values())).decode()

    @property
    def tables(self) -> dict[str, Table]:
        """All tables: name → table."""
        return {table.name: table for table in self.page.tables()}

    @property
    def verified(self) -> bool:
        """True if every check passes or is made by others, and at least one passes."""
        return self.evaluation.is_verified

    def to_csv(self, folder: str | Path) -> list[Path]:
        """Write a CSV file for each table into a folder, and make the folder if it is missing. Return the
        paths of the files."""
        return [
            write_atomically(Path(folder) / name, _writer(content))
            for name, content in self._encoded("csv").items()
        ]

    def to_xlsx(self, path: str | Path) -> Path:
        """Write an XLSX file with a sheet for each table. Return its path.

        Raises `ValueError` for another suffix than .xlsx and, with the command to install XlsxWriter, if
        XlsxWriter is missing.
        """
        from ._formats.xlsx import check_path

        check_path(path)
        (content,) = self._encoded("xlsx").values()
        return write_atomically(path, _writer(content))

    def _encoded(self, name: str) -> dict[str, bytes]:
        """Return the files of a format: name → content."""
        from ._formats import FORMATS

        return FORMATS[name](self.page, self.units)

    def _repr_html_(self) -> str:
        from html import escape

        return f'<iframe srcdoc="{escape(self.html, quote=True)}" width="100%" height="700"></iframe>'

    def __repr__(self) -> str:
        rows = [f"  {check.id:<6} {check.result:<10} {check.name}" for check in self.evaluation.checks]
        return "\n".join([self.evaluation.verdict, *rows])


def _writer(content: bytes) -> Any:
    """Return a function that writes `content` to a path."""
    return lambda name: Path(name).write_bytes(content)


def _write_both(
    first: tuple[Path, bytes], second: tuple[Path, bytes], save: Callable[[], Path | None] = lambda: None
) -> list[Path]:
    """Write two files, pairs (path, content), and return the paths of all written files. If an error prevents
    the writing of one file, or the call of `save`, both keep their old contents. Ctrl-C takes effect only
    after all files are written.

    - `save`: function that writes a third file and returns its path; None if it writes none
    """
    (path, content), (other, other_content) = first, second
    old = other.read_bytes() if other.is_file() else None
    saved: list[Path | None] = []
    written: list[Path] = []

    def write_other(name: str) -> None:
        _writer(other_content)(name)
        saved.append(save())

    def write(name: str) -> None:
        _writer(content)(name)
        written.append(write_atomically(other, write_other))

    with interruption_delayed():
        try:
            return [write_atomically(path, write), *written, *filter(None, saved)]
        except BaseException:
            if written and old is None:
                other.unlink()
            elif written and old is not None:
                write_atomically(other, _writer(old))
            raise


def report(
    problem: Problem | Evaluation | str | Path,
    output: str | Path | None = None,
    *,
    units: str | Sequence[str] | None = None,
    skip: tuple[str, ...] = (),
    progress: Any = None,
    command: str = "",
) -> Report:
    """Return the design report of a problem. The function cannot be called inside `jax.jit`.

    - `problem`: path of a problem file, a [`rockjax.Problem`][], or a [`rockjax.Evaluation`][]
    - `output`: path of the page, NAME.html; None writes nothing. NAME.json (all numbers in SI) and NAME.nc
      (all scenes) are written beside the page. Scenes that NAME.nc already has are not solved again. If
      `problem` is an `Evaluation`, its scenes are not written to NAME.nc, but to the `store` of the call of
      [`rockjax.evaluate`][], if that call had a `store`
    - `units`: units of the page, such as "kN,m,deg,g,mm", by default those of the file, or "kN,m,deg,g,mm" if
      the file states none. Each kind of quantity has at most one unit. Lengths may have two: the larger
      applies to dimensions and the smaller to displacements
    - `skip`, `progress`: as for [`rockjax.evaluate`][]; unused for an `Evaluation`
    - `command`: the command line that makes the report, shown at the head of the page; "" for none

    Returns a [`rockjax.Report`][]. Raises `ValueError`, before anything is solved, for a problem file that is
    invalid or cannot be read, for unknown units or unknown names in `skip`, and for an `output` whose suffix
    is neither .html nor .htm. Raises `OSError` for files that cannot be written, if possible before anything
    is solved; an older page and its numbers then keep their contents. For a PDF, print the page from a
    browser.
    """
    path = None if output is None else Path(os.path.expanduser(output))
    if path is not None and path.suffix.lower() not in (".html", ".htm"):
        raise ValueError(
            f"report: output must be a .html file, got {path.name}; for a PDF, print the page from a browser"
        )
    if path is not None:
        for suffix in (path.suffix, ".json", ".nc"):
            require_writable(path.with_suffix(suffix))
    if isinstance(problem, Evaluation):
        evaluation = problem
    else:
        if isinstance(problem, str | Path):
            from .reading import read_problem

            problem = read_problem(problem)
        if units is not None or problem.report.units:
            from .units import Units

            Units.parse(units or problem.report.units or ())  # raises an error before anything is solved
        check_skip(skip)
        # xarray imports `distributed`, if it is installed, to write the first file. Another thread imports it
        # and the other modules while scenes are solved.
        import_in_background(*TABLE_MODULES, "distributed", "matplotlib.pyplot")
        store = Store(None if path is None else path.with_suffix(".nc"))
        if "methods" not in skip:
            methods.start(problem, store, made_entries(problem, skip))
        evaluation = evaluate_with_store(problem, skip, store, progress, rocking.start)
    chosen = units_of(evaluation, units)
    with evaluation.scenes.store.saved_on_interruption():
        result = Report(evaluation, page_of(evaluation, chosen, command), chosen)
        if path is None:
            return result
        page, numbers = (path, result.html.encode()), (path.with_suffix(".json"), result.json.encode())
        written = _write_both(page, numbers, evaluation.scenes.store.save)
    return dataclasses.replace(result, written=tuple(written))
