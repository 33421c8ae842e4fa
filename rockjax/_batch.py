"""Many scenes at once: lanes that step together and take the next scene as soon as theirs has ended.

A thread per core owns `LANES` lanes and goes on from one chunk of scenes to the next, without waiting for those that are
still running. Inside a chunk the lanes step side by side through the same per-lane step as everywhere else; every few
trials those whose scene has ended write it out and load the next one.
"""

from __future__ import annotations

import contextlib
import functools
import os
import threading
import warnings
from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_batching import custom_vmap

from . import _results as results
from ._checks import concrete
from ._contact import glide
from ._estimate import companion, errors
from ._excitations import AbstractExcitation
from ._flat import closed, runs
from ._options import Options
from ._results import Interrupted, Peak, State
from ._scene import Flag, Lane, Plan, Scene, plan, prepare
from ._scenes import Scenes, broadcast
from ._simulate import REST, check_range, check_types, fields
from ._solve import answers
from ._step import leap, trial
from ._structures import Podium
from ._threads import Pool

LANES = 64  # fit the first-level cache, and still fill the vector unit
CHUNK = 1024  # scenes prepared at once
PATIENCE = 5  # lanes that may wait before they are served

_REPORTING = threading.Lock()  # batches side by side may share one progress bar

# The vector unit at its full width: 1.7 times as fast where there is AVX-512, and no difference elsewhere.
_COMPILER = {"xla_cpu_prefer_vector_width": 512}


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
    costs the others their answers. Ctrl-C raises [`rockjax.Interrupted`][], a `KeyboardInterrupt` that holds the answers
    so far, as soon as the present chunks of scenes are through.

    - `progress`: `True` for a progress bar, or anything with `update(number_of_scenes)`

    Raises `ValueError` for inputs that make no sense, and for `options.engine` other than `"flat"`.
    """
    return responses(podiums, excitations, initial, t_end, options, progress, threading.Event())


def responses(podiums, excitations, initial: State, t_end, options: Options, progress, stop: threading.Event) -> Peak:
    """[`peak_responses`][rockjax.peak_responses] that another thread can stop."""
    check_types("peak_responses", podiums, excitations, options)
    check_range("peak_responses", podiums, excitations, None, options)
    if options.engine != "flat":
        raise ValueError(
            f"peak_responses: options.engine must be 'flat', got {options.engine!r}; loop over peak_response for the "
            "segments engine"
        )
    scenes, shape = broadcast("peak_responses", podiums, excitations, initial, t_end)
    solutions = [drive(scenes, options, progress, stop)[:2]]
    if "errors" in options.outputs and not stop.is_set():
        solutions.append(drive(scenes, companion(options), False, stop)[:2])
    if stop.is_set() and not all(floats for floats, _ in solutions):
        raise Interrupted("stopped before any scene had ended", None)
    if len(solutions) > 1:
        (_, first), (_, second) = solutions
        first["code"][second["code"] == results.INTERRUPTED] = results.INTERRUPTED
    for answer in (answer for solution in solutions for answer in solution):
        for name, values in answer.items():
            answer[name] = values.reshape(shape)
    floats, integers = solutions[0]
    doubt = errors(solutions[0], solutions[1], concrete(options.overturn_ratio), np) if len(solutions) > 1 else None
    left = int(np.sum(integers["code"] == results.INTERRUPTED))
    if left or stop.is_set():
        message = f"stopped with {scenes.total - left} of {scenes.total} scenes solved"
        raise Interrupted(message, Peak(**fields(floats, integers), errors=doubt))
    failed = int(np.sum(integers["code"] > results.OVERTURNED))
    if failed:
        kinds = {results.NAMES[k] for k in np.unique(integers["code"]) if k > results.OVERTURNED}
        warnings.warn(f"{failed} of {scenes.total} scenes ended without an answer: {kinds}", RuntimeWarning, stacklevel=2)
    return Peak(**fields(floats, integers), errors=doubt)


class Tally(NamedTuple):
    """What the lanes did, for those who measure: trials of scenes, and trials that the lanes had time for."""

    useful: int
    possible: int


def drive(
    scenes: Scenes, options: Options, progress: Any, stop: threading.Event | None = None
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray], Tally]:
    """Floats and integers of every scene, and how busy the lanes were.

    Once `stop` is set, as Ctrl-C does, no scene begins any more; those that have not ended have the code INTERRUPTED.
    Without it Ctrl-C raises.
    """
    refill = not scenes.wide
    size = CHUNK if refill and scenes.total > 2 * LANES else LANES
    call = functools.partial(
        _advance, axes=scenes.axes, structure=scenes.structure, lanes=LANES, refill=refill, options=options
    )
    floats: dict[str, np.ndarray] = {}
    integers: dict[str, np.ndarray] = {}
    useful = possible = 0
    lock = threading.Lock()
    stopped = threading.Event() if stop is None else stop

    def chunks() -> Iterator[tuple[int, int]]:
        # A small batch is shared out: not every chunk is full.
        share = min(size, max(LANES, -(-scenes.total // workers())))
        for start in range(0, scenes.total, share):
            yield start, min(start + share, scenes.total)

    todo = chunks()

    # Ctrl-C while a thread is being started can leave it out of those that the pool waits for.
    closed = threading.Event()

    def store(done: _Done) -> None:
        nonlocal useful, possible
        used = int(done.used)
        index = np.asarray(done.which)[:used]
        with lock:
            if closed.is_set():
                return
            useful, possible = useful + int(done.useful), possible + int(done.trials) * LANES
            for whole, part, fill in ((floats, done.floats, np.nan), (integers, done.integers, 0)):
                for name, values in part.items():
                    values = np.asarray(values)
                    if name not in whole:
                        whole[name] = np.full(scenes.total, results.INTERRUPTED if name == "code" else fill, values.dtype)
                    whole[name][index] = values[:used]
        with _REPORTING:
            bar.update(used)

    def work() -> None:
        lanes = idle
        while not stopped.is_set():
            with lock:
                start, stop = next(todo, (0, 0))
            # With nothing left to hand out, the lanes run to their ends.
            leaves = scenes.part(start, stop, size)
            lanes, done = call(lanes, leaves, start, stop - start, last=stop == start)
            store(done)
            if stop == start:
                return

    idle = _idle(scenes.part(0, 0, size), scenes.axes, scenes.structure, options, LANES)
    with _bar(scenes.total, progress) as bar, Pool(workers()) as pool:
        wanted = min(workers(), -(-scenes.total // LANES))
        try:
            for future in [pool.submit(work) for _ in range(wanted)]:
                future.result()
        except BaseException as error:
            stopped.set()
            if stop is None or not isinstance(error, KeyboardInterrupt):
                raise
    with lock:
        closed.set()
    return floats, integers, Tally(useful, possible)


def workers() -> int:
    """Cores that this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:
        return os.cpu_count() or 1


def _bar(size: int, progress: Any):
    if hasattr(progress, "update"):
        return contextlib.nullcontext(progress)
    from tqdm import tqdm

    return tqdm(total=size, disable=not progress, unit=" scenes", unit_scale=True)


class _Lanes(NamedTuple):
    """What the lanes hold from one chunk to the next."""

    lane: Lane
    parts: list[Any]  # of `Scene`: what differs between scenes
    held: jax.Array  # which scene of the batch each lane holds, −1 where none


class _Done(NamedTuple):
    """Scenes that have ended, in the order of their ends; so many of the rows are used."""

    which: jax.Array
    floats: dict[str, jax.Array]
    integers: dict[str, jax.Array]
    used: jax.Array
    trials: jax.Array  # of each lane
    useful: jax.Array  # of all lanes, those that moved a scene on


class _Loop(NamedTuple):
    lanes: _Lanes
    following: jax.Array  # the next scene of the chunk to hand out
    done: _Done


@functools.partial(
    jax.jit, static_argnames=("axes", "structure", "lanes", "refill"), compiler_options=_COMPILER, donate_argnums=0
)
def _advance(
    held: _Lanes, leaves, first, count, last, options: Options, *, axes, structure, lanes: int, refill: bool
) -> tuple[_Lanes, _Done]:
    """Go on until the last scene of a chunk has been handed out; the `last` time, until every lane has come to its end.

    The chunk's scenes are numbers `first` to `first + count` of the batch.
    """
    how = plan(jax.tree.unflatten(structure, leaves)[0], options, history=False)
    chunk = _glided(_prepared(leaves, axes, structure, options), how, lanes, count)
    moves, settle = _automaton(how, options)
    size = next(y.shape[0] for y, axis in zip(leaves, axes, strict=True) if axis == 0)

    def over_lanes(function, *arguments):
        return jax.vmap(lambda parts, *rest: function(chunk.scene(parts), *rest))(*arguments)

    index_type = held.held.dtype
    if not refill:
        index = jnp.arange(lanes, dtype=index_type)
        held = _Lanes(chunk.starts(lanes), [y[:lanes] for y in chunk.parts], jnp.where(index < count, first + index, -1))

    def exchange(loop: _Loop) -> _Loop:
        state, done = loop.lanes, loop.done
        lane = over_lanes(settle, state.parts, state.lane)
        ended = (state.held >= 0) & ~runs(lane, options.max_steps)
        floats, integers = over_lanes(lambda scene, lane: answers(scene, how, closed(lane)), state.parts, lane)
        place = jnp.where(ended, done.used + jnp.cumsum(ended) - 1, size + lanes)

        def write(stores, values):
            return jax.tree.map(lambda s, y: s.at[place].set(y, mode="drop"), stores, values)

        done = done._replace(
            which=write(done.which, state.held),
            floats=write(done.floats, floats),
            integers=write(done.integers, integers),
            used=done.used + jnp.sum(ended),
        )
        free = ended | (state.held < 0)
        local = loop.following + jnp.cumsum(free) - 1
        loads = free & (local < count)
        place = jnp.clip(local, 0, size - 1)

        def load(store, differs, current):
            flag = loads.reshape((-1,) + (1,) * (current.ndim - 1))
            return jnp.where(flag, store[place] if differs else store, current)

        state = _Lanes(
            jax.tree.map(load, chunk.lane, chunk.lane_differs, lane),
            [load(y, True, now) for y, now in zip(chunk.parts, state.parts, strict=True)] if refill else state.parts,
            jnp.where(loads, first + local, jnp.where(free, -1, state.held)).astype(index_type),
        )
        return _Loop(state, jnp.minimum(loop.following + jnp.sum(free), count), done)

    def waiting(loop: _Loop) -> jax.Array:
        """How many lanes an exchange would help."""
        more = (loop.lanes.held >= 0) | (loop.following < count)
        return jnp.sum(~_moves(how, options, loop.lanes.lane) & more)

    def busy(loop: _Loop) -> Flag:
        """An exchange costs about a trial: worth it for a few lanes, or when nothing else goes on."""
        return (waiting(loop) < PATIENCE) & jnp.any(_moves(how, options, loop.lanes.lane))

    def body(loop: _Loop) -> _Loop:
        loop = exchange(loop)

        def trials(loop: _Loop) -> _Loop:
            lane, done = loop.lanes.lane, loop.done
            useful = done.useful + jnp.sum(_moves(how, options, lane))
            lane = over_lanes(moves, loop.lanes.parts, lane)
            return loop._replace(
                lanes=loop.lanes._replace(lane=lane), done=done._replace(trials=done.trials + 1, useful=useful)
            )

        return jax.lax.while_loop(busy, trials, loop)

    blank = jax.eval_shape(
        functools.partial(over_lanes, lambda scene, lane: answers(scene, how, lane)), held.parts, held.lane
    )
    floats, integers = jax.tree.map(lambda y: jnp.zeros((size + lanes, *y.shape[1:]), y.dtype), blank)
    zero = jnp.zeros((), index_type)
    done = _Done(jnp.zeros(size + lanes, index_type), floats, integers, zero, zero, zero)
    start = jnp.where(refill, 0, jnp.minimum(count, lanes)).astype(index_type)
    loop = jax.lax.while_loop(
        lambda loop: (loop.following < count) | ((last | (not refill)) & jnp.any(loop.lanes.held >= 0)),
        body,
        _Loop(held, start, done),
    )
    return loop.lanes, loop.done


def _moves(how: Plan, options: Options, lane: Lane) -> Flag:
    """Whether a lane has trials to make; with nothing elastic, full contact is left by a leap at the next exchange."""
    going = runs(lane, options.max_steps)
    return going if how.elastic else going & (lane.sigma != 0)


def _automaton(how: Plan, options: Options):
    """One trial of a lane that moves; and what a lane in full contact does before it can: leap to its next uplift."""

    def moves(scene: Scene, lane: Lane) -> Lane:
        going = _moves(how, options, lane)
        after, _ = trial(scene, how, lane)
        return jax.tree.map(lambda new, old: jnp.where(going, new, old), after, lane)

    def settle(scene: Scene, lane: Lane) -> Lane:
        if how.elastic:
            return lane
        waits = (lane.sigma == 0) & runs(lane, options.max_steps)
        leapt, _ = leap(scene, how, lane)
        return jax.tree.map(lambda new, old: jnp.where(waits, new, old), leapt, lane)

    return moves, settle


class _Chunk(NamedTuple):
    """Scenes made ready: what differs between them has a row for each, what is common to all is there once."""

    parts: list[Any]  # of `Scene`: what differs
    common: list[Any]  # of `Scene`: what does not, None where it does
    structure: Any
    lane: Lane  # at the start
    lane_differs: Any

    def scene(self, parts) -> Scene:
        parts = iter(parts)
        return jax.tree.unflatten(self.structure, [next(parts) if y is None else y for y in self.common])

    def starts(self, lanes: int) -> Lane:
        def start(y, differs):
            return y[:lanes] if differs else jnp.broadcast_to(y, (lanes, *y.shape))

        return jax.tree.map(start, self.lane, self.lane_differs)


def _prepared(leaves, axes, structure, options: Options) -> _Chunk:
    how = plan(jax.tree.unflatten(structure, leaves)[0], options, history=False)
    _, settle = _automaton(how, options)

    def ready(*leaves) -> tuple[Scene, Lane]:
        podium, excitation, initial, t_end = jax.tree.unflatten(structure, leaves)
        scene, lane = prepare(podium, excitation, initial, t_end, options, how)
        return scene, settle(scene, lane)

    differs = _differing(ready, axes, leaves)
    out_axes = jax.tree.map(lambda flag: 0 if flag else None, differs)
    scenes, lane = jax.vmap(ready, in_axes=axes, out_axes=out_axes)(*leaves)
    flat, scene_structure = jax.tree.flatten(scenes)
    own = jax.tree.leaves(differs[0])
    parts = [y for y, flag in zip(flat, own, strict=True) if flag]
    common = [None if flag else y for y, flag in zip(flat, own, strict=True)]
    return _Chunk(parts, common, scene_structure, lane, differs[1])


_GLIDES = ("t", "mark", "x", "v", "piece", "code", "steps")  # what changes of a lane that crosses panels


def _glided(chunk: _Chunk, how: Plan, lanes: int, count) -> _Chunk:
    """The lanes of a chunk where they first have to step, worked out in blocks that fit the cache."""
    if not how.elastic:
        return chunk

    def block(arguments):
        def one(parts, lane: Lane):
            lane = glide(chunk.scene(parts), how, lane)
            return {name: getattr(lane, name) for name in _GLIDES}

        return jax.vmap(one)(*arguments)

    size = chunk.parts[0].shape[0]
    split = lambda y: y.reshape(size // lanes, lanes, *y.shape[1:])
    starts = chunk.starts(size)
    used = jnp.arange(size) < count  # what fills up the chunk goes nowhere
    starts = starts._replace(code=jnp.where(used, starts.code, results.END_OF_TIME))
    blocks = jax.tree.map(split, (chunk.parts, starts))
    moved = jax.tree.map(lambda y: y.reshape(size, *y.shape[2:]), jax.lax.map(block, blocks))
    differs = chunk.lane_differs._replace(**jax.tree.map(lambda _: True, moved))
    return chunk._replace(lane=chunk.lane._replace(**moved), lane_differs=differs)


def _idle(leaves, axes, structure, options: Options, lanes: int) -> _Lanes:
    """Lanes that hold nothing."""
    shapes = tuple((y.shape, y.dtype) for y in leaves)
    numbers, how = jax.tree.flatten(options)
    blank = _shapes_of_lanes(shapes, axes, structure, tuple(jnp.result_type(y) for y in numbers), how, lanes)
    lanes_: _Lanes = jax.tree.map(lambda y: np.zeros(y.shape, y.dtype), blank)
    code = np.full_like(lanes_.lane.code, results.END_OF_TIME)
    return lanes_._replace(lane=lanes_.lane._replace(code=code), held=np.full_like(lanes_.held, -1))


@functools.lru_cache(maxsize=256)
def _shapes_of_lanes(shapes, axes, structure, option_types, option_structure, lanes: int):
    def hold(leaves, numbers):
        chunk = _prepared(leaves, axes, structure, jax.tree.unflatten(option_structure, numbers))
        return _Lanes(chunk.starts(lanes), [y[:lanes] for y in chunk.parts], jnp.zeros(lanes, jnp.result_type(int)))

    numbers = [jax.ShapeDtypeStruct((), dtype) for dtype in option_types]
    return jax.eval_shape(hold, [jax.ShapeDtypeStruct(*shape) for shape in shapes], numbers)


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
