"""Sweeps: any number of scenes, solved in chunks on one or several machines and saved in a zarr store.

A scene is one structure under one ground motion. Each chunk is one batch. The store is a folder of compressed
arrays in zarr format. A Dask cluster distributes the chunks, and repeats the chunks of workers that fail.
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
from .layout import ChunkLayout
from .paths import TakenError, expand_path, require_creatable
from .pilot import Pilot
from .runners import ChunkProgress, DaskRunner, LocalRunner
from .spec import SweepSpec, check_axis_names, check_same, make_spec, sweep_coords
from .store import Store, require_zarr

if TYPE_CHECKING:
    import xarray

SCENE_BYTES = 300  # memory of a scene while it is solved, without its parameters [bytes]


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
    """Compute peak responses of any number of scenes in chunks, and save them in a zarr store.

    Call this function outside jit. A scene is one structure under one ground motion. Scenes are defined as
    for [`rockjax.peak_responses`][]: the parameters of `structures`, `excitations`, `initial` and `t_end` may
    be arrays, which broadcast to the shape of the sweep. [`rockjax.grid`][] returns the first three arguments
    for a grid. Arrays of shape (n,) define a list of scenes.

    The same call resumes an interrupted sweep. Chunks in the store are verified by their checksums and
    reused; missing or damaged chunks are solved. Ctrl-C raises [`rockjax.Interrupted`][], whose `partial` is
    the dataset with the results so far, or None while a sample of the scenes is solved.

    - `structures`, `excitations`, `initial`, `t_end`: as for [`rockjax.peak_responses`][]
    - `coords`: names of the axes in order, or a dict of axis name → labels. The default name is `scene` for a
      single axis; several axes are `scene_0`, `scene_1`, …
    - `store`: path of a folder, or a URL that zarr can write to. With a `client`, all workers must have
      access to the store under this path or URL
    - `options`: options of the scenes
    - `outputs`: requested outputs, instead of `options.outputs`
    - `sensitivities`: names of parameters y, as in [`rockjax.peak_responses`][]. The derivatives y ∂/∂y of
      every requested peak are stored as `peak_rotation_sensitivity` … with the additional dim `parameter`
    - `chunk`: largest number of scenes in a chunk, ≥ 1; by default as many as take a few seconds
    - `client`: a `dask.distributed.Client`, whose workers solve the chunks. If None, this process solves one
      chunk after another
    - `devices`: devices that solve a chunk. `"all"` means all JAX devices of the process that solves it. A
      list of devices of this machine is permitted without a `client`. The default with a `client` is one CPU
      core for each chunk. The default without a `client` is all accelerators, or all CPU cores if there are
      no accelerators
    - `progress`: True to show a bar with the remaining time
    - `dry_run`: True to solve only a sample of the scenes, without writing anything, and to return a
      `SweepPlan` with the expected time, memory and disk space of the sweep

    Returns the store as a lazy `xarray.Dataset`, or a `SweepPlan` if `dry_run`. Parameters that vary between
    scenes are coordinates of the dataset. The `result` of scenes that do not finish names the cause, and a
    `RuntimeWarning` counts such scenes.

    Raises `ValueError` for invalid inputs and for a store with other parameters, options or versions;
    `OSError` if the store cannot be written; `RuntimeError` if workers fail; `ImportError` without the extra
    `rockjax[sweep]`. The store keeps all chunks solved before the error.
    """
    require_zarr()
    spec = make_spec(structures, excitations, coords, initial, t_end, options, outputs, sensitivities)
    if chunk is not None:
        require_whole("sweep", "chunk", chunk, 1)
    require_instance("sweep", "store", store, str | Path, "a folder or a URL")
    open_store = Store.open(store)
    if open_store is not None:
        check_same(open_store, spec, chunk)
    runner = LocalRunner(devices) if client is None else DaskRunner(client, devices)
    if open_store is None or dry_run:
        if not dry_run:
            require_creatable(store)
        try:
            pilot = runner.pilot(spec)
        except KeyboardInterrupt:
            raise Interrupted(
                "stopped while a sample of the scenes was solved; no results were stored; repeat the call to "
                "start again",
                None,
            ) from None
        check_axis_names(spec.dims, pilot.variables)
        chunk_size = chunk or pilot.chunk_size(spec.scenes, runner.cores, runner.cores_of_chunk)
        layout = (
            ChunkLayout.from_chunk_size(spec.shape, chunk_size) if open_store is None else open_store.layout
        )
        if dry_run:
            return _plan(spec, layout, pilot, open_store, runner, expand_path(store))
        motions = getattr(coords, "motions", None) or describe_motions(excitations)
        open_store = _create_store(store, spec, layout, pilot, chunk, motions)
    fingerprint, skeleton = open_store.identity["fingerprint"], spec.scene_arrays.skeleton
    job = Job(open_store.path, fingerprint, skeleton, spec.options, spec.is_float64, spec.sensitivities)
    unsolved, solved = _find_unsolved(open_store, progress)
    with ChunkProgress(open_store, unsolved, solved, progress) as bar:
        interrupt = runner.run(job, unsolved, bar)
    data = open_store.dataset()
    if interrupt is not None:
        message = (
            f"stopped with {bar.done} of {open_store.layout.chunk_count} chunks in {open_store.path}; "
            "repeat the call to continue"
        )
        raise Interrupted(message, data) from interrupt
    failed = int(np.nansum(open_store.rows()[:, -1]))
    if failed:
        message = f"{failed} of {spec.scenes} scenes did not finish; their variable 'result' names the cause"
        warnings.warn(message, RuntimeWarning, stacklevel=2)
    return data


def _create_store(
    path, spec: SweepSpec, layout: ChunkLayout, pilot: Pilot, chunk: int | None, motions
) -> Store:
    """Create the store, or return the store that another process has just created for the same sweep.

    - `path`, `chunk`: `store` and `chunk` of `sweep`
    - `spec`, `layout`: specification of the sweep, and its chunks
    - `pilot`: solved sample, for the result arrays and the expected cost
    - `motions`: attributes that describe the motions
    """
    import xarray

    coords = xarray.Dataset(coords=dict(sweep_coords(spec)))
    common_values = {name: float(y) for name, y in spec.scene_arrays.common().items() if y.ndim == 0}
    attrs = {"title": "Sweep of peak responses", "kind": "sweep", **common_values, **motions}
    attrs |= describe_options(spec.options)
    contents = coords, pilot.variables, spec.scene_arrays.arrays, pilot.expected_steps(layout), attrs
    try:
        return Store.create(path, spec.identity(layout), spec.dims, *contents)
    except TakenError:
        existing = Store.open(path)
        assert existing is not None
        check_same(existing, spec, chunk)
        return existing


def _find_unsolved(store: Store, progress: bool) -> tuple[np.ndarray, np.ndarray]:
    """Verify the chunks in a store, and return the indices of the unsolved and the solved chunks.

    The most expensive unsolved chunks come first, so that workers wait less for the last chunks.
    """
    from tqdm.auto import tqdm  # shown as a widget in notebooks

    rows = store.rows()
    is_solved = np.isfinite(rows[:, 0])
    for k in tqdm(
        np.flatnonzero(is_solved),
        desc="verifying",
        unit=" chunks",
        disable=not progress or not is_solved.any(),
    ):
        if not store.is_intact(int(k), rows[k]):
            warnings.warn(
                f"{store.path}: chunk {k} is damaged and is solved again", RuntimeWarning, stacklevel=3
            )
            store.mark_unsolved(int(k))
            is_solved[k] = False
    unsolved = np.flatnonzero(~is_solved)
    return unsolved[np.argsort(-store.expected[unsolved], kind="stable")], np.flatnonzero(is_solved)


@dataclasses.dataclass(frozen=True)
class SweepPlan:
    """Expected cost of a sweep, measured on a sample of its scenes.

    - `scenes`: number of scenes
    - `shape`: number of scenes along each axis
    - `chunk`: number of scenes of a chunk along each axis
    - `chunks`: number of chunks
    - `done`: number of scenes already in the store
    - `steps`: expected number of remaining trial steps (accepted and rejected)
    - `core_seconds`: expected time of the remaining trial steps on one core or device [s]
    - `cores`: number of cores or devices that solve the sweep
    - `seconds`: expected wall time [s]
    - `memory`: expected memory of the process that solves a chunk [bytes]
    - `disk`: expected size of the store [bytes], usually too large, because neighbouring scenes of a grid
      compress better than the sample
    - `store`: path or URL of the store
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
        chunk_axes = " × ".join(map(str, self.chunk))
        rows = [
            ("scenes", f"{self.scenes} ({axes})" + (f", {self.done} solved" if self.done else "")),
            ("chunks", f"{self.chunks}, each {chunk_axes}"),
            ("steps", f"{self.steps:.3g}, {self.steps / max(1, self.scenes - self.done):.3g} per scene"),
            (
                "time",
                f"{_format_duration(self.seconds)} on {self.cores} cores "
                f"({self.core_seconds:.3g} core seconds)",
            ),
            ("memory", f"{readable_bytes(self.memory)} in each process"),
            ("disk", f"up to {readable_bytes(self.disk)} in {self.store}"),
        ]
        return "\n".join(["SweepPlan", *(f"  {label:<8} {value}" for label, value in rows)])


def _format_duration(seconds: float) -> str:
    for unit, length in (("d", 86400), ("h", 3600), ("min", 60)):
        if seconds >= 2 * length:
            return f"{seconds / length:.3g} {unit}"
    return f"{seconds:.3g} s"


def _plan(
    spec: SweepSpec,
    layout: ChunkLayout,
    pilot: Pilot,
    store: Store | None,
    runner: LocalRunner | DaskRunner,
    path: str,
) -> SweepPlan:
    """Return the expected cost of a sweep, or of the rest of a sweep that is partly in the store.

    - `spec`, `layout`, `pilot`: specification of the sweep, its chunks, and a solved sample
    - `store`: the existing store; None if there is none
    - `path`: path or URL of the store
    - `runner`: the runner that would solve the sweep
    """
    expected = pilot.expected_steps(layout)
    is_solved = np.zeros(layout.chunk_count, bool) if store is None else np.isfinite(store.rows()[:, 0])
    sizes = layout.sizes()
    steps = float(expected[~is_solved].sum())
    core_seconds = steps * pilot.step_seconds
    parameter_bytes = sum(y.itemsize for y in spec.scene_arrays.varying().values())
    return SweepPlan(
        scenes=spec.scenes,
        shape=spec.shape,
        chunk=layout.chunk_shape,
        chunks=layout.chunk_count,
        done=int(sizes[is_solved].sum()),
        steps=steps,
        core_seconds=core_seconds,
        cores=runner.cores,
        seconds=core_seconds / min(runner.cores, runner.cores_of_chunk * max(1, int((~is_solved).sum()))),
        memory=pilot.memory + int(sizes.max()) * (SCENE_BYTES + 4 * parameter_bytes),
        disk=int(pilot.scene_bytes * spec.scenes + sum(y.nbytes for y in spec.scene_arrays.arrays.values())),
        store=path,
    )
