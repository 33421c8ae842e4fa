"""A sample of the scenes of a sweep, to estimate the cost of all."""

from __future__ import annotations

import sys
import time
from typing import Any, NamedTuple

import numpy as np

from rockjax._batch.batch import LANES
from rockjax._machine.threads import precision
from rockjax._responses.peak import data_variables

from .chunks import Devices, count_cores, count_trial_steps, solve_scenes
from .store import ChunkLayout, compressed_size, variable_for
from .study import SweepSpec

SAMPLE = (256, 16384)  # least and greatest number of scenes
SHARE = 50  # one of this many scenes is sampled
# Wall time of a chunk [s]: long compared with the writing of its files, short compared with the loss of
# time after a fault.
CHUNK_SECONDS = 2.5, 10.0
# Least number of chunks for each worker, if they are not too short, so that the wait for the last is short.
CHUNKS_PER_CORE = 8


class Pilot(NamedTuple):
    """A solved sample of the scenes.

    - `scenes`: their indices; `steps`: trial steps of each; `core_seconds`: time of one core for one trial
      step [s]
    - `variables`: description of the results; `bytes_`: size of a scene in the store; `resident`: memory of
      the process [bytes]
    """

    scenes: np.ndarray
    steps: np.ndarray
    core_seconds: float
    variables: dict[str, Any]
    bytes_: float
    resident: int

    def chunk(self, scenes: int, cores: int, cores_of_chunk: int) -> int:
        """Return the number of scenes in a chunk that is neither too short nor too long.

        - `scenes`: number of scenes to solve
        - `cores`: number of cores that solve the sweep; `cores_of_chunk`: number that solve one chunk
        """
        scene_seconds = max(1e-9, self.core_seconds * float(self.steps.mean()))
        low, high = CHUNK_SECONDS
        seconds = min(high, max(low, scenes * scene_seconds / (CHUNKS_PER_CORE * cores)))
        return max(1, round(seconds * cores_of_chunk / scene_seconds))

    def expected(self, layout: ChunkLayout) -> np.ndarray:
        """Return the expected trial steps of every chunk: the mean of its sample, or of all samples if it has
        none."""
        chunks = layout.chunk_of(self.scenes)
        number = np.bincount(chunks, minlength=layout.number)
        total = np.bincount(chunks, weights=self.steps, minlength=layout.number)
        mean = np.where(number > 0, total / np.maximum(number, 1), self.steps.mean())
        return mean * layout.sizes()


def pilot(study: SweepSpec, threads: int | None, devices: Devices) -> Pilot:
    """Solve a sample of scenes spread over the sweep, and measure their cost."""
    numbers, options = study.numbers, study.options
    low, high = SAMPLE
    count = min(numbers.size, max(low, min(high, numbers.size // SHARE)))
    rng = np.random.default_rng(0)
    edges = np.linspace(0, numbers.size, count + 1).astype(np.int64)
    scenes = edges[:-1] + (rng.random(count) * np.diff(edges)).astype(np.int64)
    with precision(study.precision):
        names = study.sensitivities
        solve = lambda which: solve_scenes(numbers.at(which), options, threads, devices, names)
        solve(scenes[:: max(1, count // low)])  # compiles
        began = time.perf_counter()
        peaks = solve(scenes)
        seconds = time.perf_counter() - began
    steps = count_trial_steps(peaks)
    answers = data_variables(peaks, options.outputs, ())
    variables = {name: variable_for(values, attrs, dims) for name, (dims, values, attrs) in answers.items()}
    stored = {name: values.astype(variables[name].dtype) for name, (_, values, _) in answers.items()}
    per_step = seconds / steps.sum() * min(count_cores(devices, threads), -(-count // LANES))
    return Pilot(scenes, steps, per_step, variables, compressed_size(stored) / count, _resident_memory())


def _resident_memory() -> int:
    """Return the greatest memory of this process so far, compiler included; the present one if the system
    does not report it [bytes]."""
    import psutil

    now = psutil.Process().memory_info().rss
    if sys.platform != "linux":
        return now
    import resource

    return max(now, 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
