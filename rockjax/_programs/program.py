"""Functions that are traced and compiled once for each kind of arguments, in this process and in
later ones."""

from __future__ import annotations

import contextlib
import functools
import logging
import operator
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

ARRAYS = np.ndarray | np.generic | jax.Array  # tracers are instances, too
COUNTS = {"loaded": 0, "compiled": 0}  # programs in this process
_LOG = logging.getLogger("rockjax")
_ANNOUNCE_AFTER = 2.0  # s of compiling, after which a message announces it
# Settings that a program is traced under and that may change within a process.
_SETTINGS = operator.attrgetter(
    "jax_enable_x64",
    "jax_default_matmul_precision",
    "jax_numpy_dtype_promotion",
    "jax_numpy_rank_promotion",
)
# Level 1 compiles faster than JAX's level 3, and the programs are as fast.
_OPTIMISATION = {"xla_backend_optimization_level": 1}


class _StaticInputs(NamedTuple):
    """Static inputs of a program: everything besides the shapes and types of its arrays."""

    structure: Any
    leaves: tuple[Any, ...]  # static leaves: functions, texts, …; None in the place of a passed leaf
    keywords: tuple[tuple[str, Any], ...]


class KeptProgram:
    """A compiled function of pytrees of arrays and numbers; other leaves and keyword arguments are static.

    - `function`: the function
    - `donate`: positions of arguments whose buffers are reused
    - `arrays_only`: whether Python numbers are static, too
    - `compiler_options`: options of XLA
    - `name`: name in keys; by default that of the function
    - `words`: name of the program in progress bars

    Concrete arguments on the CPU run a program that is stored between processes: it is loaded without tracing
    and compiling, and gives bitwise the same answers. All other arguments, such as tracers, go through
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
        words: str = "the program for this kind of scene",
    ):
        functools.update_wrapper(self, function)
        self.name = name or f"{function.__module__}.{function.__qualname__}"
        self._words, self._function, self._donate = words, function, tuple(donate)
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

    def ahead(self, *arguments: Any, **keywords: Any) -> None:
        """Load or compile, in another thread, the program for arguments of these kinds."""
        passed, static = self._split(arguments, keywords)
        key = static, _types(passed), _SETTINGS(jax.config)

        def make() -> None:
            if _SETTINGS(jax.config) == key[2]:  # settings of the calling thread may not hold in this one
                self._make(key, passed)

        if key[1] is not None and key not in self._ready and _runs_on_one_cpu():
            submit(make)

    def traced(self, *arguments: Any, **keywords: Any) -> Any:
        """Call the function through `jax.jit`."""
        passed, static = self._split(arguments, keywords)
        return self._jit(static)(*passed)

    def forget(self) -> None:
        """Drop the programs of this process; those in the store stay."""
        for cache in (self._jits, self._ready, self._locks):
            cache.clear()

    def _split(self, arguments: tuple, keywords: dict[str, Any]) -> tuple[list, _StaticInputs]:
        leaves, structure = jax.tree.flatten(arguments)
        flags = [type(y) is np.ndarray or isinstance(y, self._passed) for y in leaves]
        passed = [y for y, is_passed in zip(leaves, flags, strict=True) if is_passed]
        static_leaves = tuple(None if is_passed else y for y, is_passed in zip(leaves, flags, strict=True))
        return passed, _StaticInputs(structure, static_leaves, tuple(sorted(keywords.items())))

    def _jit(self, static: _StaticInputs) -> Any:
        """Return the jitted function of the passed leaves alone."""
        if static not in self._jits:

            def function(*passed):
                remaining = iter(passed)
                leaves = [next(remaining) if y is None else y for y in static.leaves]
                return self._function(*jax.tree.unflatten(static.structure, leaves), **dict(static.keywords))

            function.__name__ = self._function.__name__
            argument = [
                k for k, part in enumerate(static.structure.children()) for _ in range(part.num_leaves)
            ]
            passed = [k for k, y in zip(argument, static.leaves, strict=True) if y is None]
            donated = [i for i, k in enumerate(passed) if k in self._donate]
            jitted = jax.jit(function, donate_argnums=donated, compiler_options=self._options or None)
            return self._jits.setdefault(static, jitted)
        return self._jits[static]

    def _make(self, key: Any, passed: list) -> Callable:
        """Load or compile the program of a key."""
        # One thread compiles while others wait. A tracing thread must not wait, since the first one may wait
        # for its turn to trace.
        lock = self._locks.setdefault(key, threading.Lock())
        with contextlib.nullcontext() if _THREAD_STATE.tracing else lock:
            if key not in self._ready:
                self._ready[key] = self._load_or_compile(passed, key[0])
            return self._ready[key]

    def _load_or_compile(self, passed: list, static: _StaticInputs) -> Callable:
        options = _OPTIMISATION | self._options
        compile_key = f"{self.name}\ndonated {self._donate}, {options}"
        stored, text = store.enabled(), None
        with contextlib.suppress(keys.NoKeyError):
            if stored:
                argument_key = f"{keys.describe(tuple(static))}\n{keys.describe_shapes(passed)}"
                text = f"{compile_key}\n{keys.source_hash()}\n{keys.describe_machine()}\n{argument_key}"
        found = _load(text) if text else None
        if found is not None:
            return found
        with compiling(self._words):
            with _tracing():
                lowered = self._jit(static).lower(*passed)
            if stored and not text:  # user-defined classes: identified by the trace
                # Empty branches of the answers' tree leave no trace in the text of the program.
                text = f"{compile_key}\n{keys.describe_machine()}\n{lowered.out_tree}\n{lowered.as_text()}"
                found = _load(text)
            if found is not None:
                return found
            _watch_cache_hits()
            _THREAD_STATE.from_jax = False
            compiled = lowered.compile(compiler_options=options)
        COUNTS["compiled"] += 1
        # XLA cannot serialise programs that it has loaded from JAX's own cache.
        if text and not _THREAD_STATE.from_jax:
            _PENDING_WRITES.append(submit(_write, text, compiled))
        return compiled


_PROGRAMS: list[KeptProgram] = []
_PENDING_WRITES: list[Future] = []  # programs on their way into the store


class _ThreadState(threading.local):
    tracing = False  # whether this thread has its turn to trace
    from_jax = False  # whether what it compiled last came from JAX's own cache


_THREAD_STATE = _ThreadState()
_TRACE_LOCK = threading.RLock()


@contextlib.contextmanager
def _tracing() -> Iterator[None]:
    """Trace inside, one thread at a time: concurrent tracing delays compilation in other threads."""
    with _TRACE_LOCK:
        before, _THREAD_STATE.tracing = _THREAD_STATE.tracing, True
        try:
            yield
        finally:
            _THREAD_STATE.tracing = before


@functools.cache
def _watch_cache_hits() -> None:
    def record_event(event: str, **_) -> None:
        _THREAD_STATE.from_jax |= event == "/jax/compilation_cache/cache_hits"

    jax.monitoring.register_event_listener(record_event)


def _load(text: str) -> Callable | None:
    """Return a stored program, None if there is no usable one."""
    content = store.read(text)
    if content is None:
        return None
    try:
        program, arguments, answers = pickle.loads(content)
        if b"lapack" in program:
            _register_lapack()
        found = deserialize_and_load(program, arguments, answers, execution_devices=[_cpu()])
    except Exception as error:  # a changed format, a class that no longer exists
        _LOG.debug("a stored program cannot be loaded: %r", error)
        store.discard(text)
        return None
    COUNTS["loaded"] += 1
    return found


@functools.cache
def _register_lapack() -> None:
    """Register LAPACK with XLA. JAX does so when it lowers the first program that needs it; without this, a
    program that is only loaded would call a missing function and crash the process."""
    jax.jit(jax.numpy.linalg.cholesky).lower(np.eye(1))


def _write(text: str, compiled: Any) -> None:
    """Store a program, if possible."""
    try:
        content = serialize(compiled)
        # A tree of modules does not survive storage, and would fail when the program is called: fail now.
        answers = pickle.loads(pickle.dumps(content[2]))
        jax.tree.unflatten(answers, range(answers.num_leaves))
        store.write(text, pickle.dumps(content))
    except Exception as error:  # a full disk, a program that cannot be serialised
        _LOG.debug("a program cannot be stored: %r", error)


def finish_writing() -> None:
    """Wait until all compiled programs are stored."""
    wait(_PENDING_WRITES)
    _PENDING_WRITES.clear()


def forget() -> None:
    """Drop all programs of this process, including JAX's; those in the store stay."""
    for program in _PROGRAMS:
        program.forget()
    jax.clear_caches()


_COMPILING: list[str] = []
_ANNOUNCED = threading.Event()


@contextlib.contextmanager
def compiling(what: str) -> Iterator[None]:
    """Name the program being compiled inside, for progress bars; once per process a message announces a long
    compilation."""
    _COMPILING.append(what)
    timer = threading.Timer(_ANNOUNCE_AFTER, _announce)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
        _COMPILING.remove(what)


def current_compilation() -> str | None:
    """Return the name of the program being compiled, the latest of several; None if there is none."""
    names = _COMPILING[-1:]  # another thread may remove it
    return names[0] if names else None


def _announce() -> None:
    if not _ANNOUNCED.is_set():
        _ANNOUNCED.set()
        stored_note = f"it is kept in {store.folder()}, and only loaded the next time"
        note = stored_note if store.enabled() else "it is not kept (ROCKJAX_CACHE is off)"
        _LOG.warning("compiling a program for this kind of scene, which may take some seconds; %s", note)


@functools.cache
def _cpu() -> Any:
    return jax.local_devices(backend="cpu")[0]


def _types(leaves: list[Any]) -> tuple[Hashable, ...] | None:
    """Return the shapes and types of numbers and arrays; None unless all are concrete and on the CPU."""
    cpu_sharding, found = jax.sharding.SingleDeviceSharding(_cpu()), []
    for y in leaves:
        if isinstance(y, np.ndarray | np.generic):
            found.append((y.shape, y.dtype, False))
        elif isinstance(y, Tracer) or (isinstance(y, jax.Array) and y.sharding != cpu_sharding):
            return None
        else:
            found.append((y.shape, y.dtype, y.weak_type) if isinstance(y, jax.Array) else type(y))
    return tuple(found)


def _runs_on_one_cpu() -> bool:
    """Return whether programs run on a single CPU and JAX's settings do not change how."""
    settings: Any = jax.config
    uses_cpu = settings.jax_default_device in (None, "cpu", _cpu()) and jax.default_backend() == "cpu"
    is_debugged = settings.jax_disable_jit or settings.jax_check_tracer_leaks
    return uses_cpu and not is_debugged and jax.process_count() == 1


@contextlib.contextmanager
def nans_allowed() -> Iterator[None]:
    """Disable JAX's checks for NaN and inf inside: answers use them for "none" and "not requested"."""
    settings: Any = jax.config
    if settings.jax_debug_nans or settings.jax_debug_infs:
        with jax.debug_nans(False), jax.debug_infs(False):
            yield
    else:
        yield
