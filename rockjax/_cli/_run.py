"""Execution of commands: options, problem files, warnings, printed output and exit status."""

from __future__ import annotations

import contextlib
import functools
import inspect
import logging
import os
import time
import warnings
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_type_hints

import typer

from ._context import COMMAND, MASSES
from ._options import Example, Json, Option, ProblemFile, Quiet, Verbose

if TYPE_CHECKING:
    import xarray

FAILED, WRONG_INPUT, INTERRUPTED = 1, 2, 130  # exit statuses


class Console:
    """Output of a command. A summary or a JSON object is printed on stdout, and progress, remarks and errors
    on stderr.

    - `json_object`: entries of the JSON object that `--json` prints
    - `written`: files that the command has written
    - `status`: exit status
    """

    def __init__(self, quiet: bool = False, verbose: bool = False, json: bool = False):
        self.quiet, self.verbose, self.json = quiet, verbose, json
        self.start_time = time.perf_counter()
        self.json_object: dict[str, Any] = {}
        self.written: list[str | Path] = []
        self.status = 0

    def say(self, line: str) -> None:
        """Print a line of the summary."""
        if not (self.quiet or self.json):
            typer.echo(line)

    def say_warnings(self, lines: Iterable[str], indent: str = "") -> None:
        """Print lines about assumptions that do not hold or were not checked; add them to the JSON object.

        If `quiet` is set, lines that begin with "warning" are printed on stderr instead.
        """
        lines = list(lines)
        self.json_object["warnings"] = lines
        for line in lines:
            self.say(f"{indent}{line}")
            if self.quiet and line.startswith("warning"):
                typer.echo(f"rockjax: {line}", err=True)

    def note(self, line: str) -> None:
        """Print a remark if `verbose` is set."""
        if self.verbose:
            typer.echo(line, err=True)

    def error(self, line: str, status: int = FAILED) -> None:
        """Print why results are missing or incomplete, and set the exit status."""
        typer.echo(f"rockjax: {line}", err=True)
        self.status = status

    def progress(self, total: int | None, unit: str) -> Any:
        """Return a progress bar on stderr; `total` is None if the number of units is not known in advance."""
        from rockjax._progress import bar

        return bar(total, unit, not self.quiet, unit_scale=total is None or total >= 1000)

    def write(
        self, path: str | Path, data: xarray.Dataset, groups: dict[str, xarray.Dataset] | None = None
    ) -> None:
        """Write a dataset and its `groups` to a netCDF file, with the command line and the masses of the
        structure as attributes."""
        from rockjax._files import write_dataset

        data.attrs |= {"command": COMMAND.get()} | MASSES.get({})
        self.add_file(write_dataset(path, data, groups))

    def draw(self, path: str | Path, plot: str, data: Any, **arguments: Any) -> None:
        """Write the picture `rockjax.plots.<plot>(data, **arguments)`."""
        os.environ["MPLBACKEND"] = "Agg"  # this backend of matplotlib needs no screen
        from rockjax import plots
        from rockjax._files import write_figure

        self.add_file(write_figure(path, getattr(plots, plot)(data, **arguments).figure))

    def say_scenes(self, data: xarray.Dataset, total: int) -> dict[str, Any]:
        """Print the share of scenes that overturned, and the number of scenes that did not finish. Return
        entries for the JSON object: these two numbers, and the number of all scenes.

        - `data`: dataset with the variables `overturned` and `result`
        - `total`: number of all scenes
        """
        from rockjax._responses.peak import UNTIL_OVERTURNING
        from rockjax._results import did_not_finish

        overturned, failed = float(data["overturned"].mean()), int(did_not_finish(data["result"]).sum())
        note = f" (peaks {UNTIL_OVERTURNING})" if overturned else ""
        self.say(f"{total} scenes: {overturned:.1%} overturned{note}, {failed} without an answer")
        return {"scenes": total, "overturned": overturned, "without_answer": failed}

    def add_file(self, path: str | Path) -> None:
        """Add a file to the list of written files, which `close` prints."""
        self.written.append(path)

    def close(self) -> None:
        """Print the paths of all written files, or the JSON object."""
        seconds = time.perf_counter() - self.start_time
        for path in self.written:
            self.say(f"wrote {path}")
        if self.json:
            from rockjax._files import as_json
            from rockjax._version import __version__

            run_entries = {"command": COMMAND.get(), "version": __version__, "seconds": round(seconds, 3)}
            json_object = run_entries | self.json_object | {"files": list(map(str, self.written))}
            typer.echo(as_json(json_object, ascii=True))  # valid in every encoding of stdout
        if self.verbose:
            self.note(_describe_programs())
            self.note(f"{seconds:.1f} s in total")


def command(*groups: dict[str, Option], jax: bool = True) -> Callable[[Callable[..., None]], Any]:
    """Return a decorator that turns a function into a command.

    - `groups`: options that set keys of the problem file, by key
    - `jax`: whether to call `configure_jax` first

    The function takes `console` and its own options. It may also take `request`, which contains the problem
    file and the options of `groups`, or `reader`, which checks these options without a problem file.
    """
    options = {name: entry for group in groups for name, entry in group.items()}

    def decorate(function: Callable[..., None]) -> Any:
        hints = get_type_hints(function, include_extras=True)
        accepted = inspect.signature(function).parameters
        takes_file = "request" in accepted
        options_by_name: dict[str, Any] = {"ctx": (typer.Context, inspect.Parameter.empty)}
        options_by_name |= {name: (entry.annotation, entry.default) for name, entry in options.items()}
        if takes_file:
            options_by_name |= {} if "inputs" in accepted else {"problem": (ProblemFile, None)}
            options_by_name |= {"example": (Example, None)}
        options_by_name |= {
            name: (hints[name], p.default)
            for name, p in accepted.items()
            if name not in ("request", "reader", "console")
        }
        options_by_name |= {"quiet": (Quiet, False), "verbose": (Verbose, False), "json": (Json, False)}

        @functools.wraps(function)
        def run(ctx: typer.Context, **values: Any) -> None:
            console = Console(*(values.pop(name) for name in ("quiet", "verbose", "json")))

            def call() -> None:
                if jax:
                    configure_jax(console)
                converted = values | {
                    name: entry.convert(entry.flag, values[name])
                    for name, entry in options.items()
                    if values[name] is not None
                }
                flags = {name: options[name].flag if name in options else f"--{name}" for name in values}
                explicit = {
                    name: (flags[name], converted[name]) for name in values if _is_explicit(ctx, name)
                }
                if takes_file:
                    from ._request import Request, problem_file

                    path = problem_file(_take_problem(converted), values["example"])
                    keys = {name: converted[name] for name in options}
                    converted["request"] = Request(function.__name__, path, keys, explicit)
                if "reader" in accepted:
                    from rockjax._problem.reading import Reader

                    converted["reader"] = Reader(None, explicit)
                arguments = {name: converted[name] for name in accepted if name != "console"}
                function(**arguments, console=console)

            _run_and_exit(console, call)

        wrapped: Any = run
        parameters = [
            inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, annotation=annotation, default=default)
            for name, (annotation, default) in options_by_name.items()
        ]
        wrapped.__signature__ = inspect.Signature(parameters)
        wrapped.__annotations__ = {p.name: p.annotation for p in parameters}
        wrapped.__doc__ = unwrap_docstring(function)
        return wrapped

    return decorate


def _take_problem(values: dict[str, Any]) -> Path | None:
    """Return the problem file, or None. Commands with the argument `inputs` accept the problem file among the
    other inputs. It is then removed from `values["inputs"]`."""
    if "inputs" not in values:
        return values["problem"]
    inputs = values["inputs"] or []
    problems = [path for path in inputs if path.suffix.lower() == ".toml"]
    if len(problems) > 1:
        raise ValueError(f"give at most one problem file, got {problems[0]} and {problems[1]}")
    values["inputs"] = [path for path in inputs if path not in problems]
    return problems[0] if problems else None


def _run_and_exit(console: Console, call: Callable[[], None]) -> None:
    """Run a command, print its warnings as lines, and exit with its status if that is not 0."""
    from rockjax._unit_warnings import PlausibilityWarning

    with warnings.catch_warnings():
        warnings.filterwarnings("always", category=RuntimeWarning, module="rockjax")
        warnings.filterwarnings("default", category=PlausibilityWarning)
        warnings.showwarning = _show_warning
        try:
            call()
        except KeyboardInterrupt as interrupt:
            paths = ", ".join(map(str, console.written))
            saved = f"written so far: {paths}" if paths else "no results were saved"
            typer.echo(f"\nrockjax: {str(interrupt) or 'stopped'}; {saved}", err=True)
            raise typer.Exit(INTERRUPTED) from None
    console.close()
    if console.status:
        raise typer.Exit(console.status)


def unwrap_docstring(function: Callable[..., None]) -> str:
    """Return the docstring of a command as the text of its help. The help keeps line breaks, so each
    paragraph is put on one line, except paragraphs that begin with \\b. Brackets are escaped, because they
    would be read as markup."""
    paragraphs = (inspect.getdoc(function) or "").replace("[", r"\[").split("\n\n")
    return "\n\n".join(text if text.startswith("\b") else text.replace("\n", " ") for text in paragraphs)


def _is_explicit(ctx: typer.Context, name: str) -> bool:
    source = ctx.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"


def _show_warning(message, category, filename, lineno, file=None, line=None) -> None:
    del category, filename, lineno, file, line
    typer.echo(f"rockjax: warning: {message}", err=True)


def configure_jax(console: Console) -> None:
    """Configure JAX's cache of compiled programs, and logging."""
    import jax

    from rockjax._programs import key, store

    if store.enabled() and jax.config.jax_compilation_cache_dir is None:  # pyright: ignore[reportAttributeAccessIssue]
        # Programs that rockjax does not store are kept in JAX's own cache. The setting affects the whole
        # process, but the process runs only this command. Each version of rockjax has its own folder in this
        # cache. With a common folder, JAX would load programs that another version has compiled, and rockjax
        # can store only programs that are compiled in this process.
        with contextlib.suppress(key.NoKeyError):
            jax.config.update("jax_compilation_cache_dir", str(store.root() / "jax" / key.source_hash()[:16]))
            jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)
    if console.quiet:
        logging.getLogger("rockjax").setLevel(logging.ERROR)
    if console.verbose:
        console.note(f"{COMMAND.get()}: jax {jax.__version__} on {jax.default_backend()}")


def _describe_programs() -> str:
    from rockjax._programs import store
    from rockjax._programs.program import COUNTS

    return f"{COUNTS['compiled']} programs compiled, {COUNTS['loaded']} loaded from {store.root()}"


def exit_after_saving(
    output: Path, datasets: list, message: str = "stopped before all files were written"
) -> typer.Exit:
    """Save partial results, print how to resume, and return the exception that ends the command. If no podium
    has results, nothing is saved.

    - `output`: prefix of the files of the command
    - `datasets`: results of each podium, complete or not; None for a podium without results
    - `message`: reason of the interruption, for the printed line
    """
    from rockjax._cli import _checkpoint

    if any(data is not None for data in datasets):
        path = _checkpoint.save(_checkpoint.path_of(output), datasets)
        typer.echo(
            f"\nrockjax: {message}; saved in {path}; repeat the command with --resume to continue", err=True
        )
    else:
        typer.echo(f"\nrockjax: {message}; no results were saved", err=True)
    return typer.Exit(INTERRUPTED)
