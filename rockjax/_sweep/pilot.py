"""Estimate of the cost of a sweep from a sample of its scenes.

A scene is one structure under one ground motion. A sweep solves its scenes in batches, the chunks.
"""

from __future__ import annotations

import sys
import time
from typing import Any, NamedTuple

import jax
import numpy as np

from rockjax._batch.batch import LANES
from rockjax._responses.peak import data_variables

from .chunks import Devices, count_cores, count_trial_steps, solve_scenes
from .layout import ChunkLayout
from .spec import SweepSpec
from .store import compressed_size, variable_for

SAMPLE_SIZES = (256, 16384)  # smallest and largest number of sampled scenes
SCENES_PER_SAMPLE = 50  # one of this number of scenes is sampled, within the limits `SAMPLE_SIZES`
# Shortest and longest wall time of a chunk [s]. With shorter chunks, writing their files would take a large
# share of the time. With longer chunks, a failure would lose more work.
CHUNK_SECONDS = 2.5, 10.0
# Smallest number of chunks that each core helps to solve, unless chunks would take less than the shortest
# wall time. With more chunks, fewer cores are idle at the end.
CHUNKS_PER_CORE = 8


class Pilot(NamedTuple):
    """A solved sample of the scenes of a sweep, and its cost."""

    scenes: np.ndarray  # flat indices of the sampled scenes
    steps: np.ndarray  # number of trial steps (accepted and rejected) of each scene
    step_seconds: float  # time that one core, or one device, needs for a trial step [s]
    variables: dict[str, Any]  # arrays of results, by name
    scene_bytes: float  # size of the results of a scene in the store [bytes]
    memory: int  # memory of the process that solved the sample, see `_resident_memory` [bytes]

    def chunk_size(self, scenes: int, cores: int, cores_of_chunk: int) -> int:
        """Return the number of scenes in a chunk whose expected wall time is in the range `CHUNK_SECONDS`.

        - `scenes`: number of scenes to solve
        - `cores`: number of cores or devices that solve the sweep
        - `cores_of_chunk`: number of cores or devices that solve one chunk
        """
        scene_seconds = max(1e-9, self.step_seconds * float(self.steps.mean()))
        low, high = CHUNK_SECONDS
        seconds = min(high, max(low, scenes * scene_seconds / (CHUNKS_PER_CORE * cores)))
        return max(1, round(seconds * cores_of_chunk / scene_seconds))

    def expected_steps(self, layout: ChunkLayout) -> np.ndarray:
        """Return the expected number of trial steps of every chunk, shape (chunks,).

        The estimate for a chunk uses the sampled scenes in this chunk. If there are none, it uses all sampled
        scenes.
        """
        chunks = layout.chunk_of(self.scenes)
        sample_counts = np.bincount(chunks, minlength=layout.chunk_count)
        total = np.bincount(chunks, weights=self.steps, minlength=layout.chunk_count)
        mean = np.where(sample_counts > 0, total / np.maximum(sample_counts, 1), self.steps.mean())
        return mean * layout.sizes()


def pilot(spec: SweepSpec, threads: int | None, devices: Devices) -> Pilot:
    """Solve a sample of scenes spread over the sweep, and measure their cost.

    - `spec`: specification of the sweep
    - `threads`, `devices`: as for `Job.solve`
    """
    scene_arrays, options = spec.scene_arrays, spec.options
    low, high = SAMPLE_SIZES
    count = min(scene_arrays.size, max(low, min(high, scene_arrays.size // SCENES_PER_SAMPLE)))
    rng = np.random.default_rng(0)
    edges = np.linspace(0, scene_arrays.size, count + 1).astype(np.int64)
    scenes = edges[:-1] + (rng.random(count) * np.diff(edges)).astype(np.int64)
    with jax.enable_x64(spec.is_float64):
        names = spec.sensitivities
        solve = lambda indices: solve_scenes(scene_arrays.at(indices), options, threads, devices, names)
        solve(scenes[:: max(1, count // low)])  # compiles the programs, which is not measured
        start_time = time.perf_counter()
        peaks = solve(scenes)
        seconds = time.perf_counter() - start_time
    steps = count_trial_steps(peaks)
    results = data_variables(peaks, options.outputs, ())
    variables = {name: variable_for(values, attrs, dims) for name, (dims, values, attrs) in results.items()}
    arrays = {name: values.astype(variables[name].dtype) for name, (_, values, _) in results.items()}
    # A core solves `LANES` scenes at a time, so a small sample occupies only some of the cores.
    step_seconds = seconds / max(steps.sum(), 1.0) * min(count_cores(devices, threads), -(-count // LANES))
    return Pilot(scenes, steps, step_seconds, variables, compressed_size(arrays) / count, _resident_memory())


def _resident_memory() -> int:
    """Return the peak memory of this process; on systems other than Linux, its current memory [bytes]."""
    import psutil

    current = psutil.Process().memory_info().rss
    if sys.platform != "linux":
        return current
    import resource

    return max(current, 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
