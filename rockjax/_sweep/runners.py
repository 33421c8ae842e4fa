"""Runners, which solve the chunks of a sweep: in this process, or on the workers of a Dask cluster.

A chunk is a batch of scenes (one structure under one ground motion each).
"""

from __future__ import annotations

import asyncio
import concurrent.futures
import contextlib
import uuid
from typing import Any

import numpy as np

from .chunks import Devices, Job, count_cores
from .pilot import Pilot, pilot
from .spec import SweepSpec
from .store import ChunkRow, Store

REPEAT_NOTE = "solved chunks are stored; repeat the call to continue"


class LocalRunner:
    """Runner that solves chunks one after the other in this process.

    - `devices`: devices that solve a chunk, as for [`rockjax.sweep`][]
    """

    def __init__(self, devices: Devices):
        self.devices = devices
        self.cores = self.cores_of_chunk = count_cores(devices, None)

    def pilot(self, spec: SweepSpec) -> Pilot:
        return pilot(spec, None, self.devices)

    def run(self, job: Job, unsolved: np.ndarray, bar: ChunkProgress) -> KeyboardInterrupt | None:
        """Solve chunks one after the other.

        - `job`: data of the sweep
        - `unsolved`: indices of the unsolved chunks, in the order in which they are solved
        - `bar`: progress bar to advance

        Returns the `KeyboardInterrupt` of Ctrl-C, or None. Raises `OSError` if a chunk cannot be written.
        """
        try:
            for k in map(int, unsolved):
                job.solve(k, None, self.devices)
                bar.advance(k)
        except KeyboardInterrupt as interrupt:
            return interrupt
        except OSError as error:
            raise _write_error(job, bar, error) from error
        return None


def _write_error(job: Job, bar: ChunkProgress, error: BaseException) -> OSError:
    """Return an error that names the store, the cause and the number of stored chunks."""
    cause = getattr(error, "strerror", None) or error
    stored_note = f"{bar.done} of {bar.count} chunks are stored; repeat the call to continue"
    return OSError(f"{job.store} could not be written: {cause}; {stored_note}")


class DaskRunner:
    """Runner that solves chunks as tasks on the workers of a Dask cluster.

    - `client`: a `dask.distributed.Client`
    - `devices`: None if a core of a worker solves a chunk, `"all"` if all devices of a worker do
    """

    cores_of_chunk = 1

    def __init__(self, client: Any, devices: Devices):
        from distributed import Client

        if not isinstance(client, Client):
            raise ValueError(f"sweep: client must be a dask.distributed.Client, got {client!r}")
        if not (devices is None or devices == "all"):
            raise ValueError(f"sweep: devices must be None or 'all' with a client, got {devices!r}")
        self.client, self.devices = client, devices

    @property
    def cores(self) -> int:
        threads: Any = self.client.nthreads()
        return max(1, sum(threads.values()))

    def pilot(self, spec: SweepSpec) -> Pilot:
        scattered: Any = self.client.scatter([spec])  # sends long records only once
        key = f"rockjax-pilot-{uuid.uuid4().hex}"
        return _task_result(self.client.submit(pilot, scattered[0], 1, self.devices, key=key))

    def run(self, job: Job, unsolved: np.ndarray, bar: ChunkProgress) -> KeyboardInterrupt | None:
        """Solve chunks on the workers.

        - `job`: data of the sweep
        - `unsolved`: indices of the unsolved chunks, in order of priority
        - `bar`: progress bar to advance

        Returns the `KeyboardInterrupt` of Ctrl-C, or None. Raises `OSError` if a chunk cannot be written, and
        `RuntimeError` if the scheduler or workers fail.
        """
        from distributed import as_completed

        call_id = uuid.uuid4().hex[:8]
        tasks = {}
        try:
            for k in map(int, unsolved):
                key = f"rockjax-{job.fingerprint}-{k}-{call_id}"
                arguments = _solve_chunk, job, k, self.devices
                tasks[self.client.submit(*arguments, key=key, pure=False, retries=1)] = k
            for task in as_completed(list(tasks)):
                _task_result(task)
                bar.advance(tasks[task])
        except KeyboardInterrupt as interrupt:
            return interrupt
        except OSError as error:
            raise _write_error(job, bar, error) from error
        finally:
            with contextlib.suppress(Exception):  # the scheduler may be gone
                self.client.cancel(list(tasks))
        return None


def _solve_chunk(job: Job, k: int, devices: Devices) -> ChunkRow:
    """Solve chunk k on a worker, on one core or on its devices."""
    return job.solve(k, 1, devices)


def _task_result(task: Any) -> Any:
    """Return the result of a task. Raises `RuntimeError` if Dask cannot compute it."""
    from distributed.comm.core import CommClosedError
    from distributed.scheduler import KilledWorker

    try:
        return task.result()
    except (asyncio.CancelledError, concurrent.futures.CancelledError, CommClosedError) as error:
        raise RuntimeError(
            f"sweep: the scheduler is lost, or has cancelled the tasks ({_first_line(error)}); {REPEAT_NOTE}"
        ) from error
    except KilledWorker as error:
        raise RuntimeError(
            f"sweep: workers died repeatedly while they solved a chunk ({_first_line(error)}); {REPEAT_NOTE}"
        ) from error


def _first_line(error: BaseException) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]


class ChunkProgress:
    """Progress bar. It counts expected trial steps (accepted and rejected), because chunks differ in cost.

    - `store`: store of the sweep
    - `unsolved`, `solved`: indices of the unsolved and the solved chunks
    - `progress`: whether to show the bar
    """

    def __init__(self, store: Store, unsolved: np.ndarray, solved: np.ndarray, progress: bool):
        from tqdm.auto import tqdm  # shown as a widget in notebooks

        from rockjax._progress import start_clock

        self.expected = store.expected
        self.done, self.count = len(solved), store.layout.chunk_count
        self.bar = tqdm(
            total=float(self.expected[unsolved].sum()),
            disable=not progress,
            bar_format="{desc}: {percentage:3.0f}%|{bar}| [{elapsed}<{remaining}]",
        )
        self.bar.set_description_str(self._describe(), refresh=False)
        self.clock_stop = start_clock(self.bar)

    def __enter__(self) -> ChunkProgress:
        return self

    def __exit__(self, *_) -> None:
        self.clock_stop.set()
        self.bar.close()

    def _describe(self) -> str:
        return f"{self.done} of {self.count} chunks"

    def advance(self, k: int) -> None:
        """Count chunk k as solved."""
        self.done += 1
        self.bar.set_description_str(self._describe(), refresh=False)
        # The minimum keeps rounding errors from pushing the bar beyond its total.
        self.bar.update(min(float(self.expected[k]), self.bar.total - self.bar.n))
