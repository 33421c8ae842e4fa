"""Sweeps: any number of scenes in chunks, on one machine or many, kept chunk by chunk in a zarr store.

Each chunk is one call of the batch path. What runs them beside each other and elsewhere, and runs them again where a
machine fails, is Dask; here is only what a chunk is, in which order they are given away, and what has to be the same
for a store to be gone on with.
"""

from __future__ import annotations

import asyncio
import concurrent.futures
import contextlib
import dataclasses
import functools
import threading
import time
import uuid
import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import jax
import numpy as np

from . import _results as results
from ._batch import LANES, responses
from ._checks import as_float
from ._crews import crew
from ._datasets import describe_options, describe_versions, peak_variables
from ._excitations import AbstractExcitation
from ._numbers import Arguments, Numbers
from ._options import Options
from ._results import Interrupted, Peak, State
from ._simulate import REST, check_range, check_types
from ._store import FORMAT, Layout, Row, Store, compressed_size, digest, fingerprint, located, stored_as
from ._structures import Podium
from ._threads import precision

if TYPE_CHECKING:
    import xarray

Devices = Literal["all"] | Sequence[Any] | None

PILOT = (256, 16384)  # scenes that are solved to guess what the others cost
PILOT_SHARE = 50  # of so many scenes one
CHUNK_SECONDS = 10.0  # of one core: long against the writing of a chunk, short against what a fault may cost
LEAST_SECONDS = 2.5
CHUNKS_PER_CORE = 8  # so that no core waits long for the last ones
BYTES = 600  # of memory that a scene of a chunk takes while it is solved, besides its numbers


def sweep(
    structures: Podium,
    excitations: AbstractExcitation,
    coords: Mapping[str, Any] | Sequence[str] | None = None,
    *,
    store: str | Path,
    initial: State = REST,
    t_end=None,
    options: Options = Options(),
    outputs: Sequence[str] | None = None,
    chunk: int | None = None,
    client: Any = None,
    devices: Devices = None,
    progress: bool = True,
    dry_run: bool = False,
) -> xarray.Dataset | SweepPlan:
    """Peak responses of any number of scenes, chunk by chunk into a zarr store (host).

    Scenes are those of [`rockjax.peak_responses`][]: every number of `structures`, `excitations`, `initial` and `t_end` may
    be an array, and together they broadcast to the shape of the sweep. [`rockjax.grid`][] makes them for a grid, with
    `coords`; arrays of one length make a table of scenes.

    The same call goes on where an earlier one was stopped, by whatever: chunks that are in the store are verified by
    their checksums and left, what is missing or damaged is solved. Returns the store as a lazy `xarray.Dataset`, the
    numbers that vary as its coordinates. Scenes that end without an answer keep their `result`, and a `RuntimeWarning`
    counts them. Ctrl-C raises [`rockjax.Interrupted`][], whose `partial` is the dataset as it is.

    - `coords`: the names of the axes in order, with their labels or alone; `scene` for a table where it is not given
    - `store`: a folder, or a URL that zarr can write to; with a `client` one that all workers see under this name
    - `outputs`: which answers are wanted, as in [`rockjax.Options`][]
    - `chunk`: scenes in a chunk; by default as many as take about ten seconds of one core, fewer for short sweeps
    - `client`: a `dask.distributed.Client`: chunks are solved by its workers, one core each. Without it, by all cores here
    - `devices`: `"all"` for all JAX devices where a chunk is solved, by `shard_map`; or some devices of this machine.
      Without it the cores of the CPU, or all GPUs where JAX has some
    - `progress`: a bar with the time left, by what chunks are expected to cost
    - `dry_run`: solve a sample of the scenes, and return a `SweepPlan` with the time, memory and disk that all of them
      will take; nothing is written

    Raises `ValueError` for inputs that make no sense, and for a store of another sweep: other numbers, other options,
    another version; `OSError` where the store cannot be written; `RuntimeError` where workers fail. What was solved
    until then is kept in all cases.
    """
    study = _study(structures, excitations, coords, initial, t_end, options, outputs)
    _check_chunk(chunk)
    found = Store.open(store)
    if found is not None:
        _check_same(found, study, chunk)
    where = _Here(devices) if client is None else _There(client, devices)
    if found is None or dry_run:
        pilot = where.pilot(study, chunk)
        layout = Layout.of(study.shape, chunk or pilot.chunk(study.scenes, where.cores)) if found is None else found.layout
        if dry_run:
            return _plan(study, layout, pilot, found, where, located(store))
        found = _created(store, study, layout, pilot)
    job = Job(found.path, found.about["fingerprint"], study.numbers.skeleton, study.options, study.precision)
    todo, solved = _todo(found, progress)
    with _Bar(found, todo, solved, progress) as bar:
        stopped = where.run(job, todo, bar)
    data = found.dataset()
    if stopped is not None:
        message = (
            f"stopped with {bar.done} of {found.layout.number} chunks solved, kept in {found.path}: the same call goes on"
        )
        raise Interrupted(message, data) from stopped
    failed = int(np.nansum(found.rows()[:, Row._fields.index("failed")]))
    if failed:
        message = f"{failed} of {study.scenes} scenes ended without an answer; their result says why"
        warnings.warn(message, RuntimeWarning, stacklevel=2)
    return data


@dataclasses.dataclass(frozen=True)
class SweepPlan:
    """What a sweep will take, measured on a sample of its scenes.

    - `scenes`; `shape`: along each axis; `chunk`: of a chunk; `chunks`: their number; `done`: scenes in the store already
    - `steps`: trial steps that are left; `core_seconds`: what they take one core [s]; `cores`: those there are;
      `seconds`: time to wait [s]
    - `memory`: of the process that solves a chunk [bytes]; `disk`: of the whole store [bytes]
    - `store`: where it will be
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
            ("time", f"{_duration(self.seconds)} on {self.cores} cores ({self.core_seconds:.3g} core seconds)"),
            ("memory", f"{_bytes(self.memory)} in each process"),
            ("disk", f"{_bytes(self.disk)} in {self.store}"),
        ]
        return "\n".join(["SweepPlan", *(f"  {label:<8} {value}" for label, value in rows)])


def _duration(seconds: float) -> str:
    for unit, length in (("d", 86400), ("h", 3600), ("min", 60)):
        if seconds >= 2 * length:
            return f"{seconds / length:.3g} {unit}"
    return f"{seconds:.3g} s"


def _bytes(number: float) -> str:
    for unit, size in (("GiB", 2**30), ("MiB", 2**20)):
        if number >= size:
            return f"{number / size:.3g} {unit}"
    return f"{number / 2**10:.3g} KiB"


class Study(NamedTuple):
    """What is swept: the numbers of the scenes, the names and labels of their axes, and how they are solved."""

    numbers: Numbers
    dims: tuple[str, ...]
    labels: dict[str, np.ndarray]
    options: Options
    precision: bool

    @property
    def shape(self) -> tuple[int, ...]:
        return self.numbers.shape

    @property
    def scenes(self) -> int:
        return self.numbers.size

    def about(self, layout: Layout) -> dict[str, Any]:
        """Everything that tells this sweep from others, as JSON."""
        left_out = ("throw", "history")
        fields = [field.name for field in dataclasses.fields(Options) if field.name not in left_out]
        values = {name: getattr(self.options, name) for name in fields}
        about = {
            "format": FORMAT,
            **{name: text for name, text in describe_versions().items() if name != "diffrax_version"},
            "precision": "float64" if self.precision else "float32",
            "kinds": str(jax.tree.structure(self.numbers.skeleton)),
            "dims": list(self.dims),
            "shape": list(self.shape),
            "chunk": list(layout.block),
            "numbers": {name: digest(y) for name, y in self.numbers.named.items()},
            "labels": {name: digest(y) for name, y in self.labels.items()},
            "options": {name: y if isinstance(y, str) else repr(_plain(y)) for name, y in values.items()},
        }
        return about | {"fingerprint": fingerprint(about)}


def _plain(y: Any) -> Any:
    return y.item() if isinstance(y, jax.Array | np.ndarray | np.generic) else y


def _study(structures, excitations, coords, initial, t_end, options: Options, outputs) -> Study:
    options = options if outputs is None else options.replace(outputs=tuple(outputs))
    check_types("sweep", structures, excitations, options)
    check_range("sweep", structures, excitations, None, options)
    if options.engine != "flat":
        raise ValueError(f"sweep: options.engine must be 'flat', got {options.engine!r}")
    initial = jax.tree.map(as_float, initial)
    t_end = None if t_end is None else as_float(t_end)
    numbers = Numbers.of("sweep", structures, excitations, initial, t_end)
    dims, labels = _axes(coords, numbers.shape)
    return Study(numbers, dims, labels, options, bool(jax.config.jax_enable_x64))  # pyright: ignore[reportAttributeAccessIssue]


def _axes(coords, shape: tuple[int, ...]) -> tuple[tuple[str, ...], dict[str, np.ndarray]]:
    if coords is None:
        return ("scene",) if len(shape) == 1 else tuple(f"scene_{k}" for k in range(len(shape))), {}
    if isinstance(coords, str):
        raise ValueError(f"sweep: coords must be the names of the axes, got one text {coords!r}; give [{coords!r}]")
    dims = tuple(coords)
    if len(dims) != len(shape):
        raise ValueError(f"sweep: coords names {len(dims)} axes, {list(dims)}, but the scenes have the shape {shape}")
    if len(set(dims)) < len(dims):
        raise ValueError(f"sweep: coords names an axis twice: {list(dims)}")
    labels = {name: np.asarray(y) for name, y in coords.items()} if isinstance(coords, Mapping) else {}
    for (name, y), n in zip(labels.items(), shape, strict=False):
        if y.shape != (n,):
            raise ValueError(f"sweep: coords[{name!r}] must hold {n} labels, got the shape {y.shape}")
    return dims, labels


def _check_chunk(chunk) -> None:
    if chunk is not None and (not isinstance(chunk, int) or chunk < 1):
        raise ValueError(f"sweep: chunk must be a whole number of scenes ≥ 1, got chunk = {chunk!r}")


def _check_same(found: Store, study: Study, chunk: int | None) -> None:
    """Raise `ValueError` unless a store is of this very sweep."""
    layout = found.layout if chunk is None else Layout.of(study.shape, chunk)
    differences = list(_differences(found.about, study.about(layout)))
    if differences:
        raise ValueError(
            f"{found.path}: is of another sweep: {'; '.join(differences[:4])}; give another path, remove it, or make the "
            "call that it was made with"
        )


def _differences(there: Mapping[str, Any], here: Mapping[str, Any]) -> Iterator[str]:
    if there.get("format") != here["format"]:
        yield f"its format is {there.get('format')}, not {here['format']}"
        return
    for name in ("rockjax_version", "jax_version"):
        if there[name] != here[name]:
            yield f"made with {name.removesuffix('_version')} {there[name]}, this is {here[name]}"
    for name in ("precision", "dims", "shape", "kinds"):
        if there[name] != here[name]:
            yield f"its {name} {'is' if name in ('precision', 'shape') else 'are'} {there[name]}, not {here[name]}"
    if there["shape"] == here["shape"] and there["chunk"] != here["chunk"]:
        yield f"its chunks are {there['chunk']}, not {here['chunk']}"
    for name, value in here["options"].items():
        if there["options"].get(name) != value:
            yield f"options.{name} is {there['options'].get(name)} there, not {value}"
    for group in ("numbers", "labels"):
        for name in {**there[group], **here[group]}:
            if there[group].get(name) != here[group].get(name):
                yield f"{name} has other values" if group == "numbers" else f"the labels of {name} are others"


class Pilot(NamedTuple):
    """A sample of the scenes, solved.

    - `scenes`: their numbers; `steps`: trial steps of each; `core_seconds`: for one trial step, of one core [s]
    - `variables`: what answers look like; `bytes_`: a scene in the store; `resident`: memory of the process [bytes]
    """

    scenes: np.ndarray
    steps: np.ndarray
    core_seconds: float
    variables: dict[str, Any]
    bytes_: float
    resident: int

    def chunk(self, scenes: int, cores: int) -> int:
        """Scenes in a chunk that costs neither overhead nor waiting."""
        a_scene = max(1e-9, self.core_seconds * float(self.steps.mean()))
        seconds = min(CHUNK_SECONDS, max(LEAST_SECONDS, scenes * a_scene / (CHUNKS_PER_CORE * cores)))
        return max(1, round(seconds / a_scene))

    def expected(self, layout: Layout) -> np.ndarray:
        """Trial steps of every chunk: the mean of its sample, or of all where it has none."""
        chunks = layout.chunk_of(self.scenes)
        number = np.bincount(chunks, minlength=layout.number)
        total = np.bincount(chunks, weights=self.steps, minlength=layout.number)
        mean = np.where(number > 0, total / np.maximum(number, 1), self.steps.mean())
        return mean * layout.sizes()


def _pilot(numbers: Numbers, options: Options, chunk: int | None, threads: int | None, devices, x64: bool) -> Pilot:
    """Solve some scenes spread over all of them, and measure."""
    low, high = PILOT
    count = min(numbers.size, max(low, min(high, numbers.size // PILOT_SHARE), min(chunk or 0, low)))
    rng = np.random.default_rng(0)
    edges = np.linspace(0, numbers.size, count + 1).astype(np.int64)
    scenes = edges[:-1] + (rng.random(count) * np.diff(edges)).astype(np.int64)
    with precision(x64):
        solve = lambda which: _solved(numbers.at(which), options, threads, devices, False, threading.Event())
        few = scenes[:: max(1, count // low)]
        solve(few)  # compiles
        timed = []
        for which in (few, scenes):
            began = time.perf_counter()
            peaks = solve(which)
            timed.append((time.perf_counter() - began, _steps(peaks).sum()))
    steps = _steps(peaks)
    answers = {name: (values, attrs) for name, values, attrs in peak_variables(peaks, options.outputs)}
    variables = {name: stored_as(values, attrs) for name, (values, attrs) in answers.items()}
    kept = {name: values.astype(variables[name].dtype) for name, (values, _) in answers.items()}
    (short, of_few), (seconds, of_all) = timed
    # What a call costs besides its steps is not what a chunk costs.
    slope = (seconds - short) / (of_all - of_few) if of_all > of_few else 0.0
    per_step = (slope if slope > 0 else seconds / of_all) * min(_cores(devices, threads), -(-count // LANES))
    return Pilot(scenes, steps, per_step, variables, compressed_size(kept) / count, _resident())


def _steps(peaks: Peak) -> np.ndarray:
    return np.asarray(peaks.stats.steps + peaks.stats.rejected, float)


def _resident() -> int:
    """Memory that this process has now [bytes]."""
    import psutil  # which dask.distributed brings

    return psutil.Process().memory_info().rss


def _solved(
    arguments: Arguments, options: Options, threads: int | None, devices, progress: Any, stop: threading.Event
) -> Peak:
    podiums, excitations, initial, t_end = arguments
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # scenes without an answer are counted for the whole sweep
        return responses(podiums, excitations, initial, t_end, options, progress, stop, **_hands(devices, threads))


def _hands(devices: Devices, threads: int | None) -> dict[str, Any]:
    """Who solves, as arguments of the batch."""
    if devices is None:
        return {"threads": threads}
    return {"devices": jax.local_devices() if isinstance(devices, str) else devices}


def _cores(devices: Devices, threads: int | None) -> int:
    who = crew("sweep", **_hands(devices, threads))
    return who.hosts * who.devices


class Job(NamedTuple):
    """What a process needs besides the store to solve any of its chunks."""

    store: str
    fingerprint: str
    skeleton: Any  # (structures, excitations, initial, t_end) with the names of their numbers
    options: Options
    precision: bool

    def solve(self, k: int, threads: int | None, devices: Devices, progress: Any, stop: threading.Event) -> Row:
        """Solve a chunk and write it, unless another process has done so by now."""
        store, numbers = _opened(self.store, self.fingerprint, _Skeleton(self.skeleton))
        if (row := store.row(k)) is not None:
            return row
        began = time.perf_counter()
        with precision(self.precision):
            peaks = _solved(numbers.box(store.layout.box(k)), self.options, threads, devices, progress, stop)
        answers = {name: values for name, values, _ in peak_variables(peaks, self.options.outputs)}
        failed = int(np.sum(answers["result"] > results.OVERTURNED))
        return store.write(k, answers, time.perf_counter() - began, float(_steps(peaks).sum()), failed)


class _Skeleton(NamedTuple):
    """Hashed by what it is, for the cache: the store's fingerprint tells it already."""

    tree: Any

    def __hash__(self) -> int:
        return 0

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Skeleton)


@functools.lru_cache(maxsize=4)
def _opened(path: str, fingerprint: str, skeleton: _Skeleton) -> tuple[Store, Numbers]:
    """The store and its scenes, read once by each process. Raises `RuntimeError` where it is not what was asked for."""
    store = Store.open(path)
    if store is None:
        raise RuntimeError(f"{path}: there is no store here; all workers must see it under the same name")
    if store.about["fingerprint"] != fingerprint:
        raise RuntimeError(f"{path}: is of another sweep")
    for name, text in describe_versions().items():
        if store.about.get(name, text) != text:
            raise RuntimeError(f"{path}: made with {name.removesuffix('_version')} {store.about[name]}, here is {text}")
    return store, Numbers(store.inputs(), skeleton.tree, store.layout.shape)


def _created(path, study: Study, layout: Layout, pilot: Pilot) -> Store:
    import xarray

    coords = xarray.Dataset(coords=dict(_coords(study)))
    fixed = {name: float(y) for name, y in study.numbers.common().items() if y.ndim == 0}
    attrs = {"title": "Sweep of peak responses", "kind": "sweep", **fixed, **describe_options(study.options)}
    return Store.create(
        path, study.about(layout), study.dims, coords, pilot.variables, study.numbers.named, pilot.expected(layout), attrs
    )


def _coords(study: Study) -> Iterator[tuple[str, Any]]:
    """The labels of the axes, and every number that varies between scenes along the axes on which it does."""
    for name, labels in study.labels.items():
        yield name, ((name,), labels, _ABOUT.get(name, {}))
    for name, y in study.numbers.varying().items():
        short = name.rsplit(".", 1)[-1]
        along = tuple(d for d, n in zip(study.dims, y.shape, strict=True) if n > 1) or study.dims[:1]
        values = y.reshape([n for n in y.shape if n > 1] or [1])
        if short not in study.labels:
            yield (short if short not in study.dims else name), (along, values, _ABOUT.get(short, {}))


_ABOUT: dict[str, dict[str, str]] = {
    name: {"units": unit, "long_name": text}
    for name, unit, text in (
        ("alpha", "rad", "slenderness of the columns α"),
        ("tan_alpha", "1", "slenderness of the columns tan α"),
        ("width", "m", "width of a column 2B"),
        ("height", "m", "height of a column 2H"),
        ("R", "m", "half diagonal of a column"),
        ("gamma", "1", "mass ratio of the beam γ"),
        ("eta", "1", "mass ratio of the superstructure η"),
        ("T_s", "s", "period of the superstructure"),
        ("zeta", "1", "damping ratio of the superstructure ζ"),
        ("lam", "1", "inertia factor of a column λ"),
        ("g", "m s-2", "acceleration of gravity"),
        ("a_p", "m s-2", "amplitude of the pulse"),
        ("T_p", "s", "period of the pulse"),
        ("scale", "1", "factor on the motion"),
        ("motion", "1", "ground motion"),
        ("acceleration_ratio", "1", "a_p/(g tan α)"),
        ("frequency_ratio", "1", "ω_p/p"),
    )
}


def _plan(study: Study, layout: Layout, pilot: Pilot, found: Store | None, where: _Here | _There, path: str) -> SweepPlan:
    expected = pilot.expected(layout)
    done = np.zeros(layout.number, bool) if found is None else np.isfinite(found.rows()[:, 0])
    sizes = layout.sizes()
    steps = float(expected[~done].sum())
    core_seconds = steps * pilot.core_seconds
    own = sum(y.itemsize for y in study.numbers.varying().values())
    return SweepPlan(
        scenes=study.scenes,
        shape=study.shape,
        chunk=layout.block,
        chunks=layout.number,
        done=int(sizes[done].sum()),
        steps=steps,
        core_seconds=core_seconds,
        cores=where.cores,
        seconds=core_seconds / min(where.cores, where.cores_of_chunk * max(1, int((~done).sum()))),
        memory=pilot.resident + int(sizes.max()) * (BYTES + 4 * own),
        disk=int(pilot.bytes_ * study.scenes + sum(y.nbytes for y in study.numbers.named.values())),
        store=path,
    )


def _todo(found: Store, progress: bool) -> tuple[np.ndarray, np.ndarray]:
    """Chunks that are to be solved, the costliest first, so that none is waited for at the end; and those that are done."""
    from tqdm import tqdm

    rows = found.rows()
    done = np.isfinite(rows[:, 0])
    for k in tqdm(np.flatnonzero(done), desc="verifying", unit=" chunks", disable=not progress or not done.any()):
        if not found.intact(int(k), rows[k]):
            warnings.warn(f"{found.path}: chunk {k} is damaged, and is solved again", RuntimeWarning, stacklevel=3)
            found.forget(int(k))
            done[k] = False
    expected = found.expected
    todo = np.flatnonzero(~done)
    return todo[np.argsort(-expected[todo], kind="stable")], np.flatnonzero(done)


class _Bar:
    """Progress in expected trial steps, so that the time left holds although chunks differ in cost."""

    def __init__(self, found: Store, todo: np.ndarray, done: np.ndarray, progress: bool):
        from tqdm import tqdm

        self.expected, self.sizes = found.expected, found.layout.sizes()
        self.done, self.count = len(done), found.layout.number
        self.bar = tqdm(
            total=float(self.expected[todo].sum()),
            disable=not progress,
            bar_format="{percentage:3.0f}%|{bar}| {postfix} [{elapsed}<{remaining}]",
        )
        self._show()

    def __enter__(self) -> _Bar:
        return self

    def __exit__(self, *_) -> None:
        self.bar.close()

    def _show(self) -> None:
        self.bar.set_postfix_str(f"{self.done} of {self.count} chunks", refresh=False)

    def finished(self, k: int, counted: float = 0.0) -> None:
        """A chunk is through, of which so much has been counted."""
        self.done += 1
        self._show()
        self.step(float(self.expected[k]) - counted)

    def step(self, steps: float) -> None:
        """Expected steps that are through; rounding must not lead past the end."""
        self.bar.update(min(steps, self.bar.total - self.bar.n))

    @contextlib.contextmanager
    def inside(self, k: int) -> Iterator[_Inside]:
        """Counts the scenes of a chunk that is being solved."""
        counts = _Inside(self, float(self.expected[k]) / float(self.sizes[k]))
        yield counts
        self.finished(k, counts.counted)


class _Inside:
    def __init__(self, bar: _Bar, each: float):
        self.bar, self.each, self.counted = bar, each, 0.0

    def update(self, scenes: int) -> None:
        self.counted += scenes * self.each
        self.bar.step(scenes * self.each)


class _Here:
    """Chunks one after the other, each on all cores or devices of this machine."""

    def __init__(self, devices: Devices):
        self.devices = devices
        self.cores = self.cores_of_chunk = _cores(devices, None)

    def pilot(self, study: Study, chunk: int | None) -> Pilot:
        return _pilot(study.numbers, study.options, chunk, None, self.devices, study.precision)

    def run(self, job: Job, todo: np.ndarray, bar: _Bar) -> KeyboardInterrupt | None:
        """Solve chunks; returns what stopped it."""
        try:
            for k in map(int, todo):
                with bar.inside(k) as counts, _naming(job, bar):
                    job.solve(k, None, self.devices, counts, threading.Event())
        except KeyboardInterrupt as stopped:
            return stopped
        return None


@contextlib.contextmanager
def _naming(job: Job, bar: _Bar) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise _unwritten(job, bar, error) from error


def _unwritten(job: Job, bar: _Bar, error: BaseException) -> OSError:
    cause = getattr(error, "strerror", None) or error
    kept = f"{bar.done} of {bar.count} chunks are kept, the same call goes on from there"
    return OSError(f"{job.store} could not be written: {cause}; {kept}")


class _There:
    """Chunks as tasks of a Dask cluster, each on one core of a worker or on its devices."""

    cores_of_chunk = 1

    def __init__(self, client: Any, devices: Devices):
        try:
            from distributed import Client
        except ImportError:
            raise ImportError("rockjax.sweep with a client needs Dask: pip install 'rockjax[sweep]'") from None
        if not isinstance(client, Client):
            raise ValueError(f"sweep: client must be a dask.distributed.Client, got {client!r}")
        if not (devices is None or devices == "all"):
            raise ValueError(f"sweep: devices must be None or 'all' with a client, got {devices!r}")
        self.client, self.devices = client, devices

    @property
    def cores(self) -> int:
        threads: Any = self.client.nthreads()
        return max(1, sum(threads.values()))

    def pilot(self, study: Study, chunk: int | None) -> Pilot:
        task = self.client.submit(
            _pilot, study.numbers, study.options, chunk, 1, self.devices, study.precision,
            key=f"rockjax-pilot-{uuid.uuid4().hex}",
        )  # fmt: skip
        return _result(task)

    def run(self, job: Job, todo: np.ndarray, bar: _Bar) -> KeyboardInterrupt | None:
        """Solve chunks; returns what stopped it."""
        from distributed import as_completed

        call = uuid.uuid4().hex[:8]
        tasks = {}
        try:
            for k in map(int, todo):
                key = f"rockjax-{job.fingerprint}-{k}-{call}"
                tasks[self.client.submit(_task, job, k, self.devices, key=key, pure=False, retries=1)] = k
            for task in as_completed(list(tasks)):
                try:
                    _result(task)
                except OSError as error:
                    raise _unwritten(job, bar, error) from error
                bar.finished(tasks[task])
        except KeyboardInterrupt as stopped:
            return stopped
        finally:
            with contextlib.suppress(Exception):  # of a scheduler that is gone
                self.client.cancel(list(tasks))
        return None


def _task(job: Job, k: int, devices: Devices) -> Row:
    return job.solve(k, 1, devices, False, threading.Event())


def _result(task: Any) -> Any:
    """The result of a task. Raises `RuntimeError` where Dask has given it up."""
    from distributed.comm.core import CommClosedError
    from distributed.scheduler import KilledWorker

    kept = "what was solved until then is kept, the same call goes on"
    try:
        return task.result()
    except (asyncio.CancelledError, concurrent.futures.CancelledError, CommClosedError) as error:
        raise RuntimeError(f"sweep: the scheduler is lost, or has dropped the work ({_line(error)}); {kept}") from error
    except KilledWorker as error:
        raise RuntimeError(f"sweep: workers died over one chunk again and again ({_line(error)}); {kept}") from error


def _line(error: BaseException) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]
