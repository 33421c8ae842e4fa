"""A sample of the scenes of a sweep, which says what the others will take."""

from __future__ import annotations

import sys
import time
from typing import Any, NamedTuple

import numpy as np

from rockjax._batch.batch import LANES
from rockjax._machine.threads import precision
from rockjax._responses.peak import data_variables

from .chunks import Devices, cores_of, solved, trial_steps
from .store import ChunkLayout, compressed_size, stored_as
from .study import SweepSpec

SAMPLE = (256, 16384)  # scenes
SHARE = 50  # of so many scenes one
# Wall time of a chunk: long against the writing of its files, which takes some hundredths; short against what
# a fault costs.
CHUNK_SECONDS = 2.5, 10.0
# At least so many for each that solves them, where they are not too short: nobody waits long for the last.
CHUNKS_EACH = 8


class Pilot(NamedTuple):
    """A sample of the scenes, solved.

    - `scenes`: their numbers; `steps`: trial steps of each; `core_seconds`: for one trial step, of one core
      [s]
    - `variables`: what answers look like; `bytes_`: a scene in the store; `resident`: memory of the process
      [bytes]
    """

    scenes: np.ndarray
    steps: np.ndarray
    core_seconds: float
    variables: dict[str, Any]
    bytes_: float
    resident: int

    def chunk(self, scenes: int, cores: int, cores_of_chunk: int) -> int:
        """Scenes in a chunk that costs neither overhead nor waiting."""
        a_scene = max(1e-9, self.core_seconds * float(self.steps.mean()))
        low, high = CHUNK_SECONDS
        seconds = min(high, max(low, scenes * a_scene / (CHUNKS_EACH * cores)))
        return max(1, round(seconds * cores_of_chunk / a_scene))

    def expected(self, layout: ChunkLayout) -> np.ndarray:
        """Trial steps of every chunk: the mean of its sample, or of all where it has none."""
        chunks = layout.chunk_of(self.scenes)
        number = np.bincount(chunks, minlength=layout.number)
        total = np.bincount(chunks, weights=self.steps, minlength=layout.number)
        mean = np.where(number > 0, total / np.maximum(number, 1), self.steps.mean())
        return mean * layout.sizes()


def pilot(study: SweepSpec, threads: int | None, devices: Devices) -> Pilot:
    """Solve some scenes spread over all of them, and measure."""
    numbers, options = study.numbers, study.options
    low, high = SAMPLE
    count = min(numbers.size, max(low, min(high, numbers.size // SHARE)))
    rng = np.random.default_rng(0)
    edges = np.linspace(0, numbers.size, count + 1).astype(np.int64)
    scenes = edges[:-1] + (rng.random(count) * np.diff(edges)).astype(np.int64)
    with precision(study.precision):
        names = study.sensitivities
        solve = lambda which: solved(numbers.at(which), options, threads, devices, names)
        solve(scenes[:: max(1, count // low)])  # compiles
        began = time.perf_counter()
        peaks = solve(scenes)
        seconds = time.perf_counter() - began
    steps = trial_steps(peaks)
    answers = data_variables(peaks, options.outputs, ())
    variables = {name: stored_as(values, attrs, dims) for name, (dims, values, attrs) in answers.items()}
    kept = {name: values.astype(variables[name].dtype) for name, (_, values, _) in answers.items()}
    per_step = seconds / steps.sum() * min(cores_of(devices, threads), -(-count // LANES))
    return Pilot(scenes, steps, per_step, variables, compressed_size(kept) / count, _resident())


def _resident() -> int:
    """The most memory that this process has had, with the compiler at work; now, where the system does not
    tell [bytes]."""
    import psutil

    now = psutil.Process().memory_info().rss
    if sys.platform != "linux":
        return now
    import resource

    return max(now, 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
