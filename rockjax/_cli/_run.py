"""How commands run: groups of options, warnings as lines, what is reported where, and the exit status."""

from __future__ import annotations

import dataclasses
import functools
import inspect
import logging
import os
import shlex
import sys
import time
import warnings
from collections.abc import Callable
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer

if TYPE_CHECKING:
    import xarray

NO_ANSWER, WRONG_INPUT, INTERRUPTED = 1, 2, 130
COMMAND: ContextVar[str] = ContextVar("command")
MASSES: ContextVar[dict[str, Any]] = ContextVar("masses")  # of a structure by dimensions, for files


def flag(name: str) -> str:
    """The option of a name."""
    return f"--{name.replace('_', '-')}"


def option(*names: str, panel: str, help: str, **more) -> Any:
    """An option; brackets in its help are units, not markup."""
    return typer.Option(*names, help=help.replace("[", r"\["), rich_help_panel=panel, **more)


def argument(help: str, **more) -> Any:
    return typer.Argument(help=help.replace("[", r"\["), **more)


@dataclasses.dataclass
class Flags:
    """A group of options: one for each field. `given` are those that stand on the command line."""

    given: frozenset[str] = dataclasses.field(default=frozenset(), init=False)

    def values(self) -> dict[str, Any]:
        """All options by name, names of choices as texts."""
        names = [field.name for field in dataclasses.fields(self) if field.init]
        return {name: getattr(getattr(self, name), "value", getattr(self, name)) for name in names}

    def explicit(self) -> dict[str, Any]:
        """Those that stand on the command line."""
        return {name: value for name, value in self.values().items() if name in self.given}


@dataclasses.dataclass
class Report(Flags):
    """What a command says: a summary on stdout or, with --json, one object; progress and remarks on
    stderr."""

    quiet: Annotated[bool, option("--quiet", "-q", panel="Output", help="No progress bar, no summary.")] = (
        False
    )
    verbose: Annotated[
        bool, option("--verbose", "-v", panel="Output", help="Say what is solved, compiled and kept where.")
    ] = False
    json: Annotated[
        bool, option("--json", panel="Output", help="Print the summary as one JSON object, and nothing else.")
    ] = False

    def __post_init__(self):
        os.environ["MPLBACKEND"] = "Agg"  # pictures go to files: no screen is needed
        self.began = time.perf_counter()
        self.facts: dict[str, Any] = {}
        self.written: list[Path] = []
        self.status = 0

    def say(self, line: str) -> None:
        """A line of the summary."""
        if not (self.quiet or self.json):
            typer.echo(line)

    def note(self, line: str) -> None:
        """A remark for those who want to know more."""
        if self.verbose:
            typer.echo(line, err=True)

    def error(self, line: str, status: int = NO_ANSWER) -> None:
        """Why the wanted answer is not there, or not all of it."""
        typer.echo(f"rockjax: {line}", err=True)
        self.status = status

    def progress(self, total: int | None, unit: str) -> Any:
        """A bar with the time left, on stderr."""
        from rockjax._progress import bar

        return bar(total, unit, not self.quiet, unit_scale=True)

    def write(
        self, path: str | Path, data: xarray.Dataset, groups: dict[str, xarray.Dataset] | None = None
    ) -> None:
        """Write a dataset, and others as groups of its file, with the command that made them."""
        from rockjax._files import write_dataset

        data.attrs |= {"command": COMMAND.get()} | MASSES.get({})
        self.wrote(write_dataset(path, data, groups))

    def draw(self, path: str | Path, draw: str, data: Any) -> None:
        """Write the picture `rockjax.plots.<draw>(data)`."""
        from rockjax import plots
        from rockjax._files import write_figure

        self.wrote(write_figure(path, getattr(plots, draw)(data).figure))

    def wrote(self, path: Path) -> None:
        self.written.append(path)

    def close(self) -> None:
        """The end of the summary."""
        seconds = time.perf_counter() - self.began
        for path in self.written:
            self.say(f"wrote {path}")
        if self.json:
            from rockjax._files import as_json
            from rockjax._version import __version__

            about = {"command": COMMAND.get(), "version": __version__, "seconds": round(seconds, 3)}
            facts = about | self.facts | {"files": list(map(str, self.written))}
            typer.echo(as_json(facts, ascii=True))  # valid in every encoding of stdout
        if self.verbose:
            self.note(_programs())
            self.note(f"{seconds:.1f} s in all")


def command(function: Callable[..., None]) -> Callable[..., None]:
    """The command that a function is: its groups of options as options one by one, and how it ends."""
    hints = get_type_hints(function, include_extras=True)
    parameters = inspect.signature(function).parameters.values()
    groups = {
        p.name: hints[p.name]
        for p in parameters
        if isinstance(hints[p.name], type) and issubclass(hints[p.name], Flags)
    }
    options = [inspect.Parameter("ctx", inspect.Parameter.KEYWORD_ONLY, annotation=typer.Context)]
    for p in parameters:
        if p.name not in groups:
            options.append(p.replace(kind=inspect.Parameter.KEYWORD_ONLY, annotation=hints[p.name]))
            continue
        of_field = get_type_hints(groups[p.name], include_extras=True)
        options += [
            inspect.Parameter(
                field.name,
                inspect.Parameter.KEYWORD_ONLY,
                default=field.default,
                annotation=of_field[field.name],
            )
            for field in dataclasses.fields(groups[p.name])
            if field.init
        ]

    @functools.wraps(function)
    def run(**values):
        from rockjax._plausibility import PlausibilityWarning

        ctx = values.pop("ctx")
        given = frozenset(name for name in values if _is_given(ctx, name))
        made = {name: _group(kind, values, given) for name, kind in groups.items()}
        own = {name: value for name, value in values.items() if name in hints and name not in groups}
        report = next((group for group in made.values() if isinstance(group, Report)), Report())
        with warnings.catch_warnings():
            warnings.filterwarnings("always", category=RuntimeWarning, module="rockjax")
            warnings.filterwarnings("always", category=PlausibilityWarning)
            warnings.showwarning = _speak
            try:
                function(**own, **made)
            except KeyboardInterrupt as stopped:
                there = ", ".join(map(str, report.written))
                kept = f"written so far: {there}" if there else "nothing is kept"
                typer.echo(f"\nrockjax: {str(stopped) or 'stopped'}; {kept}", err=True)
                raise typer.Exit(INTERRUPTED) from None
        report.close()
        if report.status:
            raise typer.Exit(report.status)

    described: Any = run
    described.__signature__ = inspect.Signature(options)
    described.__annotations__ = {p.name: p.annotation for p in options}
    described.__doc__ = flowing(function)
    return run


def flowing(function: Callable[..., None]) -> str:
    """The docstring of a command without the line breaks of its source, which help would keep."""
    paragraphs = (inspect.getdoc(function) or "").split("\n\n")
    return "\n\n".join(text if text.startswith("\b") else text.replace("\n", " ") for text in paragraphs)


def _is_given(ctx: typer.Context, name: str) -> bool:
    source = ctx.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"


def _group(kind: type[Flags], values: dict[str, Any], given: frozenset[str]) -> Flags:
    names = [field.name for field in dataclasses.fields(kind) if field.init]
    flags = kind(**{name: values[name] for name in names})
    flags.given = given.intersection(names)
    return flags


def _speak(message, category, filename, lineno, file=None, line=None) -> None:
    del category, filename, lineno, file, line
    typer.echo(f"rockjax: warning: {message}", err=True)


def prepare(report: Report | None = None) -> None:
    """Compiled programs are kept between runs."""
    import jax

    from rockjax._programs import key, store

    if store.enabled() and jax.config.jax_compilation_cache_dir is None:  # pyright: ignore[reportAttributeAccessIssue]
        # What is traced anew in every run; this process is our own. Of another version nothing is taken: what
        # comes from here cannot be kept as a program.
        jax.config.update("jax_compilation_cache_dir", str(store.root() / "jax" / key.source()[:16]))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)
    if report is not None and report.quiet:
        logging.getLogger("rockjax").setLevel(logging.ERROR)
    if report is not None and report.verbose:
        _count_programs()
        report.note(
            f"{shlex.join(['rockjax', *sys.argv[1:]])}: jax {jax.__version__} on {jax.default_backend()}"
        )


_MADE: dict[str, float] = {"programs": 0, "seconds": 0.0, "kept": 0}


@functools.cache
def _count_programs() -> None:
    import jax

    def finished(event: str, duration_secs: float, **_) -> None:
        if event == "/jax/core/compile/backend_compile_duration":
            _MADE["programs"] += 1
            _MADE["seconds"] += duration_secs
            if duration_secs > 0.5:
                _beside_bars(f"compiled or loaded a program in {duration_secs:.1f} s")

    def happened(event: str, **_) -> None:
        if event == "/jax/compilation_cache/cache_hits":
            _MADE["kept"] += 1

    jax.monitoring.register_event_duration_secs_listener(finished)
    jax.monitoring.register_event_listener(happened)


def _beside_bars(line: str) -> None:
    from tqdm import tqdm

    tqdm.write(line, file=sys.stderr)


def _programs() -> str:
    from rockjax._programs import store
    from rockjax._programs.program import COUNTS

    kept = _MADE["kept"] + COUNTS["loaded"]
    return (
        f"{_MADE['programs']:.0f} programs in {_MADE['seconds']:.1f} s of compiling, side by side; "
        f"{kept:.0f} were kept from before in {store.root()}"
    )


def interrupted(output: Path, datasets: list, message: str = "stopped before all was written") -> typer.Exit:
    """Keep what is there, and say how to go on."""
    from rockjax._cli import partial

    if any(data is not None for data in datasets):
        kept = partial.save(partial.path_of(output), datasets)
        typer.echo(
            f"\nrockjax: {message}; kept in {kept}: the same command with --resume goes on from there",
            err=True,
        )
    else:
        typer.echo(f"\nrockjax: {message}; nothing to keep", err=True)
    return typer.Exit(INTERRUPTED)
