"""One chunk of a sweep: read its scenes from the store, solve them by the batch path, write their results."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import jax
import numpy as np

from rockjax import _results as results
from rockjax._batch.batch import responses
from rockjax._batch.executors import executor_for
from rockjax._machine.threads import precision
from rockjax._options import Options
from rockjax._responses.datasets import describe_versions
from rockjax._responses.peak import Peak, data_variables

from .scene_arrays import Arguments, SceneArrays
from .store import ChunkRecord, Store

Devices = Literal["all"] | Sequence[Any] | None


class Job(NamedTuple):
    """Inputs that a process needs, besides the store, to solve any chunk of a sweep."""

    store: str
    fingerprint: str
    skeleton: Any  # (structures, excitations, initial, t_end) with the names of their numbers
    options: Options
    precision: bool
    sensitivities: tuple[str, ...] = ()

    def solve(self, k: int, threads: int | None, devices: Devices) -> ChunkRecord:
        """Solve a chunk and write it, unless another process has already done so.

        - `k`: index of the chunk
        - `threads`: CPU threads, None for all cores
        - `devices`: JAX devices, as for [`rockjax.sweep`][]

        Returns the row of the chunk.
        """
        store, numbers = _open_store(self)
        if (row := store.row(k)) is not None:
            return row
        began = time.perf_counter()
        with precision(self.precision):
            box = numbers.box(store.layout.box(k))
            peaks = solve_scenes(box, self.options, threads, devices, self.sensitivities)
        variables = data_variables(peaks, self.options.outputs, ())
        answers = {name: values for name, (_, values, _) in variables.items()}
        failed = int(np.sum(answers["result"] > results.OVERTURNED))
        return store.write(
            k, answers, time.perf_counter() - began, float(count_trial_steps(peaks).sum()), failed
        )


_OPEN_STORES: dict[tuple[str, str], tuple[Store, SceneArrays]] = {}  # by path and fingerprint


def _open_store(job: Job) -> tuple[Store, SceneArrays]:
    """Return the store and its scenes, read once by each process. Raises `RuntimeError` if it is not the
    store of the job."""
    path, key = job.store, (job.store, job.fingerprint)
    if key in _OPEN_STORES:
        return _OPEN_STORES[key]
    store = Store.open(path)
    if store is None:
        raise RuntimeError(f"{path}: there is no store here; all workers must see it under the same name")
    if store.identity["fingerprint"] != job.fingerprint:
        raise RuntimeError(f"{path}: holds another sweep; remove it, or give this sweep another path")
    for name, text in describe_versions().items():
        if store.identity.get(name, text) != text:
            raise RuntimeError(
                f"{path}: {name} is {store.identity[name]} there, not {text}; use the same versions on all "
                "machines"
            )
    found = _OPEN_STORES[key] = store, SceneArrays(store.inputs(), job.skeleton, store.layout.shape)
    return found


def solve_scenes(
    arguments: Arguments,
    options: Options,
    threads: int | None,
    devices: Devices,
    sensitivities: tuple[str, ...],
) -> Peak:
    """Return the peaks of a batch of scenes of a sweep.

    - `arguments`: (structures, excitations, initial, t_end)
    - `options`: of the scenes
    - `threads`: CPU threads, None for all cores
    - `devices`: JAX devices, as for [`rockjax.sweep`][]
    - `sensitivities`: names of parameters
    """
    stop = threading.Event()  # Ctrl-C then raises `Interrupted`
    workers = _worker_arguments(devices, threads)
    return responses(*arguments, options, False, stop, sensitivities=sensitivities, **workers)


def _worker_arguments(devices: Devices, threads: int | None) -> dict[str, Any]:
    """Return the arguments of the batch that select devices or threads."""
    if devices is None:
        return {"threads": threads}
    return {"devices": jax.local_devices() if devices == "all" else devices}


def count_cores(devices: Devices, threads: int | None) -> int:
    pool = executor_for("sweep", **_worker_arguments(devices, threads))
    return pool.hosts * pool.devices


def count_trial_steps(peaks: Peak) -> np.ndarray:
    return np.asarray(peaks.stats.steps + peaks.stats.rejected, float)
