"""The command-line application, and its exit status on errors."""

from __future__ import annotations

import gc
import shlex
from typing import Annotated

import typer
import typer.core

from ._context import COMMAND
from ._run import FAILED, INTERRUPTED, WRONG_INPUT, unwrap_docstring
from ._terminal import terminal


class _Commands(typer.core.TyperGroup):
    """Group of all commands. It stores the command line, which output files contain as an attribute."""

    def parse_args(self, ctx, args):
        COMMAND.set(shlex.join(["rockjax", *args]))
        return super().parse_args(ctx, args)


# Number of new objects after which Python's garbage collector runs. With the default of 700, the collector
# takes 10 % of the time of the imports, which create few cycles.
COLLECTOR_THRESHOLD = 100_000

app = typer.Typer(
    cls=_Commands,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(is_requested: bool) -> None:
    if is_requested:
        from rockjax._version import __version__

        typer.echo(f"rockjax {__version__}")
        raise typer.Exit


def about(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    """Rocking podium structures: responses, spectra, overturning, fragility, design.

    Options, a problem file (TOML), or both define the structure and its ground motion; options override the
    file. Units are SI and radians. `rockjax COMMAND --help` has examples.

    Exit status: 0 = success. 1 = failure: for example, a scene (one structure under one ground motion) did
    not finish, no design satisfies the targets, a check by `rockjax report` did not pass, no fragility curve
    could be fitted, or a file could not be written. 2 = wrong input. 130 = interrupted.
    """
    del version


app.callback(help=unwrap_docstring(about))(about)


def main() -> None:
    """Run the command line. An error is printed as a message, and sets the exit status."""
    gc.set_threshold(COLLECTOR_THRESHOLD)
    with terminal():
        try:
            app()
        except KeyboardInterrupt:
            typer.echo("\nrockjax: stopped", err=True)
            raise SystemExit(INTERRUPTED) from None
        except ValueError as error:
            typer.echo(f"rockjax: {error}", err=True)
            raise SystemExit(WRONG_INPUT) from None
        except (OSError, RuntimeError, ImportError) as error:
            typer.echo(f"rockjax: {error}", err=True)
            raise SystemExit(FAILED) from None
