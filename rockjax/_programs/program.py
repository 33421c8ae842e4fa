"""Compiled functions that are stored on disk.

A function is traced and compiled once for each combination of tree structure, static values, shapes and types
of its arguments. This process and later ones then use the compiled program.
"""

from __future__ import annotations

import contextlib
import functools
import logging
import operator
import os
import pickle
import threading
from collections.abc import Callable, Hashable, Iterator, Sequence
from concurrent.futures import Future, wait
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.core import Tracer
from jax.experimental.serialize_executable import deserialize_and_load, serialize

from rockjax._machine.threads import submit

from . import key as keys
from . import store

ARRAYS = np.ndarray | np.generic | jax.Array  # includes tracers
COUNTS = {"loaded": 0, "compiled": 0}  # numbers of programs that this process has loaded and compiled
_LOG = logging.getLogger("rockjax")
_ANNOUNCE_AFTER = 2.0  # duration of a compilation after which a message announces it [s]
# JAX's settings that affect tracing, and that a user may change within a process.
_SETTINGS = operator.attrgetter(
    "jax_enable_x64",
    "jax_default_matmul_precision",
    "jax_numpy_dtype_promotion",
    "jax_numpy_rank_promotion",
)
# XLA takes a multiple of the time if more threads load or compile programs than there are cores.
_XLA_TURNS = threading.Semaphore(os.cpu_count() or 1)
# Level 1 compiles faster than JAX's default level 3, and the programs run equally fast. Level 0 compiles in
# two thirds of the time, but its programs take up to nine times as long.
_OPTIMISATION = {"xla_backend_optimization_level": 1}


class _StaticInputs(NamedTuple):
    """Static inputs of a program: all inputs except the arrays and numbers that are passed to it."""

    structure: Any  # tree structure of the arguments
    leaves: tuple[Any, ...]  # static leaves, such as functions; None in place of each passed leaf
    keywords: tuple[tuple[str, Any], ...]  # keyword arguments, sorted by name


class StoredProgram:
    """A compiled function whose arguments are pytrees of arrays and numbers. Other leaves and keyword
    arguments are static.

    - `function`: the function
    - `donate`: positions of arguments whose memory may be reused for the result
    - `arrays_only`: True if Python numbers are static, too
    - `compiler_options`: options of XLA; None for the defaults
    - `name`: name of the program in its key; by default the full name of the function
    - `description`: name of the program in progress bars

    If the arguments are not traced and JAX runs on a single CPU device, a program that is in the store is
    loaded instead of compiled. It is not traced either, unless the arguments contain user-defined classes or
    functions. The loaded program gives bitwise the same results as the program that was stored. If the
    arguments are traced, or JAX does not run on a single CPU device, the function is called through
    `jax.jit`.
    """

    def __init__(
        self,
        function: Callable,
        *,
        donate: Sequence[int] = (),
        arrays_only: bool = False,
        compiler_options: dict[str, Any] | None = None,
        name: str | None = None,
        description: str = "the program for this kind of scene",
    ):
        functools.update_wrapper(self, function)
        self.name = name or f"{function.__module__}.{function.__qualname__}"
        self._description, self._function, self._donate = description, function, tuple(donate)
        self._options = compiler_options or {}
        self._passed = ARRAYS if arrays_only else ARRAYS | bool | int | float
        self._jits: dict[_StaticInputs, Any] = {}
        self._ready: dict[Hashable, Callable] = {}
        self._locks: dict[Hashable, threading.Lock] = {}
        _PROGRAMS.append(self)

    def __call__(self, *arguments: Any, **keywords: Any) -> Any:
        passed, static = self._split(arguments, keywords)
        types = _types(passed)
        if types is None:
            return self._jit(static)(*passed)
        with nans_allowed():
            if not _runs_on_one_cpu():
                return self._jit(static)(*passed)
            key = static, types, _SETTINGS(jax.config)
            return (self._ready.get(key) or self._make(key, passed))(*passed)

    def prepare(self, *arguments: Any, **keywords: Any) -> None:
        """Start to load or compile the program for these arguments in another thread. Do nothing if the
        program is ready, or if the function would be called through `jax.jit`."""
        passed, static = self._split(arguments, keywords)
        key = static, _types(passed), _SETTINGS(jax.config)

        def make() -> None:
            if _SETTINGS(jax.config) == key[2]:  # settings may apply to the calling thread only
                self._make(key, passed)

        if key[1] is not None and key not in self._ready and _runs_on_one_cpu():
            submit(make)

    def through_jit(self, *arguments: Any, **keywords: Any) -> Any:
        """Call the function through `jax.jit`, without the store."""
        passed, static = self._split(arguments, keywords)
        return self._jit(static)(*passed)

    def forget(self) -> None:
        """Drop this function's programs from memory. Programs on disk stay."""
        for cache in (self._jits, self._ready, self._locks):
            cache.clear()

    def _split(self, arguments: tuple, keywords: dict[str, Any]) -> tuple[list, _StaticInputs]:
        """Return the leaves that are passed to the program, and its static inputs."""
        leaves, structure = jax.tree.flatten(arguments)
        flags = [type(y) is np.ndarray or isinstance(y, self._passed) for y in leaves]
        passed = [y for y, is_passed in zip(leaves, flags, strict=True) if is_passed]
        static_leaves = tuple(None if is_passed else y for y, is_passed in zip(leaves, flags, strict=True))
        return passed, _StaticInputs(structure, static_leaves, tuple(sorted(keywords.items())))

    def _jit(self, static: _StaticInputs) -> Any:
        """Return the jitted function of the passed leaves."""
        if static not in self._jits:

            def function(*passed):
                remaining = iter(passed)
                leaves = [next(remaining) if y is None else y for y in static.leaves]
                return self._function(*jax.tree.unflatten(static.structure, leaves), **dict(static.keywords))

            function.__name__ = self._function.__name__
            argument_of_leaf = [
                k for k, child in enumerate(static.structure.children()) for _ in range(child.num_leaves)
            ]
            passed = [k for k, y in zip(argument_of_leaf, static.leaves, strict=True) if y is None]
            donated = [i for i, k in enumerate(passed) if k in self._donate]
            jitted = jax.jit(function, donate_argnums=donated, compiler_options=self._options or None)
            return self._jits.setdefault(static, jitted)
        return self._jits[static]

    def _make(self, key: Any, passed: list) -> Callable:
        """Load or compile the program of a key, once for all threads."""
        # One thread compiles a program, and other threads that need it wait. A thread that holds the tracing
        # lock must not wait, because the compiling thread may need the tracing lock.
        lock = self._locks.setdefault(key, threading.Lock())
        with contextlib.nullcontext() if _THREAD_STATE.tracing else lock:
            if key not in self._ready:
                self._ready[key] = self._load_or_compile(passed, key[0])
            return self._ready[key]

    def _load_or_compile(self, passed: list, static: _StaticInputs) -> Callable:
        """Return the program from the store, or compile and store it."""
        options = _OPTIMISATION | self._options
        compile_key = f"{self.name}\ndonated {self._donate}, {options}"
        uses_store, key = store.enabled(), None
        with contextlib.suppress(keys.NoKeyError):
            if uses_store:
                argument_key = f"{keys.describe(tuple(static))}\n{keys.describe_shapes(passed)}"
                key = f"{compile_key}\n{keys.source_hash()}\n{keys.describe_machine()}\n{argument_key}"
        loaded = _load(key) if key else None
        if loaded is not None:
            return loaded
        with compiling(self._description):
            with _tracing():
                lowered = self._jit(static).lower(*passed)
            if uses_store and not key:
                # The text of the lowered program identifies user-defined classes and functions. It does not
                # show unused arguments and empty branches of the tree of answers, so the key has both trees.
                trees = f"{keys.describe_shapes(passed)}\n{lowered.out_tree}"
                key = f"{compile_key}\n{keys.describe_machine()}\n{trees}\n{lowered.as_text()}"
                loaded = _load(key)
            if loaded is not None:
                return loaded
            _watch_cache_hits()
            _THREAD_STATE.from_jax = False
            with _XLA_TURNS:
                compiled = lowered.compile(compiler_options=options)
        COUNTS["compiled"] += 1
        # XLA cannot serialise programs that come from JAX's own compilation cache.
        if key and not _THREAD_STATE.from_jax:
            _PENDING_WRITES.append(submit(_write, key, compiled))
        return compiled


_PROGRAMS: list[StoredProgram] = []  # all instances
_PENDING_WRITES: list[Future] = []  # programs that are being written to the store


class _ThreadState(threading.local):
    """State of the calling thread."""

    tracing = False  # True while this thread holds the tracing lock
    from_jax = False  # True if the last program of this thread came from JAX's own cache


_THREAD_STATE = _ThreadState()
_TRACE_LOCK = threading.RLock()


@contextlib.contextmanager
def _tracing() -> Iterator[None]:
    """Hold the tracing lock, so that only one thread traces at a time. Concurrent tracing would delay
    compilation in other threads."""
    with _TRACE_LOCK:
        before, _THREAD_STATE.tracing = _THREAD_STATE.tracing, True
        try:
            yield
        finally:
            _THREAD_STATE.tracing = before


@functools.cache
def _watch_cache_hits() -> None:
    """Make JAX set `_THREAD_STATE.from_jax` whenever it takes a program from its own compilation cache."""

    def record_event(event: str, **_) -> None:
        _THREAD_STATE.from_jax |= event == "/jax/compilation_cache/cache_hits"

    jax.monitoring.register_event_listener(record_event)


def _load(key: str) -> Callable | None:
    """Return the program stored under a key; None if nothing is stored there or it cannot be loaded."""
    content = store.read(key)
    if content is None:
        return None
    try:
        program, arguments, answers = pickle.loads(content)
        if b"lapack" in program:
            _register_lapack()
        with _XLA_TURNS:
            loaded = deserialize_and_load(program, arguments, answers, execution_devices=[_cpu()])
    except Exception as error:  # a changed format, or a class that no longer exists
        _LOG.debug("a stored program cannot be loaded: %r", error)
        store.discard(key)
        return None
    COUNTS["loaded"] += 1
    return loaded


@functools.cache
def _register_lapack() -> None:
    """Register LAPACK with XLA.

    JAX registers LAPACK when it lowers the first program that needs LAPACK. A loaded program is not lowered.
    Without the registration, a loaded program would call a missing function and crash the process.
    """
    jax.jit(jax.numpy.linalg.cholesky).lower(np.eye(1))


def _write(key: str, compiled: Any) -> None:
    """Store a program under a key, if possible."""
    try:
        content = serialize(compiled)
        # Some trees of answers cannot be rebuilt after pickling. Rebuilding the tree here raises this error
        # before the program is stored.
        answers = pickle.loads(pickle.dumps(content[2]))
        jax.tree.unflatten(answers, range(answers.num_leaves))
        store.write(key, pickle.dumps(content))
    except Exception as error:  # a full disk, or a program that cannot be serialised
        _LOG.debug("a program cannot be stored: %r", error)


def finish_writing() -> None:
    """Wait until all compiled programs are stored."""
    wait(_PENDING_WRITES)
    _PENDING_WRITES.clear()


def forget() -> None:
    """Drop all programs from memory, including JAX's. Programs on disk stay."""
    for program in _PROGRAMS:
        program.forget()
    jax.clear_caches()


_COMPILING: list[str] = []
_ANNOUNCED = threading.Event()


@contextlib.contextmanager
def compiling(name: str) -> Iterator[None]:
    """Register the name of the program that the `with` block compiles, for progress bars. A log message
    announces the first compilation in a process that takes more than 2 s."""
    _COMPILING.append(name)
    timer = threading.Timer(_ANNOUNCE_AFTER, _announce)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
        _COMPILING.remove(name)


def current_compilation() -> str | None:
    """Return the name of the program whose compilation started last; None if none is being compiled."""
    names = _COMPILING[-1:]  # a slice, because another thread may empty the list in between
    return names[0] if names else None


def _announce() -> None:
    """Log, once per process, that a program is being compiled."""
    if not _ANNOUNCED.is_set():
        _ANNOUNCED.set()
        stored_note = f"the program is stored in {store.folder()}, and later processes only load it"
        reason = store.reason_unused()
        note = f"the program is not stored: {reason}" if reason else stored_note
        _LOG.warning("compiling a program for this kind of scene, which may take some seconds; %s", note)


@functools.cache
def _cpu() -> Any:
    return jax.local_devices(backend="cpu")[0]


def _types(leaves: list[Any]) -> tuple[Hashable, ...] | None:
    """Return the shapes and types of numbers and arrays; None if one of them is traced or not on the first
    CPU device."""
    cpu_sharding, types = jax.sharding.SingleDeviceSharding(_cpu()), []
    for y in leaves:
        if isinstance(y, np.ndarray | np.generic):
            types.append((y.shape, y.dtype, False))
        elif isinstance(y, Tracer) or (isinstance(y, jax.Array) and y.sharding != cpu_sharding):
            return None
        else:
            types.append((y.shape, y.dtype, y.weak_type) if isinstance(y, jax.Array) else type(y))
    return tuple(types)


def _runs_on_one_cpu() -> bool:
    """Return whether programs run on a single CPU device in a single process, without JAX's debugging
    settings."""
    settings: Any = jax.config
    uses_cpu = settings.jax_default_device in (None, "cpu", _cpu()) and jax.default_backend() == "cpu"
    is_debugged = settings.jax_disable_jit or settings.jax_check_tracer_leaks
    return uses_cpu and not is_debugged and jax.process_count() == 1


@contextlib.contextmanager
def nans_allowed() -> Iterator[None]:
    """Disable JAX's checks for NaN and inf in the `with` block. Both are valid answers, for "none" or "not
    requested"."""
    settings: Any = jax.config
    if settings.jax_debug_nans or settings.jax_debug_infs:
        with jax.debug_nans(False), jax.debug_infs(False):
            yield
    else:
        yield
