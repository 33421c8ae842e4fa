"""One chunk of a sweep: read its scenes from the store, solve them as a batch, write their results.

A scene is one structure under one ground motion.
"""

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
from rockjax._options import Options
from rockjax._responses.datasets import describe_versions
from rockjax._responses.peak import Peak, data_variables

from .scene_arrays import Arguments, SceneArrays
from .store import ChunkRow, Store

Devices = Literal["all"] | Sequence[Any] | None


class Job(NamedTuple):
    """Data for a process that solves chunks of a sweep. The process reads the parameters of the scenes from
    the store."""

    store: str  # path or URL
    fingerprint: str  # hash of the identity of the sweep
    skeleton: Any  # see `SceneArrays.skeleton`
    options: Options
    is_float64: bool  # precision of the scenes: float64, otherwise float32
    sensitivities: tuple[str, ...] = ()  # parameters y for which y ∂/∂y of the peaks is computed

    def solve(self, k: int, threads: int | None, devices: Devices) -> ChunkRow:
        """Solve a chunk and write its results, unless the store already has them.

        - `k`: index of the chunk
        - `threads`: number of CPU threads; not used if `devices` are given
        - `devices`: JAX devices, as for [`rockjax.sweep`][]. If `threads` and `devices` are both None, all
          accelerators are used, or all CPU cores if there are no accelerators

        Returns the row of the chunk in the store.
        """
        store, scene_arrays = _open_store(self)
        if (row := store.row(k)) is not None:
            return row
        start_time = time.perf_counter()
        with jax.enable_x64(self.is_float64):
            arguments = scene_arrays.in_box(store.layout.box(k))
            peaks = solve_scenes(arguments, self.options, threads, devices, self.sensitivities)
        variables = data_variables(peaks, self.options.outputs, ())
        arrays = {name: values for name, (_, values, _) in variables.items()}
        failed = int(np.sum(results.did_not_finish(arrays["result"])))
        return store.write(
            k, arrays, time.perf_counter() - start_time, float(count_trial_steps(peaks).sum()), failed
        )


_OPEN_STORES: dict[tuple[str, str], tuple[Store, SceneArrays]] = {}  # by path and fingerprint


def _open_store(job: Job) -> tuple[Store, SceneArrays]:
    """Return the store of a job and the scenes of the sweep. A process reads them only once.

    Raises `RuntimeError` if the store is missing, contains another sweep or was made by other versions.
    """
    path, key = job.store, (job.store, job.fingerprint)
    if key in _OPEN_STORES:
        return _OPEN_STORES[key]
    store = Store.open(path)
    if store is None:
        raise RuntimeError(
            f"{path}: this worker finds no store here; all workers must be able to open it by this path"
        )
    if store.identity["fingerprint"] != job.fingerprint:
        raise RuntimeError(f"{path} contains another sweep; remove it, or give this sweep another path")
    for name, installed in describe_versions().items():
        if store.identity.get(name, installed) != installed:
            raise RuntimeError(
                f"{path}: {name} is {store.identity[name]} in the store and {installed} on this worker; use "
                "the same versions on all machines"
            )
    _OPEN_STORES[key] = store, SceneArrays(store.inputs(), job.skeleton, store.layout.shape)
    return _OPEN_STORES[key]


def solve_scenes(
    arguments: Arguments,
    options: Options,
    threads: int | None,
    devices: Devices,
    sensitivities: tuple[str, ...],
) -> Peak:
    """Return the peaks of a batch of scenes of a sweep.

    - `arguments`: (structures, excitations, initial, t_end)
    - `options`: options of the scenes
    - `threads`, `devices`: as for `Job.solve`
    - `sensitivities`: parameters y for which y ∂/∂y of the peaks is computed
    """
    stop = threading.Event()  # with this event, `responses` raises `Interrupted` on Ctrl-C
    workers = _worker_arguments(devices, threads)
    return responses(*arguments, options, False, stop, sensitivities=sensitivities, **workers)


def _worker_arguments(devices: Devices, threads: int | None) -> dict[str, Any]:
    """Return the arguments of `responses` that select devices or threads."""
    if devices is None:
        return {"threads": threads}
    return {"devices": jax.local_devices() if devices == "all" else devices}


def count_cores(devices: Devices, threads: int | None) -> int:
    """Return the number of CPU threads or of devices that solve a chunk."""
    executor = executor_for("sweep", **_worker_arguments(devices, threads))
    return executor.threads * executor.devices


def count_trial_steps(peaks: Peak) -> np.ndarray:
    """Return the number of trial steps (accepted and rejected) of each scene."""
    return np.asarray(peaks.stats.steps + peaks.stats.rejected, float)
