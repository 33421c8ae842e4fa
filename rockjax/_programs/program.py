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
_PATIENCE = 2.0  # s of compiling, after which a message announces it
# Settings that a program is traced under and that may change within a process.
_SETTINGS = operator.attrgetter(
    "jax_enable_x64",
    "jax_default_matmul_precision",
    "jax_numpy_dtype_promotion",
    "jax_numpy_rank_promotion",
)
# Level 1 compiles faster than JAX's level 3, and the programs are as fast.
_LEVEL = {"xla_backend_optimization_level": 1}


class _Fixed(NamedTuple):
    """Static inputs of a program: everything besides the shapes and types of its arrays."""

    structure: Any
    leaves: tuple[Any, ...]  # static leaves: functions, texts, …; None in the place of a passed leaf
    named: tuple[tuple[str, Any], ...]


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
        self._jits: dict[_Fixed, Any] = {}
        self._ready: dict[Hashable, Callable] = {}
        self._locks: dict[Hashable, threading.Lock] = {}
        _ALL.append(self)

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        passed, fixed = self._split(arguments, named)
        types = _types(passed)
        if types is None:
            return self._jit(fixed)(*passed)
        with nans_allowed():
            if not _on_one_cpu():
                return self._jit(fixed)(*passed)
            key = fixed, types, _SETTINGS(jax.config)
            return (self._ready.get(key) or self._make(key, passed))(*passed)

    def ahead(self, *arguments: Any, **named: Any) -> None:
        """Load or compile, in another thread, the program for arguments of these kinds."""
        passed, fixed = self._split(arguments, named)
        key = fixed, _types(passed), _SETTINGS(jax.config)

        def make() -> None:
            if _SETTINGS(jax.config) == key[2]:  # settings of the calling thread may not hold in this one
                self._make(key, passed)

        if key[1] is not None and key not in self._ready and _on_one_cpu():
            submit(make)

    def traced(self, *arguments: Any, **named: Any) -> Any:
        """Call the function through `jax.jit`."""
        passed, fixed = self._split(arguments, named)
        return self._jit(fixed)(*passed)

    def forget(self) -> None:
        """Drop the programs of this process; those in the store stay."""
        for held in (self._jits, self._ready, self._locks):
            held.clear()

    def _split(self, arguments: tuple, named: dict[str, Any]) -> tuple[list, _Fixed]:
        leaves, structure = jax.tree.flatten(arguments)
        passes = [type(y) is np.ndarray or isinstance(y, self._passed) for y in leaves]
        passed = [y for y, goes in zip(leaves, passes, strict=True) if goes]
        static = tuple(None if goes else y for y, goes in zip(leaves, passes, strict=True))
        return passed, _Fixed(structure, static, tuple(sorted(named.items())))

    def _jit(self, fixed: _Fixed) -> Any:
        """Return the jitted function of the passed leaves alone."""
        if fixed not in self._jits:

            def function(*passed):
                rest = iter(passed)
                leaves = [next(rest) if y is None else y for y in fixed.leaves]
                return self._function(*jax.tree.unflatten(fixed.structure, leaves), **dict(fixed.named))

            function.__name__ = self._function.__name__
            argument = [
                k for k, part in enumerate(fixed.structure.children()) for _ in range(part.num_leaves)
            ]
            passed = [k for k, y in zip(argument, fixed.leaves, strict=True) if y is None]
            donated = [i for i, k in enumerate(passed) if k in self._donate]
            jitted = jax.jit(function, donate_argnums=donated, compiler_options=self._options or None)
            return self._jits.setdefault(fixed, jitted)
        return self._jits[fixed]

    def _make(self, key: Any, passed: list) -> Callable:
        """Load or compile the program of a key."""
        # One thread compiles while others wait. A tracing thread must not wait, since the first one may wait
        # for its turn to trace.
        lock = self._locks.setdefault(key, threading.Lock())
        with contextlib.nullcontext() if _THREAD.tracing else lock:
            if key not in self._ready:
                self._ready[key] = self._load_or_compile(passed, key[0])
            return self._ready[key]

    def _load_or_compile(self, passed: list, fixed: _Fixed) -> Callable:
        options = _LEVEL | self._options
        how = f"{self.name}\ndonated {self._donate}, {options}"
        stored, text = store.enabled(), None
        with contextlib.suppress(keys.Unknown):
            if stored:
                what = f"{keys.describe(tuple(fixed))}\n{keys.shapes(passed)}"
                text = f"{how}\n{keys.source()}\n{keys.machine()}\n{what}"
        found = _load(text) if text else None
        if found is not None:
            return found
        with compiling(self._words):
            with _tracing():
                lowered = self._jit(fixed).lower(*passed)
            if stored and not text:  # user-defined classes: identified by the trace
                text = f"{how}\n{keys.machine()}\n{lowered.as_text()}"
                found = _load(text)
            if found is not None:
                return found
            _listen()
            _THREAD.from_jax = False
            compiled = lowered.compile(compiler_options=options)
        COUNTS["compiled"] += 1
        # XLA cannot serialise programs that it has loaded from JAX's own cache.
        if text and not _THREAD.from_jax:
            _WRITING.append(submit(_write, text, compiled))
        return compiled


_ALL: list[KeptProgram] = []
_WRITING: list[Future] = []  # programs on their way into the store


class _Thread(threading.local):
    tracing = False  # whether this thread has its turn to trace
    from_jax = False  # whether what it compiled last came from JAX's own cache


_THREAD = _Thread()
_TURN = threading.RLock()


@contextlib.contextmanager
def _tracing() -> Iterator[None]:
    """Trace inside, one thread at a time: concurrent tracing delays compilation in other threads."""
    with _TURN:
        before, _THREAD.tracing = _THREAD.tracing, True
        try:
            yield
        finally:
            _THREAD.tracing = before


@functools.cache
def _listen() -> None:
    def happened(event: str, **_) -> None:
        _THREAD.from_jax |= event == "/jax/compilation_cache/cache_hits"

    jax.monitoring.register_event_listener(happened)


def _load(text: str) -> Callable | None:
    """Return a stored program, None if there is no usable one."""
    content = store.read(text)
    if content is None:
        return None
    try:
        program, arguments, answers = pickle.loads(content)
        if b"lapack" in program:
            _find_lapack()
        found = deserialize_and_load(program, arguments, answers, execution_devices=[_cpu()])
    except Exception as error:  # a changed format, a class that no longer exists
        _LOG.debug("a stored program cannot be loaded: %r", error)
        store.discard(text)
        return None
    COUNTS["loaded"] += 1
    return found


@functools.cache
def _find_lapack() -> None:
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
    wait(_WRITING)
    _WRITING.clear()


def forget() -> None:
    """Drop all programs of this process, including JAX's; those in the store stay."""
    for program in _ALL:
        program.forget()
    jax.clear_caches()


_PRESENT: list[str] = []
_SAID = threading.Event()


@contextlib.contextmanager
def compiling(what: str) -> Iterator[None]:
    """Name the program being compiled inside, for progress bars; once per process a message announces a long
    compilation."""
    _PRESENT.append(what)
    timer = threading.Timer(_PATIENCE, _say)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
        _PRESENT.remove(what)


def present_compilation() -> str | None:
    """Return the name of the program being compiled, the latest of several; None if there is none."""
    names = _PRESENT[-1:]  # another thread may remove it
    return names[0] if names else None


def _say() -> None:
    if not _SAID.is_set():
        _SAID.set()
        kept = f"it is kept in {store.folder()}, and only loaded the next time"
        then = kept if store.enabled() else "it is not kept (ROCKJAX_CACHE is off)"
        _LOG.warning("compiling a program for this kind of scene, which may take some seconds; %s", then)


@functools.cache
def _cpu() -> Any:
    return jax.local_devices(backend="cpu")[0]


def _types(leaves: list[Any]) -> tuple[Hashable, ...] | None:
    """Return the shapes and types of numbers and arrays; None unless all are concrete and on the CPU."""
    here, found = jax.sharding.SingleDeviceSharding(_cpu()), []
    for y in leaves:
        if isinstance(y, np.ndarray | np.generic):
            found.append((y.shape, y.dtype, False))
        elif isinstance(y, Tracer) or (isinstance(y, jax.Array) and y.sharding != here):
            return None
        else:
            found.append((y.shape, y.dtype, y.weak_type) if isinstance(y, jax.Array) else type(y))
    return tuple(found)


def _on_one_cpu() -> bool:
    """Return whether programs run on a single CPU and JAX's settings do not change how."""
    settings: Any = jax.config
    usual = settings.jax_default_device in (None, "cpu", _cpu()) and jax.default_backend() == "cpu"
    debugged = settings.jax_disable_jit or settings.jax_check_tracer_leaks
    return usual and not debugged and jax.process_count() == 1


@contextlib.contextmanager
def nans_allowed() -> Iterator[None]:
    """Disable JAX's checks for NaN and inf inside: answers use them for "none" and "not requested"."""
    settings: Any = jax.config
    if settings.jax_debug_nans or settings.jax_debug_infs:
        with jax.debug_nans(False), jax.debug_infs(False):
            yield
    else:
        yield
