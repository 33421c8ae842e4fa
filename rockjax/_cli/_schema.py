"""`rockjax schema`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rockjax._problem.models import OUTPUT

from ._options import option
from ._run import Console, command


@command(jax=False)
def schema(
    console: Console,
    output: Annotated[
        Path | None, option("--output", "-o", panel=OUTPUT, help="File to write, instead of printing.")
    ] = None,
) -> None:
    """Print or write the JSON schema of problem files, for completion and checks in editors.

    \b
    Examples:
      rockjax schema
      rockjax schema -o rockjax.schema.json
    """
    import json

    from rockjax._extensions import extension
    from rockjax._files import write_atomically

    json_schema = extension("design").problem_schema()
    text = json.dumps(json_schema, indent=1) + "\n"
    if output is not None:
        console.add_file(write_atomically(output, lambda name: Path(name).write_text(text, encoding="utf-8")))
    elif console.json:
        console.json_object["schema"] = json_schema
    else:
        typer.echo(text)  # also with --quiet, which suppresses only the summary
