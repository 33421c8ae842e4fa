"""Batches of scenes: lanes that step together and take the next scene as soon as theirs has ended.

A thread per core owns `LANES` lanes and continues from one chunk of scenes to the next, without waiting for
scenes that are still running. Each accelerator has thousands of lanes of its own.
"""

from __future__ import annotations

import itertools
import threading
import warnings
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, wait
from typing import Any, NamedTuple, cast

import jax
import numpy as np

from rockjax import _results as results
from rockjax._checks import float_type
from rockjax._engine.scene import as_compiled
from rockjax._excitations.base import AbstractExcitation
from rockjax._machine.memory import BYTES, BYTES_OF_SLOPES, require_memory
from rockjax._machine.threads import submit
from rockjax._motions.convert import AnyMotions, as_batch
from rockjax._options import Options
from rockjax._parameters.variants import place_of
from rockjax._responses.arguments import check_range, check_types
from rockjax._responses.estimate import companion, errors
from rockjax._responses.peak import Peak, peak_fields
from rockjax._responses.sensitivities import of_scenes, sensitivities_of
from rockjax._results import REST, Interrupted, State
from rockjax._structures import Podium

from .chunk import LaneLayout
from .edge_distance import SCALE
from .exchange import Done
from .executors import AbstractExecutor, executor_for
from .scenes import NOTHING, Numbers, SceneBatch, broadcast

# As many lanes as fit the first-level cache and fill the vector unit.
LANES = 32
CHUNK = 1024  # scenes prepared at once
QUICK = 5  # quick scenes per lane below which waking a further thread does not pay

# An accelerator has far more units than a core has vector lanes. These numbers are estimates.
ACCELERATOR_LANES = 1024, 32768  # least, so that few programs serve all batch sizes, and most
ACCELERATOR_CHUNK = 4  # scenes prepared at once for each lane
ACCELERATOR_NUMBERS = 2**26  # of all lanes in one array: wide scenes have fewer lanes

_REPORTING = threading.Lock()  # concurrent batches may share one progress bar


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
) -> Peak:
    """Compute peak responses of a batch of scenes, in parallel on all cores or devices (host).

    Every number of `podiums`, `excitations`, `initial` and `t_end` may be an array; the arrays broadcast to
    the shape of the batch (a `Record`'s samples along the last axis are one record). `Motions`, and lists of
    records or of pulses of one kind, are a batch of shape (k,). Returns a [`rockjax.Peak`][] of NumPy arrays
    of that shape. Scenes without an answer keep the reason in their `result`, and a `RuntimeWarning` counts
    them; the other scenes are not affected. Ctrl-C raises [`rockjax.Interrupted`][], a `KeyboardInterrupt`
    that holds the answers so far, after the present chunks of scenes; it does not wait for the last scenes of
    a batch.

    - `podiums`: the structures
    - `excitations`: the ground motions
    - `initial`: initial state; by default at rest
    - `t_end`: end of each scene [s]; by default 30/p, or 10 T_s if that is longer, after the excitation
    - `options`: options of the solver and the requested outputs
    - `progress`: `True` for a progress bar, or any object with `update(number_of_scenes)`
    - `sensitivities`: parameters y for which derivatives of all requested peaks with respect to ln y are
      computed, with the other parameters held constant: parameters of the podiums as in [`rockjax.grid`][]
      (`"alpha"`, `"R"`, `"gamma"`, `"T_s"`, …), numbers of the motions (`"a_p"`, `"T_p"`, `"dt"`, …) and
      `"scale"`, a factor on any motion. They are the `sensitivities` of the answer
    - `devices`: JAX devices of one platform that share the scenes, driven by one host thread. By default one
      thread on each core if JAX runs on a CPU, else all of `jax.local_devices()`
    - `threads`: number of threads on a CPU, ≥ 1; by default one for each core that this process may use. Not
      with `devices`

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
    )
    warn_of_failures(peaks, stacklevel=3)
    return peaks


def warn_of_failures(peaks: Peak, stacklevel: int) -> None:
    """Emit a `RuntimeWarning` that counts the scenes without an answer."""
    _warn_of_codes(np.asarray(results.code_of(peaks.result)), stacklevel + 1)


def _warn_of_codes(codes: np.ndarray, stacklevel: int) -> None:
    failed = codes[codes > results.OVERTURNED]
    if failed.size:
        kinds = {results.NAMES[k] for k in np.unique(failed)}
        message = f"{failed.size} of {codes.size} scenes did not finish: {kinds}"
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
) -> Peak:
    """Compute [`peak_responses`][rockjax.peak_responses] without warnings; another thread can stop it.

    - `podiums`, `excitations`, `initial`, `t_end`, `options`, `progress`, `devices`, `threads`,
      `sensitivities`: as there
    - `stop`: event that stops the batch once it is set

    Raises [`rockjax.Interrupted`][] with the answers so far when stopped, and `ValueError` for invalid
    inputs.
    """
    check_types("peak_responses", podiums, options, "podiums")
    check_range("peak_responses", podiums, excitations, None, options)
    if options.engine != "flat":
        raise ValueError(
            f"peak_responses: options.engine must be 'flat', got "
            f"{options.engine!r}; loop over peak_response for the "
            "segments engine"
        )
    names = of_scenes("peak_responses", podiums, excitations, sensitivities)
    varied = {place_of(name).partition(".")[0] for name in names}
    if "restrainers" not in varied:
        podiums = podiums.without_idle_restrainers()
    if not options.of_joints and "elevation" not in varied:
        podiums = podiums.without_elevation()
    scenes, shape = broadcast("peak_responses", podiums, excitations, initial, t_end)
    twice = 2 if "errors" in options.outputs else 1
    require_memory("peak_responses", scenes.total, twice * BYTES + len(names) * BYTES_OF_SLOPES)
    lane_executor = executor_for("peak_responses", devices, threads)
    solutions = [run_batch(scenes, options, progress, stop, lane_executor, names)[:2]]
    if "errors" in options.outputs and not stop.is_set():
        solutions.append(run_batch(scenes, companion(options), False, stop, lane_executor)[:2])
    if stop.is_set() and not all("code" in integers for _, integers in solutions):
        raise Interrupted("stopped before any scene had ended", None)
    if len(solutions) > 1:
        (_, first), (_, second) = solutions
        first["code"][second["code"] == results.INTERRUPTED] = results.INTERRUPTED
    for answer in (answer for solution in solutions for answer in solution):
        for name, values in answer.items():
            answer[name] = values.reshape((*shape, *values.shape[1:]))
    floats, integers = solutions[0]
    estimates = errors(solutions[0], solutions[1], options, np) if len(solutions) > 1 else None
    slopes = sensitivities_of(floats, names, options.outputs)
    left = int(np.sum(integers["code"] == results.INTERRUPTED))
    if left or stop.is_set():
        message = f"stopped with {scenes.total - left} of {scenes.total} scenes solved"
        fields = peak_fields(floats, integers, options)
        raise Interrupted(message, Peak(**fields, errors=estimates, sensitivities=slopes))
    return Peak(**peak_fields(floats, integers, options), errors=estimates, sensitivities=slopes)


def bare_responses(
    podiums: Podium, excitations: AbstractExcitation, options: Options, progress: Any, edge_distance: bool
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Return floats and integers of a batch of shape (n,), as computed for `peak_responses`.

    - `podiums`, `excitations`: structures and ground motions
    - `options`: options of the solver
    - `progress`: as in `peak_responses`
    - `edge_distance`: whether the floats include the `edge_distance` of each scene
    """
    check_range("peak_responses", podiums, excitations, None, options)
    scenes, _ = broadcast("peak_responses", podiums, excitations, REST, None)
    require_memory("peak_responses", scenes.total, BYTES + edge_distance * BYTES_OF_SLOPES)
    stop = threading.Event()
    names = (SCALE,) if edge_distance else ()
    floats, integers, _ = run_batch(scenes, options, progress, stop, None, names, edge_distance)
    if stop.is_set():
        raise Interrupted("stopped while scenes were looked at", None)
    _warn_of_codes(integers["code"], stacklevel=3)
    return floats, integers


class Tally(NamedTuple):
    """Utilisation of the lanes, for measurements: trials that advanced a scene, and trials that the lanes
    could make."""

    useful: int
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
    """Return floats and integers of every scene, and the utilisation of the lanes.

    - `scenes`: the batch
    - `options`: options of the solver
    - `progress`: as in `peak_responses`
    - `stop`: event that stops the batch, set by Ctrl-C as well: no further scene begins, and unfinished
      scenes have the code INTERRUPTED. If None, Ctrl-C raises
    - `executor`: executor of the lanes; by default on all cores or devices
    - `sensitivities`: parameters for derivatives with respect to their logarithms, which the floats hold
      along a last axis
    - `edge_distance`: whether the floats include it; then `sensitivities` must be the scale alone
    """
    executor = executor_for("run_batch") if executor is None else executor
    # Python and NumPy numbers in the options get one type, so that searches with other tolerances use the
    # same program.
    options = jax.tree.map(lambda y: np.asarray(y, float_type()), options)
    options = as_compiled(scenes.podium, options)
    lane_layout = layout(scenes, executor, sensitivities)._replace(edge_distance=edge_distance)
    idle, advance = executor.program(scenes, options, lane_layout)
    answers = _Answers(scenes, lane_layout.lanes)
    lock = threading.Lock()
    stopped = threading.Event() if stop is None else stop
    todo = deque(_chunks(scenes, lane_layout, executor))

    def ends() -> Iterator[Done]:
        lanes = idle
        while not stopped.is_set():
            if executor.hosts > 1 and len(todo) < 2 * executor.hosts:
                # Calls return at once: without waiting, one thread would take the last chunks from idle ones.
                jax.block_until_ready(lanes)
            with lock:
                numbers = todo.popleft() if todo else NOTHING
                # With no further chunk for this thread, the lanes run to their ends.
                last = len(todo) < executor.hosts
            lanes, done = advance(lanes, numbers, last)
            yield done
            if last and not todo and not np.any(np.asarray(done.left)):
                return

    def work() -> None:
        # The answers of a chunk are stored while the lanes already run the next one.
        for ended, _ in itertools.pairwise(itertools.chain(ends(), [None])):
            number = answers.keep(cast(Done, ended))
            with _REPORTING:
                bar.update(number)

    from rockjax._progress import bar as bar_of

    threads = min(executor.hosts, len(todo))
    futures: list[Future] = []
    with bar_of(scenes.total, "scenes", progress, unit_scale=True) as bar:
        try:
            if threads == 1:
                work()
            else:
                futures += [submit(work) for _ in range(threads)]
                for future in futures:
                    future.result()
        except BaseException as error:
            stopped.set()
            wait(futures)
            if stop is None or not isinstance(error, KeyboardInterrupt):
                raise
    answers.close()
    return answers.floats, answers.integers, Tally(answers.useful, answers.possible)


class _Answers:
    """Answers that the threads of a batch have found so far; unfinished scenes have the code INTERRUPTED."""

    def __init__(self, scenes: SceneBatch, lanes: int):
        self.scenes, self.lanes = scenes, lanes  # of each device
        self.floats: dict[str, np.ndarray] = {}
        self.integers: dict[str, np.ndarray] = {}
        self.useful = self.possible = 0
        self._lock = threading.Lock()
        self._closed = False

    def keep(self, ended: Done) -> int:
        """Store the scenes that ended and return their number."""
        done = jax.tree.map(np.asarray, ended)
        used = np.reshape(done.used, (-1, 1))
        has_devices = used.size > 1  # devices, one after another; the rows of one are the first
        rows = (
            (np.arange(done.scene_index.size // used.size) < used).ravel()
            if has_devices
            else slice(used.item())
        )
        index = self.scenes.in_grid(np.asarray(done.scene_index)[rows])
        with self._lock:
            if self._closed:
                return 0
            # All devices wait for the slowest one.
            self.useful += int(np.sum(done.useful))
            self.possible += int(np.max(done.trials)) * self.lanes
            # The code is written last: after Ctrl-C in between, the scene still counts as unfinished.
            for store, part, fill in ((self.floats, done.floats, np.nan), (self.integers, done.integers, 0)):
                for name in sorted(part, key="code".__eq__):
                    values = part[name]
                    if name not in store:
                        blank = results.INTERRUPTED if name == "code" else fill
                        store[name] = np.full((self.scenes.total, *values.shape[1:]), blank, values.dtype)
                    store[name][index] = values[rows]
        return index.size

    def close(self) -> None:
        """Ignore further answers. If Ctrl-C comes while threads start, one of them may not be waited for."""
        with self._lock:
            self._closed = True


def _chunks(scenes: SceneBatch, lane_layout: LaneLayout, executor: AbstractExecutor) -> Iterator[Numbers]:
    """Yield chunks of scenes, interleaved between threads. Neighbouring scenes cost about the same, so all
    threads have equal work and end at about the same time."""
    # Fewer scenes than lanes take as long as a full set, and waking a thread costs more than a few scenes.
    least = lane_layout.lanes * executor.devices * (QUICK if scenes.quick else 1)
    hosts = min(executor.hosts, -(-scenes.total // least))
    most = lane_layout.size * executor.devices * hosts
    for start in range(0, scenes.total, most):
        yield from (
            Numbers(start + k, hosts, len(range(start + k, min(start + most, scenes.total), hosts)))
            for k in range(min(hosts, scenes.total - start))
        )


def layout(scenes: SceneBatch, executor: AbstractExecutor, sensitivities: tuple[str, ...] = ()) -> LaneLayout:
    """Return the layout of lanes on a device: their number, and the number of scenes prepared at once."""
    refill = not scenes.wide
    if executor.platform == "cpu":
        lanes, size = LANES, CHUNK if refill else LANES  # one program for any number of scenes
    else:
        least, most = ACCELERATOR_LANES
        share = -(-scenes.total // executor.devices)
        lanes = min(most, max(least, 1 << (share - 1).bit_length()))
        while lanes > LANES and lanes * scenes.numbers > ACCELERATOR_NUMBERS:
            lanes //= 2
        many = scenes.total > max(2, executor.devices) * lanes
        size = ACCELERATOR_CHUNK * lanes if refill and many else lanes
    return LaneLayout(scenes.axes, scenes.structure, lanes, size, refill, sensitivities)
