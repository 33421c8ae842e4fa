"""Many scenes at once: lanes that step together and take the next scene as soon as theirs has ended.

Scenes are cut into chunks of one compiled size; a thread per core drives one chunk at a time. Inside a chunk `LANES`
scenes step side by side through the same per-lane step as everywhere else; every few steps the lanes whose scene has
ended write it out and load the next one, so none waits for another.
"""

from __future__ import annotations

import contextlib
import functools
import os
import warnings
from concurrent.futures import ThreadPoolExecutor, as_completed
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_batching import custom_vmap

from . import _results as results
from ._checks import as_float
from ._excitations import AbstractExcitation
from ._flat import closed, runs
from ._options import Options
from ._record import Record
from ._results import Peak, State
from ._scene import Lane, Scene, plan, prepare
from ._simulate import REST, check_range, check_types, fields
from ._solve import answers
from ._step import step
from ._structures import Podium

LANES = 256
CHUNK = 8192  # scenes prepared at once
STRIDE = 8  # steps between looks for lanes to refill
WIDE = 64  # numbers: a scene that carries more of its own (a record each) is not moved between lanes


def peak_responses(
    podiums: Podium,
    excitations: AbstractExcitation,
    *,
    initial: State = REST,
    t_end=None,
    options: Options = Options(),
    progress: Any = False,
) -> Peak:
    """Peak responses of a batch of scenes, in parallel on all cores (host).

    Every number of `podiums`, `excitations`, `initial` and `t_end` may be an array; together they broadcast to the shape
    of the batch (a `Record`'s samples along the last axis are one record). Returns a [`rockjax.Peak`][] of NumPy arrays of
    that shape. Scenes that end without an answer keep their `result`, and a `RuntimeWarning` counts them: one scene never
    costs the others their answers.

    - `progress`: `True` for a progress bar, or anything with `update(number_of_scenes)`

    Raises `ValueError` for inputs that make no sense.
    """
    check_types("peak_responses", podiums, excitations, options)
    check_range("peak_responses", podiums, excitations, None, options)
    initial = jax.tree.map(as_float, initial)
    t_end = None if t_end is None else as_float(t_end)
    tree = (podiums, excitations, initial, t_end)
    leaves, structure = jax.tree.flatten(tree)
    own = _own_dimensions(structure, excitations)
    try:
        shape = np.broadcast_shapes(*(y.shape[: y.ndim - n] for y, n in zip(leaves, own, strict=True)))
    except ValueError as error:
        raise ValueError(f"peak_responses: the arrays in the arguments do not broadcast: {error}") from None
    batched = [y.ndim > n for y, n in zip(leaves, own, strict=True)]
    batched[0] |= not any(batched)  # one scene is a batch of one
    scenes = [
        np.broadcast_to(np.asarray(y), (*shape, *y.shape[y.ndim - n :])).reshape(-1, *y.shape[y.ndim - n :]) if b else y
        for y, n, b in zip(leaves, own, batched, strict=True)
    ]
    size = int(np.prod(shape, dtype=int))
    floats, integers = _drive(scenes, batched, structure, size, options, progress)
    for answer in (floats, integers):
        for name, values in answer.items():
            answer[name] = values.reshape(shape)
    failed = int(np.sum(integers["code"] > results.OVERTURNED))
    if failed:
        kinds = {results.NAMES[k] for k in np.unique(integers["code"]) if k > results.OVERTURNED}
        warnings.warn(f"{failed} of {size} scenes ended without an answer: {kinds}", RuntimeWarning, stacklevel=2)
    return Peak(**fields(floats, integers))


def _own_dimensions(structure, excitations) -> list[int]:
    """Dimensions of each leaf that belong to one scene: one for the samples of a record, none otherwise."""
    numbers = jax.tree.unflatten(structure, [0] * structure.num_leaves)
    if isinstance(excitations, Record):
        podium, record, *rest = numbers
        record = jax.tree.map(lambda _: 0, record)
        object.__setattr__(record, "acceleration", 1)
        numbers = (podium, record, *rest)
    return jax.tree.leaves(numbers)


def _drive(scenes, batched, structure, size: int, options: Options, progress: Any):
    wide = any(b and len(y) and y[0].size > WIDE for y, b in zip(scenes, batched, strict=True))
    lanes = LANES if size >= LANES else max(1, size)
    chunk = min(lanes if wide else CHUNK, max(lanes, -(-size // _workers())))
    starts = range(0, size, chunk)
    axes = tuple(0 if b else None for b in batched)
    floats: dict[str, np.ndarray] = {}
    integers: dict[str, np.ndarray] = {}

    def work(start: int):
        count = min(chunk, size - start)

        def part(y):
            # The last chunk is filled up to the compiled size with copies that are never run.
            return np.concatenate([y[start : start + count], np.repeat(y[:1], chunk - count, axis=0)])

        leaves = [part(y) if b else y for y, b in zip(scenes, batched, strict=True)]
        answer = _run_chunk(leaves, jnp.asarray(count), options, axes=axes, structure=structure, lanes=lanes)
        return start, count, jax.tree.map(np.asarray, answer)

    with ThreadPoolExecutor(_workers()) as pool, _bar(size, progress) as bar:
        futures = [pool.submit(work, start) for start in starts]
        try:
            for future in as_completed(futures):
                start, count, answer = future.result()
                for store, part in zip((floats, integers), answer, strict=True):
                    for name, values in part.items():
                        whole = store.setdefault(name, np.empty(size, values.dtype))
                        whole[start : start + count] = values[:count]
                bar.update(count)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return floats, integers


def _workers() -> int:
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:
        return os.cpu_count() or 1


def _bar(size: int, progress: Any):
    if hasattr(progress, "update"):
        return contextlib.nullcontext(progress)
    from tqdm import tqdm

    return tqdm(total=size, disable=not progress, unit=" scenes", unit_scale=True)


class _Queue(NamedTuple):
    """The loop's state: what the lanes hold, and what is still to be done."""

    lanes: Lane
    scenes: Any  # the parts of `Scene` that differ between scenes
    held: jax.Array  # which scene each lane holds, chunk size where none
    following: jax.Array  # the next scene to hand out
    floats: dict[str, jax.Array]
    integers: dict[str, jax.Array]


@functools.partial(jax.jit, static_argnames=("axes", "structure", "lanes"))
def _run_chunk(leaves, count, options: Options, *, axes, structure, lanes: int):
    podium = jax.tree.unflatten(structure, leaves)[0]
    how = plan(podium, options, history=False)

    def ready(*leaves) -> tuple[Scene, Lane]:
        podium, excitation, initial, t_end = jax.tree.unflatten(structure, leaves)
        return prepare(podium, excitation, initial, t_end, options, how)

    differs, _ = _differing(ready, axes, leaves)
    # Every lane starts with a state of its own; of the scene, what is common to all stays common.
    out_axes = (jax.tree.map(lambda flag: 0 if flag else None, differs), 0)
    scenes, starts = jax.vmap(ready, in_axes=axes, out_axes=out_axes)(*leaves)
    size = starts.t.shape[0]
    flat_scenes, scene_structure = jax.tree.flatten(scenes)
    own = jax.tree.leaves(differs)
    moving = [y for y, flag in zip(flat_scenes, own, strict=True) if flag]

    def whole(parts) -> Scene:
        parts = iter(parts)
        leaves = [next(parts) if flag else y for y, flag in zip(flat_scenes, own, strict=True)]
        return jax.tree.unflatten(scene_structure, leaves)

    def over_lanes(function):
        return jax.vmap(lambda parts, lane: function(whole(parts), lane))

    def advance(parts, lane: Lane) -> Lane:
        running = runs(lane, options.max_steps)
        after, _ = over_lanes(lambda scene, lane: step(scene, how, lane))(parts, lane)

        def keep(new, old):
            return jnp.where(running, new, old)

        return jax.tree.map(keep, after, lane)

    def exchange(queue: _Queue) -> _Queue:
        done = ~runs(queue.lanes, options.max_steps) & (queue.held < size)
        floats, integers = over_lanes(lambda scene, lane: answers(scene, how, closed(lane)))(queue.scenes, queue.lanes)
        at = jnp.where(done, queue.held, size)

        def write(store, values):
            return jax.tree.map(lambda s, y: s.at[at].set(y, mode="drop"), store, values)

        fresh = queue.following + jnp.cumsum(done) - 1
        index = jnp.where(done, jnp.where(fresh < count, fresh, size), queue.held)
        loads = done & (index < size)

        def load(store, held):
            flag = loads.reshape((-1,) + (1,) * (held.ndim - 1))
            return jnp.where(flag, store[jnp.clip(index, 0, size - 1)], held)

        return _Queue(
            lanes=jax.tree.map(load, starts, queue.lanes),
            scenes=[load(store, held) for store, held in zip(moving, queue.scenes, strict=True)],
            held=index,
            following=queue.following + jnp.sum(done),
            floats=write(queue.floats, floats),
            integers=write(queue.integers, integers),
        )

    def body(queue: _Queue) -> _Queue:
        stepped = jax.lax.fori_loop(0, STRIDE, lambda _, lane: advance(queue.scenes, lane), queue.lanes)
        queue = queue._replace(lanes=stepped)
        return jax.lax.cond(jnp.any(~runs(stepped, options.max_steps) & (queue.held < size)), exchange, lambda q: q, queue)

    index = jnp.arange(lanes)
    first, parts = jax.tree.map(lambda y: y[:lanes], starts), [y[:lanes] for y in moving]
    blank = jax.eval_shape(over_lanes(lambda scene, lane: answers(scene, how, lane)), parts, first)
    floats, integers = jax.tree.map(lambda y: jnp.zeros((size, *y.shape[1:]), y.dtype), blank)
    queue = _Queue(first, parts, jnp.where(index < count, index, size), jnp.asarray(lanes), floats, integers)
    queue = jax.lax.while_loop(lambda queue: jnp.any(queue.held < size), body, queue)
    return queue.floats, queue.integers


def _differing(function, axes, leaves):
    """For each output of the vmapped function, whether it differs between scenes."""
    found: list[Any] = []

    @custom_vmap
    def probe(outputs):
        return outputs

    @probe.def_vmap
    def _(axis_size, in_batched, outputs):
        del axis_size
        found.append(in_batched[0])
        return outputs, in_batched[0]

    jax.eval_shape(jax.vmap(lambda *leaves: probe(function(*leaves)), in_axes=axes), *leaves)
    return found[-1]
