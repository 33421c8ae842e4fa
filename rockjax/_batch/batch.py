"""Batches of scenes, solved in lanes.

A lane solves one scene at a time, and takes the next scene when this scene has ended. A chunk is a set of
scenes that are prepared together. On a CPU every core has a thread with `LANES` lanes. The thread takes the
next chunk without waiting for scenes that are still running. An accelerator has thousands of lanes. All lanes
of a thread or accelerator make their trial steps (accepted or rejected steps) at the same time.
"""

from __future__ import annotations

import contextlib
import itertools
import threading
import warnings
from collections import deque
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple, cast

import jax
import numpy as np

from rockjax import _results as results
from rockjax._checks import float_type
from rockjax._excitations.base import AbstractExcitation
from rockjax._machine.memory import BYTES_PER_SCENE, BYTES_PER_SENSITIVITY, require_memory
from rockjax._machine.threads import run_in_threads
from rockjax._motions.convert import AnyMotions, as_batch
from rockjax._options import Options, canonical_options
from rockjax._parameters.variants import attribute_path_of, is_of_elevation
from rockjax._responses.arguments import check_range, check_types, warn_of_small_restitution
from rockjax._responses.estimate import errors, second_options
from rockjax._responses.on_floors import SecondarySystems, as_systems
from rockjax._responses.peak import Peak, peak_fields
from rockjax._responses.sensitivities import check_sensitivities, sensitivities_of
from rockjax._results import REST, Interrupted, State
from rockjax._structures import Podium

from .chunk import LaneLayout
from .edge_distance import SCALE
from .exchange import DoneScenes
from .executors import AbstractExecutor, executor_for
from .on_floors import answers_on_floors
from .scenes import NO_SCENES, SceneBatch, SceneIndices, broadcast

# Number of lanes per core. These lanes fill the vector unit, and their data fit into the first-level cache.
LANES = 32
CHUNK = 1024  # number of scenes in a chunk
# A small batch uses one thread for each `LANES` scenes, rounded up. If the scenes are quick (see
# `SceneBatch.is_quick`), it uses one thread for each `QUICK_SCENES_PER_LANE * LANES` scenes.
QUICK_SCENES_PER_LANE = 5

# Values for accelerators, which have far more arithmetic units than a core.
# Least and largest number of lanes of a device. For long records, `ACCELERATOR_VALUES` allows fewer lanes.
ACCELERATOR_LANES = (1024, 32768)
ACCELERATOR_CHUNK = 4  # number of scenes in a chunk, per lane
# Largest number of samples of records in all lanes of a device together. With long records, the number of
# lanes is halved until this limit is met.
ACCELERATOR_VALUES = 2**26


def peak_responses(
    podiums: Podium,
    excitations: AnyMotions,
    *,
    initial: State = REST,
    t_end=None,
    options: Options = Options(),
    progress: Any = False,
    sensitivities: Sequence[str] = (),
    devices: Sequence[jax.Device] | None = None,  # pyright: ignore[reportInvalidTypeForm]
    threads: int | None = None,
    on_floors: SecondarySystems = (),
) -> Peak:
    """Compute peak responses of a batch of scenes, outside jit, in parallel on all cores or devices.

    Every parameter of `podiums`, `excitations`, `initial` and `t_end` may be an array. The arrays broadcast
    to the shape of the batch; the axis of a `Record`'s samples does not count. `Motions`, and lists of k
    records or of k pulses of one class, are a batch of shape (k,).

    Returns a [`rockjax.Peak`][] of NumPy arrays whose first axes have the shape of the batch. If a scene does
    not finish, its `result` is the reason. Other scenes are not affected, and a `RuntimeWarning` counts the
    unfinished scenes. Ctrl-C stops the batch after the present chunk of scenes on each core or device, and
    raises [`rockjax.Interrupted`][], a `KeyboardInterrupt` that contains the answers so far. `Interrupted`
    contains no answers if no scene had ended, with the output "errors" if no second solution had ended, or
    if Ctrl-C came during the solution of `on_floors`.

    - `podiums`: the structures
    - `excitations`: the ground motions
    - `initial`: initial state; by default at rest
    - `t_end`: end of each scene [s]; by default max(30/p, 10 T_s) after the end of the excitation
    - `options`: options of the solver and the requested outputs
    - `progress`: `True` for a progress bar, or any object with a method `update(number_of_scenes)`
    - `sensitivities`: parameters y for which derivatives of all requested peaks with respect to ln y are
      computed, with the other parameters held constant: parameters of the podiums as in [`rockjax.grid`][]
      (`"alpha"`, `"R"`, `"gamma"`, `"T_s"`, …), parameters of the motions (`"a_p"`, `"T_p"`, `"dt"`, …) and
      `"scale"`, a factor on any motion. `"positions"`, `"story_heights"` and, for several modes or floors,
      `"top_height"` denote a factor on all values of a row. The derivatives are the field `sensitivities` of
      the result
    - `devices`: JAX devices of one platform, which share the scenes and are served by one thread. By
      default all accelerators are used or, if there are none, threads on the CPU
    - `threads`: number of threads on a CPU, ≥ 1; must be None if `devices` are given. By default a thread is
      used for each core that this process may use
    - `on_floors`: light secondary systems on the floors of every scene, as for [`rockjax.peak_response`][];
      their answers have no sensitivities

    Raises `ValueError` for invalid inputs, and for `options.engine` other than `"flat"`.
    """
    excitations = as_batch("peak_responses", excitations)
    peaks = responses(
        podiums,
        excitations,
        initial,
        t_end,
        options,
        progress,
        threading.Event(),
        devices,
        threads,
        sensitivities,
        on_floors,
    )
    warn_of_failures(peaks, stacklevel=3)
    warn_of_small_restitution(podiums, stacklevel=3)
    return peaks


def warn_of_failures(peaks: Peak, stacklevel: int) -> None:
    """Emit a `RuntimeWarning` that counts the scenes that did not finish, if there are any."""
    _warn_of_codes(np.asarray(results.code_of(peaks.result)), stacklevel + 1)


def _warn_of_codes(codes: np.ndarray, stacklevel: int) -> None:
    failed = codes[results.did_not_finish(codes)]
    if failed.size:
        names = {results.NAMES[k] for k in np.unique(failed)}
        message = f"{failed.size} of {codes.size} scenes did not finish: {names}"
        warnings.warn(message, RuntimeWarning, stacklevel)


def responses(
    podiums: Podium,
    excitations: AbstractExcitation,
    initial: State,
    t_end,
    options: Options,
    progress: Any,
    stop: threading.Event,
    devices: Sequence | None = None,
    threads: int | None = None,
    sensitivities: Sequence[str] = (),
    on_floors: SecondarySystems = (),
) -> Peak:
    """Compute the result of [`peak_responses`][rockjax.peak_responses] without warnings. Another thread can
    stop the batch.

    - `podiums`, `excitations`, `initial`, `t_end`, `options`, `progress`, `devices`, `threads`,
      `sensitivities`, `on_floors`: as in `peak_responses`
    - `stop`: event that stops the batch once it is set

    Raises `ValueError` for invalid inputs, and [`rockjax.Interrupted`][] if `stop` is set, also by Ctrl-C.
    `Interrupted` contains the answers so far, or None if no scene has ended or if the systems on the floors
    are being solved.
    """
    check_types("peak_responses", podiums, options, "podiums")
    check_range("peak_responses", podiums, excitations, t_end, options)
    if options.engine != "flat":
        raise ValueError(
            f"peak_responses: options.engine must be 'flat', got "
            f"{options.engine!r}; call peak_response for each scene to use the segments engine"
        )
    names = check_sensitivities("peak_responses", podiums, excitations, sensitivities)
    varied = {attribute_path_of(name).partition(".")[0] for name in names}
    needs_elevation = options.of_joints or any(is_of_elevation(name) for name in names)
    if "restrainers" not in varied:
        podiums = podiums.without_idle_restrainers()
    if not needs_elevation:
        podiums = podiums.without_elevation()
    systems = as_systems("peak_responses", podiums, on_floors)
    solution_count = 2 if "errors" in options.outputs else 1
    bytes_each = solution_count * BYTES_PER_SCENE + len(names) * BYTES_PER_SENSITIVITY
    with _interrupted_by_ctrl_c():
        scenes, shape = broadcast("peak_responses", podiums, excitations, initial, t_end)
        require_memory("peak_responses", scenes.total, bytes_each)
        lane_executor = executor_for("peak_responses", devices, threads)
        solutions = [run_batch(scenes, options, progress, stop, lane_executor, names)[:2]]
        if "errors" in options.outputs and not stop.is_set():
            solutions.append(run_batch(scenes, second_options(options), False, stop, lane_executor)[:2])
    if stop.is_set() and not (len(solutions) == solution_count and all("code" in y for _, y in solutions)):
        scene = (
            "scene" if solution_count == 1 else "scene and its second solution, which estimates the errors,"
        )
        raise Interrupted(f"stopped before any {scene} had ended", None)
    if len(solutions) > 1:
        # A scene without its second solution has no estimated errors, and counts as unfinished.
        is_unfinished = solutions[1][1]["code"] == results.INTERRUPTED
        solutions[0][1]["code"][is_unfinished] = results.INTERRUPTED
        for values in solutions[0][0].values():
            values[is_unfinished] = np.nan
    for answer in (answer for solution in solutions for answer in solution):
        for name, values in answer.items():
            answer[name] = values.reshape((*shape, *values.shape[1:]))
    floats, integers = solutions[0]
    estimates = errors(solutions[0], solutions[1], options, np) if len(solutions) > 1 else None
    slopes = sensitivities_of(floats, names, options.outputs)
    unsolved = int(np.sum(integers["code"] == results.INTERRUPTED))
    if unsolved or stop.is_set():
        message = f"stopped with {scenes.total - unsolved} of {scenes.total} scenes solved"
        fields = peak_fields(podiums, floats, integers, options)
        raise Interrupted(message, Peak(**fields, errors=estimates, sensitivities=slopes))
    floor_answers = ()
    if systems:
        floor_answers = answers_on_floors(
            scenes, shape, options, systems, progress, stop, lane_executor.threads
        )
    fields = peak_fields(podiums, floats, integers, options)
    return Peak(**fields, errors=estimates, sensitivities=slopes, on_floors=floor_answers)


def raw_responses(
    podiums: Podium, excitations: AbstractExcitation, options: Options, progress: Any, edge_distance: bool
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Solve a batch of shape (n,), and return two dicts with the floats and the integers of the answers, as
    `run_batch` does. Warn of scenes that did not finish.

    - `podiums`, `excitations`: structures and ground motions
    - `options`: options of the solver
    - `progress`: as in `peak_responses`
    - `edge_distance`: True to add the edge distance of each scene (see `edge_distance.py`) to the floats

    Raises [`rockjax.Interrupted`][] without answers if Ctrl-C stops the batch.
    """
    check_range("peak_responses", podiums, excitations, None, options)
    stop = threading.Event()
    names = (SCALE,) if edge_distance else ()
    bytes_each = BYTES_PER_SCENE + edge_distance * BYTES_PER_SENSITIVITY
    with _interrupted_by_ctrl_c():
        scenes, _ = broadcast("peak_responses", podiums, excitations, REST, None)
        require_memory("peak_responses", scenes.total, bytes_each)
        floats, integers, _ = run_batch(scenes, options, progress, stop, None, names, edge_distance)
    if stop.is_set():
        raise Interrupted("stopped while scenes were solved", None)
    _warn_of_codes(integers["code"], stacklevel=3)
    return floats, integers


@contextlib.contextmanager
def _interrupted_by_ctrl_c() -> Iterator[None]:
    """Raise `Interrupted` instead of another `KeyboardInterrupt` in the `with` block, such as that of Ctrl-C
    while lanes are prepared."""
    try:
        yield
    except Interrupted:
        raise
    except KeyboardInterrupt:
        raise Interrupted("stopped before any scene had ended", None) from None


class Tally(NamedTuple):
    """Numbers of trials (trial steps of single lanes) of all threads and all devices. `useful`/`possible` is
    the used fraction of the lanes."""

    useful: int  # number of trials that advanced a scene
    # Number of trials if all lanes had scenes at all times. In each call of the program, every device counts
    # with the trials of the device that makes most, because the other devices wait for it.
    possible: int


def run_batch(
    scenes: SceneBatch,
    options: Options,
    progress: Any,
    stop: threading.Event | None = None,
    executor: AbstractExecutor | None = None,
    sensitivities: tuple[str, ...] = (),
    edge_distance: bool = False,
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray], Tally]:
    """Solve a batch. Return a dict with the floats of the answers and a dict with the integers, both with
    a row for each scene, and the `Tally`.

    - `scenes`: the batch
    - `options`: options of the solver
    - `progress`: as in `peak_responses`
    - `stop`: event that stops the batch; Ctrl-C sets it too. Once it is set, no further chunk is started, and
      unfinished scenes have the code INTERRUPTED. If `stop` is None, Ctrl-C raises `KeyboardInterrupt`
    - `executor`: executor of the lanes; by default all cores or accelerators
    - `sensitivities`: parameters y. The floats also contain the derivatives of the answers with respect to
      ln y, with the parameters along the last axis
    - `edge_distance`: True to add edge distances to the floats; `sensitivities` must then be `("scale",)`
    """
    executor = executor_for("run_batch") if executor is None else executor
    # The numbers in the options are converted to arrays of one type, so that one program serves all values.
    options = jax.tree.map(lambda y: np.asarray(y, float_type()), options)
    options = canonical_options(scenes.podium, options)
    lane_layout = layout(scenes, executor, sensitivities)._replace(edge_distance=edge_distance)
    idle, advance = executor.program(scenes, options, lane_layout)
    answers = _Answers(scenes, lane_layout.lanes)
    lock = threading.Lock()
    stopped = threading.Event() if stop is None else stop
    pending = deque(_chunks(scenes, lane_layout, executor))

    def solve_chunks() -> Iterator[DoneScenes]:
        lanes = idle
        while not stopped.is_set():
            if executor.threads > 1 and len(pending) < 2 * executor.threads:
                # `advance` returns before the lanes have advanced. Near the end of the batch the thread waits
                # for its lanes here, so that idle threads can take the last chunks.
                jax.block_until_ready(lanes)
            with lock:
                indices = pending.popleft() if pending else NO_SCENES
                # If no chunk will be left for this thread, its lanes also finish their scenes in this call.
                last = len(pending) < executor.threads
            lanes, done = advance(lanes, indices, last)
            yield done
            if last and not pending and not np.any(np.asarray(done.running)):
                return

    def work() -> None:
        # The answers of a chunk are stored while the lanes already solve the next chunk.
        for done, _ in itertools.pairwise(itertools.chain(solve_chunks(), [None])):
            stored_count = answers.store(cast(DoneScenes, done))
            with BAR_LOCK:
                bar.update(stored_count)

    from rockjax._progress import BAR_LOCK
    from rockjax._progress import bar as bar_of

    threads = min(executor.threads, len(pending))
    with bar_of(scenes.total, "scenes", progress, unit_scale=True) as bar:
        run_in_threads(work, threads, stopped, raises=stop is None)
    answers.close()
    return answers.floats, answers.integers, Tally(answers.useful, answers.possible)


class _Answers:
    """Answers that all threads have computed so far. Unfinished scenes have the code INTERRUPTED.

    - `scenes`: the batch
    - `lanes`: number of lanes of each device
    """

    def __init__(self, scenes: SceneBatch, lanes: int):
        self.scenes, self.lanes = scenes, lanes
        self.floats: dict[str, np.ndarray] = {}
        self.integers: dict[str, np.ndarray] = {}
        self.useful = self.possible = 0
        self._lock = threading.Lock()
        self._closed = False

    def store(self, done: DoneScenes) -> int:
        """Store the scenes that have ended and return their number."""
        done = jax.tree.map(np.asarray, done)
        used = np.reshape(done.used, (-1, 1))
        # The rows of the devices follow one another. The first `used` rows of each device are valid.
        has_devices = used.size > 1
        rows = (
            (np.arange(done.scene_index.size // used.size) < used).ravel()
            if has_devices
            else slice(used.item())
        )
        index = self.scenes.in_grid(np.asarray(done.scene_index)[rows])
        with self._lock:
            if self._closed:
                return 0
            # `trials` has an entry for each device. All devices wait for the device with the most trials.
            self.useful += int(np.sum(done.useful))
            self.possible += int(np.max(done.trials)) * self.lanes * used.size
            # The code is written last, so that a scene counts as unfinished if Ctrl-C interrupts the loop.
            for stored, new, blank in (
                (self.floats, done.floats, np.nan),
                (self.integers, done.integers, 0),
            ):
                for name in sorted(new, key="code".__eq__):
                    values = new[name]
                    if name not in stored:
                        fill = results.INTERRUPTED if name == "code" else blank
                        stored[name] = np.full((self.scenes.total, *values.shape[1:]), fill, values.dtype)
                    stored[name][index] = values[rows]
        return index.size

    def close(self) -> None:
        """Ignore further answers: if Ctrl-C came while threads were being started, a thread may still run."""
        with self._lock:
            self._closed = True


def _chunks(
    scenes: SceneBatch, lane_layout: LaneLayout, executor: AbstractExecutor
) -> Iterator[SceneIndices]:
    """Yield the chunks of a batch. Successive scenes take about the same time. They belong to different
    chunks, so that all threads end at about the same time."""
    # One thread is used for each `scenes_per_thread` scenes, rounded up. This number is larger for quick
    # scenes, because starting a thread takes longer than solving a few quick scenes.
    scenes_per_thread = (
        lane_layout.lanes * executor.devices * (QUICK_SCENES_PER_LANE if scenes.is_quick else 1)
    )
    threads = min(executor.threads, -(-scenes.total // scenes_per_thread))
    group = lane_layout.size * executor.devices * threads
    for start in range(0, scenes.total, group):
        yield from (
            SceneIndices(start + k, threads, len(range(start + k, min(start + group, scenes.total), threads)))
            for k in range(min(threads, scenes.total - start))
        )


def layout(scenes: SceneBatch, executor: AbstractExecutor, sensitivities: tuple[str, ...] = ()) -> LaneLayout:
    """Return the layout of the lanes on a device.

    - `scenes`, `executor`: the batch, and the executor that advances the lanes
    - `sensitivities`: parameters y of the derivatives with respect to ln y
    """
    refill = not scenes.is_wide
    if executor.platform == "cpu":
        lanes, size = LANES, CHUNK if refill else LANES  # one program for any number of scenes
    else:
        min_lanes, max_lanes = ACCELERATOR_LANES
        scenes_per_device = -(-scenes.total // executor.devices)
        lanes = min(max_lanes, max(min_lanes, 1 << (scenes_per_device - 1).bit_length()))
        while lanes > LANES and lanes * scenes.values_per_scene > ACCELERATOR_VALUES:
            lanes //= 2
        has_many_scenes = scenes.total > max(2, executor.devices) * lanes
        size = ACCELERATOR_CHUNK * lanes if refill and has_many_scenes else lanes
    return LaneLayout(scenes.axes, scenes.structure, lanes, size, refill, sensitivities)
