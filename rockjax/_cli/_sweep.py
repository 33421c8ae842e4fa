"""`rockjax sweep`."""

from __future__ import annotations

import contextlib
import dataclasses
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ._given import Given, names, problem_file
from ._options import GRID, OUTPUT, Accuracy, Example, Motion, ProblemFile, Structure
from ._outputs import store_place
from ._run import INTERRUPTED, Flags, Report, flag, option, prepare

if TYPE_CHECKING:
    import rockjax as rj

MACHINES = "Machines"


@dataclass
class Grid(Flags):
    axis: Annotated[
        list[str],
        option(
            "--axis",
            panel=GRID,
            metavar="NAME=VALUES",
            help=(
                "An axis of the grid, once for each: alpha=0.1,0.12,0.15 or alpha=0.1:0.2:11 for 11 values "
                "from 0.1 to 0.2, "
                "or gamma=1:100:7:log for equal ratios."
            ),
        ),
    ] = ()  # pyright: ignore[reportAssignmentType]
    outputs: Annotated[
        str,
        option(
            "--outputs",
            panel=GRID,
            help="Wanted answers, separated by commas: peak_rotation, peak_shear, margin …",
        ),
    ] = "peak_rotation"


@dataclass
class Machines(Flags):
    chunk: Annotated[
        int | None,
        option("--chunk", panel=MACHINES, min=1, help="Scenes in a chunk; by default some seconds of them."),
    ] = None
    workers: Annotated[
        int | None,
        option(
            "--workers", panel=MACHINES, min=1, help="So many processes on this machine, of one core each."
        ),
    ] = None
    scheduler: Annotated[
        str | None,
        option(
            "--scheduler",
            panel=MACHINES,
            help="A Dask scheduler that runs already: its address, or its file (.json).",
        ),
    ] = None
    dry_run: Annotated[
        bool,
        option(
            "--dry-run", panel=MACHINES, help="Only say how long it will take, and how much memory and disk."
        ),
    ] = False


def sweep(
    structure: Structure,
    motion: Motion,
    grid: Grid,
    machines: Machines,
    accuracy: Accuracy,
    report: Report,
    problem: ProblemFile = None,
    example: Example = None,
    store: Annotated[Path, option("--output", "-o", panel=OUTPUT, help="The zarr store to write.")] = Path(
        "rockjax-sweep.zarr"
    ),
) -> None:
    """Peak responses of a grid of any size, chunk by chunk, on this machine or a cluster.

    The axes are numbers of the structure and of the motion; a set of several motions is an axis of its own.
    Writes a zarr store that xarray opens. However a sweep was stopped, the same command goes on where it was:
    what is in the store is verified and left.

    \b
    Examples:
      rockjax sweep --axis tan_alpha=0.1:0.3:21 --axis frequency_ratio=1:8:141
      rockjax sweep --example sweep --dry-run
      rockjax sweep problem.toml --workers 2 -o study.zarr
      rockjax sweep problem.toml --scheduler tcp://10.0.0.1:8786 \\
        -o /shared/study.zarr
    """
    prepare(report)
    import rockjax as rj
    from rockjax._sweep.store import require_zarr

    require_zarr()
    store = store_place(store)
    given = Given("sweep", problem_file(problem, example), structure, motion, grid, machines, accuracy)
    if machines.workers is not None and machines.scheduler is not None:
        raise ValueError("--workers and --scheduler: give one of them")
    podium = given.podium(structure)
    grid, machines = given.settings(grid), given.settings(machines)
    axes = _axes(given, grid)
    if not axes:
        raise ValueError(
            "--axis: no axis is given; such as --axis alpha=0.1:0.2:11, or [sweep.axes] in a problem file"
        )
    options = given.options(accuracy, outputs=tuple(names(grid.outputs)))
    with given.reader.at("sweep.axes"):
        scenes = rj.grid(podium, _excitation(given, motion, podium), **axes)
    report.note(repr(scenes))
    call: dict[str, Any] = {
        "store": store,
        "options": options,
        "chunk": machines.chunk,
        "progress": not report.quiet,
    }
    with _client(machines) as client:
        if machines.dry_run:
            plan: Any = rj.sweep(*scenes, **call, client=client, dry_run=True)
            report.say(repr(plan))
            report.facts |= dataclasses.asdict(plan)
            return
        try:
            data: Any = rj.sweep(*scenes, **call, client=client)
        except rj.Interrupted as stopped:
            typer.echo(f"\nrockjax: {stopped}", err=True)
            raise typer.Exit(INTERRUPTED) from None
    report.wrote(store)
    overturned = float(data["overturned"].mean())
    failed = int((data["result"] > 2).sum())
    from rockjax._responses.peak import UNTIL_OVERTURNING

    until = f" (peaks {UNTIL_OVERTURNING})" if overturned else ""
    report.say(f"{scenes.size} scenes: {overturned:.1%} overturned{until}, {failed} without an answer")
    report.facts |= {"scenes": scenes.size, "overturned": overturned, "without_answer": failed}
    if failed:
        report.error(f"{failed} of {scenes.size} scenes ended without an answer")


def _axes(given: Given, grid: Grid) -> dict[str, Any]:
    """The axes of the file, those of the command line over them."""
    from rockjax._problem import axis_values

    axes: dict[str, Any] = {}
    table = given.own.get("axes", {})
    for name, value in table.items():
        with given.reader.at(f"sweep.axes.{name}"):
            axes[name] = axis_values(value)
    for text in grid.axis:
        name, equals, values = text.partition("=")
        if not equals or not name:
            raise ValueError(f"{flag('axis')}: expected NAME=VALUES, got {text!r}")
        try:
            axes[name] = axis_values(_parsed(values))
        except ValueError as error:
            raise ValueError(f"{flag('axis')} {name}: {error}") from None
    return axes


def _parsed(text: str) -> Any:
    """An axis on the command line as it is in a file."""
    form = f"expected numbers separated by commas, low:high:points or low:high:points:log, got {text!r}"
    try:
        if ":" not in text:
            return [float(part) for part in text.split(",")]
        low, high, points, *log = text.split(":")
        span = {"from": float(low), "to": float(high), "points": int(points)}
    except ValueError:
        raise ValueError(form) from None
    if log not in ([], ["log"]):
        raise ValueError(form)
    return span | {"log": bool(log)}


def _excitation(given: Given, motion: Motion, podium: rj.Podium) -> Any:
    """One motion; or a whole set of them, where a file has one and no option chooses among it."""
    sets = given.reader.sets(given.table.get("motions", {}))
    name = given.settings(motion).motion or (next(iter(sets)) if len(sets) == 1 else None)
    if name is None or motion.given - {"motion"}:
        return given.excitation(motion, podium)
    entries = given.reader.set_named(name, "sweep.motion", sets)
    each = entries if isinstance(entries, list) else [entries]
    if any(isinstance(entry, dict) and "kind" in entry for entry in each):
        found = given.reader.motion_set(entries, f"motions.{name}", podium)
        return found[0] if len(found) == 1 else found
    found = given.reader.recorded_set(entries, f"motions.{name}")
    return found[0].record() if len(found) == 1 else found


@contextlib.contextmanager
def _client(machines: Machines) -> Iterator[Any]:
    """The cluster that is wanted, None for this process."""
    if machines.workers is None and machines.scheduler is None:
        yield None
        return
    import jax
    from distributed import Client, LocalCluster

    if machines.scheduler is not None:
        how: dict[str, Any] = {
            "scheduler_file" if machines.scheduler.endswith(".json") else "address": machines.scheduler
        }
        with Client(**how) as client:
            yield client
        return
    # Workers share the compiled programs.
    folder = jax.config.jax_compilation_cache_dir  # pyright: ignore[reportAttributeAccessIssue]
    if folder is not None:
        os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(folder))
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.5")
    local = LocalCluster(n_workers=machines.workers, threads_per_worker=1, dashboard_address=None)  # pyright: ignore[reportArgumentType]
    with local, Client(local) as client:
        yield client
