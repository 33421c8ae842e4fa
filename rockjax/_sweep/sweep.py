"""Sweeps: any number of scenes in chunks, on one machine or many, saved chunk by chunk in a zarr store.

Each chunk is one call of the batch path. Dask distributes the chunks and repeats them after the failure of a
machine; this module defines the chunks, their order, and the properties that must agree to resume a store.
"""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rockjax._checks import require_instance, require_whole
from rockjax._machine.memory import readable_bytes
from rockjax._motions.convert import AnyMotions
from rockjax._motions.provenance import describe_motions
from rockjax._options import Options
from rockjax._responses.datasets import describe_options
from rockjax._results import REST, Interrupted, State
from rockjax._structures import Podium

from .chunks import Devices, Job
from .pilot import Pilot
from .runners import ChunkProgress, DaskRunner, LocalRunner
from .store import ChunkLayout, Store, TakenError, expand_path, require_creatable, require_zarr
from .study import SweepSpec, check_same, make_study, sweep_coords

if TYPE_CHECKING:
    import xarray

BYTES = 300  # memory for a scene while it is solved, besides its numbers


def sweep(
    structures: Podium,
    excitations: AnyMotions,
    coords: Mapping[str, Any] | Sequence[str] | None = None,
    *,
    store: str | Path,
    initial: State = REST,
    t_end=None,
    options: Options = Options(),
    outputs: Sequence[str] | None = None,
    sensitivities: Sequence[str] = (),
    chunk: int | None = None,
    client: Any = None,
    devices: Devices = None,
    progress: bool = True,
    dry_run: bool = False,
) -> xarray.Dataset | SweepPlan:
    """Compute peak responses of any number of scenes, chunk by chunk into a zarr store (host).

    Scenes are those of [`rockjax.peak_responses`][]: every number of `structures`, `excitations`, `initial`
    and `t_end` may be an array, and they broadcast to the shape of the sweep. [`rockjax.grid`][] makes them
    for a grid, with `coords`; arrays of one length make a table of scenes.

    The same call resumes an interrupted sweep: chunks in the store are verified by their checksums and kept,
    missing or damaged ones are solved. Returns the store as a lazy `xarray.Dataset`, with the numbers that
    vary as its coordinates. Scenes that do not finish keep their `result`, and a `RuntimeWarning` counts
    them. Ctrl-C raises [`rockjax.Interrupted`][], whose `partial` is the dataset so far.

    - `structures`, `excitations`, `initial`, `t_end`: as for [`rockjax.peak_responses`][]
    - `coords`: the names of the axes in order, with or without labels; by default `scene` for a table
    - `store`: a folder, or a URL that zarr can write to; with a `client` one that all workers can access
      under this name
    - `options`: of the scenes
    - `outputs`: requested outputs, as in [`rockjax.Options`][]
    - `sensitivities`: parameters y for which y ∂/∂y of every requested peak is stored as well, as in
      [`rockjax.peak_responses`][]: `peak_rotation_sensitivity` … with the further dim `parameter`
    - `chunk`: scenes in a chunk; by default as many as take some seconds
    - `client`: a `dask.distributed.Client`: chunks are solved by its workers, one core each. Without it, by
      all cores of this machine
    - `devices`: `"all"` for all JAX devices where a chunk is solved, by `shard_map`; or some devices of this
      machine. Without it the cores of the CPU, or all GPUs if JAX has some
    - `progress`: show a bar with the remaining time, by the expected cost of the chunks
    - `dry_run`: solve a sample of the scenes, and return a `SweepPlan` with the expected time, memory and
      disk space of all; nothing is written

    Raises `ValueError` for invalid inputs, and for a store of another sweep: other numbers, other options,
    another version; `OSError` if the store cannot be written; `RuntimeError` if workers fail; `ImportError`
    without the extra `rockjax[sweep]`. Chunks solved until then are kept in all cases.
    """
    require_zarr()
    study = make_study(structures, excitations, coords, initial, t_end, options, outputs, sensitivities)
    if chunk is not None:
        require_whole("sweep", "chunk", chunk, 1)
    require_instance("sweep", "store", store, str | Path, "a folder or a URL")
    found = Store.open(store)
    if found is not None:
        check_same(found, study, chunk)
    runner = LocalRunner(devices) if client is None else DaskRunner(client, devices)
    if found is None or dry_run:
        if not dry_run:
            require_creatable(store)
        pilot = runner.pilot(study)
        size = chunk or pilot.chunk(study.scenes, runner.cores, runner.cores_of_chunk)
        layout = ChunkLayout.of(study.shape, size) if found is None else found.layout
        if dry_run:
            return _plan(study, layout, pilot, found, runner, expand_path(store))
        found = _create_store(store, study, layout, pilot, chunk, describe_motions(excitations))
    fingerprint, skeleton = found.identity["fingerprint"], study.numbers.skeleton
    job = Job(found.path, fingerprint, skeleton, study.options, study.precision, study.sensitivities)
    unsolved, solved = _find_unsolved(found, progress)
    with ChunkProgress(found, unsolved, solved, progress) as bar:
        interrupt = runner.run(job, unsolved, bar)
    data = found.dataset()
    if interrupt is not None:
        message = (
            f"stopped with "
            f"{bar.done} of {found.layout.number} chunks solved, kept in {found.path}: the same call goes on"
        )
        raise Interrupted(message, data) from interrupt
    failed = int(np.nansum(found.rows()[:, -1]))
    if failed:
        message = f"{failed} of {study.scenes} scenes did not finish; their variable 'result' names the cause"
        warnings.warn(message, RuntimeWarning, stacklevel=2)
    return data


def _create_store(
    path, study: SweepSpec, layout: ChunkLayout, pilot: Pilot, chunk: int | None, motions
) -> Store:
    """Return a new store; or, if another client was the first to start this very sweep, its store."""
    import xarray

    coords = xarray.Dataset(coords=dict(sweep_coords(study)))
    common_numbers = {name: float(y) for name, y in study.numbers.common().items() if y.ndim == 0}
    attrs = {"title": "Sweep of peak responses", "kind": "sweep", **common_numbers, **motions}
    attrs |= describe_options(study.options)
    parts = coords, pilot.variables, study.numbers.arrays, pilot.expected(layout), attrs
    try:
        return Store.create(path, study.identity(layout), study.dims, *parts)
    except TakenError:
        found = Store.open(path)
        assert found is not None
        check_same(found, study, chunk)
        return found


def _find_unsolved(found: Store, progress: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return the chunks to solve, the most expensive first, so that the last ones are short; and those that
    are done."""
    from tqdm.auto import tqdm  # a widget in notebooks

    rows = found.rows()
    done = np.isfinite(rows[:, 0])
    for k in tqdm(
        np.flatnonzero(done), desc="verifying", unit=" chunks", disable=not progress or not done.any()
    ):
        if not found.is_intact(int(k), rows[k]):
            warnings.warn(
                f"{found.path}: chunk {k} is damaged, and is solved again", RuntimeWarning, stacklevel=3
            )
            found.forget(int(k))
            done[k] = False
    expected = found.expected
    unsolved = np.flatnonzero(~done)
    return unsolved[np.argsort(-expected[unsolved], kind="stable")], np.flatnonzero(done)


@dataclasses.dataclass(frozen=True)
class SweepPlan:
    """Expected cost of a sweep, measured on a sample of its scenes.

    - `scenes`; `shape`: along each axis; `chunk`: of a chunk; `chunks`: their number; `done`: scenes in the
      store already
    - `steps`: remaining trial steps; `core_seconds`: time of one core for them [s]; `cores`: number of
      available cores; `seconds`: expected wall time [s]
    - `memory`: of the process that solves a chunk [bytes]; `disk`: upper limit for the store, because
      neighbours on a grid compress better than the sample does [bytes]
    - `store`: its path or URL
    """

    scenes: int
    shape: tuple[int, ...]
    chunk: tuple[int, ...]
    chunks: int
    done: int
    steps: float
    core_seconds: float
    cores: int
    seconds: float
    memory: int
    disk: int
    store: str

    def __repr__(self) -> str:
        axes = " × ".join(map(str, self.shape))
        of_chunk = " × ".join(map(str, self.chunk))
        rows = [
            ("scenes", f"{self.scenes} ({axes})" + (f", {self.done} solved" if self.done else "")),
            ("chunks", f"{self.chunks}, each {of_chunk}"),
            ("steps", f"{self.steps:.3g}, {self.steps / max(1, self.scenes - self.done):.3g} a scene"),
            (
                "time",
                f"{_duration(self.seconds)} on {self.cores} cores ({self.core_seconds:.3g} core seconds)",
            ),
            ("memory", f"{readable_bytes(self.memory)} in each process"),
            ("disk", f"up to {readable_bytes(self.disk)} in {self.store}"),
        ]
        return "\n".join(["SweepPlan", *(f"  {label:<8} {value}" for label, value in rows)])


def _duration(seconds: float) -> str:
    for unit, length in (("d", 86400), ("h", 3600), ("min", 60)):
        if seconds >= 2 * length:
            return f"{seconds / length:.3g} {unit}"
    return f"{seconds:.3g} s"


def _plan(
    study: SweepSpec,
    layout: ChunkLayout,
    pilot: Pilot,
    found: Store | None,
    runner: LocalRunner | DaskRunner,
    path: str,
) -> SweepPlan:
    expected = pilot.expected(layout)
    done = np.zeros(layout.number, bool) if found is None else np.isfinite(found.rows()[:, 0])
    sizes = layout.sizes()
    steps = float(expected[~done].sum())
    core_seconds = steps * pilot.core_seconds
    bytes_per_scene = sum(y.itemsize for y in study.numbers.varying().values())
    return SweepPlan(
        scenes=study.scenes,
        shape=study.shape,
        chunk=layout.block,
        chunks=layout.number,
        done=int(sizes[done].sum()),
        steps=steps,
        core_seconds=core_seconds,
        cores=runner.cores,
        seconds=core_seconds / min(runner.cores, runner.cores_of_chunk * max(1, int((~done).sum()))),
        memory=pilot.resident + int(sizes.max()) * (BYTES + 4 * bytes_per_scene),
        disk=int(pilot.bytes_ * study.scenes + sum(y.nbytes for y in study.numbers.arrays.values())),
        store=path,
    )
