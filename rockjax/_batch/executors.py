"""Executors, which advance the lanes of a batch with one thread for each CPU core, or with one thread for all
accelerators. A lane solves one scene after another. A chunk is a set of scenes that are prepared together."""

from __future__ import annotations

import abc
import contextlib
import functools
import os
from collections.abc import Callable, Iterable, Sequence

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding
from jax.sharding import PartitionSpec as P

from rockjax._options import Options
from rockjax._programs.program import StoredProgram

from .chunk import LaneLayout
from .exchange import DoneScenes, Lanes
from .lanes import advance, idle_lanes
from .scenes import SceneBatch, SceneIndices

# (lanes, indices of the scenes of a chunk, True if no chunk follows) ↦ (lanes, scenes that have ended)
Program = Callable[[Lanes, SceneIndices, bool], tuple[Lanes, DoneScenes]]

# On a CPU, a call that finishes the last scenes of a batch ends after about this number of trial steps, and
# the next call continues. Calls must be short, because Ctrl-C takes effect between calls.
MAX_LAST_TRIALS = 30_000
UNLIMITED_TRIALS = np.iinfo(np.int32).max

# On a CPU with AVX-512, this option makes the compiler use the full width of the vector unit.
_COMPILER_OPTIONS = {"cpu": {"xla_cpu_prefer_vector_width": 512}}


class AbstractExecutor(abc.ABC):
    """Threads of this process, each of which advances the lanes of one or more devices."""

    threads: int  # number of threads
    devices: int  # number of devices per thread
    platform: str  # JAX's name of the platform, such as "cpu"

    @abc.abstractmethod
    def program(self, scenes: SceneBatch, options: Options, layout: LaneLayout) -> tuple[Lanes, Program]:
        """Return lanes without scenes, and a program that advances the lanes through a chunk of scenes.

        - `scenes`, `options`, `layout`: the batch, the options of the solver, and the layout of the lanes

        If lanes take further scenes (`LaneLayout.refill`) and another chunk follows, a call of the program
        ends when all scenes of its chunk have been loaded. Otherwise the call ends when all scenes have
        ended. There is one exception: on a CPU with refilled lanes, a call for the last chunk ends after
        about `MAX_LAST_TRIALS` trial steps, and further calls finish the scenes.

        Successive scenes take about the same time. They go to different devices, so that all devices end at
        about the same time. Every device has its own lanes and counters.
        """


class ThreadExecutor(AbstractExecutor):
    """Threads on the cores of one CPU, each with its own lanes."""

    devices = 1
    platform = "cpu"

    def __init__(self, threads: int):
        self.threads = threads
        # If JAX has accelerators, arrays must be placed on the CPU explicitly.
        cpu = None if jax.default_backend() == "cpu" else jax.local_devices(backend="cpu")[0]
        self._on_cpu = contextlib.nullcontext if cpu is None else functools.partial(jax.default_device, cpu)

    def program(self, scenes: SceneBatch, options: Options, layout: LaneLayout) -> tuple[Lanes, Program]:
        def advance_lanes(lanes: Lanes, indices: SceneIndices, last: bool) -> tuple[Lanes, DoneScenes]:
            max_trials = (MAX_LAST_TRIALS if last else 0) if layout.refill else UNLIMITED_TRIALS
            leaves = scenes.leaves_of_chunk(indices, layout.size)
            with self._on_cpu():
                return _advance_on_cpu(lanes, leaves, *indices, max_trials, options, layout=layout)

        return idle_lanes(scenes, options, layout), advance_lanes


class DeviceExecutor(AbstractExecutor):
    """One or more devices of one platform, synchronised between chunks and independent within a chunk."""

    threads = 1

    def __init__(self, devices: Sequence):
        self.devices = len(devices)
        self.platform = devices[0].platform
        self.mesh = Mesh(np.array(devices), ("scenes",))

    def program(self, scenes: SceneBatch, options: Options, layout: LaneLayout) -> tuple[Lanes, Program]:
        split, common = NamedSharding(self.mesh, P("scenes")), NamedSharding(self.mesh, P())
        # Leaves that all scenes share are sent to the devices once.
        leaves = [
            jax.device_put(y, common) if rows is None else y
            for y, rows in zip(scenes.leaves, scenes.rows, strict=True)
        ]
        scenes = scenes._replace(leaves=leaves)
        shardings = [common if rows is None else split for rows in scenes.rows]
        call = _on_mesh(self.mesh)

        def advance_lanes(lanes: Lanes, indices: SceneIndices, last: bool) -> tuple[Lanes, DoneScenes]:
            split_indices = indices.split(self.devices)
            leaves = scenes.leaves_of_chunk(indices, layout.size, self.devices)
            leaves, first, count = jax.device_put(
                (leaves, split_indices.first, split_indices.scenes), (shardings, split, split)
            )
            max_trials = UNLIMITED_TRIALS if last or not layout.refill else 0
            return call(lanes, leaves, first, split_indices.stride, count, max_trials, options, layout=layout)

        idle = idle_lanes(scenes, options, layout)
        idle = jax.tree.map(lambda y: np.concatenate([y] * self.devices), idle)
        return jax.device_put(idle, split), advance_lanes


_advance_on_cpu = StoredProgram(
    advance,
    donate=[0],
    compiler_options=_COMPILER_OPTIONS["cpu"],
    description="the program for batches of this kind of scene",
)


@functools.cache
def _on_mesh(mesh: Mesh):
    """Return the program for all devices of a mesh. During a call, no device waits for another one."""

    def advance_all(lanes, leaves, first, stride, count, max_trials, options, layout: LaneLayout):
        """Call `advance` on every device.

        - `lanes`, `first`, `count`: as for `advance`, with the devices along the first axis
        - `leaves`, `stride`, `max_trials`, `options`, `layout`: as for `advance`
        """

        def advance_on_device(lanes, leaves, first, stride, count, max_trials, options):
            """Call `advance` on one device.

            - `first`, `count`: as for `advance`, shape (1,)
            - `lanes`, `leaves`, `stride`, `max_trials`, `options`: as for `advance`
            """
            lanes, done = advance(lanes, leaves, first[0], stride, count[0], max_trials, options, layout)
            counters = {name: getattr(done, name)[None] for name in ("used", "trials", "useful", "running")}
            return lanes, done._replace(**counters)

        split, common = P("scenes"), P()
        specs = [common if axis is None else split for axis in layout.axes]
        run = jax.shard_map(
            advance_on_device,
            mesh=mesh,
            in_specs=(split, specs, split, common, split, common, common),
            out_specs=split,
            check_vma=False,
        )
        return run(lanes, leaves, first, stride, count, max_trials, options)

    options = _COMPILER_OPTIONS.get(mesh.devices.flat[0].platform)
    return jax.jit(advance_all, static_argnames="layout", donate_argnums=0, compiler_options=options)


def executor_for(owner: str, devices: Sequence | None = None, threads: int | None = None) -> AbstractExecutor:
    """Return the executor for devices or threads.

    - `owner`: class or function, for messages
    - `devices`: JAX devices of one platform, or None
    - `threads`: number of threads on a CPU, or None

    If both are None, the executor uses all accelerators or, without accelerators, a CPU thread for each core.
    Raises `ValueError` for invalid devices or threads, and if both are given.
    """
    if threads is not None and (not isinstance(threads, int) or threads < 1):
        raise ValueError(f"{owner}: threads must be a whole number ≥ 1, got threads = {threads!r}")
    if devices is None:
        platform = "cpu" if threads else _platform()
        return (
            ThreadExecutor(threads or workers())
            if platform == "cpu"
            else DeviceExecutor(jax.local_devices(backend=platform))
        )
    if isinstance(devices, str) or not isinstance(devices, Iterable):
        raise ValueError(
            f"{owner}: devices must be JAX devices, as from jax.local_devices(), got {devices!r}"
        )
    devices = list(devices)
    if threads is not None:
        raise ValueError(f"{owner}: one thread serves all devices; pass devices or threads, not both")
    if not devices or not all(isinstance(device, jax.Device) for device in devices):
        raise ValueError(
            f"{owner}: devices must be one or more JAX devices, as from jax.local_devices(), got {devices!r}"
        )
    if len(set(devices)) < len(devices) or len({device.platform for device in devices}) > 1:
        raise ValueError(f"{owner}: devices must be different devices of one platform, got {devices!r}")
    if any(device.process_index != jax.process_index() for device in devices):
        raise ValueError(
            f"{owner}: devices must belong to this process, see jax.local_devices(), got {devices!r}"
        )
    return DeviceExecutor(devices)


def _platform() -> str:
    """Return the name of the platform, such as "cpu", on which JAX places new arrays."""
    default_device = jax.config.jax_default_device
    return getattr(default_device, "platform", default_device) or jax.default_backend()


def workers() -> int:
    """Return the number of cores that this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:
        return os.cpu_count() or 1
