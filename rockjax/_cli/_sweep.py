"""`rockjax sweep`."""

from __future__ import annotations

import contextlib
import dataclasses
import os
from collections.abc import Iterator
from typing import Annotated, Any

import typer

from rockjax._problem import models
from rockjax._problem.models import GRID, MACHINES, OUTPUT

from ._options import PULSE_DEFAULTS, SINGLE_DEFAULTS, accuracy_options, option, options_of, structure_options
from ._outputs import store_path
from ._request import Request
from ._run import INTERRUPTED, Console, command


@command(
    structure_options(**SINGLE_DEFAULTS),
    options_of(models.Pulses, **PULSE_DEFAULTS),
    options_of(models.Record),
    options_of(models.Sweep),
    accuracy_options(rtol=1e-8, method="dopri8"),
)
def sweep(
    request: Request,
    console: Console,
    axis: Annotated[
        list[str],
        option(
            "--axis",
            panel=GRID,
            metavar="NAME=VALUES",
            help="An axis of the grid: alpha=0.1,0.12,0.15, or alpha=0.1:0.2:11 for 11 values from 0.1 to "
            "0.2, or gamma=1:100:7:log for equal ratios. Repeat the option for each axis.",
        ),
    ] = (),  # pyright: ignore[reportArgumentType]
    workers: Annotated[
        int | None,
        option(
            "--workers",
            panel=MACHINES,
            min=1,
            help="Number of worker processes on this machine, one core each.",
        ),
    ] = None,
    scheduler: Annotated[
        str | None,
        option(
            "--scheduler",
            panel=MACHINES,
            help="Address or file (.json) of a running Dask scheduler.",
        ),
    ] = None,
    dry_run: Annotated[
        bool,
        option("--dry-run", panel=MACHINES, help="Only estimate time, memory and disk space."),
    ] = False,
    store: Annotated[  # not Path, which removes a slash of a URL
        str, option("--output", "-o", panel=OUTPUT, help="The zarr store to write: a folder or a URL.")
    ] = "rockjax-sweep.zarr",
) -> None:
    """Compute peak responses of a grid of scenes of any size, chunk by chunk, on this machine or a cluster.

    A scene is one structure under one motion. The axes are parameters of the structure and of the motion. For
    a structure by dimensions they are its keys, in the units of the file; the value for a list is a factor. A
    set of several motions is an additional axis. Writes a zarr store, which xarray opens. The same command
    continues an interrupted sweep: chunks in the store are verified and reused.

    \b
    Examples:
      rockjax sweep --axis tan_alpha=0.1:0.3:21 --axis frequency_ratio=1:8:141
      rockjax sweep --example sweep --dry-run
      rockjax sweep dimensions.toml --axis story_stiffnesses=0.9,1,1.1 \\
        --workers 2 -o study.zarr
      rockjax sweep problem.toml --scheduler tcp://10.0.0.1:8786 \\
        -o /shared/study.zarr
    """
    import rockjax as rj
    from rockjax._sweep.store import require_zarr

    require_zarr()
    path = store_path(store)
    if workers is not None and scheduler is not None:
        raise ValueError("--workers and --scheduler are alternatives; give one")
    structure, axes = request.structure(), _axes(request, axis)
    if not axes:
        raise ValueError(
            "rockjax sweep needs an axis, such as --axis alpha=0.1:0.2:11, or [sweep.axes] in a problem file"
        )
    options = request.options(outputs=tuple(request.settings.outputs))
    with request.reader.errors_at("sweep.axes"):
        scenes = rj.grid(structure, request.motion_or_set(request.podium()), **axes)
    console.note(repr(scenes))
    arguments: dict[str, Any] = {
        "store": path,
        "options": options,
        "chunk": request.settings.chunk,
        "progress": not console.quiet,
    }
    with _client(workers, scheduler) as client:
        if dry_run:
            plan: Any = rj.sweep(*scenes, **arguments, client=client, dry_run=True)
            console.say(repr(plan))
            console.json_object |= dataclasses.asdict(plan)
            return
        try:
            data: Any = rj.sweep(*scenes, **arguments, client=client)
        except rj.Interrupted as interrupt:
            typer.echo(f"\nrockjax: {interrupt}", err=True)
            raise typer.Exit(INTERRUPTED) from None
    console.add_file(path)
    console.json_object |= console.say_scenes(data, scenes.size)
    failed = console.json_object["without_answer"]
    if failed:
        console.error(
            f"{failed} of {scenes.size} scenes did not finish; the variable 'result' names the cause of each"
        )


def _axes(request: Request, texts: list[str]) -> dict[str, Any]:
    """Return the values along each axis, by name. An axis on the command line replaces the axis of the same
    name in the problem file.

    - `request`: problem of the command
    - `texts`: values of `--axis`, such as "alpha=0.1:0.2:11"
    """
    import numpy as np

    from_options = {}
    for text in texts:
        name, equals, values = text.partition("=")
        if not equals or not name:
            raise ValueError(f"--axis needs NAME=VALUES, got {text!r}")
        if name in from_options:
            raise ValueError(f"--axis gives {name} twice; give each axis once")
        from_options[name] = _parse_axis(values)
    axes = request.settings.axes | request.reader.check(models.Sweep, {"axes": from_options}).axes
    return {
        name: np.asarray(axis)
        if isinstance(axis, list)
        else (np.geomspace if axis.log else np.linspace)(axis.low, axis.high, axis.points)
        for name, axis in axes.items()
    }


def _parse_axis(text: str) -> Any:
    """Return the part of `--axis` after "=" as an entry of the table `[sweep.axes]`."""
    message = (
        f"--axis needs numbers separated by commas, low:high:points or low:high:points:log, got {text!r}"
    )
    try:
        if ":" not in text:
            return [float(number) for number in text.split(",")]
        low, high, points, *log = text.split(":")
        span = {"from": float(low), "to": float(high), "points": int(points)}
    except ValueError:
        raise ValueError(message) from None
    if log not in ([], ["log"]):
        raise ValueError(message)
    return span | {"log": bool(log)}


@contextlib.contextmanager
def _client(workers: int | None, scheduler: str | None) -> Iterator[Any]:
    """Yield a Dask client: of a scheduler, or of `workers` new processes on this machine. Yield None if
    neither is given."""
    if workers is None and scheduler is None:
        yield None
        return
    import jax
    from distributed import Client, LocalCluster

    if scheduler is not None:
        connection: dict[str, Any] = {
            "scheduler_file" if scheduler.endswith(".json") else "address": scheduler
        }
        with Client(**connection) as client:
            yield client
        return
    # Worker processes inherit these environment variables, and so share JAX's cache of compiled programs.
    folder = jax.config.jax_compilation_cache_dir  # pyright: ignore[reportAttributeAccessIssue]
    if folder is not None:
        os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(folder))
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.5")
    local = LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None)  # pyright: ignore[reportArgumentType]
    with local, Client(local) as client:
        yield client
