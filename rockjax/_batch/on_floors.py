"""Light secondary systems (contents and oscillators) on the floors of a batch of scenes."""

from __future__ import annotations

import threading
from collections import deque
from typing import Any

import jax
import numpy as np

from rockjax import _results as results
from rockjax._machine.threads import run_in_threads
from rockjax._options import Options
from rockjax._programs.program import StoredProgram
from rockjax._responses.on_floors import as_answers, floor_options, on_floors
from rockjax._results import Interrupted

from .scenes import SceneBatch, SceneIndices

CHUNK = 16  # number of scenes that are solved together


@StoredProgram
def _chunk(leaves, systems, options, *, structure, axes, capacity: int):
    """Return the answers of secondary systems on the floors of a chunk of scenes."""

    def solve_scene(*leaves):
        podium, excitation, initial, t_end = jax.tree.unflatten(structure, leaves)
        structures = podium.without_elevation(), systems
        return on_floors(structures, excitation, initial, t_end, options, capacity=capacity)

    return jax.vmap(solve_scene, in_axes=axes)(*leaves)


def answers_on_floors(
    scenes: SceneBatch,
    shape: tuple[int, ...],
    options: Options,
    systems: tuple,
    progress: Any,
    stop: threading.Event,
    threads: int,
) -> tuple[Any, ...]:
    """Return the answers of each secondary system, as arrays that have the shape of the batch.

    - `scenes`, `shape`, `options`: scenes, shape and options of the batch
    - `systems`: secondary systems on the floors of every scene
    - `progress`: as in `peak_responses`
    - `stop`: event that stops the batch once it is set
    - `threads`: number of threads

    Raises [`rockjax.Interrupted`][], without partial answers, if the batch is stopped.
    """
    from rockjax._progress import BAR_LOCK
    from rockjax._progress import bar as bar_of

    options = floor_options(options)
    pending, answers = deque(range(0, scenes.total, CHUNK)), {}

    def solve(first: int) -> Any:
        count, capacity = min(CHUNK, scenes.total - first), options.history
        leaves = scenes.leaves_of_chunk(SceneIndices(first, 1, count), CHUNK)
        while True:
            static = {"structure": scenes.structure, "axes": scenes.axes, "capacity": capacity}
            answer = jax.tree.map(np.asarray, _chunk(leaves, systems, options, **static))
            # `answer` is (floats, (integers, codes)). If the history of a scene needs more steps than
            # `capacity`, the chunk is solved again with a larger capacity.
            is_full = np.any(answer[1][1][:count] == results.HISTORY_FULL)
            if not is_full or capacity >= options.max_steps + 2:
                return jax.tree.map(lambda y: y[:count] if y.ndim else np.full(count, y), answer)
            capacity *= 4

    with bar_of(scenes.total, "scenes with floors", progress, unit_scale=True) as bar:

        def work() -> None:
            while not stop.is_set():
                try:
                    first = pending.popleft()
                except IndexError:
                    return
                answers[first] = solve(first)
                with BAR_LOCK:
                    bar.update(answers[first][1][1].size)

        run_in_threads(work, min(threads, len(pending)), stop, raises=False)
    if stop.is_set():
        raise Interrupted("stopped while secondary systems on floors were solved", None)
    grid_order = np.argsort(scenes.in_grid(np.arange(scenes.total)))
    joined = jax.tree.map(
        lambda *y: np.concatenate(y)[grid_order].reshape(shape), *(answers[k] for k in sorted(answers))
    )
    floats, (integers, _) = joined
    return as_answers(systems, floats, integers)
